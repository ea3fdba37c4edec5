//! What attacks the drivers of one scene.

use std::num::NonZeroUsize;

use anyhow::{Context as _, Result};
use sage_core::{
    motion::Trajectory,
    objective::{Context, Reason, Scorer},
};
use sage_data::Recording;
use sage_sim::{
    attack_test::{AttackPath, AttackTest},
    avoidable::{Avoidable, Avoidance, AvoidanceOptions},
    drive::Drive,
    episode::{LAST_FRAME, Verdict},
};
use serde_json::{Map, Value};

use super::{Attacked, attack_file, row::AttackRow};
use crate::{contact_row::step, run_generator::RunGenerator, scene_queue::Failure};

/// What attacks the drivers of one scene.
pub(super) enum SceneAttacks<'a> {
    /// Nothing; with the description of an attack that the scene holds already.
    AsItIs(Map<String, Value>),
    /// One attack from a file, with its description.
    Given(Trajectory, Map<String, Value>),
    /// A generator at its operating points.
    Generated(&'a RunGenerator<'a>),
}

/// One drive of a driver: its attack, and what its row says of it.
pub(super) struct PlannedDrive {
    pub(super) described: Map<String, Value>,
    /// Name of the operating point on the page; empty without a generator.
    pub(super) label: String,
    /// What differs between the drives of a sweep, and its value.
    pub(super) swept: Option<(&'static str, f64)>,
    /// `None` for the scene as it is.
    pub(super) attack: Option<PlannedAttack>,
}

/// An attack with its scores against the drive that it was planned against.
pub(crate) struct PlannedAttack {
    /// The adversary's path: the plan, or what it drove against this driver.
    pub(super) path: AttackPath,
    pub(super) feasible: bool,
    believable: Option<bool>,
    unbelievable: Vec<Reason>,
    /// Step of the contact with that drive.
    pub(crate) contact: Option<usize>,
    /// Whether that drive has an evasive manoeuvre.
    avoidable: Avoidable,
    /// Drives of the driver that the generator asked for.
    queries: usize,
}

impl<'a> SceneAttacks<'a> {
    /// The attacks of a scene, and its adversary, if the attack names it.
    ///
    /// *Errors*: an attack on another scene; weights that cannot be used end the run.
    pub(super) fn of(
        attacked: &'a Attacked,
        recording: &Recording,
        scene_name: &str,
        source_hash: &str,
        wanted: Option<&str>,
    ) -> Result<(Self, Option<String>), Failure> {
        let fail = |error: anyhow::Error| Failure::Scene(error);
        let wanted_id = || wanted.map(str::to_owned);
        Ok(match attacked {
            Attacked::AsItIs => {
                (Self::AsItIs(attack_file::provenance(recording).map_err(fail)?), wanted_id())
            }
            Attacked::FromFile(file) => {
                let attack = file.attack(&recording.scene, scene_name, source_hash, wanted);
                let (adversary, trajectory) = attack.map_err(fail)?;
                (Self::Given(trajectory, file.described().clone()), Some(adversary))
            }
            Attacked::Generated(generator) => (Self::Generated(generator), wanted_id()),
        })
    }

    /// Whether the driver is attacked, and so first drives the unchanged scene.
    pub(super) fn has_attack(&self) -> bool {
        !matches!(self, Self::AsItIs(_))
    }

    /// The drives of a driver; the test holds its drive in the unchanged scene, if it is attacked.
    ///
    /// *Errors*: a scene that cannot be attacked; those of the generator.
    pub(super) fn planned(&self, test: Option<&AttackTest>) -> Result<Vec<PlannedDrive>> {
        let context = || -> Result<Context> {
            let test = test.context("an attacked driver is tested")?;
            let scene = test.scene();
            scene.attackable_horizon()?;
            scene.check_apart_now()?;
            let ctx = test.context()?;
            ctx.check_apart_now()?;
            Ok(ctx)
        };
        match self {
            Self::AsItIs(known) => {
                let described = complete(known.clone());
                Ok(vec![PlannedDrive { described, label: String::new(), swept: None, attack: None }])
            }
            Self::Given(trajectory, described) => {
                let ctx = context()?;
                let avoidance = Avoidance::new(&ctx, AvoidanceOptions::default())?;
                let attack = Some(PlannedAttack::of(&ctx, &avoidance, AttackPath::of(trajectory.clone())));
                let described = complete(described.clone());
                Ok(vec![PlannedDrive { described, label: String::new(), swept: None, attack }])
            }
            Self::Generated(generator) => {
                let (ctx, built) = (context()?, &generator.built);
                let avoidance = Avoidance::new(&ctx, AvoidanceOptions::default())?;
                let test = test.context("an attacked driver is tested")?;
                let attacks = built.attacks_on_driver(&ctx, test, generator.args.seed)?;
                let planned = attacks.into_iter().zip(&generator.points).map(|(attack, point)| {
                    attack.check(ctx.scene())?;
                    let uses_point = built.facts.uses_operating_point();
                    let label = if uses_point { point.long_label() } else { generator.method.to_string() };
                    let path = test.path_of(&attack)?;
                    let planned = PlannedAttack::of(&ctx, &avoidance, path);
                    let attack = planned.after(attack.queries);
                    let swept = point.swept().filter(|_| uses_point);
                    let described = generator.describe(point);
                    Ok(PlannedDrive { described, label, swept, attack: Some(attack) })
                });
                planned.collect()
            }
        }
    }
}

impl PlannedAttack {
    /// A plan with its scores against the drive before, and the last evasive manoeuvre of that drive.
    pub(crate) fn of(ctx: &Context, avoidance: &Avoidance, path: AttackPath) -> Self {
        let candidate = ctx.candidate(path.trajectory.clone());
        let scores = Scorer::new(ctx).scores(&candidate);
        let (feasible, believable) = (scores.feasible, scores.believable);
        let avoidable = avoidance.of(&candidate);
        let contact = scores.collision_step;
        let unbelievable = scores.unbelievable;
        Self { path, feasible, believable, unbelievable, contact, avoidable, queries: 0 }
    }

    /// The same, found after so many drives of the driver.
    pub(crate) fn after(self, queries: usize) -> Self {
        Self { queries, ..self }
    }

    /// The row of the attack, with its verdict and the drive before.
    pub(crate) fn row(self, verdict: Verdict, before: &Drive) -> AttackRow {
        let first = before.contacts.first().map(|contact| contact.step);
        AttackRow {
            trajectory: self.path.trajectory,
            feasible: self.feasible,
            believable: self.believable,
            unbelievable: self.unbelievable,
            verdict,
            queries: NonZeroUsize::new(self.queries),
            avoidable: self.avoidable,
            unattacked_contact: first.filter(|frame| *frame <= LAST_FRAME).map(step),
        }
    }
}

/// A description whose fields `method` and `lambda` are there, null if they are not known.
fn complete(mut known: Map<String, Value>) -> Map<String, Value> {
    for key in ["method", "lambda"] {
        known.entry(key).or_insert(Value::Null);
    }
    known
}
