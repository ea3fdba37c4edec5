//! The inner loops of the networks, over flat row-major matrices.
//!
//! Products of matrices come from `faer`, on one thread: its kernels choose the widest vectors of the processor at run
//! time, and the bits do not depend on the number of threads. All other loops are compiled for several vector widths
//! and chosen at run time too; their order of operations, and with it every bit, is the same in all of them.
//!
//! faer takes a seventh of the build. An update with nalgebra's products takes 1.15 times as long, with our own tiles for AVX2
//! 1.07 times (one thread, a processor with AVX-512).

use faer::{Accum, MatMut, MatRef, Par, linalg::matmul::matmul, traits::RealField};

/// `f32` or `f64`, with the products of matrices.
pub trait Real: sage_sim::actor::Real + RealField {}

impl<T: sage_sim::actor::Real + RealField> Real for T {}

/// Numbers that are masked at a time: as many as fill two vectors of AVX2 in `f32`.
const LANES: usize = 16;

/// Runs a short loop compiled for the widest vectors of the processor. A closure that is too long to be inlined would
/// not be; longer loops are types with an inlined `call`.
#[inline(always)]
pub(crate) fn vectorised<R>(run: impl FnOnce() -> R) -> R {
    pulp::Arch::new().dispatch(run)
}

/// A row-major matrix in a slice: the numbers, and how many rows and columns.
#[derive(Clone, Copy)]
pub(crate) struct Rows<'a, T> {
    pub(crate) numbers: &'a [T],
    pub(crate) shape: [usize; 2],
}

impl<'a, T> Rows<'a, T> {
    pub(crate) fn new(numbers: &'a [T], shape: [usize; 2]) -> Self {
        debug_assert_eq!(numbers.len(), shape[0] * shape[1]);
        Self { numbers, shape }
    }

    fn view(self) -> MatRef<'a, T> {
        MatRef::from_row_major_slice(self.numbers, self.shape[0], self.shape[1])
    }
}

/// `out = a bᵀ`.
pub(crate) fn times_transposed<T: Real>(out: &mut [T], a: Rows<T>, b: Rows<T>) {
    let out = MatMut::from_row_major_slice_mut(out, a.shape[0], b.shape[0]);
    matmul(out, Accum::Replace, a.view(), b.view().transpose(), T::of(1.0), Par::Seq);
}

/// `out = a b`.
pub(crate) fn times<T: Real>(out: &mut [T], a: Rows<T>, b: Rows<T>) {
    let out = MatMut::from_row_major_slice_mut(out, a.shape[0], b.shape[1]);
    matmul(out, Accum::Replace, a.view(), b.view(), T::of(1.0), Par::Seq);
}

/// `out = a b'`, where `b'` has the first `columns` columns of `b`.
pub(crate) fn times_first_columns<T: Real>(out: &mut [T], a: Rows<T>, b: Rows<T>, columns: usize) {
    let out = MatMut::from_row_major_slice_mut(out, a.shape[0], columns);
    matmul(out, Accum::Replace, a.view(), b.view().subcols(0, columns), T::of(1.0), Par::Seq);
}

/// `out = aᵀ b`.
pub(crate) fn transposed_times<T: Real>(out: &mut [T], a: Rows<T>, b: Rows<T>) {
    let out = MatMut::from_row_major_slice_mut(out, a.shape[1], b.shape[1]);
    matmul(out, Accum::Replace, a.view().transpose(), b.view(), T::of(1.0), Par::Seq);
}

/// Adds a bias to every row and takes the positive part. NaN stays NaN.
pub(crate) fn add_bias_relu<T: Real>(rows: &mut [T], bias: &[T]) {
    let zero = T::default();
    vectorised(|| {
        for row in rows.chunks_exact_mut(bias.len()) {
            for (x, b) in row.iter_mut().zip(bias) {
                let y = *x + *b;
                *x = if y < zero { zero } else { y };
            }
        }
    });
}

/// Gradients of a narrow layer's parameters, and of the bias before the ReLU.
pub(crate) struct NarrowGradients<'a, T> {
    pub(crate) weights: &'a mut [T],
    pub(crate) biases: &'a mut [T],
    pub(crate) hidden_biases: &'a mut [T],
}

/// Backward pass of [`sage_sim::actor::narrow_layer`] after a ReLU layer: from the gradient of the outputs to the gradient before
/// the ReLU (`input`), and, if asked for, of the parameters. `x` is the output of the ReLU.
pub(crate) fn narrow_layer_backward<T: Real>(
    output: &[T],
    x: &[T],
    w: &[T],
    input: &mut [T],
    gradients: Option<NarrowGradients<T>>,
    outputs: usize,
) {
    pulp::Arch::new().dispatch(NarrowBackward { output, x, w, input, gradients, outputs });
}

struct NarrowBackward<'a, T> {
    output: &'a [T],
    x: &'a [T],
    w: &'a [T],
    input: &'a mut [T],
    gradients: Option<NarrowGradients<'a, T>>,
    outputs: usize,
}

