//! AdvTrajOpt: projected gradient ascent on the adversary's positions (Zhang et al., CVPR 2022), with the objective and the
//! steps that the SAGE paper gives it.
//!
//! A displacement is added to a base trajectory and scaled down until speed, acceleration, jerk and deviation keep their
//! bounds. The plain gradient acts on a few frames: its kinks break the bounds, the scale goes to 0, and nothing moves. The well-built
//! variant smooths the gradient, starts from a bicycle's motion, and keeps clear of edges and others.

use sage_core::{
    Error,
    generator::Generator,
    geometry::{Point, distance, norm, sub},
    motion::{HORIZON, Pose},
    objective::{Context, PoseGradient},
    registry::Entry,
};
use sage_generators::{Facts, GeneratorInputs, GeneratorKind};
use serde::{Deserialize, Serialize};

use crate::optimisers::{
    Optimised, Optimiser, Optimum, Start, StartFrom, Weights, bicycle::Bicycle, bounds, check_steps,
    evaluate, facts, fit, generator_of, smoothing::Smoothing,
};

/// Scales of the displacement that are tried, as multiples of the last one.
const SCALES: usize = 50;
/// A step shorter than this has no direction, metres; the heading is then that of the base.
const LEAST_WAY: f64 = 0.05;

/// The generator `adv-traj-opt`.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AdvTrajOpt {
    /// Weight of the smooth adversarial reward.
    pub adversarial: f64,
    /// Weight of the smooth realism penalty.
    pub realism: f64,
    /// Weight of missing distance to edges and others.
    pub clearance: f64,
    /// Steps of the search.
    pub steps: usize,
    /// Largest displacement of a position in a step, metres.
    pub rate: f64,
    /// Weight of squared third differences in the smoothing of the gradient.
    pub smoothing: f64,
    /// Largest deviation from the base, metres.
    pub deviation: f64,
    /// Where the search begins: `log`, or the attack of `prior` or `sage`.
    pub start: StartFrom,
}

impl Default for AdvTrajOpt {
    fn default() -> Self {
        Self {
            adversarial: 0.9,
            realism: 0.1,
            clearance: 0.3,
            steps: 50,
            rate: 0.2,
            smoothing: 1e6,
            deviation: 10.0,
            start: StartFrom::Log,
        }
    }
}

impl Entry<dyn GeneratorKind> for AdvTrajOpt {
    const NAME: &'static str = "adv-traj-opt";
    const SUMMARY: &'static str =
        "projected gradient ascent on positions, smoothed, clear of edges and others";
    const SOURCE: &'static str = "Zhang et al. (2022), as the SAGE paper configures it, well built";
    type Options = Self;

    fn build(options: Self) -> Result<Box<dyn GeneratorKind>, String> {
        options.search().check()?;
        if !(options.smoothing >= 0.0 && options.smoothing <= 1e9) {
            return Err(format!("`smoothing` is {}; expected 0 to 1e9", options.smoothing));
        }
        Ok(Box::new(options))
    }
}

impl AdvTrajOpt {
    /// The options of `adv-traj-opt-published`: the plain gradient on the recorded positions, without clearance. It starts
    /// from the recording, where the original draws ten random starts within 1 m; the bound of 10 m and the 50 scales are
    /// ours.
    pub fn published() -> Self {
        Self { clearance: 0.0, smoothing: 0.0, ..Self::default() }
    }

    pub(crate) fn search(&self) -> Search {
        let Self { adversarial, realism, clearance, steps, rate, deviation, .. } = *self;
        let smoothing = (self.smoothing > 0.0).then(|| Smoothing::new(HORIZON, self.smoothing));
        Search { weights: Weights { adversarial, realism, clearance }, steps, rate, deviation, smoothing }
    }
}

impl GeneratorKind for AdvTrajOpt {
    fn facts(&self) -> Facts {
        facts(self.start, self.clearance > 0.0)
    }

    fn build(&self, inputs: &GeneratorInputs) -> Result<Box<dyn Generator>, sage_generators::Error> {
        Ok(Box::new(Optimised { optimiser: self.search(), first: generator_of(self.start, inputs)? }))
    }
}

