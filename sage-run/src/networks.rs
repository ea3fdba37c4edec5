//! Loads networks, weights and generators by the names that commands accept, and says which they are.

use advsage::{
    Registries, Result, dial,
    named_generator::{GeneratorSpec, NamedGenerator},
    selection::Selection,
    weights::{NamedExperts, NamedNetwork},
};
use sage_backbones::Backbone;
use sage_core::registry::Registry;
use sage_generators::Aggression;
use sage_merging::ExpertSet;

use crate::progress;

/// Loads a prior with its experts, and prints on stderr which are used.
///
/// *Errors*: as [`NamedExperts::load`].
pub fn load_experts(registry: &Registry<dyn Backbone>, name: &str) -> Result<ExpertSet> {
    let loaded = NamedExperts::load(registry, name)?;
    announce_experts(&loaded);
    Ok(loaded.experts)
}

/// Loads the dial that was fitted for a set of experts and a selection. It maps aggression to λ and μ.
///
/// *Errors*: no dial was fitted, or it was fitted for other experts.
pub fn load_dial(name: &str, experts: &ExpertSet, selection: &Selection, merger: &str) -> Result<Aggression> {
    let dial = dial::find(name, experts, selection)?;
    if let Some(note) = dial::note_on_use(&dial, merger, None) {
        progress::say(&format!("warning: {note}"));
    }
    Ok(dial.mu)
}

/// Builds a generator by name, and prints on stderr which experts it uses and what the user should know.
///
/// *Errors*: an option is out of range or names an unknown part; weights cannot be used, or have no dial.
pub fn build_generator(spec: GeneratorSpec, registries: &Registries) -> Result<NamedGenerator> {
    let method = spec.part().to_string();
    let checked = spec.checked(registries)?;
    if !checked.unused.is_empty() {
        let options: Vec<String> = checked.unused.iter().map(|field| format!("--{field}")).collect();
        progress::say(&format!("note: `{method}` does not depend on {}", options.join(", ")));
    }
    checked.note.iter().for_each(|note| progress::say(&format!("note: {note}")));
    let named = checked.build(announce_experts)?;
    named.notes.iter().for_each(|note| progress::say(&format!("warning: {note}")));
    Ok(named)
}

/// Prints on stderr which weights are used.
pub fn announce(loaded: &NamedNetwork) {
    progress::say(&format!("note: {}", loaded.description()));
}

/// Prints on stderr which experts are used.
pub fn announce_experts(loaded: &NamedExperts) {
    progress::say(&format!("note: {}", loaded.description()));
}
