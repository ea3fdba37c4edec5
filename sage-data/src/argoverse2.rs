//! Scenarios of Argoverse 2 motion forecasting: `scenario_<id>.parquet` with `log_map_archive_<id>.json` beside it.
//!
//! A scenario becomes MetaDrive values and goes through the decoder that pickles go through. It has no sizes, heights of road
//! users, lights or speed limits; road edges are derived from the drivable areas. `docs/formats.md` says what is read.
//!
//! - Columns may be in any order, with or without dictionary, in several row groups, compressed by snappy or not; the rows in any
//!   order. Files of pandas without unneeded columns work. Other compressions and two rows of a road user in one step are errors.
//! - The heights of a map are kept in the source, but road users have none, so the map is flat. Centre lines that a file lacks lie
//!   halfway between the boundaries.
//! - Kept in the values: `object_type` and `object_category` of each track, `focal_track_id`, `city`, and the map as text
//!   (`argoverse2_map`).
//!
//! Readers of Parquet cost a clean build about 40 s of CPU time: the feature `argoverse2` of the crates is on by default.

mod decode;
mod edges;
mod lanes;
mod map_file;
mod pages;
mod rows;

use sage_core::{
    motion::{HISTORY, NOW},
    scene::{AdversaryOrigin, Levels, Scene, Track, TrackKind, select_adversary},
};

pub(crate) use decode::document;

/// Name of the data set in MetaDrive values.
const DATASET: &str = "argoverse2";
/// Frame of a file that is *now* unless the user names another: the scene is then the frames 10 to 100, because positions at
/// both ends of a recording disagree with its velocities.
pub(crate) const DEFAULT_NOW: usize = 20;
/// Least distance that an adversary covers, metres.
const MOVES: f64 = 2.0;

/// The adversary of a scenario: by the rule of all scenes among the vehicles that the data set scores, then among the unscored
/// ones; never a fragment. It covers 2 m and is there in all frames.
pub(crate) fn adversary(scene: &Scene, category: impl Fn(&str) -> i64) -> (Option<usize>, AdversaryOrigin) {
    let moves = |track: &Track| {
        let ends =
            track.valid.iter().position(|valid| *valid).zip(track.valid.iter().rposition(|valid| *valid));
        let [a, b] = ends.map_or([[0.0; 2]; 2], |(first, last)| [track.point(first), track.point(last)]);
        (b[0] - a[0]).hypot(b[1] - a[1]) > MOVES
    };
    let is_whole = |track: &Track| {
        track.count_valid(0..HISTORY) == HISTORY && track.count_valid(NOW..scene.frames) == scene.frames - NOW
    };
    for of in [&[3, 2][..], &[1]] {
        let may = |k: &usize| {
            let track = &scene.tracks[*k];
            *k == scene.ego
                || track.kind == TrackKind::Vehicle
                    && of.contains(&category(&track.id))
                    && is_whole(track)
                    && moves(track)
        };
        let chosen: Vec<usize> = (0..scene.tracks.len()).filter(may).collect();
        let tracks: Vec<Track> = chosen.iter().map(|k| scene.tracks[*k].clone()).collect();
        let ego = chosen.iter().position(|k| *k == scene.ego).unwrap_or(0);
        if let (Some(found), origin) = select_adversary(&tracks, ego, &Levels::of(&scene.map)) {
            return (Some(chosen[found]), origin);
        }
    }
    (None, AdversaryOrigin::None)
}
