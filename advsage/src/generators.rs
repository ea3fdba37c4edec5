//! Builds generators: from parts, networks and a selection, at operating points.

use std::sync::Arc;

use sage_core::{
    Error,
    generator::{ApartNow, Attack, Generator as _, OperatingPoint, PreparedProposer},
    objective::Context,
    scene::Scene,
};
use sage_generators::{Facts, GeneratorInputs};
use sage_merging::{ExpertSet, Merger, Range};
use sage_sim::{
    SimScene,
    attack_test::{AttackPath, AttackTest},
    attacker::{Attacker, plan_of_generator},
    drive::Drive,
    policy::Replay,
    queried::QueriedDriver,
    traffic::Plan,
};
use serde_json::{Map, Value};

use crate::{
    Registries, Result, WithContext as _,
    error::in_one_line,
    operating_point::{OperatingPointSpec, RowKey},
    part::Part,
    selection::Selection,
};

/// What the generators of a command are built from: weights, merger, selection and seed. Clones share the data.
#[derive(Clone)]
pub struct Generators<'r> {
    registries: &'r Registries,
    inputs: GeneratorInputs,
}

impl<'r> Generators<'r> {
    /// Generators without weights.
    ///
    /// *Errors*: the merger is not registered, or refuses its options.
    pub fn new(registries: &'r Registries, merger: &Part, selection: &Selection, seed: u64) -> Result<Self> {
        let merger = merger.build(&registries.mergers)?.into();
        let selection = Arc::new(selection.objective.clone());
        Ok(Self { registries, inputs: GeneratorInputs { experts: None, merger, seed, selection } })
    }

    /// Generators with given inputs.
    pub fn with_inputs(registries: &'r Registries, inputs: GeneratorInputs) -> Self {
        Self { registries, inputs }
    }

    /// The same with a prior and its experts.
    pub fn with_experts(&self, experts: &ExpertSet) -> Self {
        let inputs = GeneratorInputs { experts: Some(experts.clone()), ..self.inputs.clone() };
        Self { registries: self.registries, inputs }
    }

    /// What generators get.
    pub fn inputs(&self) -> &GeneratorInputs {
        &self.inputs
    }

    /// The merger of the experts.
    pub fn merger(&self) -> &Arc<dyn Merger> {
        &self.inputs.merger
    }

    /// What a generator depends on and knows.
    ///
    /// *Errors*: the name is not registered, or the generator refuses the options.
    pub fn facts(&self, part: &Part) -> Result<Facts> {
        Ok(part.build(&self.registries.generators)?.facts())
    }

    /// Builds a generator for some operating points.
    ///
    /// *Errors*: the name is not registered, or the generator refuses the options or inputs; an operating point is
    /// given twice, or names an expert that there is not.
    pub fn build(&self, part: &Part, specs: &[OperatingPointSpec]) -> Result<BuiltGenerator> {
        let kind = part.build(&self.registries.generators)?;
        let facts = kind.facts();
        let key = |point: Option<OperatingPointSpec>| RowKey {
            method: part.name.clone(),
            options: part.options.clone(),
            point,
        };
        // Without a mixture the names of the experts do not matter.
        let experts = self.inputs.experts.clone().filter(|_| facts.depends_on_lambda);
        let (keys, points) = if facts.uses_operating_point() {
            let key = |spec: &OperatingPointSpec| {
                let mu = if facts.depends_on_mu { None } else { spec.lambda };
                key(Some(OperatingPointSpec { mu: mu.unwrap_or(spec.mu), ..spec.clone() }))
            };
            let points = specs.iter().map(|spec| spec.point(experts.as_ref()));
            let keys: Vec<RowKey> = specs.iter().map(key).collect();
            refuse_duplicates(&keys)?;
            (keys, points.collect::<Result<_>>()?)
        } else {
            (vec![key(None)], vec![OperatingPoint::at(1.0, 1.0)])
        };
        let generator = ApartNow(kind.build(&self.inputs)?);
        let source = self.inputs.experts.as_ref().and_then(ExpertSet::source);
        let mut files = Map::new();
        for file in kind.files() {
            if let Some(source) = source {
                files.insert(file.clone(), source.tensors(&file)?.0.hash()?.into());
            }
        }
        let (label, range) = (part.to_string(), self.inputs.merger.range());
        Ok(BuiltGenerator { facts, keys, points, files, label, generator, experts, range })
    }
}

