//! The objective that selects one of the candidates, as the user names it.

use std::path::Path;

use sage_core::{
    files,
    objective::{Objective, ObjectiveSpec, PRESETS},
};

use crate::{Error, Registries, Result, WithContext as _, part::Part};

/// Size limit of an objective file, bytes.
const LIMIT: u64 = 1 << 20;

/// An objective for selection, with the name under which its dial is stored.
///
/// ```
/// use advsage::{Registries, selection::Selection};
///
/// let registries = Registries::of_attacks()?;
/// let natural = Selection::of(&registries, "natural", None)?;
/// assert_eq!(natural.objective.spec().feasibility.name, "drivable");
/// // An objective of your own, as JSON; the rule can be replaced.
/// let early = r#"{"terms": [{"name": "adversarial", "weight": 1}]}"#;
/// let early = Selection::of(&registries, early, Some(&"drivable".parse()?))?;
/// assert_eq!(early.objective.spec().feasibility.name, "drivable");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Selection {
    /// Name of the preset or of the file.
    pub name: String,
    /// The objective.
    pub objective: Objective,
}

impl Selection {
    /// Builds a selection from the name of a preset or of a JSON file, or from the JSON itself. `feasibility` replaces
    /// its feasibility rule.
    ///
    /// *Errors*: there is no such preset or file, or it names a part that is not registered.
    pub fn of(registries: &Registries, name: &str, feasibility: Option<&Part>) -> Result<Self> {
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

/// The selection, as JSON, of the feasible plan that ends nearest to a place `X,Y`, metres in the scene's frame.
///
/// *Errors*: a text that is no place.
pub fn ends_near(place: &str) -> std::result::Result<String, String> {
    let number = |text: &str| text.trim().parse::<f64>().ok().filter(|x| x.is_finite());
    let point = place.split_once(',').and_then(|(x, y)| Some([number(x)?, number(y)?]));
    let point = point.ok_or("expected two numbers of metres, such as 12.5,-3")?;
    serde_json::to_string(&ObjectiveSpec::ends_near(point)).map_err(|error| error.to_string())
}

fn read(name: &str) -> Result<ObjectiveSpec> {
    if name.trim_start().starts_with('{') {
        return serde_json::from_str(name).with_context(|| format!("selection `{name}`"));
    }
    let path = Path::new(name);
    if !name.ends_with(".json") && !path.exists() {
        let known = PRESETS.map(|(name, _)| name).join(", ");
        return Err(Error::Unknown(format!(
            "unknown selection `{name}`; known: {known}; or an objective as JSON or as a JSON file"
        )));
    }
    let text = files::read_text(path, LIMIT).with_context(|| format!("cannot read `{name}`"))?;
    serde_json::from_str(&text).with_context(|| format!("`{name}`"))
}
