//! Batch normalisation `γ (x − mean) / √(variance + 1e-5) + β`, column by column, as PyTorch computes it.
//!
//! Training uses mean and biased variance of the batch and updates running statistics, whose variance is unbiased.
//! Evaluation uses the running statistics.

use candle_core::{
    CpuStorage, CustomOp3, Device, InplaceOp2, Layout, Result, Shape, Tensor, WithDType,
    backend::BackendStorage as _,
};

use super::{
    add_row::add_row,
    real::{BlockSums, Real, by_dtype, slice, slice_mut, wide, with_slice},
};
use crate::parameters::{Init, Scope};

/// Added to the variance.
const EPSILON: f64 = 1e-5;
/// Share of the new batch in the running statistics.
const MOMENTUM: f64 = 0.1;
/// Names of the running statistics, which no gradient changes.
const RUNNING: [&str; 2] = ["running_mean", "running_var"];

/// Whether a tensor of this name is a running statistic of a batch norm.
pub fn is_running(name: &str) -> bool {
    RUNNING.iter().any(|running| name.ends_with(running))
}

/// Whether a tensor of this name is a running variance.
pub fn is_running_variance(name: &str) -> bool {
    name.ends_with(RUNNING[1])
}

/// A layer of batch normalisation.
#[derive(Clone, Debug)]
pub struct BatchNorm {
    gamma: Tensor,
    beta: Tensor,
    running_mean: Tensor,
    running_variance: Tensor,
}

impl BatchNorm {
    /// Takes `weight`, `bias`, `running_mean` and `running_var` from the scope.
    ///
    /// *Errors*: a tensor that is missing or has another shape.
    pub fn new(scope: &Scope, width: usize) -> Result<Self> {
        let tensor = |name: &str, value| scope.tensor(name, &[width], Init::Constant(value));
        Ok(Self {
            gamma: tensor("weight", 1.0)?,
            beta: tensor("bias", 0.0)?,
            running_mean: tensor(RUNNING[0], 0.0)?,
            running_variance: tensor(RUNNING[1], 1.0)?,
        })
    }

    /// Evaluation mode.
    ///
    /// *Shapes*: `x` (n, width), as the result.
    /// *Errors*: another width.
    pub fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let scale = (&self.gamma / (&self.running_variance + EPSILON)?.sqrt()?)?;
        let shift = (&self.beta - (&self.running_mean * &scale)?)?;
        add_row(&x.broadcast_mul(&scale)?, &shift)
    }

    /// Training mode. It changes the running statistics in place, also for every other network that is built from the
    /// same tensors.
    ///
    /// *Shapes*: `x` (n, width), as the result, n ≥ 2.
    /// *Errors*: fewer rows, or another width.
    pub fn forward_training(&self, x: &Tensor) -> Result<Tensor> {
        let x = x.contiguous()?;
        let (n, d) = x.dims2()?;
        if n < 2 {
            candle_core::bail!("batch norm of {n} rows; training needs at least 2");
        }
        let [mean, variance] = by_dtype!(x.dtype(), T => {
            with_slice::<T, _>(&x, |x| wide(#[inline(always)] || statistics(x, d)))?
        });
        let unbiased = n as f64 / (n - 1) as f64;
        let updates = [(&self.running_mean, &mean, 1.0), (&self.running_variance, &variance, unbiased)];
        for (running, batch, factor) in updates {
            let batch: Vec<f64> = batch.iter().map(|x| x * factor).collect();
            let batch = Tensor::from_vec(batch, d, &Device::Cpu)?.to_dtype(x.dtype())?;
            running.inplace_op2(&batch, &Update)?;
        }
        let inverse = variance.iter().map(|variance| 1.0 / (variance + EPSILON).sqrt()).collect();
        x.apply_op3(&self.gamma.contiguous()?, &self.beta.contiguous()?, Normalise { mean, inverse })
    }
}

/// Mean and biased variance of each column.
#[inline(always)]
fn statistics<T: Real>(x: &[T], d: usize) -> [Vec<f64>; 2] {
    let share = (d as f64) / x.len() as f64;
    let mut sums = BlockSums::new(d);
    for row in x.chunks_exact(d) {
        for (sum, x) in sums.next_row().iter_mut().zip(row) {
            *sum += *x;
        }
    }
    let mean: Vec<f64> = sums.finish().into_iter().map(|sum: T| sum.to_f64() * share).collect();
    let centre: Vec<T> = mean.iter().map(|x| T::from_f64(*x)).collect();
    let mut squares = BlockSums::new(d);
    for row in x.chunks_exact(d) {
        for ((sum, x), centre) in squares.next_row().iter_mut().zip(row).zip(&centre) {
            *sum += (*x - *centre) * (*x - *centre);
        }
    }
    [mean, squares.finish().into_iter().map(|sum: T| sum.to_f64() * share).collect()]
}

/// `running += momentum · (batch − running)`.
struct Update;

impl InplaceOp2 for Update {
    fn name(&self) -> &'static str {
        "running-statistics"
    }

    fn cpu_fwd(
        &self,
        running: &mut CpuStorage,
        running_layout: &Layout,
        batch: &CpuStorage,
        batch_layout: &Layout,
    ) -> Result<()> {
        by_dtype!(running.dtype(), T => {
            let momentum = <T as WithDType>::from_f64(MOMENTUM);
            let batch = slice::<T>(batch, batch_layout)?;
            for (running, batch) in slice_mut::<T>(running, running_layout)?.iter_mut().zip(batch) {
                *running += momentum * (*batch - *running);
            }
            Ok(())
        })
    }
}

