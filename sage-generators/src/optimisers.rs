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

use crate::{Facts, GeneratorInputs, ProposerKind, generators, proposers::MixedExperts};

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
    /// Attacks of SAGE, if the search starts there.
    pub(crate) sage: Option<Box<dyn Generator>>,
}

impl<O: Optimiser> Generator for Optimised<O> {
    fn attacks(&self, ctx: &Context, at: &[OperatingPoint], seed: u64) -> Result<Vec<Attack>, Error> {
        let optimised = |start: Start| -> Result<Attack, Error> {
            let Optimum { points, began, value } = self.optimiser.optimise(&start, ctx)?;
            let attack = Attack::only(Proposal::of(Trajectory::new("optimised trajectory", points)?));
            let note = (value <= began).then(|| Note::Other(NOTHING_BETTER.to_owned()));
            Ok(Attack { note, ..attack })
        };
        match &self.sage {
            Some(sage) => {
                let attacks = sage.attacks(ctx, at, seed)?;
                let one = |attack: &Attack| optimised(Start::of_plan(ctx, attack.trajectory())?);
                attacks.iter().map(one).collect()
            }
            None => Ok(vec![optimised(Start::of_log(ctx)?)?; at.len()]),
        }
    }
}

/// SAGE with its default options, if a search begins there.
///
/// *Errors*: a missing input.
pub(crate) fn sage_of(
    from: StartFrom,
    inputs: &GeneratorInputs,
) -> Result<Option<Box<dyn Generator>>, crate::Error> {
    let build = || -> Result<Box<dyn Generator>, crate::Error> {
        let sage = generators()?.build_default(MixedExperts::NAME)?;
        sage.build(inputs)
    };
    (from == StartFrom::Sage).then(build).transpose()
}

/// Properties of an optimiser's generator.
pub(crate) fn facts(from: StartFrom, others_future: bool) -> Facts {
    let from_sage = from == StartFrom::Sage;
    Facts {
        knows: Knowledge {
            ego_future: true,
            others_future: others_future || from_sage,
            own_future: !from_sage,
        },
        depends_on_lambda: from_sage,
        depends_on_mu: from_sage,
        needs_experts: from_sage,
        is_upper_bound: false,
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
