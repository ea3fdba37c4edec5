//! The searches of a study.

use advsage::{part::Part, search::rule, selection::Selection};
use sage_sim::search::SearchOptions;

use super::Study;
use crate::{Error, Result};

impl Study {
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