/// The normalisation by statistics of `x` itself.
struct Normalise {
    mean: Vec<f64>,
    inverse: Vec<f64>,
}

impl Normalise {
    /// Mean and 1/√(variance + ε) as numbers of one type.
    fn columns<T: Real>(&self) -> [Vec<T>; 2] {
        [&self.mean, &self.inverse].map(|column| column.iter().map(|x| T::from_f64(*x)).collect())
    }
}

#[inline(always)]
fn normalise<T: Real>(x: &[T], gamma: &[T], beta: &[T], mean: &[T], inverse: &[T]) -> Vec<T> {
    let mut out = x.to_vec();
    for row in out.chunks_exact_mut(mean.len()) {
        for (k, y) in row.iter_mut().enumerate() {
            *y = (*y - mean[k]) * inverse[k] * gamma[k] + beta[k];
        }
    }
    out
}

/// Gradients with respect to x, γ and β.
#[inline(always)]
fn backward<T: Real>(x: &[T], gamma: &[T], dy: &[T], mean: &[T], inverse: &[T]) -> [Vec<T>; 3] {
    let d = mean.len();
    let mut sums = BlockSums::new(2 * d);
    for (x, dy) in x.chunks_exact(d).zip(dy.chunks_exact(d)) {
        let (dgamma, dbeta) = sums.next_row().split_at_mut(d);
        for k in 0..d {
            dgamma[k] += dy[k] * (x[k] - mean[k]) * inverse[k];
            dbeta[k] += dy[k];
        }
    }
    let mut dgamma: Vec<T> = sums.finish();
    let dbeta = dgamma.split_off(d);
    let share = T::from_f64(d as f64 / x.len() as f64);
    let mut dx = dy.to_vec();
    for (x, dx) in x.chunks_exact(d).zip(dx.chunks_exact_mut(d)) {
        for k in 0..d {
            let unit = (x[k] - mean[k]) * inverse[k];
            dx[k] = gamma[k] * inverse[k] * (dx[k] - share * (dbeta[k] + unit * dgamma[k]));
        }
    }
    [dx, dgamma, dbeta]
}

