//! Where the dial stands, and the generators for it.

use anyhow::{Result, bail};
use sage_core::generator::Generator;
use sage_generators::{Aggression, Choice, Method, Setting};
use sage_merging::{Experts, Merger};
use serde::Serialize;

/// How candidates are chosen.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Choosing {
    pub(crate) choice: Choice,
    pub(crate) strict: bool,
}

/// A place of the dial.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct Place {
    /// Where it was put as one dial, if it was.
    pub(crate) aggression: Option<f64>,
    /// Between the experts.
    pub(crate) lambda: f64,
    /// Weight of the adversarial reward in the choice.
    pub(crate) mu: f64,
}

impl Place {
    /// At a lambda, with μ the same or another.
    ///
    /// *Errors*: one out of range.
    pub(crate) fn at(lambda: f64, mu: Option<f64>) -> Result<Self> {
        if !(0.0..=1.0).contains(&lambda) {
            bail!(
                "lambda is {lambda}; expected 0 (realistic) to 1 (adversarial): going beyond the experts comes later"
            );
        }
        let mu = mu.unwrap_or(lambda);
        if !(0.0..=1.0).contains(&mu) {
            bail!("mu is {mu}; expected 0 to 1");
        }
        Ok(Self { aggression: None, lambda, mu })
    }

    /// At an aggression.
    ///
    /// *Errors*: one out of range.
    pub(crate) fn of(dial: &Aggression, aggression: f64) -> Result<Self> {
        let (lambda, mu) = dial.place(aggression).map_err(anyhow::Error::msg)?;
        Ok(Self { aggression: Some(aggression), lambda, mu })
    }

    /// As a table says it.
    pub(crate) fn label(&self) -> String {
        match self.aggression {
            Some(aggression) => format!("a {}", short(aggression)),
            None if self.mu == self.lambda => short(self.lambda),
            None => format!("{} mu {}", short(self.lambda), short(self.mu)),
        }
    }

    /// As a picture says it.
    pub(crate) fn long_label(&self) -> String {
        match self.aggression {
            Some(aggression) => format!("aggression {}", short(aggression)),
            None => format!("lambda {}", short(self.lambda)),
        }
    }

    /// As the name of a file says it.
    pub(crate) fn file_label(&self) -> String {
        self.aggression.map_or_else(|| short(self.lambda), |a| format!("a{}", short(a)))
    }
}

/// Two digits where they say all, else as many as there are: other places have other labels.
fn short(x: f64) -> String {
    let two = format!("{x:.2}");
    if two.parse() == Ok(x) { two } else { x.to_string() }
}

/// The generator of a method at a place.
///
/// *Errors*: a setting that it refuses.
pub(crate) fn build(
    method: &dyn Method,
    place: Place,
    choosing: Choosing,
    experts: &Experts,
    merger: &dyn Merger,
) -> Result<Box<dyn Generator>> {
    let Place { lambda, mu, .. } = place;
    let label = place.label();
    let Choosing { choice, strict } = choosing;
    let setting = Setting { experts, merger, lambda, mu, label: &label, choice, strict };
    method.generator(&setting).map_err(anyhow::Error::msg)
}
