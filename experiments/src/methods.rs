//! Generators by the names that commands take.

use std::sync::Arc;

use anyhow::{Result, bail};
use sage_backbones::{Backbone, candidates::Selection};
use sage_core::generator::Generator;
use sage_generators::{Cat, Choice, Judge, Log, Oracle, RandomGoals, Rule, Steered};
use sage_merging::{Experts, Merger};

/// Candidates of every method that proposes several.
const CANDIDATES: usize = 32;
/// Distance that the candidates of steered networks keep, metres.
const APART: f32 = 6.0;

/// The methods, with what they do.
pub(crate) const METHODS: [(&str, &str); 7] = [
    ("sage", "experts mixed at lambda, the best of 32 candidates"),
    ("prior", "the untuned prior with the same choice"),
    ("random", "random goals with the same choice"),
    ("oracle", "the best of all goals"),
    ("cat", "CAT's collision probability over the prior's candidates"),
    ("rule", "a Bezier curve that cuts in onto the ego's way"),
    ("log", "no attack"),
];

/// How candidates are chosen.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Choosing {
    pub(crate) choice: Choice,
    pub(crate) strict: bool,
    /// Weight of the adversarial reward; lambda if `None`.
    pub(crate) mu: Option<f64>,
}

/// Whether a method follows lambda.
pub(crate) fn is_steered(method: &str) -> bool {
    matches!(method, "sage" | "prior" | "random" | "oracle")
}

/// The generator of a method at a lambda.
///
/// *Errors*: an unknown method, lambda or mu out of range.
pub(crate) fn build(
    method: &str,
    lambda: f64,
    choosing: Choosing,
    experts: &Experts,
    merger: &dyn Merger,
) -> Result<Box<dyn Generator>> {
    let judge = || -> Result<Judge> {
        if !(0.0..=1.0).contains(&lambda) {
            bail!(
                "lambda is {lambda}; expected 0 (realistic) to 1 (adversarial): going beyond the experts comes later"
            );
        }
        Judge::new(choosing.choice, choosing.mu.unwrap_or(lambda), choosing.strict)
            .map_err(anyhow::Error::msg)
    };
    let prior = || -> Result<Arc<dyn Backbone>> {
        Ok(Arc::from(experts.prior().rebuilt(experts.prior().parameters().clone())?))
    };
    let steered = |name: String, network: Arc<dyn Backbone>| -> Result<Box<dyn Generator>> {
        let selection = Selection::Nms { radius: APART };
        Ok(Box::new(Steered {
            name,
            network,
            prior: prior()?,
            candidates: CANDIDATES,
            selection,
            judge: judge()?,
        }))
    };
    Ok(match method {
        "sage" => steered(
            format!("sage {lambda:.2}"),
            Arc::from(experts.prior().rebuilt(merger.merge(experts, lambda)?)?),
        )?,
        "prior" => steered(format!("prior, choice {lambda:.2}"), prior()?)?,
        "random" => Box::new(RandomGoals { prior: prior()?, candidates: CANDIDATES, judge: judge()? }),
        "oracle" => Box::new(Oracle { prior: prior()?, judge: judge()? }),
        "cat" => Box::new(Cat { prior: prior()?, candidates: CANDIDATES }),
        "rule" => Box::new(Rule::default()),
        "log" => Box::new(Log),
        _ => bail!("unknown method `{method}`; known: {}", METHODS.map(|m| m.0).join(", ")),
    })
}
