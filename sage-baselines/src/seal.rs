//! SEAL: a learned score selects among the prior's candidates, and a learned driver takes over before the hit.
//!
//! The driver's skills are those of windows of 10 steps of driving; a flow draws one for what the adversary sees, and
//! holds it for 10 steps. `sage train-adversary seal` trains all of it. Source: Stoler et al., SEAL (2025).

mod driver;
mod hand_over;
pub mod networks;
mod path;
mod selector;

use std::sync::Arc;

use sage_core::{
    Error,
    generator::{Attack, Generator, Knowledge, OperatingPoint, Reaction},
    motion::{NOW, Trajectory},
    objective::Context,
    registry::Entry,
};
use sage_generators::{Facts, GeneratorInputs, GeneratorKind, ProposeAndSelect, proposers::CatGoals};
use serde::{Deserialize, Serialize};

pub use path::relative_paths;
pub use selector::learned_scores;

use crate::seal::networks::{SEAL_FILE, SealWeights};
use driver::Skills;
use hand_over::planned_hit;
use selector::CriticalitySelector;

/// Options that both generators have.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SealScore {
    /// Number of candidates.
    pub candidates: usize,
    /// File of the learned parts, beside the prior.
    pub file: String,
}

impl Default for SealScore {
    fn default() -> Self {
        Self { candidates: CatGoals::default().candidates, file: SEAL_FILE.to_owned() }
    }
}

/// Properties of both: the score uses the ego's path.
const FACTS: Facts = Facts::of_selection(
    Knowledge { ego_future: true, others_future: false, own_future: false, ..Knowledge::NOW },
    false,
);

impl Entry<dyn GeneratorKind> for SealScore {
    const NAME: &'static str = "seal-score";
    const SUMMARY: &'static str = "the prior's candidate of the highest learned criticality";
    const SOURCE: &'static str = "Stoler et al. 2025 (SEAL), the score alone";
    type Options = Self;

    fn build(options: Self) -> Result<Box<dyn GeneratorKind>, String> {
        options.check()?;
        Ok(Box::new(options))
    }
}

impl SealScore {
    fn check(&self) -> Result<(), String> {
        CatGoals { candidates: self.candidates }.check()?;
        let is_name = !self.file.is_empty() && !self.file.contains(['/', '\\']);
        if is_name { Ok(()) } else { Err(format!("`file` is `{}`; expected the name of a file", self.file)) }
    }

    fn weights(
        &self,
        name: &'static str,
        inputs: &GeneratorInputs,
    ) -> Result<Arc<SealWeights>, sage_generators::Error> {
        let needs = "learned parts beside the prior; name weights that hold them with --weights";
        let source = inputs
            .experts(name)?
            .source()
            .ok_or(sage_generators::Error::Inputs { generator: name, needs })?;
        Ok(Arc::new(SealWeights::load_file(source, &self.file)?))
    }

    fn selected(
        &self,
        name: &'static str,
        inputs: &GeneratorInputs,
        weights: Arc<SealWeights>,
    ) -> Result<ProposeAndSelect, sage_generators::Error> {
        let proposer = CatGoals { candidates: self.candidates }.proposer(inputs.prior(name)?);
        Ok(ProposeAndSelect {
            proposer,
            selector: Box::new(CriticalitySelector(weights)),
            refinement: None,
            facts: FACTS,
        })
    }
}

impl GeneratorKind for SealScore {
    fn facts(&self) -> Facts {
        FACTS
    }

    fn files(&self) -> Vec<String> {
        vec![self.file.clone()]
    }

    fn build(&self, inputs: &GeneratorInputs) -> Result<Box<dyn Generator>, sage_generators::Error> {
        let weights = self.weights(Self::NAME, inputs)?;
        Ok(Box::new(self.selected(Self::NAME, inputs, weights)?))
    }
}

/// Options of `seal`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Seal {
    /// Number of candidates.
    pub candidates: usize,
    /// File of the learned parts, beside the prior.
    pub file: String,
    /// The driver's first action comes this many steps and one before the planned hit, 0 to 80; `null` for *now*.
    pub before_hit: Option<usize>,
}

impl Default for Seal {
    fn default() -> Self {
        let SealScore { candidates, file } = SealScore::default();
        Self { candidates, file, before_hit: Some(10) }
    }
}

impl Entry<dyn GeneratorKind> for Seal {
    const NAME: &'static str = "seal";
    const SUMMARY: &'static str =
        "`seal-score` with a learned driver at the wheel from 1.1 s before the planned hit";
    const SOURCE: &'static str = "Stoler et al. 2025 (SEAL)";
    type Options = Self;

    fn build(options: Self) -> Result<Box<dyn GeneratorKind>, String> {
        options.score().check()?;
        match options.before_hit {
            Some(steps @ 81..) => Err(format!("`before_hit` is {steps}; expected 0 to 80 steps, or null")),
            _ => Ok(Box::new(options)),
        }
    }
}

impl Seal {
    fn score(&self) -> SealScore {
        SealScore { candidates: self.candidates, file: self.file.clone() }
    }
}

impl GeneratorKind for Seal {
    fn facts(&self) -> Facts {
        FACTS
    }

    fn files(&self) -> Vec<String> {
        vec![self.file.clone()]
    }

    fn build(&self, inputs: &GeneratorInputs) -> Result<Box<dyn Generator>, sage_generators::Error> {
        let score = self.score();
        let weights = score.weights(Self::NAME, inputs)?;
        let selected = score.selected(Self::NAME, inputs, weights.clone())?;
        Ok(Box::new(HandOver { selected, skills: Arc::new(Skills(weights)), before_hit: self.before_hit }))
    }
}

/// Plans of a selection, from which a learned driver takes over.
struct HandOver {
    selected: ProposeAndSelect,
    skills: Arc<Skills>,
    before_hit: Option<usize>,
}

impl Generator for HandOver {
    fn attacks(&self, ctx: &Context, at: &[OperatingPoint], seed: u64) -> Result<Vec<Attack>, Error> {
        let mut attacks = self.selected.attacks(ctx, at, seed)?;
        for attack in &mut attacks {
            let reaction = reaction(self.skills.clone(), attack.trajectory(), ctx, self.before_hit, seed);
            attack.reaction = Some(reaction);
        }
        Ok(attacks)
    }
}

/// The reaction of a learned driver that takes over some steps before a plan hits the ego's path; `None` for *now*.
fn reaction(
    skills: Arc<Skills>,
    plan: &Trajectory,
    ctx: &Context,
    before_hit: Option<usize>,
    seed: u64,
) -> Reaction {
    // A car that is not there now begins with the first point of its plan.
    let first = if ctx.adversary().is_valid(NOW) { NOW } else { NOW + 1 };
    let from = hand_over::frame(planned_hit(plan.points(), ctx), before_hit).max(first);
    Reaction { from, policy: skills, seed }
}

/// The same for a driver of these weights that takes over 10 steps before the hit, as published.
pub fn seal_reaction(weights: Arc<SealWeights>, plan: &Trajectory, ctx: &Context, seed: u64) -> Reaction {
    reaction(Arc::new(Skills(weights)), plan, ctx, Seal::default().before_hit, seed)
}
