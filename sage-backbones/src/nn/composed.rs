//! The operations of this module made of candle's own, for devices other than the CPU. They equal those for the CPU but for
//! rounding errors, which tests show on the CPU.

use std::sync::atomic::{AtomicBool, Ordering};

use candle_core::{D, DType, Device, Result, Tensor};
use candle_nn::ops;

use super::groups::{Group, Groups};

static ON_CPU: AtomicBool = AtomicBool::new(false);

/// From now on the CPU takes the operations for other devices too; for tests.
#[doc(hidden)]
pub fn compose_on_cpu() {
    ON_CPU.store(true, Ordering::Relaxed);
}

/// Whether the operations on a tensor are those of this file.
pub(super) fn is_composed(x: &Tensor) -> bool {
    !x.device().is_cpu() || ON_CPU.load(Ordering::Relaxed)
}

/// Added to the variance of a layer norm.
pub(super) const EPSILON: f64 = 1e-5;

/// As [`super::add_row`].
pub(super) fn add_row(x: &Tensor, row: &Tensor) -> Result<Tensor> {
    x.broadcast_add(&row.flatten_all()?)
}

/// As [`super::norm_relu()`]; with groups, a row of biases for each.
pub(super) fn norm_relu(
    x: &Tensor,
    biases: &Tensor,
    scale: &Tensor,
    groups: Option<&Groups>,
) -> Result<Tensor> {
    let z = match groups {
        None => x.broadcast_add(&biases.flatten_all()?)?,
        Some(groups) => (x + biases.index_select(&groups.of_rows(x.device())?, 0)?)?,
    };
    ops::layer_norm_slow(&z, &scale.get(0)?, &scale.get(1)?, EPSILON as f32)?.relu()
}

/// As [`super::softmax()`].
pub(super) fn softmax(x: &Tensor, scale: f64) -> Result<Tensor> {
    ops::softmax(&(x * scale)?, D::Minus1)
}

/// As [`super::log_softmax`].
pub(super) fn log_softmax(x: &Tensor) -> Result<Tensor> {
    ops::log_softmax(x, D::Minus1)
}

/// As [`super::max_of_rows`].
pub(super) fn max_of_rows(x: &Tensor, groups: &Groups) -> Result<Tensor> {
    let of = |group: &Group| largest(&x.narrow(0, group.start, group.end - group.start)?, 0);
    Tensor::cat(&groups.as_slice().iter().map(of).collect::<Result<Vec<_>>>()?, 0)
}

/// As [`super::max_of_others`]. It takes memory for each pair of rows of a group.
pub(super) fn max_of_others(x: &Tensor, groups: &Groups) -> Result<Tensor> {
    let of = |group: &Group| {
        let (n, seen) = (group.end - group.start, group.seen - group.start);
        let d = x.dim(1)?;
        if seen == 0 {
            return Tensor::zeros((n, d), x.dtype(), x.device());
        }
        let rows = x.narrow(0, group.start, seen)?.relu()?.unsqueeze(0)?;
        let others = others(n, seen, x.dtype(), x.device())?.unsqueeze(2)?;
        largest(&rows.broadcast_mul(&others)?, 1)?.squeeze(1)
    };
    let others = groups.as_slice().iter().map(of).collect::<Result<Vec<_>>>()?;
    Tensor::cat(&[x, &Tensor::cat(&others, 0)?], 1)
}

/// The maxima along a dimension, of which 1 is left. Where values are equal, one of them gets the gradient; by candle's `max`
/// each would get all of it.
fn largest(x: &Tensor, dim: usize) -> Result<Tensor> {
    x.contiguous()?.gather(&x.argmax_keepdim(dim)?, dim)
}

/// (n, seen): 0 where a row is itself, else 1.
fn others(n: usize, seen: usize, dtype: DType, device: &Device) -> Result<Tensor> {
    let numbers = (0..n).flat_map(|row| (0..seen).map(move |other| if row == other { 0.0_f32 } else { 1.0 }));
    Tensor::from_iter(numbers, device)?.reshape((n, seen))?.to_dtype(dtype)
}

