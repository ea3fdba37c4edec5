//! The number types of the layers, and access to the numbers of a tensor.

use candle_core::{CpuStorage, Layout, Result, Storage, Tensor, WithDType};

/// `f32` or `f64`.
pub trait Real: WithDType {
    /// Square root.
    fn root(self) -> Self;
    /// Exponential function; in `f32` to 2 units in the last place, and zero below −87.
    fn exponential(self) -> Self;
    /// The larger of two numbers; either one if the other is NaN.
    fn larger(self, other: Self) -> Self;
    /// The numbers of a storage, if they are of this type.
    fn numbers(storage: &mut CpuStorage) -> Option<&mut [Self]>;
}

impl Real for f32 {
    #[inline(always)]
    fn root(self) -> Self {
        self.sqrt()
    }

    // A polynomial that the compiler can turn into vector code, four times as fast as the library.
    #[inline(always)]
    fn exponential(self) -> Self {
        const ROUND: f32 = 12_582_912.0;
        let x = if self > 88.0 { 88.0 } else { self };
        let shifted = x * std::f32::consts::LOG2_E + ROUND;
        let n = shifted - ROUND;
        let r = (x - n * 0.693_359_4) + n * 2.121_944_4e-4;
        let mut p = 1.987_569_1e-4;
        p = p * r + 1.398_199_9e-3;
        p = p * r + 8.333_452e-3;
        p = p * r + 4.166_579_6e-2;
        p = p * r + 1.666_666_5e-1;
        p = p * r + 0.5;
        let value = (p * r * r + r) + 1.0;
        let power = Self::from_bits(shifted.to_bits().wrapping_add(127) << 23);
        if x < -87.0 { 0.0 } else { value * power }
    }

    #[inline(always)]
    fn larger(self, other: Self) -> Self {
        if self > other { self } else { other }
    }

    fn numbers(storage: &mut CpuStorage) -> Option<&mut [Self]> {
        match storage {
            CpuStorage::F32(numbers) => Some(numbers),
            _ => None,
        }
    }
}

impl Real for f64 {
    #[inline(always)]
    fn root(self) -> Self {
        self.sqrt()
    }

    #[inline(always)]
    fn exponential(self) -> Self {
        self.exp()
    }

    #[inline(always)]
    fn larger(self, other: Self) -> Self {
        if self > other { self } else { other }
    }

    fn numbers(storage: &mut CpuStorage) -> Option<&mut [Self]> {
        match storage {
            CpuStorage::F64(numbers) => Some(numbers),
            _ => None,
        }
    }
}

/// Logistic function `1/(1 + e^−x)`.
#[inline(always)]
pub fn sigmoid<T: Real>(x: T) -> T {
    T::one() / (T::one() + (T::zero() - x).exponential())
}

/// Hyperbolic tangent by [`sigmoid`], which the compiler can turn into vector code.
#[inline(always)]
pub fn tanh<T: Real>(x: T) -> T {
    let two = T::one() + T::one();
    two * sigmoid(two * x) - T::one()
}

/// Sum with eight running totals, for vector code and small rounding errors.
#[inline(always)]
pub(super) fn sum<T: Real>(items: &[T]) -> T {
    let mut lanes = [T::zero(); 8];
    let chunks = items.chunks_exact(8);
    let rest = chunks.remainder();
    for chunk in chunks {
        for (lane, x) in lanes.iter_mut().zip(chunk) {
            *lane += *x;
        }
    }
    for (lane, x) in lanes.iter_mut().zip(rest) {
        *lane += *x;
    }
    ((lanes[0] + lanes[4]) + (lanes[1] + lanes[5])) + ((lanes[2] + lanes[6]) + (lanes[3] + lanes[7]))
}

/// Runs a loop compiled for the widest vectors of the processor. The order of the operations does not change,
/// nor does any bit of the result.
///
/// All functions that the loop calls must be inlined into it.
#[inline(always)]
pub fn wide<R>(run: impl FnOnce() -> R) -> R {
    pulp::Arch::new().dispatch(run)
}

