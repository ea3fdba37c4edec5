//! What is measured of a scene's attacks.

use advsage::ego::Ego;
use sage_core::{
    generator::Attack,
    objective::Context,
    selection_outcome::{CandidateCounts, SelectionOutcome},
};
use sage_sim::{
    SimScene,
    attack_test::AttackTest,
    avoidable::Avoidable,
    reference::{Answer, Watching},
};

use super::scored::ScoredCandidates;
use crate::Result;

/// An attack with what came of it.
pub(super) struct MeasuredAttack<'a> {
    pub(super) attack: &'a Attack,
    /// Step of the contact.
    pub(super) contact: Option<usize>,
    pub(super) avoidable: Avoidable,
    /// Whether `r157` prevents the contact.
    pub(super) references: Vec<Answer>,
    pub(super) outcome: SelectionOutcome,
    pub(super) counts: CandidateCounts,
}

/// Measures all attacks of a scene.
///
/// *Errors*: an attack that is not one on this scene.
pub(super) fn measured<'a>(
    attacks: &'a [Attack],
    scored: &mut ScoredCandidates,
    ctx: &Context,
    ego: &'a Ego,
    test: Option<&AttackTest<'a>>,
    seed: u64,
) -> Result<Vec<MeasuredAttack<'a>>> {
    let mut r157 = None;
    let measure = |attack: &'a Attack| {
        attack.check(ctx.scene())?;
        scored.score(attack)?;
        let contact = scored.get(attack.trajectory())?.scores.collision_step;
        let references = match contact {
            None => Vec::new(),
            Some(_) => r157.get_or_insert_with(|| R157::new(ego, test, ctx, seed)).answers(attack),
        };
        let (outcome, counts) = scored.outcome(attack)?;
        let avoidable = scored.avoidable(attack.trajectory())?;
        Ok(MeasuredAttack { attack, contact, avoidable, references, outcome, counts })
    };
    attacks.iter().map(measure).collect()
}

/// The reference driver `r157`, asked whether it prevents an attack.
struct R157<'p>(Option<Watching<'p>>);

impl<'p> R157<'p> {
    /// Watches the drive that is attacked up to *now*; without an answer in a scene that cannot be simulated.
    fn new(ego: &'p Ego, test: Option<&AttackTest<'p>>, ctx: &Context, seed: u64) -> Self {
        let watch = || -> Result<Watching<'p>, sage_sim::Error> {
            match test {
                Some(test) => test.watching(),
                None => {
                    let simulated = SimScene::new(ctx.scene().clone(), ctx.index().clone())?;
                    ego.test(&simulated, seed)?.watching()
                }
            }
        };
        Self(watch().ok())
    }

    fn answers(&self, attack: &Attack) -> Vec<Answer> {
        let prevention = self.0.as_ref().and_then(|watching| watching.prevention(attack.trajectory()).ok());
        prevention.map_or(Vec::new(), |prevention| prevention.answers)
    }
}
