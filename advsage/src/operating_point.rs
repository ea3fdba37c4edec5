//! Operating points (λ, μ, aggression, mixtures): the options that name them, for commands, Python and programs, and the keys of
//! result rows.

use std::str::FromStr;

use sage_core::generator::{Mixture, OperatingPoint};
use sage_generators::Aggression;
use sage_merging::{ADVERSARIAL, ExpertSet, Range};
use serde::{Deserialize, Deserializer, Serialize};
use serde_json::{Map, Value};

use crate::{Error, part::Part};

/// Most values of a sweep.
const MOST_VALUES: usize = 1001;

/// An operating point as the user gives it: by λ, by aggression, or by the weights of named experts.
///
/// ```
/// use advsage::operating_point::OperatingPointSpec;
/// use sage_merging::Range;
///
/// let point = OperatingPointSpec::at(0.5, None, Range::Simplex)?;
/// // Without μ the selection weighs as the experts are mixed.
/// assert_eq!((point.mu, point.variant().as_str()), (0.5, "lambda0.50"));
/// # Ok::<(), advsage::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OperatingPointSpec {
    /// Aggression, if it determines λ and μ.
    pub aggression: Option<f64>,
    /// Interpolation weight λ, from the realistic to the adversarial expert; none for weights by name.
    pub lambda: Option<f64>,
    /// Weights of named experts, if given.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub mix: Vec<(String, f64)>,
    /// Weight μ of the selection.
    pub mu: f64,
}

impl OperatingPointSpec {
    /// The operating point at a λ. μ equals λ unless given; for a λ beyond 0 to 1, the nearest of the two.
    ///
    /// *Errors*: λ or μ out of range.
    pub fn at(lambda: f64, mu: Option<f64>, range: Range) -> crate::Result<Self> {
        range.check_weights(2, &Mixture::between(lambda))?;
        Ok(Self {
            aggression: None,
            lambda: Some(lambda),
            mix: Vec::new(),
            mu: checked(mu.unwrap_or(lambda.clamp(0.0, 1.0)))?,
        })
    }

    /// The operating point at an aggression.
    ///
    /// *Errors*: the aggression is out of range.
    pub fn of(dial: &Aggression, aggression: f64) -> crate::Result<Self> {
        let (lambda, mu) = dial.lambda_and_mu(aggression)?;
        Ok(Self { aggression: Some(aggression), lambda: Some(lambda), mix: Vec::new(), mu })
    }

    /// The operating point at weights of named experts. μ is the weight of the adversarial expert unless
    /// given.
    ///
    /// *Errors*: μ is out of range.
    pub fn mixed(mix: &[(String, f64)], mu: Option<f64>) -> crate::Result<Self> {
        let adversarial = mix.iter().find(|(name, _)| name == ADVERSARIAL).map_or(0.0, |(_, weight)| *weight);
        Ok(Self {
            aggression: None,
            lambda: None,
            mix: mix.to_vec(),
            mu: checked(mu.unwrap_or(adversarial.clamp(0.0, 1.0)))?,
        })
    }

    /// The operating point for a generator. With a set of experts, λ interpolates between its realistic and
    /// its adversarial expert.
    ///
    /// *Errors*: the set does not contain a named expert.
    pub fn point(&self, experts: Option<&ExpertSet>) -> crate::Result<OperatingPoint> {
        let mixture = match (experts, self.lambda) {
            (Some(experts), Some(lambda)) => experts.between(lambda)?,
            (Some(experts), None) => {
                let weights: Vec<(&str, f64)> = self.mix.iter().map(|(name, w)| (&name[..], *w)).collect();
                experts.mixture(&weights)?
            }
            (None, Some(lambda)) => Mixture::between(lambda),
            (None, None) => Mixture::new(self.mix.iter().map(|(_, weight)| *weight).collect()),
        };
        Ok(OperatingPoint { mixture, mu: self.mu })
    }

    /// Label in a table.
    pub fn label(&self) -> String {
        match (self.aggression, self.lambda) {
            (Some(aggression), _) => format!("a {}", short(aggression)),
            (None, Some(lambda)) if self.mu == lambda => short(lambda),
            (None, Some(lambda)) => format!("{} mu {}", short(lambda), short(self.mu)),
            (None, None) => format!("{} mu {}", self.mixture_label(), short(self.mu)),
        }
    }

