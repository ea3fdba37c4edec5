//! No attack: the adversary's logged future.

use sage_core::{
    Error,
    generator::{Attack, Generator, Knowledge, OperatingPoint, Proposal},
    motion::{HORIZON, NOW, Trajectory},
    objective::Context,
    registry::Entry,
    scene::Scene,
};
use serde::{Deserialize, Serialize};

use crate::{Facts, GeneratorInputs, GeneratorKind};

/// The logged future; a frame that is not valid repeats the last position.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Log {}

impl Generator for Log {
    fn attacks(&self, ctx: &Context, at: &[OperatingPoint], _: u64) -> Result<Vec<Attack>, Error> {
        let attack = Attack::only(Proposal::of(logged_future(ctx.scene())?));
        Ok(vec![attack; at.len()])
    }
}

impl GeneratorKind for Log {
    fn facts(&self) -> Facts {
        Facts::without_operating_point(Knowledge { own_future: true, ..Knowledge::NOW })
    }

    fn build(&self, _: &GeneratorInputs) -> Result<Box<dyn Generator>, crate::Error> {
        Ok(Box::new(*self))
    }
}

impl Entry<dyn GeneratorKind> for Log {
    const NAME: &'static str = "log";
    const SUMMARY: &'static str = "no attack: the logged future";
    const SOURCE: &'static str = "this project";
    type Options = Self;

    fn build(options: Self) -> Result<Box<dyn GeneratorKind>, String> {
        Ok(Box::new(options))
    }
}

/// The adversary's logged future; gaps repeat the last position before them.
///
/// *Errors*: [`Error::Scene`] if there is no adversary, or it has no valid frame in its history.
pub fn logged_future(scene: &Scene) -> Result<Trajectory, Error> {
    let track = scene.adversary()?;
    let last_valid = (0..=NOW).rev().find(|f| track.is_valid(*f)).ok_or_else(|| Error::Scene {
        scene: scene.id.clone(),
        problem: format!("adversary `{}` has no valid frame up to frame {NOW}", track.id.escape_debug()),
    })?;
    let mut last = track.point(last_valid);
    let position = |f: usize| {
        if track.is_valid(f) {
            last = track.point(f);
        }
        last
    };
    Trajectory::new("logged future", (NOW + 1..=NOW + HORIZON).map(position).collect())
}
