//! The tensors of actor and critic by name, for checkpoints.

use std::collections::BTreeMap;

use super::{
    super::{NamedTensor, kernels::Real},
    ActorCritic,
};

impl<T: Real> ActorCritic<T> {
    /// All tensors that change: networks, deviations and moments (`m.…`, `v.…`), as views.
    pub fn tensors(&self) -> Vec<NamedTensor<'_, T>> {
        let mut all = Vec::new();
        for (network, trained) in [("actor", &self.actor), ("critic", &self.critic)] {
            let shape = trained.network.shape();
            let columns = [
                ("", trained.network.parameters()),
                ("m.", &trained.moments.first[..]),
                ("v.", &trained.moments.second[..]),
            ];
            for (prefix, numbers) in columns {
                for ((name, shape), range) in shape.tensors().into_iter().zip(shape.ranges()) {
                    all.push(NamedTensor {
                        name: format!("{prefix}{network}.{name}"),
                        shape,
                        numbers: &numbers[range],
                    });
                }
            }
        }
        let moments = &self.deviation_moments;
        for (prefix, numbers) in [("", &self.log_deviations), ("m.", &moments.first), ("v.", &moments.second)]
        {
            let name = format!("{prefix}log_deviations");
            all.push(NamedTensor { name, shape: vec![numbers.len()], numbers });
        }
        all
    }

    /// Sets all tensors and the number of steps.
    ///
    /// *Errors*: the name of a tensor that is missing or has another size; nothing has changed then.
    pub fn set_tensors(&mut self, tensors: &BTreeMap<String, Vec<T>>, steps: u64) -> Result<(), String> {
        for NamedTensor { name, numbers, .. } in self.tensors() {
            let found = tensors.get(&name).ok_or_else(|| format!("tensor `{name}` is missing"))?;
            if found.len() != numbers.len() {
                let expected = numbers.len();
                return Err(format!("tensor `{name}` has {} numbers; expected {expected}", found.len()));
            }
        }
        for (network, trained) in [("actor", &mut self.actor), ("critic", &mut self.critic)] {
            let shape = *trained.network.shape();
            let columns = [
                ("", trained.network.parameters_mut()),
                ("m.", &mut trained.moments.first[..]),
                ("v.", &mut trained.moments.second[..]),
            ];
            for (prefix, numbers) in columns {
                for ((name, _), range) in shape.tensors().iter().zip(shape.ranges()) {
                    numbers[range].copy_from_slice(&tensors[&format!("{prefix}{network}.{name}")]);
                }
            }
        }
        let moments = &mut self.deviation_moments;
        let all = [("", &mut self.log_deviations), ("m.", &mut moments.first), ("v.", &mut moments.second)];
        for (prefix, numbers) in all {
            numbers.copy_from_slice(&tensors[&format!("{prefix}log_deviations")]);
        }
        self.set_steps(steps);
        Ok(())
    }

    /// Sets the first number of a tensor to NaN.
    pub(super) fn break_weight(&mut self, tensor: &str) {
        let tensors = self.tensors().into_iter().map(|t| (t.name, t.numbers.to_vec()));
        let mut all: BTreeMap<String, Vec<T>> = tensors.collect();
        if let Some(first) = all.get_mut(tensor).and_then(|numbers| numbers.first_mut()) {
            *first = T::of(f64::NAN);
        }
        // The names and sizes are its own.
        let _ = self.set_tensors(&all, self.steps());
    }
}