impl CustomOp3 for Normalise {
    fn name(&self) -> &'static str {
        "batch-norm"
    }

    fn cpu_fwd(
        &self,
        x: &CpuStorage,
        x_layout: &Layout,
        gamma: &CpuStorage,
        gamma_layout: &Layout,
        beta: &CpuStorage,
        beta_layout: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        by_dtype!(x.dtype(), T => {
            let [mean, inverse] = self.columns::<T>();
            let (x, gamma, beta) = (slice(x, x_layout)?, slice(gamma, gamma_layout)?, slice(beta, beta_layout)?);
            let out = wide(#[inline(always)] || normalise(x, gamma, beta, &mean, &inverse));
            Ok((candle_core::WithDType::to_cpu_storage_owned(out), x_layout.shape().clone()))
        })
    }

    fn bwd(
        &self,
        x: &Tensor,
        gamma: &Tensor,
        _beta: &Tensor,
        _result: &Tensor,
        gradient: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let gradient = gradient.contiguous()?;
        by_dtype!(x.dtype(), T => {
            let [mean, inverse] = self.columns::<T>();
            let [dx, dgamma, dbeta] = with_slice::<T, _>(x, |x| {
                with_slice::<T, _>(gamma, |gamma| {
                    with_slice::<T, _>(&gradient, |dy| {
                        wide(#[inline(always)] || backward(x, gamma, dy, &mean, &inverse))
                    })
                })
            })???;
            let tensor = |values: Vec<T>, like: &Tensor| Tensor::from_vec(values, like.shape(), like.device());
            Ok((Some(tensor(dx, x)?), Some(tensor(dgamma, gamma)?), Some(tensor(dbeta, gamma)?)))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::Var;

    fn layer() -> BatchNorm {
        let tensor = |values: [f64; 2]| Tensor::new(&values, &Device::Cpu).unwrap();
        BatchNorm {
            gamma: tensor([1.5, -0.5]),
            beta: tensor([0.2, 0.1]),
            running_mean: tensor([0.0, 0.0]),
            running_variance: tensor([1.0, 1.0]),
        }
    }

    #[test]
    fn a_batch_gives_statistics_worked_out_by_hand() {
        // Columns (1, 2, 3) and (0, 0, 6): means 2 and 2, biased variances 2/3 and 8, unbiased 1 and 12.
        let layer = layer();
        let x = Tensor::new(&[[1.0_f64, 0.0], [2.0, 0.0], [3.0, 6.0]], &Device::Cpu).unwrap();
        let y = layer.forward_training(&x).unwrap().to_vec2::<f64>().unwrap();
        assert!((y[2][0] - (1.5 / (2.0 / 3.0 + 1e-5_f64).sqrt() + 0.2)).abs() < 1e-12);
        assert!((y[2][1] - (-0.5 * 4.0 / (8.0 + 1e-5_f64).sqrt() + 0.1)).abs() < 1e-12);
        let near = |tensor: &Tensor, expected: [f64; 2]| {
            let found = tensor.to_vec1::<f64>().unwrap();
            assert!(found.iter().zip(expected).all(|(x, y)| (x - y).abs() < 1e-12), "{found:?}");
        };
        near(&layer.running_mean, [0.2, 0.2]);
        near(&layer.running_variance, [0.9 + 0.1, 0.9 + 1.2]);
        let y = layer.forward(&x).unwrap().to_vec2::<f64>().unwrap();
        assert!((y[0][0] - (1.5 * 0.8 / (1.0 + 1e-5_f64).sqrt() + 0.2)).abs() < 1e-12);
        assert!(layer.forward_training(&x.narrow(0, 0, 1).unwrap()).is_err());
    }

    #[test]
    fn gradients_equal_differences() {
        let numbers = [0.3, -1.2, 0.8, 2.0, -0.4, 0.7, 1.9, -0.1];
        let weights = Tensor::new(&[[1.0, -2.0], [0.5, 0.3], [-1.1, 0.9], [0.2, 1.4]], &Device::Cpu).unwrap();
        let loss = |layer: &BatchNorm, x: &Tensor| {
            let y = layer.forward_training(x).unwrap();
            (y.sqr().unwrap() * &weights).unwrap().sum_all().unwrap()
        };
        let [gamma, beta] = [layer().gamma, layer().beta].map(|tensor| Var::from_tensor(&tensor).unwrap());
        let x = Var::from_slice(&numbers, (4, 2), &Device::Cpu).unwrap();
        let traced =
            BatchNorm { gamma: gamma.as_tensor().clone(), beta: beta.as_tensor().clone(), ..layer() };
        let store = loss(&traced, &x).backward().unwrap();
        for (which, variable) in [&x, &gamma, &beta].into_iter().enumerate() {
            let gradient = store.get(variable).unwrap().flatten_all().unwrap().to_vec1::<f64>().unwrap();
            for (index, gradient) in gradient.into_iter().enumerate() {
                let at = |step: f64| -> f64 {
                    let mut values =
                        variable.as_detached_tensor().flatten_all().unwrap().to_vec1::<f64>().unwrap();
                    values[index] += step;
                    let moved = Tensor::from_vec(values, variable.dims(), &Device::Cpu).unwrap();
                    let (mut layer, mut input) = (layer(), x.as_detached_tensor());
                    *[&mut input, &mut layer.gamma, &mut layer.beta][which] = moved;
                    loss(&layer, &input).to_scalar().unwrap()
                };
                let difference = (at(1e-6) - at(-1e-6)) / 2e-6;
                assert!((gradient - difference).abs() < 1e-7, "{which} {index}: {gradient} {difference}");
            }
        }
    }

    #[test]
    fn running_statistics_are_known_by_name() {
        let specs = Scope::list(|scope| BatchNorm::new(&scope.at("norm"), 3)).unwrap();
        let running: Vec<_> = specs.iter().filter(|spec| is_running(&spec.name)).collect();
        assert_eq!(running.len(), 2);
        assert!(is_running_variance("norm.running_var") && !is_running_variance("norm.running_mean"));
    }
}