    /// Label in a picture.
    pub fn long_label(&self) -> String {
        match (self.aggression, self.lambda) {
            (Some(aggression), _) => format!("aggression {}", short(aggression)),
            (None, Some(lambda)) => format!("lambda {}", short(lambda)),
            (None, None) => self.mixture_label(),
        }
    }

    /// What differs between the points of a sweep, and its value; `None` for a mixture of experts by name.
    pub fn swept(&self) -> Option<(&'static str, f64)> {
        let by_lambda = self.lambda.map(|lambda| ("lambda", lambda));
        self.aggression.map(|aggression| ("aggression", aggression)).or(by_lambda)
    }

    /// Part of file names, and the field `variant` of rows.
    pub fn variant(&self) -> String {
        match (self.aggression, self.lambda) {
            (Some(aggression), _) => format!("aggression{}", short(aggression)),
            (None, Some(lambda)) if self.mu == lambda => format!("lambda{}", short(lambda)),
            (None, Some(lambda)) => format!("lambda{}-mu{}", short(lambda), short(self.mu)),
            (None, None) => {
                let plain = |c: char| if c.is_alphanumeric() || "._-".contains(c) { c } else { '-' };
                let weights = self.mix.iter().map(|(name, weight)| format!("{name}{}", short(*weight)));
                let weights = weights.collect::<Vec<_>>().join("-");
                format!("{}-mu{}", weights.chars().map(plain).collect::<String>(), short(self.mu))
            }
        }
    }

    /// Label of the mixture alone, for a policy without selection.
    pub fn mixture_label(&self) -> String {
        match self.lambda {
            Some(lambda) => format!("lambda {}", short(lambda)),
            None => {
                let weights = self.mix.iter().map(|(name, weight)| format!("{name}={}", short(*weight)));
                weights.collect::<Vec<_>>().join(",")
            }
        }
    }
}

/// Operating points as a command, a study or a program lists them. The texts describe the options of a command.
#[derive(Clone, Debug, Default, Deserialize)]
#[cfg_attr(feature = "clap", derive(clap::Args), command(next_help_heading = "Attack"))]
#[serde(default)]
pub struct OperatingPoints {
    /// Interpolation weight lambda: 0 is the realistic expert, 1 the adversarial one. A number, a
    /// comma-separated list, or FROM:TO:STEP.
    #[cfg_attr(feature = "clap", arg(long, value_name = "L", allow_hyphen_values = true))]
    pub lambda: Option<Values>,
    /// Weight mu of the selection, 0 (realism) to 1 (attack); default: lambda.
    #[cfg_attr(
        feature = "clap",
        arg(long, value_name = "M", value_parser = number, allow_hyphen_values = true)
    )]
    pub mu: Option<f64>,
    /// Aggression, 0 to 1: sets lambda and mu such that the attack rate rises linearly. Same form as
    /// --lambda.
    #[cfg_attr(feature = "clap", arg(long, value_name = "A", allow_hyphen_values = true))]
    pub aggression: Option<Values>,
    /// Weights of the experts by name: realistic=0.5,adversarial=0.3,lawful=0.2. Mu defaults to the weight of
    /// the adversarial expert.
    #[cfg_attr(feature = "clap", arg(long, value_name = "NAME=W,..."))]
    pub mix: Vec<Mix>,
}

/// One or more values of λ or aggression: as text `1`, `0,0.5,1` or `0:1:0.1`.
#[derive(Clone, Debug, PartialEq)]
pub struct Values(pub Vec<f64>);

impl FromStr for Values {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        sweep(text).map(Self)
    }
}

impl<'de> Deserialize<'de> for Values {
    /// A number, a list of numbers, or text.
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        #[derive(Deserialize)]
        #[serde(untagged)]
        enum Numbers {
            List(Vec<f64>),
            One(f64),
            Text(String),
        }
        match Numbers::deserialize(deserializer)? {
            Numbers::List(list) => Ok(Self(list)),
            Numbers::One(number) => Ok(Self(vec![number])),
            Numbers::Text(text) => text.parse().map_err(serde::de::Error::custom),
        }
    }
}

