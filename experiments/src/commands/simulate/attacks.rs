//! What attacks the drivers of one scene.

use advsage::{
    generators::Against, named_generator::NamedGenerator, planned_attack::PlannedAttack, prepared,
    rows::GeneratedBy,
};
use anyhow::{Context as _, Result};
use sage_core::{motion::Trajectory, objective::Context};
use sage_data::Recording;
use sage_sim::attack_test::{AttackPath, AttackTest};

use super::{Attacked, attack_file};

/// What attacks the drivers of one scene.
pub(super) enum SceneAttacks<'a> {
    /// Nothing; with the description of an attack that the scene holds already.
    AsItIs(GeneratedBy),
    /// One attack from a file, with its description.
    Given(Trajectory, GeneratedBy),
    /// A generator at its operating points.
    Generated(&'a NamedGenerator),
}

/// One drive of a driver: its attack, and what its row says of it.
pub(super) struct PlannedDrive {
    pub(super) generated: GeneratedBy,
    /// Name of the operating point on the page; empty without a generator.
    pub(super) label: String,
    /// What differs between the drives of a sweep, and its value.
    pub(super) swept: Option<(&'static str, f64)>,
    /// `None` for the scene as it is.
    pub(super) attack: Option<PlannedAttack>,
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
    ) -> Result<(Self, Option<String>)> {
        let wanted_id = || wanted.map(str::to_owned);
        Ok(match attacked {
            Attacked::AsItIs => (Self::AsItIs(attack_file::provenance(recording)?), wanted_id()),
            Attacked::FromFile(file) => {
                let attack = file.attack(&recording.scene, scene_name, source_hash, wanted);
                let (adversary, trajectory) = attack?;
                (Self::Given(trajectory, file.generated().clone()), Some(adversary))
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
        let context =
            || -> Result<Context> { Ok(prepared::drive(test.context("an attacked driver is tested")?)?) };
        match self {
            Self::AsItIs(known) => {
                let generated = known.clone();
                Ok(vec![PlannedDrive { generated, label: String::new(), swept: None, attack: None }])
            }
            Self::Given(trajectory, generated) => {
                let ctx = context()?;
                let attack = Some(PlannedAttack::of(&ctx, AttackPath::of(trajectory.clone())));
                let generated = generated.clone();
                Ok(vec![PlannedDrive { generated, label: String::new(), swept: None, attack }])
            }
            Self::Generated(generator) => {
                let (ctx, built) = (context()?, &generator.built);
                let test = test.context("an attacked driver is tested")?;
                let attacks = built.planned(&ctx, Against::Driver(test), generator.spec.seed)?;
                let planned = attacks.into_iter().zip(&generator.points).map(|(attack, point)| {
                    attack.check(ctx.scene())?;
                    let uses_point = built.facts.uses_operating_point();
                    let label = if uses_point { point.long_label() } else { generator.method.to_string() };
                    let path = test.path_of(&attack)?;
                    let planned = PlannedAttack::of(&ctx, path);
                    let attack = planned.extended(attack.extension);
                    let swept = point.swept().filter(|_| uses_point);
                    let generated = generator.generated_by(point);
                    Ok(PlannedDrive { generated, label, swept, attack: Some(attack) })
                });
                planned.collect()
            }
        }
    }
}
