//! Ids of tracks and map features as the integers that records have.

use std::collections::HashMap;

use sage_core::scene::Scene;

/// Numbers of ids. Ids that are integers keep their value; if any is none, all are numbered from 1.
pub(crate) struct Ids {
    numbers: HashMap<String, i64>,
    is_numbered: bool,
}

impl Ids {
    /// Numbers of the tracks of a scene, within 32 bits.
    pub(crate) fn of_tracks(scene: &Scene) -> Self {
        Self::of(scene.tracks.iter().map(|track| &track.id[..]), |id| i32::try_from(id).is_ok())
    }

    /// Numbers of the map features of a scene.
    pub(crate) fn of_features(scene: &Scene) -> Self {
        Self::of(scene.map.features.iter().map(|feature| &feature.id[..]), |_| true)
    }

    fn of<'s>(ids: impl Iterator<Item = &'s str> + Clone, fits: impl Fn(i64) -> bool) -> Self {
        let is_numbered = ids.clone().any(|id| !integer(id).is_some_and(&fits));
        let mut numbers = HashMap::new();
        if is_numbered {
            for (number, id) in (1..).zip(ids) {
                numbers.insert(id.to_owned(), number);
            }
        }
        Self { numbers, is_numbered }
    }

    /// Number of an id; `None` for a text that no feature of the map has.
    pub(crate) fn get(&self, id: &str) -> Option<i64> {
        if self.is_numbered { self.numbers.get(id).copied() } else { integer(id) }
    }

    /// Id by number, in the order of the numbers; empty if ids kept their values.
    pub(crate) fn table(&self) -> Vec<(i64, String)> {
        let mut table: Vec<(i64, String)> =
            self.numbers.iter().map(|(id, number)| (*number, id.clone())).collect();
        table.sort_unstable();
        table
    }
}

/// The integer that a text is in its only decimal form.
fn integer(id: &str) -> Option<i64> {
    id.parse::<i64>().ok().filter(|number| number.to_string() == id)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_integers_in_their_usual_form_are_kept() {
        let ids = |all: &[&str]| Ids::of(all.iter().copied(), |id| i32::try_from(id).is_ok());
        assert_eq!(ids(&["7", "-3"]).get("7"), Some(7));
        assert_eq!(ids(&["7", "-3"]).table(), []);
        for odd in ["ego", "07", "+7", "9999999999", ""] {
            let ids = ids(&["7", odd]);
            assert_eq!((ids.get("7"), ids.get(odd), ids.get("8")), (Some(1), Some(2), None), "{odd}");
            assert_eq!(ids.table(), [(1, "7".to_owned()), (2, odd.to_owned())]);
        }
    }
}
