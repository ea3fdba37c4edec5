//! The road users of a scene, shared between copies of it until one is changed.

use std::{
    ops::{Deref, DerefMut},
    sync::Arc,
};

use super::Track;

/// Tracks, read as a vector. A copy of a scene with another ego or adversary shares them; the first change of a shared one copies
/// them all.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tracks(Arc<Vec<Track>>);

impl Tracks {
    /// Whether two scenes share their tracks.
    pub fn is_same(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

impl Deref for Tracks {
    type Target = Vec<Track>;

    fn deref(&self) -> &Vec<Track> {
        &self.0
    }
}

impl DerefMut for Tracks {
    fn deref_mut(&mut self) -> &mut Vec<Track> {
        Arc::make_mut(&mut self.0)
    }
}

impl From<Vec<Track>> for Tracks {
    fn from(tracks: Vec<Track>) -> Self {
        Self(Arc::new(tracks))
    }
}

impl FromIterator<Track> for Tracks {
    fn from_iter<I: IntoIterator<Item = Track>>(tracks: I) -> Self {
        Self(Arc::new(tracks.into_iter().collect()))
    }
}

impl<'t> IntoIterator for &'t Tracks {
    type Item = &'t Track;
    type IntoIter = std::slice::Iter<'t, Track>;

    fn into_iter(self) -> Self::IntoIter {
        self.0.iter()
    }
}

impl<'t> IntoIterator for &'t mut Tracks {
    type Item = &'t mut Track;
    type IntoIter = std::slice::IterMut<'t, Track>;

    fn into_iter(self) -> Self::IntoIter {
        self.iter_mut()
    }
}

impl IntoIterator for Tracks {
    type Item = Track;
    type IntoIter = std::vec::IntoIter<Track>;

    fn into_iter(self) -> Self::IntoIter {
        Arc::unwrap_or_clone(self.0).into_iter()
    }
}

#[cfg(test)]
mod tests {
    use super::{super::TrackKind, *};

    #[test]
    fn a_change_of_a_copy_leaves_the_original_alone() {
        let track = Track {
            id: "car".to_owned(),
            kind: TrackKind::Vehicle,
            position: vec![[0.0; 3]],
            heading: vec![0.0],
            velocity: vec![[0.0; 2]],
            size: vec![[4.0, 2.0, 1.5]],
            valid: vec![true],
        };
        let tracks = Tracks::from(vec![track]);
        let mut copy = tracks.clone();
        assert!(copy.is_same(&tracks));
        copy[0].heading[0] = 1.0;
        assert!(!copy.is_same(&tracks) && tracks[0].heading[0] == 0.0);
    }
}
