//! Adversaries of environments: what a user describes, and what attacks.

use std::{collections::HashMap, sync::Arc};

use advsage::{
    AdversarySpec, GeneratorSpec,
    named_search::{NamedSearch, SearchSpec},
    part::Part,
    searched_attacker::SearchedAttacker,
};
use pyo3::{prelude::*, types::PyDict};
use sage_core::{generator::OperatingPoint, motion::Trajectory, seed::Rng};
use sage_learn::curricula::curricula;
use sage_sim::{
    Error, SimScene,
    attacker::Attacker,
    batch::Adversary,
    curriculum::{Curriculum, Progress},
    drive::Drive,
    search::{Requirement, SearchOptions},
    traffic::Plan,
};

use crate::{
    built::Built,
    errors::OptionError,
    generator::{PyGenerator, part},
    parts::{Driver, registries},
    scene::person,
    values,
};

/// An adversary as a user describes it.
pub(crate) struct Described {
    attacks: Attacks,
    /// `None` for the same share and intensity throughout.
    curriculum: Option<Part>,
    probability: f64,
    against_drives: bool,
    total_steps: u64,
}

enum Attacks {
    Generator(Arc<Built>),
    Search {
        ego: Box<Driver>,
        options: Box<SearchOptions>,
        adversary: Box<AdversarySpec>,
        weights: Option<String>,
    },
    Plans(GivenPlans),
}

/// The adversary of checked values: one of `generator`, `search` (a driver) and `plans` (a list of scene id and positions);
/// `curriculum` or None, `probability`, `against_drives`, `total_steps`, `budget`, `require`, `weights`.
///
/// *Errors*: a part that there is not, or a value that it refuses.
pub(crate) fn of(described: &Bound<'_, PyDict>) -> PyResult<Described> {
    let py = described.py();
    let get = |key: &str| -> PyResult<Option<Bound<'_, PyAny>>> {
        Ok(described.get_item(key)?.filter(|value| !value.is_none()))
    };
    let attacks = if let Some(generator) = get("generator")? {
        let generator = generator.cast_into::<PyGenerator>().map_err(|error| {
            OptionError::new_err(format!(
                "adversary: the generator is {:?}; expected a Generator",
                error.into_inner()
            ))
        })?;
        Attacks::Generator(generator.get().built())
    } else if let Some(plans) = get("plans")? {
        let mut given: HashMap<String, Vec<Trajectory>> = HashMap::new();
        for pair in plans.try_iter()? {
            let (id, positions): (String, Bound<'_, PyAny>) = pair?.extract()?;
            let plans = values::trajectories(&format!("adversary: the plans of `{id}`"), &positions)?;
            given.entry(id).or_default().extend(plans);
        }
        Attacks::Plans(GivenPlans(given))
    } else {
        let ego = get("search")?.ok_or_else(|| OptionError::new_err("adversary: nothing attacks"))?;
        let driver = Driver::of(py, &ego)?;
        if driver.planner.is_some() {
            return Err(OptionError::new_err(
                "adversary: a search within an environment takes drivers by name; search with sage.search and your planner, and give its result as \"plans\"",
            ));
        }
        let require = get("require")?.map(|require| require.extract::<String>()).transpose()?;
        let require =
            require.map(|text| text.parse::<Requirement>()).transpose().map_err(OptionError::new_err)?;
        let kind = get("adversary_type")?.map(|kind| kind.extract::<String>()).transpose()?;
        let adversary = person(kind.as_deref(), None)?;
        let budget = get("budget")?.map(|budget| crate::seed::count(&budget)).transpose()?;
        let base = SearchOptions::default();
        let options = SearchOptions {
            require: require.unwrap_or_else(|| adversary.requirement()),
            budget: budget.unwrap_or(base.budget),
            ..base
        };
        let weights = get("weights")?.map(|weights| weights.extract::<String>()).transpose()?;
        let (ego, options, adversary) = (Box::new(driver), Box::new(options), Box::new(adversary));
        Attacks::Search { ego, options, adversary, weights }
    };
    if let Attacks::Generator(built) = &attacks
        && get("curriculum")?.is_some()
        && built.named.spec.points.mu.is_some()
    {
        return Err(OptionError::new_err(
            "adversary: a curriculum sets λ and μ of each attack; leave mu out of the generator",
        ));
    }
    let curriculum = get("curriculum")?.map(|name| part(&name.extract::<String>()?)).transpose()?;
    let number =
        |key: &str, default: f64| -> PyResult<f64> { get(key)?.map_or(Ok(default), |value| value.extract()) };
    Ok(Described {
        attacks,
        curriculum,
        probability: number("probability", 1.0)?,
        against_drives: get("against_drives")?.is_some_and(|value| value.is_truthy().unwrap_or(false)),
        total_steps: get("total_steps")?.map_or(Ok(0), |value| value.extract())?,
    })
}

