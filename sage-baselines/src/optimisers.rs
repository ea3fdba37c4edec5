//! What generators that optimise a trajectory share: a bicycle with gradients, a fit of controls to positions, Adam,
//! bounds of motion, and the start of the search.

pub(crate) mod adam;
pub(crate) mod bicycle;
pub(crate) mod bounds;
pub(crate) mod fit;
pub(crate) mod smoothing;
mod start;

use sage_core::{
    Error,
    generator::{Attack, Generator, Knowledge, Note, OperatingPoint, Proposal},
    geometry::Point,
    motion::{Pose, Trajectory},
    objective::{Clearance, Context, PoseGradient, SmoothAdversarial, SmoothObjective, SmoothRealism},
};
use sage_generators::{Facts, GeneratorInputs, generators};

pub(crate) use start::Start;
pub use start::StartFrom;

/// Least and greatest weight of a term, number of steps, and rate that options may have.
const WEIGHTS: [f64; 2] = [0.0, 100.0];
const MOST_STEPS: usize = 10_000;
/// Note on an attack that is where the search began.
const NOTHING_BETTER: &str = "the search found nothing better than its start";

/// Weights of the terms that an optimiser maximises.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Weights {
    pub(crate) adversarial: f64,
    pub(crate) realism: f64,
    pub(crate) clearance: f64,
}

impl Weights {
    pub(crate) fn check(&self) -> Result<(), String> {
        let all =
            [("adversarial", self.adversarial), ("realism", self.realism), ("clearance", self.clearance)];
        match all.into_iter().find(|(_, weight)| !(WEIGHTS[0]..=WEIGHTS[1]).contains(weight)) {
            Some((name, weight)) => {
                Err(format!("`{name}` is {weight}; expected a weight from {} to {}", WEIGHTS[0], WEIGHTS[1]))
            }
            None => Ok(()),
        }
    }

    pub(crate) fn objective(&self) -> SmoothObjective {
        SmoothObjective::new(vec![
            (self.adversarial, Box::new(SmoothAdversarial::default())),
            (-self.realism, Box::new(SmoothRealism)),
            (-self.clearance, Box::new(Clearance::default())),
        ])
    }
}

/// Refuses a number of steps or a rate out of range.
pub(crate) fn check_steps(steps: usize, rate: f64) -> Result<(), String> {
    if steps == 0 || steps > MOST_STEPS {
        return Err(format!("`steps` is {steps}; expected 1 to {MOST_STEPS}"));
    }
    if !(rate > 0.0 && rate.is_finite()) {
        return Err(format!("`rate` is {rate}; expected a number above 0"));
    }
    Ok(())
}

/// The best positions of a search, and the values of the smooth objective at its start and there.
pub(crate) struct Optimum {
    pub(crate) points: Vec<Point>,
    pub(crate) began: f64,
    pub(crate) value: f64,
}

impl Optimum {
    /// The start of a search.
    pub(crate) fn start(value: f64, poses: &[Pose]) -> Self {
        Self { points: positions(poses), began: value, value }
    }

    /// Takes what is better.
    pub(crate) fn update(&mut self, value: f64, poses: &[Pose]) {
        if value > self.value {
            (self.value, self.points) = (value, positions(poses));
        }
    }
}

fn positions(poses: &[Pose]) -> Vec<Point> {
    poses.iter().map(|pose| pose.position).collect()
}

/// An optimiser of trajectories.
pub(crate) trait Optimiser: Send + Sync {
    /// The best that a search finds, at least as good as its start.
    ///
    /// *Errors*: a term whose gradient is not finite, with the step.
    fn optimise(&self, start: &Start, ctx: &Context) -> Result<Optimum, Error>;
}

/// The generator of an optimiser.
pub(crate) struct Optimised<O> {
    pub(crate) optimiser: O,
    /// What makes the attacks from which the search begins, if it does not begin at the recording.
    pub(crate) first: Option<Box<dyn Generator>>,
}

impl<O: Optimiser> Generator for Optimised<O> {
    fn attacks(&self, ctx: &Context, at: &[OperatingPoint], seed: u64) -> Result<Vec<Attack>, Error> {
        let optimised = |start: Start| -> Result<Attack, Error> {
            let Optimum { points, began, value } = self.optimiser.optimise(&start, ctx)?;
            let attack = Attack::only(Proposal::of(Trajectory::new("optimised trajectory", points)?));
            let note = (value <= began).then(|| Note::Other(NOTHING_BETTER.to_owned()));
            Ok(Attack { note, ..attack })
        };
        match &self.first {
            Some(first) => {
                let attacks = first.attacks(ctx, at, seed)?;
                let one = |attack: &Attack| optimised(Start::of_plan(ctx, attack.trajectory())?);
                attacks.iter().map(one).collect()
            }
            None => Ok(vec![optimised(Start::of_log(ctx)?)?; at.len()]),
        }
    }
}

/// The generator with default options from whose attack a search begins, if there is one.
///
/// *Errors*: a missing input.
pub(crate) fn generator_of(
    from: StartFrom,
    inputs: &GeneratorInputs,
) -> Result<Option<Box<dyn Generator>>, sage_generators::Error> {
    let build = |name| generators()?.build_default(name)?.build(inputs);
    from.generator().map(build).transpose()
}

/// Properties of an optimiser's generator.
pub(crate) fn facts(from: StartFrom, others_future: bool) -> Facts {
    let from_log = from == StartFrom::Log;
    Facts {
        knows: Knowledge {
            ego_future: true,
            others_future: others_future || !from_log,
            own_future: from_log,
            driver: false,
        },
        depends_on_lambda: from == StartFrom::Sage,
        depends_on_mu: !from_log,
        needs_experts: !from_log,
        is_upper_bound: false,
        plans_against_ego: true,
    }
}

