//! Rule: a Bézier curve that cuts in onto the ego's path.
//!
//! During the first three quarters of the ego's path the adversary follows a cubic curve from its own next
//! position to a point on the ego's path. From there it drives one frame ahead of the ego. The rule
//! involves neither learning nor search. Source: CAT's rule-based generator.

use sage_core::{
    Error,
    generator::{Attack, Generator, Knowledge, OperatingPoint, Proposal},
    geometry::Point,
    motion::{HORIZON, NOW, Trajectory},
    objective::Context,
    registry::Entry,
};
use serde::{Deserialize, Serialize};

use crate::{Facts, GeneratorInputs, GeneratorKind};

/// The rule-based generator.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Rule {
    /// Use the adversary's frames as the published code does, even if they are not valid.
    pub raw: bool,
}

impl Generator for Rule {
    fn attacks(&self, ctx: &Context, at: &[OperatingPoint], _: u64) -> Result<Vec<Attack>, Error> {
        let attack = Attack::only(Proposal::of(self.trajectory(ctx)?));
        Ok(vec![attack; at.len()])
    }
}

impl Rule {
    fn trajectory(&self, ctx: &Context) -> Result<Trajectory, Error> {
        let track = ctx.adversary();
        let mut ego: Vec<Point> = ctx.ego().positions().to_vec();
        // After the end of its path the ego counts as standing.
        ego.resize(ctx.horizon(), *ego.last().unwrap_or(&ctx.scene().ego().point(NOW)));
        // The frame itself, or the nearest valid one; of two, the earlier.
        let position = |frame: usize| {
            if self.raw || track.is_valid(frame) {
                return track.position.get(frame).map_or([0.0; 2], |_| track.point(frame));
            }
            let valid = (NOW..track.valid.len()).filter(|f| track.is_valid(*f));
            valid.min_by_key(|f| (f.abs_diff(frame), *f)).map_or(track.point(NOW), |f| track.point(f))
        };
        let length = ego.len() * 3 / 4;
        let first = if self.raw || track.is_valid(NOW + 1) { position(NOW + 1) } else { position(NOW) };
        let mut future = bezier(first, position(NOW + 1 + length / 3), &ego);
        // The rule gives one point less than there are steps: its last displacement is repeated.
        while future.len() < HORIZON {
            let [a, b] = [future[future.len() - 2], future[future.len() - 1]];
            future.push([2.0 * b[0] - a[0], 2.0 * b[1] - a[1]]);
        }
        Trajectory::new("rule", future)
    }
}

impl GeneratorKind for Rule {
    fn facts(&self) -> Facts {
        Facts::without_operating_point(Knowledge {
            ego_future: true,
            others_future: false,
            own_future: true,
            ..Knowledge::NOW
        })
    }

    fn build(&self, _: &GeneratorInputs) -> Result<Box<dyn Generator>, crate::Error> {
        Ok(Box::new(*self))
    }
}

impl Entry<dyn GeneratorKind> for Rule {
    const NAME: &'static str = "rule";
    const SUMMARY: &'static str = "a Bezier curve that cuts in onto the ego's path";
    const SOURCE: &'static str = "CAT's rule-based generator";
    type Options = Self;

    fn build(options: Self) -> Result<Box<dyn GeneratorKind>, String> {
        Ok(Box::new(options))
    }
}

/// The rule's points for an ego path of n positions: n − 1 points. The first is `first`; the curve is
/// attracted by `second` and the middle of the ego's path; the rest are the ego's own positions.
pub fn bezier(first: Point, second: Point, ego: &[Point]) -> Vec<Point> {
    let n = ego.len();
    let length = n * 3 / 4;
    let [third, fourth] = [ego[2 * length / 3], ego[length.min(n - 1)]];
    let curve = |j: usize| {
        let s = j as f64 / (length.max(2) - 1) as f64;
        let r = 1.0 - s;
        let [a, b, c, d] = [r * r * r, 3.0 * r * r * s, 3.0 * r * s * s, s * s * s];
        [0, 1].map(|k| a * first[k] + b * second[k] + c * third[k] + d * fourth[k])
    };
    (0..length).map(curve).chain(ego[(length + 1).min(n)..].iter().copied()).collect()
}
