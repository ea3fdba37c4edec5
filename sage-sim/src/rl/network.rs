//! A network with two hidden ReLU layers and a linear output layer, and its backward pass.
//!
//! All parameters lie in one slice, in the order of their names: `l1.weight` [h₁, inputs], `l1.bias`, `l2.weight`
//! [h₂, h₁], `l2.bias`, `l3.weight` [outputs, h₂], `l3.bias`, row-major as in PyTorch.

use std::ops::Range;

use sage_core::seed::Rng;

use super::kernels::{
    NarrowGradients, Real, Rows, add_bias_relu, mask, mask_and_sum, narrow_layer, narrow_layer_backward,
    positive_part, times, times_first_columns, times_transposed, transposed_times,
};

/// Sizes of a network.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Numbers that go in.
    pub inputs: usize,
    /// Units of the hidden layers.
    pub hidden: [usize; 2],
    /// Numbers that come out.
    pub outputs: usize,
}

impl Shape {
    /// Name and shape of each parameter tensor, in the order of the slice.
    pub fn tensors(&self) -> [(&'static str, Vec<usize>); 6] {
        let Self { inputs, hidden: [h1, h2], outputs } = *self;
        [
            ("l1.weight", vec![h1, inputs]),
            ("l1.bias", vec![h1]),
            ("l2.weight", vec![h2, h1]),
            ("l2.bias", vec![h2]),
            ("l3.weight", vec![outputs, h2]),
            ("l3.bias", vec![outputs]),
        ]
    }

    /// Number of parameters.
    pub fn count(&self) -> usize {
        self.tensors().iter().map(|(_, shape)| shape.iter().product::<usize>()).sum()
    }

    /// Where each tensor lies in the slice of the parameters.
    pub(super) fn ranges(&self) -> [Range<usize>; 6] {
        let mut end = 0;
        self.tensors().map(|(_, shape)| {
            let start = end;
            end += shape.iter().product::<usize>();
            start..end
        })
    }
}

/// A network.
#[derive(Clone, Debug, PartialEq)]
pub struct Network<T> {
    shape: Shape,
    parameters: Vec<T>,
}

/// Outputs of the layers for a batch, kept for the backward pass.
#[derive(Clone, Debug)]
pub(super) struct Activations<T> {
    pub(super) first: Vec<T>,
    pub(super) second: Vec<T>,
    pub(super) output: Vec<T>,
}

/// Working memory of [`Network::forward_one`].
#[derive(Clone, Debug, Default)]
pub struct SingleRow<T> {
    first: Vec<T>,
    second: Vec<T>,
}

/// Gradients of a batch before the ReLUs.
#[derive(Clone, Debug)]
pub(super) struct HiddenGradients<T> {
    pub(super) first: Vec<T>,
    second: Vec<T>,
}

impl<T: Real> Activations<T> {
    pub(super) fn new(rows: usize, shape: &Shape) -> Self {
        let zeros = |width: usize| vec![T::default(); rows * width];
        Self { first: zeros(shape.hidden[0]), second: zeros(shape.hidden[1]), output: zeros(shape.outputs) }
    }
}

impl<T: Real> HiddenGradients<T> {
    pub(super) fn new(rows: usize, shape: &Shape) -> Self {
        let zeros = |width: usize| vec![T::default(); rows * width];
        Self { first: zeros(shape.hidden[0]), second: zeros(shape.hidden[1]) }
    }
}

impl<T: Real> Network<T> {
    /// PyTorch's initial values: weights and biases uniform within ±1/√(inputs of the layer).
    pub fn random(shape: Shape, rng: &mut Rng) -> Self {
        let fans = [shape.inputs, shape.hidden[0], shape.hidden[1]];
        let mut parameters = Vec::with_capacity(shape.count());
        for (k, (_, tensor)) in shape.tensors().iter().enumerate() {
            let bound = 1.0 / (fans[k / 2] as f64).sqrt();
            parameters
                .extend((0..tensor.iter().product::<usize>()).map(|_| T::of(rng.uniform(-bound, bound))));
        }
        Self { shape, parameters }
    }

    /// Orthogonal weights (Saxe et al. 2014, arXiv 1312.6120) times a gain for each layer, and biases of 0.
    pub fn orthogonal(shape: Shape, gains: [f64; 3], rng: &mut Rng) -> Self {
        let mut parameters = Vec::with_capacity(shape.count());
        for (k, (_, tensor)) in shape.tensors().iter().enumerate() {
            match tensor[..] {
                [rows, columns] => {
                    let weights = orthogonal_rows(rows, columns, rng);
                    parameters.extend(weights.into_iter().map(|x| T::of(gains[k / 2] * x)));
                }
                _ => parameters.resize(parameters.len() + tensor[0], T::default()),
            }
        }
        Self { shape, parameters }
    }

    /// A network with given parameters; `None` if they are not as many as the shape has.
    pub fn of(shape: Shape, parameters: Vec<T>) -> Option<Self> {
        (parameters.len() == shape.count()).then_some(Self { shape, parameters })
    }

