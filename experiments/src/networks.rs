//! Loads networks and weights by the names that commands accept, and says which they are.

use advsage::selection::Selection;
use advsage::weights::{NamedExperts, NamedNetwork, find_dial, note_on_merger};
use anyhow::Result;
use sage_backbones::Backbone;
use sage_core::registry::Registry;
use sage_generators::Aggression;
use sage_merging::ExpertSet;
use sage_run::progress;

/// Loads a prior by name.
///
/// *Errors*: as [`NamedNetwork::load`].
pub(crate) fn load(registry: &Registry<dyn Backbone>, name: &str) -> Result<NamedNetwork> {
    let loaded = NamedNetwork::load(registry, name)?;
    note(loaded.note.as_deref());
    Ok(loaded)
}

/// Loads a prior with its experts, and prints on stderr which are used.
///
/// *Errors*: as [`NamedExperts::load`].
pub(crate) fn load_experts(registry: &Registry<dyn Backbone>, name: &str) -> Result<ExpertSet> {
    let loaded = NamedExperts::load(registry, name)?;
    announce_experts(&loaded);
    Ok(loaded.experts)
}

/// Loads the dial that was fitted for a set of experts and a selection. It maps aggression to λ and μ.
///
/// *Errors*: no dial was fitted, or it was fitted for other experts.
pub(crate) fn load_dial(
    name: &str,
    experts: &ExpertSet,
    selection: &Selection,
    merger: &str,
) -> Result<Aggression> {
    let dial = find_dial(name, experts, selection)?;
    if let Some(note) = note_on_merger(&dial, merger) {
        progress::say(&format!("warning: {note}"));
    }
    Ok(dial.mu)
}

/// Prints on stderr which weights are used.
pub(crate) fn announce(loaded: &NamedNetwork) {
    progress::say(&format!("note: {}", loaded.description()));
}

/// Prints on stderr which experts are used.
pub(crate) fn announce_experts(loaded: &NamedExperts) {
    note(loaded.note.as_deref());
    progress::say(&format!("note: {}", loaded.description()));
}

fn note(text: Option<&str>) {
    if let Some(text) = text {
        progress::say_once(&format!("note: {text}"));
    }
}
