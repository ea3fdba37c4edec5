//! Leaky ReLU: `x` for positive `x`, `0.01 x` otherwise.

use candle_core::{CpuStorage, CustomOp1, Layout, Result, Shape, Tensor, backend::BackendStorage as _};
use sage_backbones::nn::{Real, by_dtype, slice, wide, with_slice};

/// Slope of negative inputs.
const SLOPE: f64 = 0.01;

struct LeakyRelu;

/// *Shapes*: any; the result has the shape of `x`.
pub(super) fn leaky_relu(x: &Tensor) -> Result<Tensor> {
    x.contiguous()?.apply_op1(LeakyRelu)
}

/// `values`, scaled where `signs` is not positive.
#[inline(always)]
fn scaled<T: Real>(signs: &[T], values: &[T]) -> Vec<T> {
    let slope = T::from_f64(SLOPE);
    let pairs = signs.iter().zip(values);
    pairs.map(|(sign, value)| *value * if *sign > T::zero() { T::one() } else { slope }).collect()
}

impl CustomOp1 for LeakyRelu {
    fn name(&self) -> &'static str {
        "leaky-relu"
    }

    fn cpu_fwd(&self, x: &CpuStorage, layout: &Layout) -> Result<(CpuStorage, Shape)> {
        by_dtype!(x.dtype(), T => {
            let x = slice::<T>(x, layout)?;
            let out = wide(#[inline(always)] || scaled(x, x));
            Ok((candle_core::WithDType::to_cpu_storage_owned(out), layout.shape().clone()))
        })
    }

    fn bwd(&self, x: &Tensor, _result: &Tensor, gradient: &Tensor) -> Result<Option<Tensor>> {
        let gradient = gradient.contiguous()?;
        by_dtype!(x.dtype(), T => {
            let dx = with_slice::<T, _>(x, |x| {
                with_slice::<T, _>(&gradient, |dy| wide(#[inline(always)] || scaled(x, dy)))
            })??;
            Ok(Some(Tensor::from_vec(dx, x.shape(), x.device())?))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::{Device, Var};

    #[test]
    fn negative_numbers_and_their_gradients_are_scaled_and_nan_is_kept() {
        let x = Var::new(&[2.0_f64, -3.0, f64::NAN], &Device::Cpu).unwrap();
        let y = leaky_relu(&x).unwrap();
        let values = y.to_vec1::<f64>().unwrap();
        assert_eq!(values[..2], [2.0, -0.03]);
        assert!(values[2].is_nan());
        let gradient = y.sum_all().unwrap().backward().unwrap();
        assert_eq!(gradient.get(&x).unwrap().to_vec1::<f64>().unwrap()[..2], [1.0, 0.01]);
    }
}