/// What attacks are made against. Their context has the same path of the ego.
#[derive(Clone, Copy)]
pub enum Against<'t> {
    /// The ego's recording.
    Recording,
    /// A driver, which a generator may query.
    Driver(&'t AttackTest<'t>),
    /// The drive of a driver without an attack; the driver is not asked.
    Drive(&'t AttackTest<'t>),
}

/// A generator with its operating points.
pub struct BuiltGenerator {
    /// What it depends on and knows.
    pub facts: Facts,
    /// Key of each result row; one key without an operating point if the generator depends on none.
    pub keys: Vec<RowKey>,
    /// Operating point of each key.
    pub points: Vec<OperatingPoint>,
    /// Hashes of the files beside the prior that it was built from.
    pub files: Map<String, Value>,
    label: String,
    generator: ApartNow,
    experts: Option<ExpertSet>,
    range: Range,
}

impl BuiltGenerator {
    /// Attacks at all operating points. An adversary that reacts has the path that it drives against the ego.
    ///
    /// *Errors*: [`Error::ContactNow`], and those of the generator and of the driver.
    pub fn attacks(&self, ctx: &Context, against: Against, seed: u64) -> Result<Vec<Attack>> {
        let attacks = self.planned(ctx, against, seed)?;
        match against {
            Against::Recording => Ok(driven_by_recording(attacks, ctx, seed)?),
            Against::Driver(test) | Against::Drive(test) => driven_in_test(attacks, ctx, test),
        }
    }

    /// The same; an adversary that reacts does so when it is driven.
    ///
    /// *Errors*: as [`BuiltGenerator::attacks`].
    pub fn planned(&self, ctx: &Context, against: Against, seed: u64) -> Result<Vec<Attack>, Error> {
        match against {
            // A recording does the same against every plan.
            Against::Driver(test) if self.queries(test) => {
                self.generator.attacks_on(ctx, &QueriedDriver::new(test), &self.points, seed)
            }
            _ => self.generator.attacks(ctx, &self.points, seed),
        }
    }

    /// Whether it asks the driver of a test what it does.
    fn queries(&self, test: &AttackTest) -> bool {
        self.facts.knows.driver && !test.is_recording()
    }

    /// What its attacks in a scene share, for [`BuiltGenerator::planned_at`]; `None` if there is nothing to keep.
    ///
    /// *Errors*: as [`BuiltGenerator::attacks`].
    pub fn prepare(&self, ctx: &Context) -> Result<Option<Box<dyn PreparedProposer>>, Error> {
        self.generator.prepare(ctx)
    }

    /// The attack that [`BuiltGenerator::planned`] gives at one of its points, by its number. `prepared` is what a generator with the
    /// same proposer prepared for this scene.
    ///
    /// *Errors*: as [`BuiltGenerator::attacks`].
    pub fn planned_at(
        &self,
        ctx: &Context,
        test: &AttackTest,
        prepared: Option<&dyn PreparedProposer>,
        number: usize,
        seed: u64,
    ) -> Result<Attack> {
        let at = &self.points[number..=number];
        let attacks = match prepared {
            _ if self.queries(test) => self.generator.attacks_on(ctx, &QueriedDriver::new(test), at, seed)?,
            Some(prepared) => self.generator.attacks_prepared(prepared, ctx, at, seed)?,
            None => self.generator.attacks(ctx, at, seed)?,
        };
        let none = || crate::Error::Value(format!("generator `{}` gave no attack", self.label));
        attacks.into_iter().next().ok_or_else(none)
    }

    /// Its name and options.
    pub fn label(&self) -> &str {
        &self.label
    }

    /// Whether it can attack at a λ between two experts, known before the first attack.
    ///
    /// *Errors*: an expert is missing.
    pub fn check_lambda(&self) -> Result<()> {
        let checked = self.among_experts(&OperatingPoint::at(1.0, 1.0));
        checked.map(drop).with_context(|| format!("generator `{}`", self.label))
    }