#[cfg(test)]
mod tests {
    use candle_core::Var;
    use sage_core::seed::Rng;

    use super::*;

    /// Inputs of an operation, by shape; some are equal, none is 0.
    fn inputs(shapes: &[&[usize]]) -> Vec<Var> {
        let mut rng = Rng::new(1, "inputs", "test");
        let input = |shape: &&[usize]| {
            let numbers: Vec<f64> =
                (0..shape.iter().product()).map(|_| (4.0 * rng.normal()).floor() / 4.0 + 0.125).collect();
            Var::from_tensor(&Tensor::from_vec(numbers, *shape, &Device::Cpu).unwrap()).unwrap()
        };
        shapes.iter().map(input).collect()
    }

    type Form<'f> = &'f dyn Fn(&[Tensor]) -> Result<Tensor>;

    /// Compares results and gradients of two forms of an operation.
    fn compare(name: &str, shapes: &[&[usize]], forms: [Form; 2]) {
        let variables = inputs(shapes);
        let tensors: Vec<Tensor> = variables.iter().map(|variable| variable.as_tensor().clone()).collect();
        let numbers = |x: &Tensor| x.flatten_all().unwrap().to_vec1::<f64>().unwrap();
        let [fast, composed] = forms.map(|form| {
            let y = form(&tensors).unwrap();
            let mut rng = Rng::new(2, "weights", "test");
            let weights: Vec<f64> = (0..y.elem_count()).map(|_| rng.normal()).collect();
            let weights = Tensor::from_vec(weights, y.dims(), &Device::Cpu).unwrap();
            let store = (&y * weights).unwrap().sum_all().unwrap().backward().unwrap();
            let gradients = variables.iter().map(|variable| numbers(store.get(variable).unwrap()));
            std::iter::once(numbers(&y)).chain(gradients).collect::<Vec<_>>()
        });
        for (part, (fast, composed)) in fast.iter().zip(&composed).enumerate() {
            assert_eq!(fast.len(), composed.len(), "{name}");
            for (a, b) in fast.iter().zip(composed) {
                assert!((a - b).abs() <= 1e-9 * (1.0 + b.abs()), "{name}, part {part}: {a} {b}");
            }
        }
    }

    #[test]
    fn composed_operations_equal_those_for_the_cpu_with_their_gradients() {
        let groups = Groups::with_unseen([(3, 1), (1, 0), (1, 2), (2, 0)]);
        let rows = groups.rows();
        compare(
            "add row",
            &[&[rows, 5], &[5]],
            [&|x| super::super::add_row(&x[0], &x[1]), &|x| add_row(&x[0], &x[1])],
        );
        compare(
            "norm",
            &[&[rows, 5], &[5], &[2, 5]],
            [&|x| super::super::norm_relu(&x[0], &x[1], &x[2]), &|x| norm_relu(&x[0], &x[1], &x[2], None)],
        );
        compare(
            "norm by group",
            &[&[rows, 5], &[groups.len(), 5], &[2, 5]],
            [&|x| super::super::norm_relu::norm_relu_by_group(x[0].clone(), &x[1], &x[2], &groups), &|x| {
                norm_relu(&x[0], &x[1], &x[2], Some(&groups))
            }],
        );
        compare("softmax", &[&[rows, 5]], [&|x| super::super::softmax(&x[0], 0.7), &|x| softmax(&x[0], 0.7)]);
        compare(
            "log softmax",
            &[&[rows, 5]],
            [&|x| super::super::log_softmax(&x[0]), &|x| log_softmax(&x[0])],
        );
        compare(
            "maxima of rows",
            &[&[rows, 5]],
            [&|x| super::super::max_of_rows(&x[0], &groups), &|x| max_of_rows(&x[0], &groups)],
        );
        compare(
            "maxima of others",
            &[&[rows, 5]],
            [&|x| super::super::max_of_others(&x[0], &groups), &|x| max_of_others(&x[0], &groups)],
        );
    }
}
