//! `max(0, γ · norm(x + b) + β)` in one pass: the bias, the layer norm and the ReLU after a product. The bias is
//! one row for the whole matrix, or one row for each group of successive rows.

use candle_core::{
    CpuStorage, CustomOp3, InplaceOp3, Layout, Result, Shape, Tensor, backend::BackendStorage as _,
};

use super::{
    composed::{self, EPSILON, is_composed},
    groups::Groups,
    real::{BlockSums, Real, by_dtype, slice, slice_mut, sum, wide, with_slice},
};

/// Without groups, one row of biases is for all rows.
struct NormRelu(Option<Groups>);

/// `max(0, γ · (z − mean z) / √(var z + 1e-5) + β)` with `z = x + bias`, row by row; the variance is
/// the biased one.
///
/// *Shapes*: `x` (n, d), `bias` (d) or (1, d), `scale` (2, d) = γ over β; result (n, d).
pub fn norm_relu(x: &Tensor, bias: &Tensor, scale: &Tensor) -> Result<Tensor> {
    if is_composed(x) {
        return composed::norm_relu(x, bias, scale, None);
    }
    x.contiguous()?.apply_op3(&bias.contiguous()?, &scale.contiguous()?, NormRelu(None))
}

/// [`norm_relu`] with a row of biases for each group of rows, for an `x` that no other code reads. It is
/// overwritten if no gradient needs it.
///
/// *Shapes*: `x` (n, d), `biases` (groups, d), `scale` (2, d); result (n, d).
pub(super) fn norm_relu_by_group(
    x: Tensor,
    biases: &Tensor,
    scale: &Tensor,
    groups: &Groups,
) -> Result<Tensor> {
    run(x, biases, scale, NormRelu(Some(groups.clone())))
}

/// [`norm_relu`] for a tensor that no other code reads. It is overwritten if no gradient needs it.
pub(super) fn norm_relu_in_place(x: Tensor, bias: &Tensor, scale: &Tensor) -> Result<Tensor> {
    run(x, bias, scale, NormRelu(None))
}

fn run(x: Tensor, bias: &Tensor, scale: &Tensor, op: NormRelu) -> Result<Tensor> {
    if is_composed(&x) {
        return composed::norm_relu(&x, bias, scale, op.0.as_ref());
    }
    if x.track_op() || bias.track_op() || scale.track_op() {
        return x.contiguous()?.apply_op3(&bias.contiguous()?, &scale.contiguous()?, op);
    }
    x.inplace_op3(&bias.contiguous()?, &scale.contiguous()?, &op)?;
    Ok(x)
}

/// Mean and 1/√(variance + ε) of `z`.
#[inline(always)]
fn moments<T: Real>(z: &[T], squares: &mut [T]) -> (T, T) {
    let share = T::one() / T::from_f64(z.len() as f64);
    let mean = sum(z) * share;
    for (square, z) in squares.iter_mut().zip(z) {
        let d = *z - mean;
        *square = d * d;
    }
    let variance = sum(squares) * share;
    (mean, T::one() / (variance + T::from_f64(EPSILON)).root())
}

#[inline(always)]
fn forward<T: Real>(x: &mut [T], biases: &[T], scale: &[T], groups: &Groups) {
    let d = scale.len() / 2;
    let (gamma, beta) = scale.split_at(d);
    let mut squares = vec![T::zero(); d];
    for (group, bias) in groups.as_slice().iter().zip(biases.chunks_exact(d)) {
        for y in x[group.start * d..group.end * d].chunks_exact_mut(d) {
            for (y, b) in y.iter_mut().zip(bias) {
                *y += *b;
            }
            let (mean, inverse) = moments(y, &mut squares);
            for ((y, gamma), beta) in y.iter_mut().zip(gamma).zip(beta) {
                let value = (*y - mean) * inverse * *gamma + *beta;
                // This order of the comparison propagates NaN, so that it is found.
                *y = if value < T::zero() { T::zero() } else { value };
            }
        }
    }
}

impl NormRelu {
    /// The rows of each row of biases, if the shapes fit.
    fn groups(&self, x: &Layout, bias: &Layout, scale: &Layout) -> Result<Groups> {
        let d = scale.shape().elem_count() / 2;
        let rows = x.shape().elem_count().checked_div(d).unwrap_or(0);
        let groups = self.0.clone().unwrap_or_else(|| Groups::of_lengths([rows]));
        let fits = x.dims().last() == Some(&d)
            && scale.shape().elem_count() == 2 * d
            && bias.shape().elem_count() == groups.len() * d
            && groups.rows() == rows;
        if fits {
            return Ok(groups);
        }
        candle_core::bail!(
            "norm-relu of {:?} with bias {:?} and scale {:?}",
            x.dims(),
            bias.dims(),
            scale.dims()
        )
    }
}

