//! Softmax and log-softmax over the last axis.

use candle_core::{
    CpuStorage, CustomOp1, InplaceOp1, Layout, Result, Shape, Tensor, backend::BackendStorage as _,
};

use super::{
    composed::{self, is_composed},
    real::{Real, by_dtype, slice, slice_mut, sum, wide, with_slice},
};

struct Softmax {
    scale: f64,
}

struct LogSoftmax;

/// `softmax(scale · x)` of every row.
///
/// *Shapes*: `x` (…, n); result the same.
pub fn softmax(x: &Tensor, scale: f64) -> Result<Tensor> {
    if is_composed(x) {
        return composed::softmax(x, scale);
    }
    x.contiguous()?.apply_op1(Softmax { scale })
}

/// [`softmax`] for a tensor that no other code reads. It is overwritten if no gradient needs it.
pub(super) fn softmax_in_place(x: Tensor, scale: f64) -> Result<Tensor> {
    if x.track_op() || is_composed(&x) {
        return softmax(&x, scale);
    }
    x.inplace_op1(&Softmax { scale })?;
    Ok(x)
}

/// `x − log Σ exp x` of every row.
///
/// *Shapes*: `x` (…, n); result the same.
pub fn log_softmax(x: &Tensor) -> Result<Tensor> {
    if is_composed(x) {
        return composed::log_softmax(x);
    }
    x.contiguous()?.apply_op1(LogSoftmax)
}

/// Largest element of a row. NaN may be ignored here; it appears in the sum.
#[inline(always)]
fn largest<T: Real>(row: &[T]) -> T {
    let mut lanes = [row[0]; 8];
    let chunks = row.chunks_exact(8);
    let rest = chunks.remainder();
    for chunk in chunks {
        for (lane, x) in lanes.iter_mut().zip(chunk) {
            *lane = x.larger(*lane);
        }
    }
    rest.iter().chain(&lanes).fold(row[0], |best, x| x.larger(best))
}

#[inline(always)]
fn softmax_rows<T: Real>(x: &mut [T], n: usize, scale: f64) {
    let scale = T::from_f64(scale);
    for row in x.chunks_exact_mut(n) {
        let shift = largest(row) * scale;
        for x in row.iter_mut() {
            *x = (*x * scale - shift).exponential();
        }
        let factor = T::one() / sum(row);
        for x in row {
            *x *= factor;
        }
    }
}

/// `scale · y · (dy − Σ y dy)`.
#[inline(always)]
fn softmax_gradient<T: Real>(y: &[T], dy: &[T], n: usize, scale: f64) -> Vec<T> {
    let mut out = vec![T::zero(); y.len()];
    let scale = T::from_f64(scale);
    for ((y, dy), out) in y.chunks_exact(n).zip(dy.chunks_exact(n)).zip(out.chunks_exact_mut(n)) {
        for ((out, y), dy) in out.iter_mut().zip(y).zip(dy) {
            *out = *y * *dy;
        }
        let shared = sum(out);
        for ((out, y), dy) in out.iter_mut().zip(y).zip(dy) {
            *out = scale * *y * (*dy - shared);
        }
    }
    out
}

// Computed in double precision. A common shift of all scores has a gradient of exactly zero; with rounding
// errors of a single-precision sum, Adam would make steps.
fn log_softmax_rows<T: Real>(x: &[T], n: usize) -> Vec<T> {
    let mut out = x.to_vec();
    for row in out.chunks_exact_mut(n) {
        let shift = largest(row).to_f64();
        let total: f64 = row.iter().map(|x| (x.to_f64() - shift).exp()).sum();
        let normalizer = shift + total.ln();
        for y in row.iter_mut() {
            *y = T::from_f64(y.to_f64() - normalizer);
        }
    }
    out
}

/// `dy − softmax(x) Σ dy`.
fn log_softmax_gradient<T: Real>(x: &[T], dy: &[T], n: usize) -> Vec<T> {
    let mut out = vec![T::zero(); x.len()];
    let mut powers = vec![0.0; n];
    for ((x, dy), out) in x.chunks_exact(n).zip(dy.chunks_exact(n)).zip(out.chunks_exact_mut(n)) {
        let shift = largest(x).to_f64();
        for (power, x) in powers.iter_mut().zip(x) {
            *power = (x.to_f64() - shift).exp();
        }
        let total: f64 = dy.iter().map(|dy| dy.to_f64()).sum();
        let share = total / powers.iter().sum::<f64>();
        for ((out, power), dy) in out.iter_mut().zip(&powers).zip(dy) {
            *out = T::from_f64(dy.to_f64() - power * share);
        }
    }
    out
}

fn width(layout: &Layout) -> Result<usize> {
    match layout.dims().last() {
        Some(&n) if n > 0 => Ok(n),
        _ => candle_core::bail!("softmax of {:?}: no entry to weigh", layout.dims()),
    }
}

impl CustomOp1 for Softmax {
    fn name(&self) -> &'static str {
        "softmax"
    }

    fn cpu_fwd(&self, x: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let n = width(layout)?;
        by_dtype!(x.dtype(), T => {
            let mut out = slice::<T>(x, layout)?.to_vec();
            wide(#[inline(always)] || softmax_rows(&mut out, n, self.scale));
            Ok((candle_core::WithDType::to_cpu_storage_owned(out), layout.shape().clone()))
        })
    }

    fn bwd(&self, x: &Tensor, result: &Tensor, gradient: &Tensor) -> Result<Option<Tensor>> {
        let gradient = gradient.contiguous()?;
        let n = width(x.layout())?;
        by_dtype!(x.dtype(), T => {
            let dx = with_slice::<T, _>(result, |y| {
                with_slice::<T, _>(&gradient, |dy| wide(#[inline(always)] || softmax_gradient(y, dy, n, self.scale)))
            })??;
            Ok(Some(Tensor::from_vec(dx, x.shape(), x.device())?))
        })
    }
}

impl InplaceOp1 for Softmax {
    fn name(&self) -> &'static str {
        "softmax"
    }

    fn cpu_fwd(&self, x: &mut CpuStorage, layout: &Layout) -> Result<()> {
        let n = width(layout)?;
        by_dtype!(x.dtype(), T => {
            let x = slice_mut::<T>(x, layout)?;
            wide(#[inline(always)] || softmax_rows(x, n, self.scale));
            Ok(())
        })
    }
}

impl CustomOp1 for LogSoftmax {
    fn name(&self) -> &'static str {
        "log-softmax"
    }

    fn cpu_fwd(&self, x: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        let n = width(layout)?;
        by_dtype!(x.dtype(), T => {
            let out = log_softmax_rows::<T>(slice(x, layout)?, n);
            Ok((candle_core::WithDType::to_cpu_storage_owned(out), layout.shape().clone()))
        })
    }

    fn bwd(&self, x: &Tensor, _result: &Tensor, gradient: &Tensor) -> Result<Option<Tensor>> {
        let gradient = gradient.contiguous()?;
        let n = width(x.layout())?;
        by_dtype!(x.dtype(), T => {
            let dx = with_slice::<T, _>(x, |x| {
                with_slice::<T, _>(&gradient, |dy| log_softmax_gradient(x, dy, n))
            })??;
            Ok(Some(Tensor::from_vec(dx, x.shape(), x.device())?))
        })
    }
}
