//! Tensors of learners by name, for checkpoints.

use std::collections::BTreeMap;

use sage_sim::{Error, actor::Shape};

use super::kernels::Real;

/// A tensor of a learner.
#[derive(Clone, Debug)]
pub struct NamedTensor<'a, T> {
    /// Name, such as `m.actor.l1.weight`.
    pub name: String,
    /// Shape.
    pub shape: Vec<usize>,
    /// Numbers.
    pub numbers: &'a [T],
}

/// The tensors of a network in several vectors of its shape, such as parameters and moments, each with a prefix.
pub(super) fn views<'a, T>(
    network: &str,
    shape: &Shape,
    columns: impl IntoIterator<Item = (&'static str, &'a [T])>,
) -> Vec<NamedTensor<'a, T>> {
    let mut all = Vec::new();
    for (prefix, numbers) in columns {
        for ((name, shape), range) in shape.tensors().into_iter().zip(shape.ranges()) {
            all.push(NamedTensor {
                name: format!("{prefix}{network}.{name}"),
                shape,
                numbers: &numbers[range],
            });
        }
    }
    all
}

/// Sets the tensors of a network; [`check`] has found all of them.
pub(super) fn set<'a, T: Real>(
    network: &str,
    shape: &Shape,
    columns: impl IntoIterator<Item = (&'static str, &'a mut [T])>,
    tensors: &BTreeMap<String, Vec<T>>,
) {
    for (prefix, numbers) in columns {
        for ((name, _), range) in shape.tensors().iter().zip(shape.ranges()) {
            numbers[range].copy_from_slice(&tensors[&format!("{prefix}{network}.{name}")]);
        }
    }
}

/// Whether all tensors are there with their sizes.
///
/// *Errors*: the name of a tensor that is missing or has another size.
pub(super) fn check<T>(own: &[NamedTensor<T>], tensors: &BTreeMap<String, Vec<T>>) -> Result<(), Error> {
    for NamedTensor { name, numbers, .. } in own {
        let found = tensors.get(name).ok_or_else(|| Error::Value(format!("tensor `{name}` is missing")))?;
        if found.len() != numbers.len() {
            let expected = numbers.len();
            return Err(Error::Value(format!(
                "tensor `{name}` has {} numbers; expected {expected}",
                found.len()
            )));
        }
    }
    Ok(())
}

/// Copies of all tensors, the first number of one of them NaN.
pub(super) fn with_broken<T: Real>(own: &[NamedTensor<T>], tensor: &str) -> BTreeMap<String, Vec<T>> {
    let mut all: BTreeMap<String, Vec<T>> =
        own.iter().map(|tensor| (tensor.name.clone(), tensor.numbers.to_vec())).collect();
    if let Some(first) = all.get_mut(tensor).and_then(|numbers| numbers.first_mut()) {
        *first = T::of(f64::NAN);
    }
    all
}
