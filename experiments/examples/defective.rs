//! `sage` with parts that panic in some scenes, to see that a defect costs these scenes alone.
//!
//! ```sh
//! cargo run --release -p experiments --example defective -- simulate scenes/ \
//!     --ego 'fragile{"scene": "merge-1-2"}' --out drives
//! ```

use std::process::ExitCode;

use sage_core::{
    Error as CoreError,
    generator::{Attack, Generator, Knowledge, OperatingPoint, Proposal},
    motion::{HORIZON, NOW, Trajectory},
    objective::Context,
    registry::Entry,
};
use sage_generators::{Facts, GeneratorInputs, GeneratorKind};
use sage_sim::{
    Error,
    policy::{Driver, EgoPolicy, Start, View},
    vehicle::Action,
    world::Control,
};
use serde::{Deserialize, Serialize};

/// A policy and a generator that panic in one scene. The type is also its own options.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
struct Fragile {
    /// Id of the scene.
    scene: String,
    /// The step at which the policy panics; 0 before it starts.
    step: usize,
}

impl Fragile {
    /// Panics in the scene, as an index out of range does.
    fn check(&self, scene: &str) {
        let none: [usize; 0] = [];
        if scene == self.scene {
            std::hint::black_box(none[std::hint::black_box(80)]);
        }
    }
}

impl Entry<dyn EgoPolicy> for Fragile {
    const NAME: &'static str = "fragile";
    const SUMMARY: &'static str = "coasts, and panics in one scene";
    const SOURCE: &'static str = "this example";
    type Options = Self;

    fn build(options: Self) -> Result<Box<dyn EgoPolicy>, String> {
        Ok(Box::new(options))
    }
}

impl EgoPolicy for Fragile {
    fn start(&self, start: &Start) -> Result<Box<dyn Driver>, Error> {
        if self.step == 0 {
            self.check(start.scene_id());
        }
        Ok(Box::new(FragileDriver { part: self.clone(), scene: start.scene_id().to_owned() }))
    }
}

#[derive(Clone)]
struct FragileDriver {
    part: Fragile,
    scene: String,
}

impl Driver for FragileDriver {
    fn control(&mut self, view: &View) -> Result<Control, Error> {
        if view.step() >= self.part.step {
            self.part.check(&self.scene);
        }
        Ok(Control::Drive(Action::default()))
    }

    fn boxed_clone(&self) -> Result<Box<dyn Driver>, Error> {
        Ok(Box::new(self.clone()))
    }
}

impl Generator for Fragile {
    fn attacks(&self, ctx: &Context, at: &[OperatingPoint], _: u64) -> Result<Vec<Attack>, CoreError> {
        self.check(&ctx.scene().id);
        let track = ctx.adversary();
        let ([x, y], [vx, vy]) = (track.point(NOW), track.velocity[NOW]);
        let point = |step: usize| [x + 0.1 * step as f64 * vx, y + 0.1 * step as f64 * vy];
        let trajectory = Trajectory::new("straight on", (1..=HORIZON).map(point).collect())?;
        Ok(at.iter().map(|_| Attack::only(Proposal::of(trajectory.clone()))).collect())
    }
}

impl GeneratorKind for Fragile {
    fn facts(&self) -> Facts {
        Facts::without_operating_point(Knowledge::NOW)
    }

    fn build(&self, _: &GeneratorInputs) -> Result<Box<dyn Generator>, sage_generators::Error> {
        Ok(Box::new(self.clone()))
    }
}

impl Entry<dyn GeneratorKind> for Fragile {
    const NAME: &'static str = "fragile";
    const SUMMARY: &'static str = "straight on, and panics in one scene";
    const SOURCE: &'static str = "this example";
    type Options = Self;

    fn build(options: Self) -> Result<Box<dyn GeneratorKind>, String> {
        Ok(Box::new(options))
    }
}

fn main() -> ExitCode {
    experiments::run(|| {
        let mut registries = experiments::Registries::shipped()?;
        registries.parts.policies = registries.parts.policies.with::<Fragile>()?;
        registries.parts.generators = registries.parts.generators.with::<Fragile>()?;
        Ok(registries)
    })
}