impl<T: Real> pulp::NullaryFnOnce for NarrowBackward<'_, T> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { output, x, w, input, mut gradients, outputs } = self;
        let width = w.len() / outputs;
        if let Some(gradients) = &mut gradients {
            gradients.weights.fill(T::default());
            gradients.biases.fill(T::default());
            gradients.hidden_biases.fill(T::default());
        }
        let rows = output.chunks_exact(outputs).zip(x.chunks_exact(width));
        for ((d, x), input) in rows.zip(input.chunks_exact_mut(width)) {
            through_narrow_layer(d, w, x, input);
            let Some(gradients) = &mut gradients else { continue };
            for (sum, g) in gradients.hidden_biases.iter_mut().zip(&*input) {
                *sum += *g;
            }
            let columns = gradients.weights.chunks_exact_mut(width).zip(gradients.biases.iter_mut());
            for (d, (weights, bias)) in d.iter().zip(columns) {
                *bias += *d;
                for (g, x) in weights.iter_mut().zip(x) {
                    *g += *d * *x;
                }
            }
        }
    }
}

/// Gradient of one row before the ReLU.
#[inline(always)]
fn through_narrow_layer<T: Real>(d: &[T], w: &[T], x: &[T], input: &mut [T]) {
    for (k, d) in d.iter().enumerate() {
        let w = &w[k * x.len()..][..x.len()];
        for (g, w) in input.iter_mut().zip(w) {
            *g = if k == 0 { *d * *w } else { *g + *d * *w };
        }
    }
    mask_row(input, x);
}

/// Sets gradients to 0 where the ReLU's output is not positive, and sums the columns of the result.
pub(crate) fn mask_and_sum<T: Real>(gradient: &mut [T], output: &[T], sums: &mut [T]) {
    pulp::Arch::new().dispatch(MaskAndSum { gradient, output, sums });
}

struct MaskAndSum<'a, T> {
    gradient: &'a mut [T],
    output: &'a [T],
    sums: &'a mut [T],
}

impl<T: Real> pulp::NullaryFnOnce for MaskAndSum<'_, T> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { gradient, output, sums } = self;
        let width = sums.len();
        sums.fill(T::default());
        for (row, output) in gradient.chunks_exact_mut(width).zip(output.chunks_exact(width)) {
            mask_row(row, output);
            for (sum, g) in sums.iter_mut().zip(row) {
                *sum += *g;
            }
        }
    }
}

/// Sets gradients to 0 where the ReLU's output is not positive.
pub(crate) fn mask<T: Real>(gradient: &mut [T], output: &[T]) {
    vectorised(|| mask_row(gradient, output));
}

#[inline(always)]
fn mask_row<T: Real>(gradient: &mut [T], output: &[T]) {
    let (chunks, rest) = gradient.as_chunks_mut::<LANES>();
    let (output_chunks, output_rest) = output.as_chunks::<LANES>();
    for (g, x) in chunks.iter_mut().zip(output_chunks) {
        // A copy: of a gradient in place the compiler makes a branch for each number.
        let all = *g;
        *g = std::array::from_fn(|k| if x[k] > T::default() { all[k] } else { T::default() });
    }
    for (g, x) in rest.iter_mut().zip(output_rest) {
        *g = if *x > T::default() { *g } else { T::default() };
    }
}

/// Writes `[a | b]` row by row.
pub(crate) fn join<T: Copy>(out: &mut [T], a: &[T], b: &[T], [left, right]: [usize; 2]) {
    let rows = a.chunks_exact(left).zip(b.chunks_exact(right));
    for (out, (a, b)) in out.chunks_exact_mut(left + right).zip(rows) {
        out[..left].copy_from_slice(a);
        out[left..].copy_from_slice(b);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_are_those_of_the_definition() {
        let a = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];
        let b = [1.0, 0.0, 2.0, -1.0, 3.0, 1.0];
        let mut out = [0.0; 4];
        times_transposed(&mut out, Rows::new(&a, [2, 3]), Rows::new(&b, [2, 3]));
        assert_eq!(out, [7.0, 8.0, 16.0, 17.0]);
        times(&mut out, Rows::new(&a, [2, 3]), Rows::new(&b, [3, 2]));
        assert_eq!(out, [14.0, 1.0, 32.0, 1.0]);
        let mut out = [0.0; 2];
        times_first_columns(&mut out, Rows::new(&a, [2, 3]), Rows::new(&b, [3, 2]), 1);
        assert_eq!(out, [14.0, 32.0]);
        let mut out = [0.0; 9];
        transposed_times(&mut out, Rows::new(&a, [2, 3]), Rows::new(&b, [2, 3]));
        assert_eq!(out, [-3.0, 12.0, 6.0, -3.0, 15.0, 9.0, -3.0, 18.0, 12.0]);
    }

    #[test]
    fn relu_keeps_nan_and_stops_at_zero() {
        let mut rows = [1.0_f32, -3.0, f32::NAN, -0.5];
        add_bias_relu(&mut rows, &[0.5, 0.5]);
        assert_eq!(rows[0], 1.5);
        assert_eq!(rows[1], 0.0);
        assert!(rows[2].is_nan());
        assert_eq!(rows[3], 0.0);
        let mut gradient = [1.0_f32, 1.0];
        mask(&mut gradient, &[0.0, 2.0]);
        assert_eq!(gradient, [0.0, 1.0]);
    }
}
