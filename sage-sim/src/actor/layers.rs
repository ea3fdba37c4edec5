//! Layers of a network for one input, over flat row-major matrices.
//!
//! Loops are compiled for several vector widths and chosen at run time; their order of operations, and with it every bit, is
//! the same in all of them.

use std::{
    fmt::Debug,
    ops::{Add, AddAssign, Div, Mul, Neg, Sub, SubAssign},
};

/// `f32` or `f64`.
pub trait Real:
    Copy
    + Default
    + Debug
    + PartialOrd
    + Send
    + Sync
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + AddAssign
    + SubAssign
    + 'static
{
    /// The nearest number.
    fn of(x: f64) -> Self;
    /// As `f64`.
    fn wide(self) -> f64;
    /// Square root.
    fn root(self) -> Self;
    /// Hyperbolic tangent.
    fn hyperbolic_tangent(self) -> Self;
}

impl Real for f32 {
    #[inline(always)]
    fn of(x: f64) -> Self {
        x as Self
    }
    #[inline(always)]
    fn wide(self) -> f64 {
        f64::from(self)
    }
    #[inline(always)]
    fn root(self) -> Self {
        Self::sqrt(self)
    }
    #[inline(always)]
    fn hyperbolic_tangent(self) -> Self {
        self.tanh()
    }
}

impl Real for f64 {
    #[inline(always)]
    fn of(x: f64) -> Self {
        x
    }
    #[inline(always)]
    fn wide(self) -> f64 {
        self
    }
    #[inline(always)]
    fn root(self) -> Self {
        Self::sqrt(self)
    }
    #[inline(always)]
    fn hyperbolic_tangent(self) -> Self {
        self.tanh()
    }
}

/// Running totals of a dot product: as many as fill two vectors of AVX2 in `f32`.
const LANES: usize = 16;

/// Takes the positive part. NaN stays NaN.
pub(super) fn positive_part<T: Real>(numbers: &mut [T]) {
    for x in numbers {
        *x = if *x < T::default() { T::default() } else { *x };
    }
}

/// Sum of the products of two slices.
#[inline(always)]
fn dot<T: Real>(a: &[T], b: &[T]) -> T {
    let mut lanes = [T::default(); LANES];
    let (a_chunks, b_chunks) = (a.chunks_exact(LANES), b.chunks_exact(LANES));
    let rest = a_chunks.remainder().iter().zip(b_chunks.remainder());
    for (a, b) in a_chunks.zip(b_chunks) {
        for k in 0..LANES {
            lanes[k] += a[k] * b[k];
        }
    }
    for (lane, (a, b)) in lanes.iter_mut().zip(rest) {
        *lane += *a * *b;
    }
    let mut width = LANES / 2;
    while width > 0 {
        for k in 0..width {
            lanes[k] += lanes[k + width];
        }
        width /= 2;
    }
    lanes[0]
}

/// `out = x wᵀ + bias` for few outputs, as dot products; a matrix product of so few columns is slower.
pub fn narrow_layer<T: Real>(out: &mut [T], x: &[T], w: &[T], bias: &[T]) {
    pulp::Arch::new().dispatch(NarrowLayer { out, x, w, bias });
}

struct NarrowLayer<'a, T> {
    out: &'a mut [T],
    x: &'a [T],
    w: &'a [T],
    bias: &'a [T],
}

impl<T: Real> pulp::NullaryFnOnce for NarrowLayer<'_, T> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { out, x, w, bias } = self;
        let width = w.len() / bias.len();
        for (out, x) in out.chunks_exact_mut(bias.len()).zip(x.chunks_exact(width)) {
            for ((out, w), b) in out.iter_mut().zip(w.chunks_exact(width)).zip(bias) {
                *out = dot(x, w) + *b;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dot_products_take_every_item() {
        for n in 0..50 {
            let a: Vec<f64> = (0..n).map(f64::from).collect();
            let expected: f64 = a.iter().map(|x| x * x).sum();
            assert_eq!(dot(&a, &a), expected);
        }
    }
}