/// Weights of experts by name, in the order in which they are given: as text `NAME=WEIGHT,...`.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct Mix(pub Vec<(String, f64)>);

impl FromStr for Mix {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        mix(text).map(Self)
    }
}

/// Refuses axes that exclude each other: one of them may be given.
///
/// *Errors*: two are.
pub fn check_exclusive(axes: &[(&str, bool)]) -> Result<(), String> {
    if axes.iter().filter(|(_, is_given)| *is_given).count() > 1 {
        let names: Vec<&str> = axes.iter().map(|(name, _)| *name).collect();
        let (last, others) = names.split_last().map_or(("", &[][..]), |(last, others)| (*last, others));
        return Err(format!("{} and {last} exclude each other; give one of them", others.join(", ")));
    }
    Ok(())
}

/// Which options of operating points are given.
#[derive(Clone, Copy, Debug)]
pub struct GivenPoints {
    /// Values of λ.
    pub lambda: bool,
    /// A weight μ.
    pub mu: bool,
    /// Values of aggression.
    pub aggression: bool,
    /// Weights of experts by name.
    pub mix: bool,
}

impl GivenPoints {
    /// Refuses options that exclude each other.
    ///
    /// *Errors*: more than one of λ, aggression and mix; aggression with μ, which it sets.
    pub fn check(self) -> Result<(), String> {
        let Self { lambda, mu, aggression, mix } = self;
        check_exclusive(&[("lambda", lambda), ("aggression", aggression), ("mix", mix)])?;
        if aggression && mu {
            return Err("aggression sets mu; leave mu out, or give lambda and mu".to_owned());
        }
        Ok(())
    }
}

impl OperatingPoints {
    /// Refuses points that exclude each other.
    ///
    /// *Errors*: as [`GivenPoints::check`].
    pub fn check(&self) -> Result<(), String> {
        let Self { lambda, mu, aggression, mix } = self;
        let [lambda, mu, aggression] = [lambda.is_some(), mu.is_some(), aggression.is_some()];
        GivenPoints { lambda, mu, aggression, mix: !mix.is_empty() }.check()
    }

    /// The points at some values of λ.
    pub fn of_lambda(lambda: impl Into<Vec<f64>>) -> Self {
        Self { lambda: Some(Values(lambda.into())), ..Self::default() }
    }

    /// True if there are none.
    pub fn is_empty(&self) -> bool {
        self.aggression.is_none() && self.mix.is_empty() && self.lambda.is_none()
    }

    /// All of them: aggressions first, then mixtures, then λ. The dial is asked for only if there are aggressions.
    ///
    /// *Errors*: a value that is out of range, or that the merger refuses; those of the dial.
    pub fn specs<E: From<Error>>(
        &self,
        range: Range,
        dial: impl FnOnce() -> Result<Aggression, E>,
    ) -> Result<Vec<OperatingPointSpec>, E> {
        let mut specs = Vec::new();
        if let Some(Values(aggressions)) = &self.aggression {
            let dial = dial()?;
            let points = aggressions.iter().map(|aggression| OperatingPointSpec::of(&dial, *aggression));
            specs.extend(points.collect::<crate::Result<Vec<_>>>()?);
        }
        for Mix(mix) in &self.mix {
            let weights = mix.iter().map(|(_, weight)| *weight).collect();
            range.check_weights(mix.len(), &Mixture::new(weights)).map_err(Error::from)?;
            specs.push(OperatingPointSpec::mixed(mix, self.mu)?);
        }
        for lambda in self.lambda.iter().flat_map(|Values(values)| values) {
            specs.push(OperatingPointSpec::at(*lambda, self.mu, range)?);
        }
        Ok(specs)
    }

    /// Their names in file names, which do not depend on a dial.
    ///
    /// *Errors*: as [`OperatingPoints::specs`].
    pub fn variants(&self, range: Range) -> crate::Result<Vec<String>> {
        let specs = self.specs(range, || Ok::<_, Error>(Aggression::new(vec![0.0, 1.0])?))?;
        Ok(specs.iter().map(OperatingPointSpec::variant).collect())
    }
}

