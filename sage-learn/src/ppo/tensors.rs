//! The tensors of actor and critic by name, for checkpoints.

use std::collections::BTreeMap;

use sage_sim::Error;

use super::{
    super::{
        NamedTensor,
        kernels::Real,
        named_tensors::{check, set, views, with_broken},
    },
    ActorCritic,
};

impl<T: Real> ActorCritic<T> {
    /// All tensors that change: networks, deviations and moments (`m.…`, `v.…`), as views.
    pub fn tensors(&self) -> Vec<NamedTensor<'_, T>> {
        let mut all = Vec::new();
        for (network, trained) in [("actor", &self.actor), ("critic", &self.critic)] {
            let columns = [
                ("", trained.network.parameters()),
                ("m.", &trained.moments.first[..]),
                ("v.", &trained.moments.second[..]),
            ];
            all.extend(views(network, trained.network.shape(), columns));
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
    pub fn set_tensors(&mut self, tensors: &BTreeMap<String, Vec<T>>, steps: u64) -> Result<(), Error> {
        check(&self.tensors(), tensors)?;
        for (network, trained) in [("actor", &mut self.actor), ("critic", &mut self.critic)] {
            let shape = *trained.network.shape();
            let columns = [
                ("", trained.network.parameters_mut()),
                ("m.", &mut trained.moments.first[..]),
                ("v.", &mut trained.moments.second[..]),
            ];
            set(network, &shape, columns, tensors);
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
        let all = with_broken(&self.tensors(), tensor);
        // The names and sizes are its own.
        let _ = self.set_tensors(&all, self.steps());
    }
}