/// Sums over the rows of a matrix, column by column, in blocks. The sum within a block has the matrix's own
/// precision, the sum over blocks double precision. If the true sum is zero, Adam would make steps of full
/// size from the rounding errors of a plain sum.
pub struct BlockSums<T> {
    block: Vec<T>,
    total: Vec<f64>,
    rows: usize,
}

impl<T: Real> BlockSums<T> {
    const BLOCK: usize = 32;

    /// Sums of no rows yet.
    pub fn new(columns: usize) -> Self {
        Self { block: vec![T::zero(); columns], total: vec![0.0; columns], rows: 0 }
    }

    /// The sums to which the next row is added.
    #[inline(always)]
    pub fn next_row(&mut self) -> &mut [T] {
        if self.rows == Self::BLOCK {
            self.close();
        }
        self.rows += 1;
        &mut self.block
    }

    fn close(&mut self) {
        for (total, x) in self.total.iter_mut().zip(&mut self.block) {
            *total += x.to_f64();
            *x = T::zero();
        }
        self.rows = 0;
    }

    /// The sums.
    pub fn finish(mut self) -> Vec<T> {
        self.close();
        self.total.into_iter().map(T::from_f64).collect()
    }
}

/// The numbers of a contiguous argument of a custom operation.
pub fn slice<'a, T: Real>(storage: &'a CpuStorage, layout: &Layout) -> Result<&'a [T]> {
    let all = storage.as_slice::<T>()?;
    let (start, end) = layout
        .contiguous_offsets()
        .ok_or(candle_core::Error::RequiresContiguous { op: "a layer of sage-backbones" })?;
    Ok(&all[start..end])
}

/// The numbers of a contiguous argument of a custom operation, to be written.
pub fn slice_mut<'a, T: Real>(storage: &'a mut CpuStorage, layout: &Layout) -> Result<&'a mut [T]> {
    let (start, end) = layout
        .contiguous_offsets()
        .ok_or(candle_core::Error::RequiresContiguous { op: "a layer of sage-backbones" })?;
    match T::numbers(storage) {
        Some(all) => Ok(&mut all[start..end]),
        None => candle_core::bail!("numbers of two types in one layer"),
    }
}

/// Calls `f` with the numbers of a contiguous tensor on the CPU.
pub fn with_slice<T: Real, R>(tensor: &Tensor, f: impl FnOnce(&[T]) -> R) -> Result<R> {
    let (storage, layout) = tensor.storage_and_layout();
    match &*storage {
        Storage::Cpu(cpu) => Ok(f(slice(cpu, layout)?)),
        _ => candle_core::bail!("this layer runs on the CPU only"),
    }
}

/// Runs the same code for the number type of a tensor.
#[macro_export]
macro_rules! by_dtype {
    ($dtype:expr, $T:ident => $body:expr) => {
        match $dtype {
            $crate::candle::DType::F32 => {
                type $T = f32;
                $body
            }
            $crate::candle::DType::F64 => {
                type $T = f64;
                $body
            }
            other => $crate::candle::bail!("layers work in f32 and f64, not in {other:?}"),
        }
    };
}
pub use by_dtype;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_fast_exponential_is_accurate_to_two_units_in_the_last_place() {
        let mut worst = 0.0_f64;
        for k in -86_999..88_000 {
            let x = k as f32 * 1e-3;
            let exact = f64::from(x).exp();
            worst = worst.max((f64::from(x.exponential()) - exact).abs() / exact);
        }
        assert!(worst < 2.4e-7, "{worst:e}");
        assert_eq!(0.0_f32.exponential(), 1.0);
        assert_eq!(f32::NEG_INFINITY.exponential(), 0.0);
        assert_eq!((-1e30_f32).exponential(), 0.0);
        assert!(f32::NAN.exponential().is_nan());
        assert!(1e30_f32.exponential() > 1e38);
    }

    #[test]
    fn sums_take_every_item() {
        for n in 0..30 {
            let items: Vec<f64> = (0..n).map(f64::from).collect();
            assert_eq!(sum(&items), f64::from(n * (n - 1) / 2));
        }
    }
}
