//! Selection of an adversary if the file names none.

use super::{AdversaryOrigin, Levels, Track, TrackKind};
use crate::{
    geometry::{Point, distance},
    motion::{DT, HISTORY, HORIZON, LEAST_HORIZON, NOW},
};

/// Distance below which two logged paths conflict in space, metres: about one and a half lane widths.
const CONFLICT: f64 = 5.0;
/// A vehicle whose centre stays this close to the ego's in all common frames is a copy of the ego, metres.
/// No two cars can be that close.
const COPY: f64 = 0.5;
/// Least displacement over the recording of a car that counts as moving, metres.
const MOVING: f64 = 2.0;

/// A place of a track's future: frame, position, and height of the ground.
type Place = (usize, Point, f64);

/// Conflict of two logged futures: the number of frames between the two arrivals at their closest point,
/// and the distance there (m). Places on different levels are not close. `None` if either has no valid frame, or if no two
/// places are on one level.
pub fn path_conflict(a: &Track, b: &Track, levels: &Levels) -> Option<(usize, f64)> {
    let future = |track: &Track| -> Vec<Place> {
        let valid = (NOW + 1..=NOW + HORIZON).filter(|&f| track.is_valid(f));
        valid.map(|f| (f, track.point(f), track.ground(f))).collect()
    };
    conflict(&future(a), &future(b), levels)
}

/// The same for a recording that ends *now*: both go on with their velocities.
fn extrapolated_conflict(a: &Track, b: &Track, levels: &Levels) -> Option<(usize, f64)> {
    let future = |track: &Track| -> Vec<Place> {
        let ([x, y], [vx, vy]) = (track.point(NOW), track.velocity[NOW]);
        let at = |step: usize| [x + DT * step as f64 * vx, y + DT * step as f64 * vy];
        let steps = (1..=HORIZON).filter(|_| track.is_valid(NOW));
        steps.map(|step| (NOW + step, at(step), track.ground(NOW))).collect()
    };
    conflict(&future(a), &future(b), levels)
}

fn conflict(a: &[Place], b: &[Place], levels: &Levels) -> Option<(usize, f64)> {
    let mut best: Option<(usize, f64)> = None;
    for (s, p, low) in a {
        for (t, q, high) in b {
            let d = distance(*p, *q);
            let gap = s.abs_diff(*t);
            let is_closer =
                best.is_none_or(|(least_gap, least)| d < least || (d == least && gap < least_gap));
            if is_closer && !levels.differ(*low, *high) {
                best = Some((gap, d));
            }
        }
    }
    best
}

/// Whether a track is a second recording of the ego: a vehicle in its place in every frame that both have.
pub fn is_copy_of_ego(track: &Track, ego: &Track, levels: &Levels) -> bool {
    let mut common = (0..track.valid.len()).filter(|&f| track.is_valid(f) && ego.is_valid(f)).peekable();
    track.kind == TrackKind::Vehicle
        && common.peek().is_some()
        && common.all(|f| distance(track.point(f), ego.point(f)) < COPY && !levels.differ_at(f, track, ego))
}

/// Selects the vehicle whose logged path conflicts most with the ego's. It must move, be valid in all of history, and
/// not be a copy of the ego or on another level all the time. If less than 1 s after *now* is recorded, both paths are
/// extrapolated instead. Paths within 5 m of each other rank first, by the gap between the arrivals at the closest
/// point, then by distance; ties are broken by id.
pub fn select_adversary(tracks: &[Track], ego: usize, levels: &Levels) -> (Option<usize>, AdversaryOrigin) {
    let eligible = |track: &Track| {
        track.kind == TrackKind::Vehicle && track.count_valid(0..HISTORY) == HISTORY && moves(track)
    };
    let has_future = tracks[ego].valid.len() > NOW + LEAST_HORIZON;
    let measure = if has_future { path_conflict } else { extrapolated_conflict };
    let best = tracks
        .iter()
        .enumerate()
        .filter(|(k, track)| *k != ego && eligible(track) && !is_copy_of_ego(track, &tracks[ego], levels))
        .filter_map(|(k, track)| measure(&tracks[ego], track, levels).map(|(gap, d)| (k, gap, d)))
        .min_by(|(i, gap_i, d_i), (j, gap_j, d_j)| {
            // Distant paths are ranked by distance alone: their gap is meaningless.
            let rank = |gap: usize, d: f64| if d <= CONFLICT { (false, gap) } else { (true, 0) };
            rank(*gap_i, *d_i)
                .cmp(&rank(*gap_j, *d_j))
                .then(d_i.total_cmp(d_j))
                .then_with(|| tracks[*i].id.cmp(&tracks[*j].id))
        });
    match best {
        Some((track, ..)) => (Some(track), AdversaryOrigin::Conflict),
        None => (None, AdversaryOrigin::None),
    }
}

/// Whether a track leaves its first valid position.
fn moves(track: &Track) -> bool {
    let mut valid = (0..track.valid.len()).filter(|&f| track.is_valid(f));
    let Some(first) = valid.next() else { return false };
    valid.any(|f| distance(track.point(first), track.point(f)) > MOVING)
}