    /// Sizes.
    pub fn shape(&self) -> &Shape {
        &self.shape
    }

    /// All parameters.
    pub fn parameters(&self) -> &[T] {
        &self.parameters
    }

    pub(super) fn parameters_mut(&mut self) -> &mut [T] {
        &mut self.parameters
    }

    /// Name of the first tensor with a number that is not finite.
    pub fn not_finite(&self) -> Option<&'static str> {
        let is_bad =
            |range: &Range<usize>| self.parameters[range.clone()].iter().any(|x| !x.wide().is_finite());
        let (names, ranges) = (self.shape.tensors(), self.shape.ranges());
        names.iter().zip(&ranges).find(|(_, range)| is_bad(range)).map(|((name, _), _)| *name)
    }

    fn tensors(&self) -> [&[T]; 6] {
        self.shape.ranges().map(|range| &self.parameters[range])
    }

    /// Outputs for a batch of inputs, row-major.
    pub(super) fn forward(&self, inputs: &[T], to: &mut Activations<T>) {
        let Shape { inputs: width, hidden: [h1, h2], .. } = self.shape;
        let rows = inputs.len() / width;
        let [w1, b1, w2, b2, w3, b3] = self.tensors();
        times_transposed(&mut to.first, Rows::new(inputs, [rows, width]), Rows::new(w1, [h1, width]));
        add_bias_relu(&mut to.first, b1);
        times_transposed(&mut to.second, Rows::new(&to.first, [rows, h1]), Rows::new(w2, [h2, h1]));
        add_bias_relu(&mut to.second, b2);
        narrow_layer(&mut to.output, &to.second, w3, b3);
    }

    /// Outputs for one input. It differs from a row of a batch by rounding only, and takes no memory but `memory`.
    pub fn forward_one(&self, input: &[T], memory: &mut SingleRow<T>, output: &mut [T]) {
        let [w1, b1, w2, b2, w3, b3] = self.tensors();
        let SingleRow { first, second } = memory;
        first.resize(b1.len(), T::default());
        second.resize(b2.len(), T::default());
        narrow_layer(first, input, w1, b1);
        positive_part(first);
        narrow_layer(second, first, w2, b2);
        positive_part(second);
        narrow_layer(output, second, w3, b3);
    }

    /// Gradients of all parameters from those of the outputs.
    pub(super) fn backward(
        &self,
        inputs: &[T],
        at: &Activations<T>,
        output: &[T],
        hidden: &mut HiddenGradients<T>,
        gradient: &mut [T],
    ) {
        let Shape { inputs: width, hidden: [h1, h2], outputs } = self.shape;
        let rows = inputs.len() / width;
        let [_, _, w2, _, w3, _] = self.tensors();
        let [r1, rb1, r2, rb2, r3, rb3] = self.shape.ranges();
        let (low, high) = gradient.split_at_mut(r3.start);
        let (weights, biases) = high.split_at_mut(rb3.start - r3.start);
        let last = NarrowGradients { weights, biases, hidden_biases: &mut low[rb2] };
        narrow_layer_backward(output, &at.second, w3, &mut hidden.second, Some(last), outputs);
        let second = Rows::new(&hidden.second, [rows, h2]);
        transposed_times(&mut low[r2], second, Rows::new(&at.first, [rows, h1]));
        times(&mut hidden.first, second, Rows::new(w2, [h2, h1]));
        mask_and_sum(&mut hidden.first, &at.first, &mut low[rb1]);
        let first = Rows::new(&hidden.first, [rows, h1]);
        transposed_times(&mut low[r1], first, Rows::new(inputs, [rows, width]));
    }

    /// Gradient of some inputs from that of the outputs: `to` gets a row per row of the batch.
    pub(super) fn backward_to_inputs(
        &self,
        at: &Activations<T>,
        output: &[T],
        hidden: &mut HiddenGradients<T>,
        columns: Range<usize>,
        to: &mut [T],
    ) {
        let Shape { inputs: width, hidden: [h1, h2], outputs } = self.shape;
        let rows = at.output.len() / outputs;
        let [w1, _, w2, _, w3, _] = self.tensors();
        narrow_layer_backward(output, &at.second, w3, &mut hidden.second, None, outputs);
        times(&mut hidden.first, Rows::new(&hidden.second, [rows, h2]), Rows::new(w2, [h2, h1]));
        mask(&mut hidden.first, &at.first);
        // The columns of the first layer as rows, so that each input is one dot product.
        let transposed: Vec<T> =
            columns.clone().flat_map(|k| (0..h1).map(move |j| w1[j * width + k])).collect();
        let none = vec![T::default(); columns.len()];
        narrow_layer(to, &hidden.first, &transposed, &none);
    }

