//! `sage` with parts of your own in every command, and a study of your own over them: a reward, a metric, a merger, a
//! generator, a driving policy and a study file.
//!
//! ```sh
//! cargo run --release -p experiments --example own_study -- bench own --out table/
//! ```

use std::process::ExitCode;

use sage_core::{
    Error,
    generator::{Attack, Generator, Knowledge, OperatingPoint, Proposal},
    geometry::distance,
    metric::{MeasuredTrajectory, Metric},
    motion::{DT, HORIZON, NOW, Trajectory},
    objective::{Context, Reward, Situation},
    registry::{Entry, NoOptions},
};
use sage_generators::{Facts, GeneratorInputs, GeneratorKind};
use sage_merging::{ExpertSet, Merger, TensorMerger, TensorRule, TensorSet};
use sage_sim::{
    policy::{Driver, EgoPolicy, Start, View},
    vehicle::Action,
    world::Control,
};

/// A reward: distance of the two cars after the first step, metres.
struct StartGap;

impl Entry<dyn Reward> for StartGap {
    const NAME: &'static str = "start gap";
    const SUMMARY: &'static str = "distance of the two cars after the first step";
    const SOURCE: &'static str = "this example";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Reward>, String> {
        Ok(Box::new(Self))
    }
}

impl Reward for StartGap {
    fn score(&self, situation: &Situation) -> Option<f64> {
        let ego = situation.ego.boxes().first()?.as_ref()?;
        Some(distance(situation.candidate.boxes().first()?.center, ego.center))
    }
}

/// A merger: half-way from the prior to the mixture.
struct Halfway;

impl Entry<dyn Merger> for Halfway {
    const NAME: &'static str = "halfway";
    const SUMMARY: &'static str = "half-way from the prior to the mixture";
    const SOURCE: &'static str = "this example";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Merger>, String> {
        Ok(Box::new(Self))
    }
}

impl TensorMerger for Halfway {
    fn prepare(&self, _: &ExpertSet, _: u64) -> Result<Box<dyn TensorRule>, sage_merging::Error> {
        Ok(Box::new(Self))
    }
}

impl TensorRule for Halfway {
    fn merge(&self, tensor: &TensorSet, at: &[f64], out: &mut [f32]) {
        for (k, out) in out.iter_mut().enumerate() {
            let mixed: f64 = at.iter().zip(tensor.experts).map(|(w, expert)| w * f64::from(expert[k])).sum();
            *out = (0.5 * (f64::from(tensor.prior[k]) + mixed)) as f32;
        }
    }
}

/// A generator: the adversary keeps its velocity.
struct Coast;

impl Entry<dyn GeneratorKind> for Coast {
    const NAME: &'static str = "coast";
    const SUMMARY: &'static str = "keeps its velocity";
    const SOURCE: &'static str = "this example";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn GeneratorKind>, String> {
        Ok(Box::new(Self))
    }
}

impl GeneratorKind for Coast {
    fn facts(&self) -> Facts {
        Facts::without_operating_point(Knowledge::NOW)
    }

    fn build(&self, _: &GeneratorInputs) -> Result<Box<dyn Generator>, sage_generators::Error> {
        Ok(Box::new(Self))
    }
}

impl Generator for Coast {
    fn attacks(&self, ctx: &Context, at: &[OperatingPoint], _: u64) -> Result<Vec<Attack>, Error> {
        let ([x, y], [vx, vy]) = (ctx.adversary().point(NOW), ctx.adversary().velocity[NOW]);
        let point = |step: usize| [x + step as f64 * DT * vx, y + step as f64 * DT * vy];
        let attack = |_| {
            Ok(Attack::only(Proposal::of(Trajectory::new("coasting", (1..=HORIZON).map(point).collect())?)))
        };
        at.iter().map(attack).collect()
    }
}

/// A driving policy that touches nothing: the car rolls straight on.
#[derive(Clone, Copy)]
struct Roll;

impl Entry<dyn EgoPolicy> for Roll {
    const NAME: &'static str = "roll";
    const SUMMARY: &'static str = "rolls straight on";
    const SOURCE: &'static str = "this example";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn EgoPolicy>, String> {
        Ok(Box::new(Self))
    }
}

impl EgoPolicy for Roll {
    fn start(&self, _: &Start) -> Result<Box<dyn Driver>, sage_sim::Error> {
        Ok(Box::new(*self))
    }
}

impl Driver for Roll {
    fn control(&mut self, _: &View) -> Result<Control, sage_sim::Error> {
        Ok(Control::Drive(Action { steer: 0.0, throttle: 0.0 }))
    }

    fn boxed_clone(&self) -> Result<Box<dyn Driver>, sage_sim::Error> {
        Ok(Box::new(*self))
    }
}

fn main() -> ExitCode {
    experiments::run(|| {
        let mut all = experiments::Registries::shipped()?;
        all.parts.rewards = all.parts.rewards.with::<StartGap>()?;
        all.parts.mergers = all.parts.mergers.with::<Halfway>()?;
        all.parts.generators = all.parts.generators.with::<Coast>()?;
        all.parts.policies = all.parts.policies.with::<Roll>()?;
        let top_speed = Metric::mean("top speed", |t: &MeasuredTrajectory| {
            t.candidate.profile().speed.iter().copied().reduce(f64::max)
        });
        all.metrics.trajectory = all.metrics.trajectory.with(top_speed.unit("m/s").about("largest speed"))?;
        all.studies.push(("own", include_str!("own_study.yaml")));
        Ok(all)
    })
}
