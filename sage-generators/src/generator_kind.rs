//! Kinds of generators by name, and their properties.
//!
//! A generator is built in two steps, from its options and then from [`GeneratorInputs`]: its properties, which decide
//! whether weights are loaded, are known after the first.

use sage_core::generator::{Generator, Knowledge};

use crate::{Error, GeneratorInputs};

/// Properties of a generator.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Facts {
    /// Information that it uses beyond the observation up to *now*.
    pub knows: Knowledge,
    /// Whether its attacks depend on the mixture of experts.
    pub depends_on_lambda: bool,
    /// Whether its attacks depend on μ.
    pub depends_on_mu: bool,
    /// Whether it needs a prior and experts.
    pub needs_experts: bool,
    /// Whether it is an upper bound, for which a table needs one row.
    pub is_upper_bound: bool,
    /// Whether its candidates, and not only the selection among them, depend on the ego's path: planned against another
    /// drive of the ego, it gives other candidates.
    pub plans_against_ego: bool,
}

impl Facts {
    /// Properties of a generator that needs no experts and does not depend on λ or μ. If it knows the ego's path, it plans
    /// against it.
    pub const fn without_operating_point(knows: Knowledge) -> Self {
        Self {
            knows,
            depends_on_lambda: false,
            depends_on_mu: false,
            needs_experts: false,
            is_upper_bound: false,
            plans_against_ego: knows.ego_future,
        }
    }

    /// Properties of a generator that selects among the prior's proposals, from what the selector knows and whether it
    /// depends on μ.
    pub const fn of_selection(knows: Knowledge, depends_on_mu: bool) -> Self {
        Self {
            knows,
            depends_on_lambda: false,
            depends_on_mu,
            needs_experts: true,
            is_upper_bound: false,
            plans_against_ego: false,
        }
    }

    /// Whether its attacks depend on λ or μ.
    pub fn uses_operating_point(&self) -> bool {
        self.depends_on_lambda || self.depends_on_mu
    }
}

/// A kind of generator, with its options.
///
/// What a generator needs and knows is said before any weights are loaded:
///
/// ```
/// use sage_generators::generators;
///
/// let generators = generators()?;
/// let facts = |name: &str| generators.build_default(name).map(|kind| kind.facts());
/// let (sage, rule) = (facts("sage")?, facts("rule")?);
/// assert!(sage.needs_experts && sage.depends_on_lambda && sage.depends_on_mu);
/// // The rule is built without experts, and has one attack a scene whatever λ is.
/// assert!(!rule.needs_experts && !rule.uses_operating_point());
/// assert_eq!(facts("most-likely")?.knows.to_string(), "history only");
/// # Ok::<(), sage_core::Error>(())
/// ```
pub trait GeneratorKind: Send + Sync {
    /// Properties of the generator.
    fn facts(&self) -> Facts;

    /// Names of the files beside the prior that it reads: they identify its attacks as weights do.
    fn files(&self) -> Vec<String> {
        Vec::new()
    }

    /// Builds the generator.
    ///
    /// *Errors*: a missing input.
    fn build(&self, inputs: &GeneratorInputs) -> Result<Box<dyn Generator>, Error>;
}