    /// Gradient of the first `columns` inputs of each row, from what [`Self::backward`] left in `hidden`. It uses a
    /// matrix product, which is faster than [`Self::backward_to_inputs`] for many columns.
    ///
    /// *Shapes*: `to` rows × `columns`.
    pub(super) fn first_input_gradients(&self, hidden: &HiddenGradients<T>, columns: usize, to: &mut [T]) {
        let Shape { inputs: width, hidden: [h1, _], .. } = self.shape;
        let [w1, ..] = self.tensors();
        let rows = hidden.first.len() / h1;
        let first = Rows::new(&hidden.first, [rows, h1]);
        times_first_columns(to, first, Rows::new(w1, [h1, width]), columns);
    }
}

/// A random matrix, row-major, whose rows are orthonormal, or whose columns are if it has fewer of them.
fn orthogonal_rows(rows: usize, columns: usize, rng: &mut Rng) -> Vec<f64> {
    let (count, length) = (rows.min(columns), rows.max(columns));
    let mut all: Vec<Vec<f64>> = Vec::with_capacity(count);
    for _ in 0..count {
        let mut vector: Vec<f64> = (0..length).map(|_| rng.normal()).collect();
        // Twice, because rounding leaves a rest after the first time.
        for _ in 0..2 {
            for other in &all {
                let along: f64 = vector.iter().zip(other).map(|(a, b)| a * b).sum();
                vector.iter_mut().zip(other).for_each(|(x, b)| *x -= along * b);
            }
        }
        let norm = vector.iter().map(|x| x * x).sum::<f64>().sqrt();
        vector.iter_mut().for_each(|x| *x /= norm);
        all.push(vector);
    }
    let at = |row: usize, column: usize| if rows <= columns { all[row][column] } else { all[column][row] };
    (0..rows * columns).map(|k| at(k / columns, k % columns)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gradients_are_slopes() {
        let shape = Shape { inputs: 3, hidden: [5, 4], outputs: 2 };
        let mut rng = Rng::new(1, "network", "test");
        let mut network = Network::<f64>::random(shape, &mut rng);
        let inputs: Vec<f64> = (0..18).map(|_| rng.uniform(-1.0, 1.0)).collect();
        let weights: Vec<f64> = (0..12).map(|_| rng.uniform(-1.0, 1.0)).collect();
        let mut at = Activations::new(6, &shape);
        let mut value = |network: &Network<f64>, inputs: &[f64]| -> f64 {
            network.forward(inputs, &mut at);
            at.output.iter().zip(&weights).map(|(y, w)| y * w).sum()
        };
        value(&network, &inputs);
        let mut at = Activations::new(6, &shape);
        network.forward(&inputs, &mut at);
        let (mut hidden, mut gradient) = (HiddenGradients::new(6, &shape), vec![0.0; shape.count()]);
        network.backward(&inputs, &at, &weights, &mut hidden, &mut gradient);
        const STEP: f64 = 1e-6;
        for (k, expected) in gradient.iter().enumerate() {
            let [up, down] = [STEP, -STEP].map(|step| {
                network.parameters[k] += step;
                let y = value(&network, &inputs);
                network.parameters[k] -= step;
                y
            });
            let slope = (up - down) / (2.0 * STEP);
            assert!((slope - expected).abs() < 1e-8, "{k}: {slope} against {expected}");
        }
        let mut of_first = vec![0.0; 12];
        network.first_input_gradients(&hidden, 2, &mut of_first);
        let mut to = vec![0.0; 12];
        network.backward_to_inputs(&at, &weights, &mut hidden, 0..2, &mut to);
        for (x, y) in of_first.iter().zip(&to) {
            assert!((x - y).abs() < 1e-14, "{x} and {y}");
        }
        network.backward_to_inputs(&at, &weights, &mut hidden, 1..3, &mut to);
        for row in 0..6 {
            for k in 0..2 {
                let [up, down] = [STEP, -STEP].map(|step| {
                    let mut moved = inputs.clone();
                    moved[3 * row + 1 + k] += step;
                    value(&network, &moved)
                });
                let slope = (up - down) / (2.0 * STEP);
                assert!((slope - to[2 * row + k]).abs() < 1e-8);
            }
        }
    }

    #[test]
    fn shapes_count_their_parameters() {
        let count = |inputs, outputs| Shape { inputs, hidden: [256, 256], outputs }.count();
        // Actor and critic of the learned adversary with 146 numbers of state and 12 of action.
        assert_eq!(count(146, 12), 106_508);
        assert_eq!(count(146 + 12, 1), 106_753);
    }

    #[test]
    fn a_number_that_is_not_finite_is_found_by_its_tensor() {
        let shape = Shape { inputs: 3, hidden: [4, 4], outputs: 1 };
        let mut network = Network::<f32>::random(shape, &mut Rng::new(1, "network", "test"));
        assert_eq!(network.not_finite(), None);
        network.parameters[3 * 4 + 4] = f32::NAN;
        assert_eq!(network.not_finite(), Some("l2.weight"));
    }
}
