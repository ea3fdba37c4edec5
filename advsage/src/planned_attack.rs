//! An attack that was planned against a drive, and what the attacked drive says of it.

use sage_core::{
    generator::Extension,
    motion::NOW,
    objective::{Context, Reason, Scorer},
};
use sage_sim::{
    attack_test::AttackPath,
    avoidable::{Avoidable, Avoidance, AvoidanceOptions},
    drive::Drive,
    episode::{Episode, LAST_FRAME, Verdict},
    search::AttackedPath,
};

use crate::{
    Result,
    rows::{contact::step, drive::DriveAttack},
};

/// An attack that was planned against the drive without it.
pub struct PlannedAttack {
    /// The adversary's path: the plan, or what it drove against this driver.
    pub path: AttackPath,
    /// Whether it is feasible by the paper's rule.
    pub feasible: bool,
    /// Step of the contact with that drive.
    contact: Option<usize>,
    /// The scene with that drive.
    ctx: Context,
    /// What the generator adds to the attack.
    extension: Option<Extension>,
}

impl PlannedAttack {
    /// A plan in the scene with the drive before.
    pub fn of(ctx: &Context, path: AttackPath) -> Self {
        let scores = Scorer::new(ctx).scores(&ctx.candidate(path.trajectory.clone()));
        let (feasible, contact) = (scores.feasible, scores.collision_step);
        Self { path, feasible, contact, ctx: ctx.clone(), extension: None }
    }

    /// The same with what the generator adds to the attack.
    pub fn extended(self, extension: Option<Extension>) -> Self {
        Self { extension, ..self }
    }

    /// The row of the attack, with what the attacked drive says of it. `before` is the drive without the attack.
    ///
    /// *Errors*: those of the search for evasive manoeuvres.
    pub fn row(self, verdict: Verdict, episode: &Episode, before: &Drive) -> Result<DriveAttack> {
        let first = before.contacts.first().map(|contact| contact.step);
        let mut row = DriveAttack {
            trajectory: self.path.trajectory.clone(),
            feasible: self.feasible,
            planned_contact: self.contact,
            believable: None,
            unbelievable: Vec::new(),
            verdict,
            extension: self.extension,
            avoidable: Avoidable::default(),
            unattacked_contact: first.filter(|frame| *frame <= LAST_FRAME).map(step),
        };
        let Some(contact) = episode.contacts.first().filter(|_| verdict.attack) else { return Ok(row) };
        let ctx = AttackedPath::of(episode, before).context(&self.ctx)?;
        let candidate = ctx.candidate(self.path.trajectory);
        row.unbelievable = Scorer::new(&ctx).scores(&candidate).unbelievable;
        if !verdict.solid && row.unbelievable.is_empty() {
            row.unbelievable.push(Reason::shallow(contact.overlap));
        }
        row.believable = Some(row.unbelievable.is_empty());
        let avoidance = Avoidance::new(&ctx, AvoidanceOptions::default())?;
        row.avoidable = avoidance.of_contact(&candidate, contact.contact.step.checked_sub(NOW));
        Ok(row)
    }
}