    /// The attack on a drive at an operating point, as [`Attacker::plan`] plans it, with all candidates.
    ///
    /// *Errors*: the scene cannot be attacked; the merger refuses the λ.
    pub(crate) fn attack_at(
        &self,
        ctx: &Context,
        at: &OperatingPoint,
        seed: u64,
    ) -> Result<Attack, sage_sim::Error> {
        let point = self.point_in(ctx.scene(), at)?;
        // A contact at now counts here, as in the published evaluation.
        let attack = self.generator.0.attacks(ctx, std::slice::from_ref(&point), seed)?.into_iter().next();
        let attack = attack.ok_or_else(|| self.wrong_in(ctx.scene(), "the generator gave no attack"))?;
        attack.check(ctx.scene())?;
        Ok(attack)
    }

    fn wrong_in(&self, scene: &Scene, problem: &str) -> sage_sim::Error {
        sage_sim::Error::Plan {
            scene: scene.id.clone(),
            problem: format!("attack of `{}`: {problem}", self.label),
        }
    }

    /// [`BuiltGenerator::among_experts`] for a scene that errors name.
    fn point_in(&self, scene: &Scene, at: &OperatingPoint) -> Result<OperatingPoint, sage_sim::Error> {
        self.among_experts(at).map_err(|error| self.wrong_in(scene, &in_one_line(&error)))
    }

    /// An operating point between two experts, among all experts of the set; one of its own points as it is.
    ///
    /// *Errors*: the merger refuses the λ.
    fn among_experts(&self, at: &OperatingPoint) -> Result<OperatingPoint> {
        let is_between = self.facts.uses_operating_point() && !self.points.contains(at);
        let Some(lambda) = at.mixture.lambda().filter(|_| is_between) else { return Ok(at.clone()) };
        OperatingPointSpec::at(lambda, Some(at.mu), self.range)?.point(self.experts.as_ref())
    }
}

impl Attacker for BuiltGenerator {
    /// The plan at an operating point: one of its own, or a λ between two experts. A contact at *now* is no error, as in the published
    /// evaluation.
    fn plan(
        &self,
        scene: &SimScene,
        drive: Option<&Drive>,
        at: &OperatingPoint,
        seed: u64,
    ) -> Result<Arc<Plan>, sage_sim::Error> {
        let point = self.point_in(scene.scene(), at)?;
        plan_of_generator(&*self.generator.0, &point, scene, drive, seed)
    }
}

/// Attacks whose adversaries react get the path that they drive against the driver of a test.
fn driven_in_test(attacks: Vec<Attack>, ctx: &Context, test: &AttackTest) -> Result<Vec<Attack>> {
    let driven = |attack: Attack| {
        attack.check(ctx.scene())?;
        let path = test.path_of(&attack)?.trajectory;
        Ok(attack.with_drive(path, "the driver under test"))
    };
    attacks.into_iter().map(driven).collect()
}

/// Attacks whose adversaries react get the path that they drive against the ego's recording.
///
/// *Errors*: an attack that is not one on this scene; those of the simulation.
fn driven_by_recording(attacks: Vec<Attack>, ctx: &Context, seed: u64) -> Result<Vec<Attack>, Error> {
    if attacks.iter().all(|attack| attack.reaction.is_none()) {
        return Ok(attacks);
    }
    let in_scene = |error: sage_sim::Error| error.in_scene(ctx.scene());
    let scene = SimScene::new(ctx.scene().clone(), ctx.index().clone()).map_err(in_scene)?;
    let driven = |attack: Attack| {
        attack.check(ctx.scene())?;
        let path = AttackPath::driven(&Replay, &scene, &attack, seed).map_err(in_scene)?;
        Ok(attack.with_drive(path.trajectory, "the ego's recording"))
    };
    attacks.into_iter().map(driven).collect()
}

/// Hashes of a prior and its experts, by name.
///
/// *Errors*: none on a CPU.
pub fn weight_hashes(experts: &ExpertSet) -> Result<Map<String, Value>> {
    let experts_of = experts.experts().iter().map(|(name, weights)| (&**name, weights));
    let all = std::iter::once(("prior", experts.prior().parameters())).chain(experts_of);
    all.map(|(name, weights)| Ok((name.to_owned(), weights.hash()?.into()))).collect()
}

/// Refuses duplicate rows.
///
/// *Errors*: the first key that occurs twice.
pub fn refuse_duplicates(keys: &[RowKey]) -> Result<()> {
    match keys.iter().enumerate().find(|(k, key)| keys[..*k].contains(key)) {
        Some((_, key)) => Err(crate::Error::Value(format!("the row `{}` is given twice", key.label()))),
        None => Ok(()),
    }
}
