//! All commands of `sage`, with a reward, a driving policy and a metric of your own.

mod metric;
mod policy;
mod reward;

use std::process::ExitCode;

use experiments::Registries;

fn main() -> ExitCode {
    experiments::run(|| {
        let mut registries = Registries::shipped()?;
        registries.parts.rewards = registries.parts.rewards.with::<reward::SpeedUp>()?;
        registries.parts.policies = registries.parts.policies.with::<policy::Steady>()?;
        registries.metrics.trajectory = registries.metrics.trajectory.with(metric::top_speed())?;
        Ok(registries)
    })
}
