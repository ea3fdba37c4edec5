//! Passes of a batch through a network, forwards and back to the gradients.

use std::ops::Range;

use sage_sim::actor::{Network, Shape, narrow_layer};

use super::kernels::{
    NarrowGradients, Real, Rows, add_bias_relu, mask, mask_and_sum, narrow_layer_backward, times,
    times_first_columns, times_transposed, transposed_times,
};

/// Outputs of the layers for a batch, kept for the backward pass.
#[derive(Clone, Debug)]
pub(crate) struct Activations<T> {
    pub(crate) first: Vec<T>,
    pub(crate) second: Vec<T>,
    pub(crate) output: Vec<T>,
}

/// Gradients of a batch before the ReLUs.
#[derive(Clone, Debug)]
pub(crate) struct HiddenGradients<T> {
    pub(crate) first: Vec<T>,
    second: Vec<T>,
}

impl<T: Real> Activations<T> {
    pub(crate) fn new(rows: usize, shape: &Shape) -> Self {
        let zeros = |width: usize| vec![T::default(); rows * width];
        Self { first: zeros(shape.hidden[0]), second: zeros(shape.hidden[1]), output: zeros(shape.outputs) }
    }
}

impl<T: Real> HiddenGradients<T> {
    pub(crate) fn new(rows: usize, shape: &Shape) -> Self {
        let zeros = |width: usize| vec![T::default(); rows * width];
        Self { first: zeros(shape.hidden[0]), second: zeros(shape.hidden[1]) }
    }
}

/// Passes of a batch through a [`Network`].
pub(crate) trait BatchPasses<T> {
    /// Outputs for a batch of inputs, row-major.
    fn forward(&self, inputs: &[T], to: &mut Activations<T>);

    /// Gradients of all parameters from those of the outputs.
    fn backward(
        &self,
        inputs: &[T],
        at: &Activations<T>,
        output: &[T],
        hidden: &mut HiddenGradients<T>,
        gradient: &mut [T],
    );

    /// Gradient of some inputs from that of the outputs: `to` gets a row per row of the batch.
    fn backward_to_inputs(
        &self,
        at: &Activations<T>,
        output: &[T],
        hidden: &mut HiddenGradients<T>,
        columns: Range<usize>,
        to: &mut [T],
    );

    /// Gradient of the first `columns` inputs of each row, from what [`Self::backward`] left in `hidden`. It uses a
    /// matrix product, which is faster than [`Self::backward_to_inputs`] for many columns.
    ///
    /// *Shapes*: `to` rows × `columns`.
    fn first_input_gradients(&self, hidden: &HiddenGradients<T>, columns: usize, to: &mut [T]);
}

impl<T: Real> BatchPasses<T> for Network<T> {
    fn forward(&self, inputs: &[T], to: &mut Activations<T>) {
        let Shape { inputs: width, hidden: [h1, h2], .. } = *self.shape();
        let rows = inputs.len() / width;
        let [w1, b1, w2, b2, w3, b3] = self.tensors();
        times_transposed(&mut to.first, Rows::new(inputs, [rows, width]), Rows::new(w1, [h1, width]));
        add_bias_relu(&mut to.first, b1);
        times_transposed(&mut to.second, Rows::new(&to.first, [rows, h1]), Rows::new(w2, [h2, h1]));
        add_bias_relu(&mut to.second, b2);
        narrow_layer(&mut to.output, &to.second, w3, b3);
    }

    fn backward(
        &self,
        inputs: &[T],
        at: &Activations<T>,
        output: &[T],
        hidden: &mut HiddenGradients<T>,
        gradient: &mut [T],
    ) {
        let Shape { inputs: width, hidden: [h1, h2], outputs } = *self.shape();
        let rows = inputs.len() / width;
        let [_, _, w2, _, w3, _] = self.tensors();
        let [r1, rb1, r2, rb2, r3, rb3] = self.shape().ranges();
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

    fn backward_to_inputs(
        &self,
        at: &Activations<T>,
        output: &[T],
        hidden: &mut HiddenGradients<T>,
        columns: Range<usize>,
        to: &mut [T],
    ) {
        let Shape { inputs: width, hidden: [h1, h2], outputs } = *self.shape();
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

    fn first_input_gradients(&self, hidden: &HiddenGradients<T>, columns: usize, to: &mut [T]) {
        let Shape { inputs: width, hidden: [h1, _], .. } = *self.shape();
        let [w1, ..] = self.tensors();
        let rows = hidden.first.len() / h1;
        let first = Rows::new(&hidden.first, [rows, h1]);
        times_first_columns(to, first, Rows::new(w1, [h1, width]), columns);
    }
}

#[cfg(test)]
mod tests {
    use sage_core::seed::Rng;

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
                network.parameters_mut()[k] += step;
                let y = value(&network, &inputs);
                network.parameters_mut()[k] -= step;
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
}
