//! GOOSE: a policy moves the control points of the adversary's path, and sees after each move what the ego does.
//!
//! The path is a NURBS through the adversary's recording ([`Curve`]). In six trials the ego drives against it; after each but
//! the last a policy changes weights and control points, from what happened in the drive. It was trained by reinforcement
//! learning with goals in hindsight (`sage train-adversary goose`). Source: Ransiek et al., GOOSE (2024), in the version of
//! Stoler et al., SEAL (2025).

mod curve;
mod features;
mod goal;
mod mirror;
pub mod networks;
mod trial;

use sage_core::{
    Error,
    generator::{Attack, DriverUnderTest, Extension, Generator, Knowledge, OperatingPoint, Proposal},
    metric::{MeasuredTrajectory, Metric},
    objective::Context,
    registry::Entry,
};
use sage_generators::{Facts, GeneratorInputs, GeneratorKind};
use serde::{Deserialize, Serialize};

pub use curve::{CONTROL_POINTS, Curve};
pub use goal::{DESIRED, Goal, HINDSIGHT, HINDSIGHT_GOALS, Outcome, attack_outcome, outcome_in_hindsight};
pub use mirror::{mirrored_action, mirrored_rest, mirrored_rows};
pub use trial::{RepeatedEgo, Trial, TrialScene};

use crate::goose::networks::{ACTION, GOOSE_FILE, GooseWeights};

/// Trials of a scene: the recording's curve, and five changes.
pub const TRIALS: usize = 6;

/// What its attacks add: the number of drives of the driver that it asked for.
pub const QUERIES: &str = "queries";

/// The metric of [`QUERIES`].
pub fn queries_metric() -> Metric<MeasuredTrajectory> {
    let queries =
        |t: &MeasuredTrajectory| t.extension.as_ref().filter(|one| one.name == QUERIES)?.value.as_f64();
    Metric::mean(QUERIES, queries)
        .unit("drives")
        .about("drives of the driver under test that the generator asked for")
        .less_is_better()
}

/// Options of `goose`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Goose {
    /// Most trials in a scene, 1 to 100. The first is the curve through the recording.
    pub trials: usize,
    /// File of the networks, beside the prior.
    pub file: String,
    /// Whether what happened is encoded by random weights, as in the published evaluation, which does not save them.
    pub random_encoder: bool,
}

impl Default for Goose {
    fn default() -> Self {
        Self { trials: TRIALS, file: GOOSE_FILE.to_owned(), random_encoder: false }
    }
}

impl Entry<dyn GeneratorKind> for Goose {
    const NAME: &'static str = "goose";
    const SUMMARY: &'static str =
        "a learned policy moves the control points of the adversary's path, in six trials against the driver";
    const SOURCE: &'static str = "Ransiek et al. 2024 (GOOSE), as in Stoler et al. 2025 (SEAL)";
    type Options = Self;

    fn build(options: Self) -> Result<Box<dyn GeneratorKind>, String> {
        let Self { trials, file, .. } = &options;
        if !(1..=100).contains(trials) {
            return Err(format!("`trials` is {trials}; expected 1 to 100"));
        }
        if file.is_empty() || file.contains(['/', '\\']) {
            return Err(format!("`file` is `{file}`; expected the name of a file"));
        }
        Ok(Box::new(options))
    }
}

impl GeneratorKind for Goose {
    fn facts(&self) -> Facts {
        let knows = Knowledge { ego_future: true, others_future: true, own_future: true, driver: true };
        Facts { needs_experts: true, ..Facts::without_operating_point(knows) }
    }

    fn files(&self) -> Vec<String> {
        vec![self.file.clone()]
    }

    fn build(&self, inputs: &GeneratorInputs) -> Result<Box<dyn Generator>, sage_generators::Error> {
        let needs = "a policy beside the prior; name weights that hold one with --weights";
        let experts = inputs.experts(Self::NAME)?;
        let source =
            experts.source().ok_or(sage_generators::Error::Inputs { generator: Self::NAME, needs })?;
        let weights = GooseWeights::load_file(source, &self.file)?;
        let weights = if self.random_encoder { weights.with_random_encoder(inputs.seed)? } else { weights };
        Ok(Box::new(Policy { weights, trials: self.trials }))
    }
}

/// Plans by a policy.
struct Policy {
    weights: GooseWeights,
    trials: usize,
}

impl Policy {
    fn attack(&self, ctx: &Context, driver: &dyn DriverUnderTest) -> Result<Attack, Error> {
        let scene = TrialScene::new(ctx, self.weights.options())?;
        let trials = tried(&scene, driver, self.trials, |trial| action(&self.weights, ctx, trial))?;
        let last = trials.len() - 1;
        let extension = Extension { name: QUERIES.to_owned(), value: trials.len().into() };
        let candidates = trials.into_iter().map(|trial| Proposal::of(trial.plan)).collect();
        Ok(Attack { extension: Some(extension), ..Attack::of(candidates, last, None) })
    }
}

/// The action of a policy after a trial.
///
/// *Errors*: [`Error::Scene`] if a number is not finite.
pub fn action(weights: &GooseWeights, ctx: &Context, trial: &Trial) -> Result<[f64; ACTION], Error> {
    weights.action(&trial.rows, &trial.rest(&DESIRED)).map_err(|error| Error::Scene {
        scene: ctx.scene().id.clone(),
        problem: format!("policy of the adversary: {error}"),
    })
}

/// The trials of a policy: at most `most`, at least one; they end when the goal is reached.
///
/// *Errors*: those of the policy and of the driver.
pub fn tried(
    scene: &TrialScene,
    driver: &dyn DriverUnderTest,
    most: usize,
    mut act: impl FnMut(&Trial) -> Result<[f64; ACTION], Error>,
) -> Result<Vec<Trial>, Error> {
    let mut trials = vec![scene.trial(scene.first_curve().clone(), driver)?];
    while trials.len() < most {
        let Some(last) = trials.last().filter(|trial| !trial.outcome.is_done) else { break };
        let curve = last.curve.changed(&act(last)?);
        trials.push(scene.trial(curve, driver)?);
    }
    Ok(trials)
}

impl Generator for Policy {
    fn attacks(&self, ctx: &Context, at: &[OperatingPoint], _: u64) -> Result<Vec<Attack>, Error> {
        let attack = Attack { extension: None, ..self.attack(ctx, &RepeatedEgo(ctx))? };
        Ok(vec![attack; at.len()])
    }

    fn attacks_on(
        &self,
        ctx: &Context,
        driver: &dyn DriverUnderTest,
        at: &[OperatingPoint],
        _: u64,
    ) -> Result<Vec<Attack>, Error> {
        Ok(vec![self.attack(ctx, driver)?; at.len()])
    }
}
