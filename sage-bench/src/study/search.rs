//! The searches of a study.

use advsage::{AdversarySpec, part::Part, search::rule, selection::Selection};
use sage_sim::search::SearchOptions;

use super::Study;
use crate::{Error, Result, context::Context as _};

impl Study {
    /// Adversaries of the searches: a label, and who it is; one without a label for that of the scene.
    ///
    /// *Errors*: a kind of people that there is not, or a placement out of range.
    pub fn adversaries(&self) -> Result<Vec<(String, AdversarySpec)>> {
        if self.adversary.is_empty() {
            return Ok(vec![(String::new(), AdversarySpec::default())]);
        }
        let of = |text: &String| -> Result<(String, AdversarySpec)> {
            let part: Part = text.parse().map_err(Error::Value)?;
            let kind = serde_json::from_value(part.name.clone().into()).map_err(|_| {
                Error::Value(format!("`adversary`: `{}` is none; known: pedestrian, cyclist", part.name))
            })?;
            let place = match part.options.is_empty() {
                true => None,
                false => {
                    Some(serde_json::from_value(part.options.into()).with_context(|| format!("`{text}`"))?)
                }
            };
            let spec = AdversarySpec { id: None, kind: Some(kind), place };
            spec.check()?;
            Ok((text.clone(), spec))
        };
        self.adversary.iter().map(of).collect()
    }

    /// The rule and the options of its searches.
    ///
    /// *Errors*: as [`rule`].
    pub fn searches(&self, registries: &advsage::Registries) -> Result<(Selection, SearchOptions)> {
        let feasibility =
            self.feasibility.as_deref().map(str::parse::<Part>).transpose().map_err(Error::Value)?;
        let avoidable = self.avoidable.unwrap_or(self.search.avoidable);
        Ok((rule(registries, feasibility.as_ref())?, SearchOptions { avoidable, ..self.search }))
    }
}
