//! What a choice among candidates makes large, as the user names it.

use std::path::Path;

use anyhow::{Context as _, Result, bail};
use sage_core::{
    files,
    objective::{Objective, ObjectiveSpec, PRESETS},
};

use crate::{Registries, part::Part};

/// Largest file of an objective that is read, bytes.
const LIMIT: u64 = 1 << 20;

/// A selection with the name by which dials are fitted for it.
pub(crate) struct Selection {
    /// Name of the preset, or the file's.
    pub(crate) name: String,
    pub(crate) objective: Objective,
}

impl Selection {
    /// A preset's name or a JSON file, with another feasibility rule if one is given.
    ///
    /// *Errors*: no such preset or file; a spec that names what is not registered.
    pub(crate) fn of(registries: &Registries, name: &str, feasibility: Option<&Part>) -> Result<Self> {
        let mut spec = match ObjectiveSpec::preset(name) {
            Some(spec) => spec,
            None => read(name)?,
        };
        if let Some(rule) = feasibility {
            spec.feasibility = rule.spec();
        }
        let objective = Objective::new(&spec, &registries.rewards, &registries.feasibilities);
        let objective = objective.with_context(|| format!("selection `{name}`"))?;
        Ok(Self { name: name.to_owned(), objective })
    }
}

fn read(name: &str) -> Result<ObjectiveSpec> {
    let path = Path::new(name);
    if !name.ends_with(".json") && !path.exists() {
        let known = PRESETS.map(|(name, _)| name).join(", ");
        bail!("unknown selection `{name}`; known: {known}; or a JSON file of an objective");
    }
    let text = files::read_text(path, LIMIT).with_context(|| format!("cannot read `{name}`"))?;
    serde_json::from_str(&text).with_context(|| format!("`{name}`"))
}
