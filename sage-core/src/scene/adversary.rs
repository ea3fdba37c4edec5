//! Selection of an adversary if the file names none.

use super::{AdversaryOrigin, Track, TrackKind};
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

/// Conflict of two logged futures: the number of frames between the two arrivals at their closest point,
/// and the distance there (m). `None` if either has no valid frame.
pub fn path_conflict(a: &Track, b: &Track) -> Option<(usize, f64)> {
    let future = |track: &Track| -> Vec<(usize, Point)> {
        (NOW + 1..=NOW + HORIZON).filter(|&f| track.is_valid(f)).map(|f| (f, track.point(f))).collect()
    };
    conflict(&future(a), &future(b))
}

/// The same for a recording that ends *now*: both go on with their velocities.
fn extrapolated_conflict(a: &Track, b: &Track) -> Option<(usize, f64)> {
    let future = |track: &Track| -> Vec<(usize, Point)> {
        let ([x, y], [vx, vy]) = (track.point(NOW), track.velocity[NOW]);
        let at = |step: usize| [x + DT * step as f64 * vx, y + DT * step as f64 * vy];
        (1..=HORIZON).filter(|_| track.is_valid(NOW)).map(|step| (NOW + step, at(step))).collect()
    };
    conflict(&future(a), &future(b))
}

fn conflict(a: &[(usize, Point)], b: &[(usize, Point)]) -> Option<(usize, f64)> {
    let mut best: Option<(usize, f64)> = None;
    for (s, p) in a {
        for (t, q) in b {
            let d = distance(*p, *q);
            let gap = s.abs_diff(*t);
            if best.is_none_or(|(least_gap, least)| d < least || (d == least && gap < least_gap)) {
                best = Some((gap, d));
            }
        }
    }
    best
}

/// Whether a track is a second recording of the ego: a vehicle in its place in every frame that both have.
pub fn is_copy_of_ego(track: &Track, ego: &Track) -> bool {
    let mut common = (0..track.valid.len()).filter(|&f| track.is_valid(f) && ego.is_valid(f)).peekable();
    track.kind == TrackKind::Vehicle
        && common.peek().is_some()
        && common.all(|f| distance(track.point(f), ego.point(f)) < COPY)
}

/// Selects the vehicle whose logged path conflicts most with the ego's. It must move, be valid in all of history, and
/// not be a copy of the ego. If less than 1 s after *now* is recorded, both paths are extrapolated instead. Paths within 5 m of each other rank first, by the gap between the arrivals at the closest
/// point, then by distance; ties are broken by id.
pub fn select_adversary(tracks: &[Track], ego: usize) -> (Option<usize>, AdversaryOrigin) {
    let eligible = |track: &Track| {
        track.kind == TrackKind::Vehicle && track.count_valid(0..HISTORY) == HISTORY && moves(track)
    };
    let has_future = tracks[ego].valid.len() > NOW + LEAST_HORIZON;
    let measure = if has_future { path_conflict } else { extrapolated_conflict };
    let best = tracks
        .iter()
        .enumerate()
        .filter(|(k, track)| *k != ego && eligible(track) && !is_copy_of_ego(track, &tracks[ego]))
        .filter_map(|(k, track)| measure(&tracks[ego], track).map(|(gap, d)| (k, gap, d)))
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