/// Value and gradient of an objective at a step of an optimisation.
///
/// *Errors*: a term that is not finite, with the step.
pub(crate) fn evaluate(
    objective: &mut SmoothObjective,
    poses: &[Pose],
    ctx: &Context,
    gradient: &mut PoseGradient,
    step: usize,
) -> Result<f64, Error> {
    objective.value(poses, ctx, gradient).map_err(|term| Error::Scene {
        scene: ctx.scene().id.clone(),
        problem: format!("the gradient of `{term}` is not finite at step {step} of the optimisation"),
    })
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use sage_core::{
        geometry::{cross, distance, dot, norm, sub},
        motion::DT,
        objective::DifferentiableReward,
        scene::{Scene, SceneIndex},
    };
    use sage_data::procedural::{Kind, generate};

    use super::{
        bicycle::{ACCELERATION, DECELERATION, STEERING},
        *,
    };
    use crate::{AdvTrajOpt, King};

    /// Procedural scenes of every kind.
    fn contexts() -> Vec<Context> {
        let scenes = Kind::ALL.iter().flat_map(|kind| (0..4).filter_map(|n| generate(*kind, 7, n)));
        let context = |scene: Scene| {
            let scene = Arc::new(scene);
            let index = SceneIndex::new(scene.map.clone());
            Context::new(&scene, &index, &Default::default())
        };
        scenes.filter_map(|scene| context(scene).ok()).collect()
    }

    #[test]
    fn searches_end_better_than_they_began() {
        let contexts = contexts();
        let search = AdvTrajOpt::default().search();
        let optimisers: [&dyn Optimiser; 2] = [&King::default(), &search];
        for optimiser in optimisers {
            let mut better = 0;
            for ctx in &contexts {
                let start = Start::of_log(ctx).unwrap_or_else(|error| panic!("{error}"));
                let found = optimiser.optimise(&start, ctx).unwrap_or_else(|error| panic!("{error}"));
                assert!(found.value >= found.began, "{}", ctx.scene().id);
                assert!(found.points.len() == 80 && found.points.iter().flatten().all(|x| x.is_finite()));
                better += usize::from(found.value > found.began);
            }
            assert!(
                contexts.len() > 20 && better * 10 > contexts.len() * 9,
                "{better} of {}",
                contexts.len()
            );
        }
    }

    #[test]
    fn king_keeps_the_limits_of_its_bicycle() {
        for ctx in contexts() {
            let start = Start::of_log(&ctx).unwrap_or_else(|error| panic!("{error}"));
            let found = King::default().optimise(&start, &ctx).unwrap_or_else(|error| panic!("{error}"));
            let points = [&[start.now.position][..], &found.points].concat();
            let ways: Vec<Point> = points.windows(2).map(|p| sub(p[1], p[0])).collect();
            let rear = bicycle::Bicycle::of_length(ctx.size()[0]).rear;
            // The slip at full steering; the course turns by the heading's turn and by the change of the slip.
            let slip = (0.5 * STEERING.tan()).atan();
            for pair in ways.windows(2) {
                let [a, b] = [norm(pair[0]), norm(pair[1])];
                let gain = (b - a) / DT / DT;
                // The softplus adds at most ln 2 / 7 m/s to a standing car.
                assert!((-DECELERATION - 1e-6..=ACCELERATION + 1.0).contains(&gain), "{gain}");
                if a > 0.05 {
                    let turn = cross(pair[0], pair[1]).atan2(dot(pair[0], pair[1])).abs();
                    assert!(turn <= a / rear * slip.sin() + 2.0 * slip + 1e-6, "{turn}");
                }
            }
        }
    }

    #[test]
    fn positions_keep_their_bounds() {
        let search = AdvTrajOpt::default().search();
        for ctx in contexts() {
            let start = Start::of_log(&ctx).unwrap_or_else(|error| panic!("{error}"));
            let (base, history) = (search.base(&start, &ctx), [start.now.position, start.before[0]]);
            let greatest = |points: &[Point]| bounds::greatest(history, points.iter().copied());
            let base: Vec<Point> = base.iter().map(|pose| pose.position).collect();
            let bounds = bounds::raised(greatest(&base)).map(|bound| bound * (1.0 + 1e-9));
            let found = search.optimise(&start, &ctx).unwrap_or_else(|error| panic!("{error}"));
            assert!(bounds::are_kept(greatest(&found.points), bounds), "{}", ctx.scene().id);
            let farthest = found.points.iter().zip(&base).map(|(a, b)| distance(*a, *b)).fold(0.0, f64::max);
            assert!(farthest <= 10.0 + 1e-9, "{farthest}");
        }
    }

    #[test]
    fn a_gradient_that_is_not_finite_names_scene_step_and_term() {
        struct Broken;
        impl DifferentiableReward for Broken {
            fn name(&self) -> &str {
                "broken"
            }

            fn value(&self, _: &[Pose], _: &Context, _: &mut PoseGradient) -> f64 {
                f64::NAN
            }
        }
        let ctx = &contexts()[0];
        let start = Start::of_log(ctx).unwrap_or_else(|error| panic!("{error}"));
        let mut objective = SmoothObjective::new(vec![(1.0, Box::new(Broken))]);
        let error = evaluate(&mut objective, &start.poses, ctx, &mut PoseGradient::default(), 12);
        let text = error.err().map(|error| error.to_string()).unwrap_or_default();
        assert!(
            text.contains(&ctx.scene().id) && text.contains("`broken` is not finite at step 12"),
            "{text}"
        );
    }
}
