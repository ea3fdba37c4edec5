//! Ids of road users and roads.

use std::collections::{HashMap, HashSet};

use super::{
    file::{Name, Object, Own},
    keyed::Of,
};

/// Ids of the objects. One without an id has its number, or that with a mark if another has it.
pub(super) fn ids_of_objects(objects: &[Of<Object>], own: &Own) -> Vec<String> {
    let originals = originals(&own.objects);
    let given: HashSet<&str> =
        objects.iter().filter_map(|Of(object)| Some(object.id.as_ref()?.0.as_str())).collect();
    let named = objects.iter().enumerate().map(|(k, Of(object))| match &object.id {
        Some(id) => original(id, &originals),
        None if given.contains(&k.to_string()[..]) => format!("object-{k}"),
        None => k.to_string(),
    });
    named.collect()
}

/// Ids that were no integers, by the numbers that took their place.
pub(super) fn originals(table: &[(i64, String)]) -> HashMap<i64, &String> {
    table.iter().map(|(number, id)| (*number, id)).collect()
}

/// The id that a name stands for.
pub(super) fn original(Name(id): &Name, originals: &HashMap<i64, &String>) -> String {
    let original = id.parse().ok().and_then(|id: i64| originals.get(&id));
    original.map_or_else(|| id.clone(), |id| (*id).clone())
}