impl Described {
    /// The adversary.
    ///
    /// *Errors*: an unknown part, or weights that cannot be used.
    pub(crate) fn build(self) -> sage_run::Result<Adversary> {
        let Self { attacks, curriculum, probability, against_drives, total_steps } = self;
        let has_curriculum = curriculum.is_some();
        let mut lambda = f64::NAN;
        let attacker: Arc<dyn Attacker> = match attacks {
            Attacks::Generator(built) => {
                if has_curriculum {
                    built.named.built.check_lambda()?;
                }
                lambda = built.named.points[0].lambda.unwrap_or(f64::NAN);
                Arc::new(OfGenerator { built, has_curriculum })
            }
            Attacks::Search { ego, options, adversary, weights } => {
                let generator = GeneratorSpec { weights, ..GeneratorSpec::default() };
                let generator = adversary.generator(generator, Some(options.require))?;
                let spec = SearchSpec { generator, ..SearchSpec::default() };
                let search: NamedSearch = spec.build(registries()?)?;
                Arc::new(SearchedAttacker::new(search, ego.policy, ego.references, *options, 0))
            }
            Attacks::Plans(plans) => Arc::new(plans),
        };
        let curriculum: Arc<dyn Curriculum> = match curriculum {
            Some(part) => part.build(&curricula()?)?.into(),
            None => Arc::new(Share { probability, lambda }),
        };
        Ok(Adversary::new(attacker, curriculum, against_drives, total_steps))
    }
}

/// A share of episodes with an attack. λ is that of the generator; NaN if it is at none.
struct Share {
    probability: f64,
    lambda: f64,
}

impl Curriculum for Share {
    fn draw(&self, _: &Progress, rng: &mut Rng) -> Option<f64> {
        (rng.unit() < self.probability).then_some(self.lambda)
    }
}

/// A generator at the point that the user gave, or at those of a curriculum.
struct OfGenerator {
    built: Arc<Built>,
    has_curriculum: bool,
}

impl Attacker for OfGenerator {
    fn plan(
        &self,
        scene: &SimScene,
        drive: Option<&Drive>,
        at: &OperatingPoint,
        seed: u64,
    ) -> Result<Arc<Plan>, Error> {
        let built = &self.built.named.built;
        built.plan(scene, drive, if self.has_curriculum { at } else { &built.points[0] }, seed)
    }
}

/// Plans that were made before, by identifier of the scene.
struct GivenPlans(HashMap<String, Vec<Trajectory>>);

impl Attacker for GivenPlans {
    fn plan(
        &self,
        scene: &SimScene,
        _: Option<&Drive>,
        _: &OperatingPoint,
        seed: u64,
    ) -> Result<Arc<Plan>, Error> {
        let id = &scene.scene().id;
        let plans = self.0.get(id).filter(|plans| !plans.is_empty()).ok_or_else(|| Error::Plan {
            scene: id.clone(),
            problem: "no plan was given for it".to_owned(),
        })?;
        let plan = &plans[(seed % plans.len() as u64) as usize];
        Ok(Arc::new(Plan::of_adversary(scene.scene(), plan)?))
    }

    fn draws(&self) -> bool {
        true
    }
}
