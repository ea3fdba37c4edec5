//! Names of road users, and texts that a reader takes literally.

use std::{
    borrow::Cow,
    collections::{HashMap, HashSet},
};

use sage_core::scene::Scene;

/// A unique name for each track: `Ego`, `Adversary`, else its kind and id, such as `Vehicle_7`.
pub(super) fn entity_names(scene: &Scene) -> Vec<String> {
    let mut used = HashSet::new();
    let mut next: HashMap<String, usize> = HashMap::new();
    let tracks = scene.tracks.iter().enumerate();
    let names = tracks.map(|(index, track)| {
        if index == scene.ego {
            return "Ego".to_owned();
        }
        if scene.adversary == Some(index) {
            return "Adversary".to_owned();
        }
        let base = format!("{}_{}", capitalized(track.kind.name()), plain(&track.id));
        let mut name = base.clone();
        let number = next.entry(base.clone()).or_insert(2);
        while !used.insert(name.clone()) {
            name = format!("{base}_{number}");
            *number += 1;
        }
        name
    });
    names.collect()
}

/// Letters, digits and `_-.` of a text; every other character becomes `_`. Colons, slashes and dollar signs
/// have a meaning in names.
fn plain(text: &str) -> String {
    text.chars().map(|c| if c.is_ascii_alphanumeric() || "_-.".contains(c) { c } else { '_' }).collect()
}

/// A kind such as `TRAFFIC_CONE` as the start of a name: `Traffic_cone`.
fn capitalized(kind: &str) -> String {
    let mut name = plain(kind).to_ascii_lowercase();
    if let Some(first) = name.get_mut(..1) {
        first.make_ascii_uppercase();
    }
    name
}

/// A text whose start is not taken for a parameter or an expression: a dollar sign there is escaped.
pub(super) fn literal(text: &str) -> Cow<'_, str> {
    if text.starts_with('$') { Cow::Owned(format!("\\{text}")) } else { Cow::Borrowed(text) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kinds_and_ids_become_plain_names() {
        assert_eq!(capitalized("TRAFFIC_CONE"), "Traffic_cone");
        assert_eq!(capitalized(""), "");
        assert_eq!(plain("a::b/$ü\n1.5-x"), "a__b____1.5-x");
        assert_eq!((literal("$a"), literal("a$")), ("\\$a".into(), "a$".into()));
    }
}
