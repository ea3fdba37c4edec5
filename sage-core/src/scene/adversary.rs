//! Selection of an adversary if the file names none.

use super::{AdversaryOrigin, Track, TrackKind};
use crate::{
    geometry::distance,
    motion::{HISTORY, HORIZON, NOW},
};

/// Distance below which two logged paths conflict in space, metres: about one and a half lane widths.
const CONFLICT: f64 = 5.0;
/// Least displacement over the recording of a car that counts as moving, metres.
const MOVING: f64 = 2.0;

/// Conflict of two logged futures: the number of frames between the two arrivals at their closest point,
/// and the distance there (m). `None` if either has no valid frame.
pub fn path_conflict(a: &Track, b: &Track) -> Option<(usize, f64)> {
    let future =
        |track: &Track| -> Vec<usize> { (NOW + 1..=NOW + HORIZON).filter(|&f| track.is_valid(f)).collect() };
    let (of_a, of_b) = (future(a), future(b));
    let mut best: Option<(usize, f64)> = None;
    for &s in &of_a {
        for &t in &of_b {
            let d = distance(a.point(s), b.point(t));
            let gap = s.abs_diff(t);
            if best.is_none_or(|(least_gap, least)| d < least || (d == least && gap < least_gap)) {
                best = Some((gap, d));
            }
        }
    }
    best
}

/// Selects the vehicle whose logged path conflicts most with the ego's. It must move and be valid in all of
/// history. Paths within 5 m of each other rank first, by the gap between the arrivals at the closest
/// point, then by distance; ties are broken by id.
pub fn select_adversary(tracks: &[Track], ego: usize) -> (Option<usize>, AdversaryOrigin) {
    let eligible = |track: &Track| {
        track.kind == TrackKind::Vehicle && track.count_valid(0..HISTORY) == HISTORY && moves(track)
    };
    let best = tracks
        .iter()
        .enumerate()
        .filter(|(k, track)| *k != ego && eligible(track))
        .filter_map(|(k, track)| path_conflict(&tracks[ego], track).map(|(gap, d)| (k, gap, d)))
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