/// A search over positions.
pub(crate) struct Search {
    weights: Weights,
    steps: usize,
    rate: f64,
    deviation: f64,
    /// Of the gradient. With it the base is a bicycle's motion, and a step has the length of the rate.
    smoothing: Option<Smoothing>,
}

impl Search {
    fn check(&self) -> Result<(), String> {
        self.weights.check()?;
        check_steps(self.steps, self.rate)?;
        if !(self.deviation > 0.0 && self.deviation <= 1000.0) {
            return Err(format!("`deviation` is {}; expected metres above 0, at most 1000", self.deviation));
        }
        Ok(())
    }

    /// The base trajectory.
    pub(crate) fn base(&self, start: &Start, ctx: &Context) -> Vec<Pose> {
        if self.smoothing.is_none() {
            return start.poses.clone();
        }
        let bicycle = Bicycle::of_length(ctx.size()[0]);
        let (controls, _) = fit::controls(&bicycle, &start.now, &start.poses);
        bicycle.motion(&start.now, &controls).poses
    }

    /// Moves a displacement along a gradient with respect to the positions. Headings follow from them and have none.
    /// `scale` is that at which the gradient was taken.
    fn ascend(&self, displacement: &mut [Point], gradient: &mut [Point], scale: f64) {
        let step = match &self.smoothing {
            None => self.rate * scale,
            Some(smoothing) => {
                smoothing.apply(gradient);
                let length = gradient.iter().map(|g| norm(*g)).fold(0.0, f64::max);
                if length > 0.0 { self.rate / length } else { 0.0 }
            }
        };
        for (d, g) in displacement.iter_mut().zip(gradient) {
            (0..2).for_each(|i| d[i] += step * g[i]);
        }
    }

    /// The largest of the scales at which the displaced base keeps all bounds; 0 if none does.
    fn scale(&self, base: &[Pose], displacement: &[Point], history: [Point; 2], bounds: [f64; 5]) -> f64 {
        let farthest = displacement.iter().map(|d| norm(*d)).fold(0.0, f64::max);
        let scales = (1..=SCALES).rev().map(|k| k as f64 / SCALES as f64);
        let mut kept = scales.filter(|scale| {
            let points = displaced(base, displacement, *scale);
            scale * farthest <= self.deviation && bounds::are_kept(bounds::greatest(history, points), bounds)
        });
        kept.next().unwrap_or(0.0)
    }
}

/// The base with a share of a displacement.
fn displaced<'a>(
    base: &'a [Pose],
    displacement: &'a [Point],
    scale: f64,
) -> impl Iterator<Item = Point> + 'a {
    base.iter().zip(displacement).map(move |(pose, d)| [0, 1].map(|i| pose.position[i] + scale * d[i]))
}

/// Poses at points, with headings along their steps.
fn poses(points: impl Iterator<Item = Point>, base: &[Pose], now: Point) -> Vec<Pose> {
    let mut last = now;
    points
        .zip(base)
        .map(|(position, base)| {
            let way = sub(position, last);
            let moves = distance(position, last) >= LEAST_WAY;
            last = position;
            Pose { position, heading: if moves { way[1].atan2(way[0]) } else { base.heading } }
        })
        .collect()
}

impl Optimiser for Search {
    fn optimise(&self, start: &Start, ctx: &Context) -> Result<Optimum, Error> {
        let base = self.base(start, ctx);
        let (now, history) = (start.now.position, [start.now.position, start.before[0]]);
        let own = bounds::greatest(history, base.iter().map(|pose| pose.position));
        let bounds = bounds::raised(own);
        let mut objective = self.weights.objective();
        let mut gradient = PoseGradient::default();
        let mut displacement = vec![[0.0; 2]; base.len()];
        let first = poses(displaced(&base, &displacement, 0.0), &base, now);
        let value = evaluate(&mut objective, &first, ctx, &mut gradient, 0)?;
        let mut best = Optimum::start(value, &first);
        let mut scale = 1.0;
        for step in 1..=self.steps {
            self.ascend(&mut displacement, &mut gradient.position, scale);
            scale = self.scale(&base, &displacement, history, bounds);
            let poses = poses(displaced(&base, &displacement, scale), &base, now);
            let value = evaluate(&mut objective, &poses, ctx, &mut gradient, step)?;
            best.update(value, &poses);
        }
        Ok(best)
    }
}