/// Gradients with respect to x, bias and scale.
#[inline(always)]
fn backward<T: Real>(x: &[T], biases: &[T], scale: &[T], y: &[T], dy: &[T], groups: &Groups) -> [Vec<T>; 3] {
    let d = scale.len() / 2;
    let gamma = &scale[..d];
    let mut dx = vec![T::zero(); x.len()];
    let mut dbiases = Vec::with_capacity(biases.len());
    let mut scale_sums = BlockSums::<T>::new(2 * d);
    let [mut unit, mut through, mut work] = [(); 3].map(|()| vec![T::zero(); d]);
    let share = T::one() / T::from_f64(d as f64);
    for (group, bias) in groups.as_slice().iter().zip(biases.chunks_exact(d)) {
        let mut bias_sums = BlockSums::<T>::new(d);
        let span = group.start * d..group.end * d;
        let given = x[span.clone()].chunks_exact(d).zip(y[span.clone()].chunks_exact(d));
        let gradients = dy[span.clone()].chunks_exact(d).zip(dx[span].chunks_exact_mut(d));
        for ((x, y), (dy, dx)) in given.zip(gradients) {
            for ((unit, x), b) in unit.iter_mut().zip(x).zip(bias) {
                *unit = *x + *b;
            }
            let (mean, inverse) = moments(&unit, &mut work);
            for unit in &mut unit {
                *unit = (*unit - mean) * inverse;
            }
            let (dgamma, dbeta) = scale_sums.next_row().split_at_mut(d);
            for k in 0..d {
                let passed = if y[k] > T::zero() { dy[k] } else { T::zero() };
                dbeta[k] += passed;
                dgamma[k] += passed * unit[k];
                through[k] = passed * gamma[k];
                work[k] = through[k] * unit[k];
            }
            let mean_through = sum(&through) * share;
            let mean_product = sum(&work) * share;
            let dbias = bias_sums.next_row();
            for k in 0..d {
                dx[k] = inverse * (through[k] - mean_through - unit[k] * mean_product);
                dbias[k] += dx[k];
            }
        }
        dbiases.extend(bias_sums.finish());
    }
    [dx, dbiases, scale_sums.finish()]
}

impl InplaceOp3 for NormRelu {
    fn name(&self) -> &'static str {
        "norm-relu"
    }

    fn cpu_fwd(
        &self,
        x: &mut CpuStorage,
        x_layout: &Layout,
        bias: &CpuStorage,
        bias_layout: &Layout,
        scale: &CpuStorage,
        scale_layout: &Layout,
    ) -> Result<()> {
        let groups = self.groups(x_layout, bias_layout, scale_layout)?;
        by_dtype!(x.dtype(), T => {
            let (bias, scale) = (slice::<T>(bias, bias_layout)?, slice(scale, scale_layout)?);
            let x = slice_mut(x, x_layout)?;
            wide(#[inline(always)] || forward(x, bias, scale, &groups));
            Ok(())
        })
    }
}

impl CustomOp3 for NormRelu {
    fn name(&self) -> &'static str {
        "norm-relu"
    }

    fn cpu_fwd(
        &self,
        x: &CpuStorage,
        x_layout: &Layout,
        bias: &CpuStorage,
        bias_layout: &Layout,
        scale: &CpuStorage,
        scale_layout: &Layout,
    ) -> Result<(CpuStorage, Shape)> {
        let groups = self.groups(x_layout, bias_layout, scale_layout)?;
        by_dtype!(x.dtype(), T => {
            let (bias, scale) = (slice::<T>(bias, bias_layout)?, slice(scale, scale_layout)?);
            let mut out = slice(x, x_layout)?.to_vec();
            wide(#[inline(always)] || forward(&mut out, bias, scale, &groups));
            Ok((candle_core::WithDType::to_cpu_storage_owned(out), x_layout.shape().clone()))
        })
    }

    fn bwd(
        &self,
        x: &Tensor,
        bias: &Tensor,
        scale: &Tensor,
        result: &Tensor,
        gradient: &Tensor,
    ) -> Result<(Option<Tensor>, Option<Tensor>, Option<Tensor>)> {
        let gradient = gradient.contiguous()?;
        let groups = self.groups(x.layout(), bias.layout(), scale.layout())?;
        by_dtype!(x.dtype(), T => {
            let [dx, dbias, dscale] = with_slice::<T, _>(x, |x| {
                with_slice::<T, _>(bias, |bias| {
                    with_slice::<T, _>(scale, |scale| {
                        with_slice::<T, _>(result, |y| {
                            with_slice::<T, _>(&gradient, |dy| wide(#[inline(always)] || backward(x, bias, scale, y, dy, &groups)))
                        })
                    })
                })
            })?????;
            let device = x.device();
            Ok((
                Some(Tensor::from_vec(dx, x.shape(), device)?),
                Some(Tensor::from_vec(dbias, bias.shape(), device)?),
                Some(Tensor::from_vec(dscale, scale.shape(), device)?),
            ))
        })
    }
}
