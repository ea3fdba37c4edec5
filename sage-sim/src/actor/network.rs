//! A network with two hidden ReLU layers and a linear output layer.
//!
//! All parameters lie in one slice, in the order of their names: `l1.weight` [h₁, inputs], `l1.bias`, `l2.weight`
//! [h₂, h₁], `l2.bias`, `l3.weight` [outputs, h₂], `l3.bias`, row-major as in PyTorch.

use std::ops::Range;

use sage_core::seed::Rng;

use super::layers::{Real, narrow_layer, positive_part};

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
    pub fn ranges(&self) -> [Range<usize>; 6] {
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

/// Working memory of [`Network::forward_one`].
#[derive(Clone, Debug, Default)]
pub struct SingleRow<T> {
    first: Vec<T>,
    second: Vec<T>,
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

    /// All parameters, for training.
    pub fn parameters_mut(&mut self) -> &mut [T] {
        &mut self.parameters
    }

    /// Name of the first tensor with a number that is not finite.
    pub fn not_finite(&self) -> Option<&'static str> {
        let is_bad =
            |range: &Range<usize>| self.parameters[range.clone()].iter().any(|x| !x.wide().is_finite());
        let (names, ranges) = (self.shape.tensors(), self.shape.ranges());
        names.iter().zip(&ranges).find(|(_, range)| is_bad(range)).map(|((name, _), _)| *name)
    }

    /// The parameters of each tensor.
    pub fn tensors(&self) -> [&[T]; 6] {
        self.shape.ranges().map(|range| &self.parameters[range])
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