/// A finite number.
///
/// *Errors*: a text that is none.
pub fn number(text: &str) -> Result<f64, String> {
    match text.trim().parse::<f64>() {
        Ok(number) if number.is_finite() => Ok(number),
        _ => Err(format!("`{text}` is not a finite number")),
    }
}

/// Parses `1`, `0,0.5,1` or `0:1:0.1`.
///
/// *Errors*: no finite number, a step that does not lead to the end, or too many values.
///
/// ```
/// use advsage::operating_point::{mix, sweep};
///
/// assert_eq!(sweep("0:1:0.25")?, [0.0, 0.25, 0.5, 0.75, 1.0]);
/// assert_eq!(sweep("0,0.5")?, [0.0, 0.5]);
/// assert!(sweep("1:0:0.25").is_err(), "the step leads away from 0");
/// assert_eq!(mix("adversarial=0.5,lawful=0.5")?[1], ("lawful".to_owned(), 0.5));
/// # Ok::<(), String>(())
/// ```
pub fn sweep(text: &str) -> Result<Vec<f64>, String> {
    let colons = text.matches(':').count();
    if colons != 0 && colons != 2 {
        return Err(format!("`{text}` is no sweep; expected FROM:TO:STEP, such as 0:1:0.25"));
    }
    if let [from, to, step] = text.split(':').collect::<Vec<_>>()[..] {
        let [from, to, step] = [number(from)?, number(to)?, number(step)?];
        let count = (to - from) / step;
        if step == 0.0 || count < 0.0 {
            return Err(format!("the step {step} does not lead from {from} to {to}"));
        }
        if count >= MOST_VALUES as f64 {
            return Err(format!("{text} has more than {} steps", MOST_VALUES - 1));
        }
        // Rounded, because three times 0.1 is not exactly 0.3.
        let at = |k: usize| ((from + k as f64 * step) * 1e9).round() / 1e9;
        return Ok((0..=(count + 1e-9) as usize).map(at).collect());
    }
    if text.split(',').count() > MOST_VALUES {
        return Err(format!("more than {MOST_VALUES} values"));
    }
    text.split(',').map(number).collect()
}

/// Weights of experts by name: `NAME=WEIGHT,...`.
///
/// *Errors*: what is no such list.
pub fn mix(text: &str) -> Result<Vec<(String, f64)>, String> {
    let mut weights: Vec<(String, f64)> = Vec::new();
    for part in text.split(',') {
        let (name, weight) = part.split_once('=').ok_or(format!("`{part}` is not NAME=WEIGHT"))?;
        let name = name.trim();
        if weights.iter().any(|(known, _)| known == name) {
            return Err(format!("`{name}` has two weights"));
        }
        weights.push((name.to_owned(), number(weight)?));
    }
    Ok(weights)
}

fn checked(mu: f64) -> crate::Result<f64> {
    if !(0.0..=1.0).contains(&mu) {
        return Err(Error::Value(format!("mu is {mu}; expected 0 to 1")));
    }
    Ok(mu)
}

/// A number with two decimals if they are exact, else with all decimals, so that different operating points
/// have different labels.
fn short(x: f64) -> String {
    let two = format!("{x:.2}");
    if two.parse() == Ok(x) { two } else { x.to_string() }
}

/// Key of a result row: a generator, and its operating point if it depends on one.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RowKey {
    /// Name of the generator.
    pub method: String,
    /// Options of the generator that the user gave.
    #[serde(default, skip_serializing_if = "Map::is_empty")]
    pub options: Map<String, Value>,
    /// Operating point; none if the generator does not depend on one.
    pub point: Option<OperatingPointSpec>,
}

impl RowKey {
    /// The generator.
    pub fn part(&self) -> Part {
        Part { name: self.method.clone(), options: self.options.clone() }
    }

    /// Label in a table.
    pub fn label(&self) -> String {
        let part = self.part();
        match &self.point {
            Some(point) => format!("{part} {}", point.label()),
            None => part.to_string(),
        }
    }
}
