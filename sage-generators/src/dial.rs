//! Fitted aggression dials: `dial.json` in the folder of the experts' weights.
//!
//! A dial belongs to terms: the file stores the objective that each was fitted for. A selection finds its dial by terms and
//! weights, not by a file name.

use std::collections::BTreeMap;

use sage_backbones::weights::Weights;
use sage_core::{objective::ObjectiveSpec, registry::Entry as _};
use sage_merging::{ADVERSARIAL, ExpertSet, REALISTIC};
use serde::{Deserialize, Serialize};

use crate::{Aggression, Error, proposers::MixedExperts};

/// File of the dials in a folder of weights.
pub const DIAL_FILE: &str = "dial.json";
/// Largest dial file that is read, bytes.
const LIMIT: u64 = 16 << 20;
/// Command that fits a dial.
const REMEDY: &str = "`sage calibrate` fits one";

/// Content of `dial.json`: one dial per selection.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Dials(pub BTreeMap<String, FittedDial>);

/// The rate that rises linearly along a dial.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Rate {
    /// Share of scenes with a feasible hit of the ego.
    Attack,
    /// Share of scenes with a believable attack.
    Believable,
}

impl Rate {
    /// Its name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Attack => "attack",
            Self::Believable => "believable",
        }
    }
}

/// A dial with the data of its fit.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct FittedDial {
    /// μ at evenly spaced aggressions, or λ for an objective that does not depend on μ.
    pub mu: Aggression,
    /// The generator whose candidates were selected in the fit.
    #[serde(default = "sage")]
    pub generator: String,
    /// Hashes of the realistic and the adversarial expert.
    pub experts: [String; 2],
    /// The merger used in the fit.
    pub merger: String,
    /// The objective of the selection used in the fit.
    pub objective: ObjectiveSpec,
    /// The rate that was fitted.
    pub rate: Rate,
    /// The rate at these aggressions in the scenes of the fit.
    pub rates: Vec<f64>,
    /// The scenes of the fit.
    pub data: String,
    /// The command of the fit.
    pub command: String,
}

fn sage() -> String {
    MixedExperts::NAME.to_owned()
}

impl FittedDial {
    /// The dial for a selection, from a folder of weights: one fitted for the same terms, regardless of its
    /// name and feasibility rule.
    ///
    /// *Errors*: no dial was fitted, or it was fitted for other experts.
    pub fn load(
        weights: &Weights,
        experts: &ExpertSet,
        selection: &str,
        objective: &ObjectiveSpec,
    ) -> Result<Self, Error> {
        let fail = |problem| Err(Error::Dial { problem });
        let from = weights.path(DIAL_FILE);
        let from = from.display();
        if !weights.has(DIAL_FILE) {
            return fail(format!("there is no dial `{from}`: {REMEDY}"));
        }
        let text = weights.text(DIAL_FILE, LIMIT)?;
        let dials: Dials = match serde_json::from_str(&text) {
            Ok(dials) => dials,
            Err(error) => return fail(format!("`{from}`: {error}")),
        };
        let is_for = |dial: &Self| {
            let known = &dial.objective;
            known.terms == objective.terms && known.violation_weight == objective.violation_weight
        };
        let Some(dial) = dials.0.into_values().find(is_for) else {
            return fail(format!("`{from}` has no dial for the selection `{selection}`: {REMEDY}"));
        };
        if dial.experts != hashes(experts)? {
            return fail(format!("the dial in `{from}` was fitted for other experts: {REMEDY}"));
        }
        Ok(dial)
    }
}

/// Hashes that identify the realistic and the adversarial expert.
///
/// *Errors*: a set without them.
pub fn hashes(experts: &ExpertSet) -> Result<[String; 2], Error> {
    Ok([experts.expert(REALISTIC)?.hash()?, experts.expert(ADVERSARIAL)?.hash()?])
}
