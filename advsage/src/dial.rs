//! The aggression dial of experts: how λ and μ follow from an aggression.

use sage_generators::{Aggression, FittedDial};
use sage_merging::ExpertSet;

use crate::{
    Error, Result,
    part::Part,
    selection::Selection,
    weights::{self, NamedExperts},
};

/// The dial that was fitted for a set of experts and a selection. It maps aggression to λ and μ.
///
/// *Errors*: no dial was fitted, or it was fitted for other experts.
pub fn find(name: &str, experts: &ExpertSet, selection: &Selection) -> Result<FittedDial> {
    Ok(FittedDial::load(&weights::find(name)?, experts, &selection.name, selection.objective.spec())?)
}

/// What the user should know of a dial that is used with a merger, and perhaps a generator; `None` if it was fitted for these.
pub fn note_on_use(dial: &FittedDial, merger: &str, generator: Option<&str>) -> Option<String> {
    let pairs = [("merger", &*dial.merger, Some(merger)), ("generator", &*dial.generator, generator)];
    let other = pairs.into_iter().find(|(_, fitted, used)| used.is_some_and(|used| used != *fitted));
    other.map(|(what, fitted, used)| {
        let used = used.unwrap_or_default();
        format!("the dial was fitted for the {what} `{fitted}`; with `{used}` the attack rate may not rise linearly")
    })
}

/// The dial of some weights.
///
/// *Errors*: there are no weights, or no dial was fitted for them.
pub(crate) fn of_weights(
    weights: Option<&NamedExperts>,
    selection: &Selection,
    merger: &Part,
    generator: Option<&str>,
    notes: &mut Vec<String>,
) -> Result<Aggression> {
    let weights = weights
        .ok_or_else(|| Error::Value("a dial needs experts; name weights that hold some".to_owned()))?;
    let dial = find(&weights.name, &weights.experts, selection)?;
    notes.extend(note_on_use(&dial, &merger.to_string(), generator));
    Ok(dial.mu)
}
