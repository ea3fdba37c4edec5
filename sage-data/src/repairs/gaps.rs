//! Gaps of road users that stand: they are hidden for a while, and still there, unless somebody else is recorded in their place.

use sage_core::{
    geometry::distance,
    motion::DT,
    scene::Note,
    scene::{Held, Scene, Track},
};

/// Largest distance between both ends of a gap, metres, and speed between them, m/s.
const SAME_PLACE: f64 = 0.5;
const STANDING: f64 = 0.5;
/// Overlap of recorded boxes that says nothing, metres: labels of neighbours overlap.
const TOUCHING: f64 = 0.2;
/// Names of road users in the note.
const NAMED: usize = 5;

/// Holds road users other than the ego through gaps at whose ends they are in the same place.
pub(super) fn hold(scene: &mut Scene) {
    let mut held: Vec<String> = Vec::new();
    let mut is_held = vec![false; scene.tracks.len()];
    scene.held.iter().for_each(|held| is_held[held.track] = true);
    for k in (0..scene.tracks.len()).filter(|k| *k != scene.ego) {
        let mut gaps = standing_gaps(&scene.tracks[k]);
        gaps.retain(|gap| is_place_free(scene, &is_held, k, *gap));
        if !gaps.is_empty() {
            let track = &mut scene.tracks[k];
            held.push(format!("`{}`", track.id.escape_debug()));
            let held = gaps.into_iter().map(|[last, next]| Held::between(k, track, last, next));
            scene.held.extend(held);
            is_held[k] = true;
        }
    }
    let more = match held.len().saturating_sub(NAMED) {
        0 => String::new(),
        more => format!(" and {more} more"),
    };
    if !held.is_empty() {
        let words =
            if held.len() == 1 { "1 road user is" } else { &format!("{} road users are", held.len()) };
        held.truncate(NAMED);
        let text = format!(
            "{words} held through gaps at whose ends they stand in the same place ({}{more})",
            held.join(", ")
        );
        let note = Note::HeldInGap(text);
        // A native file has it already.
        if !scene.notes.contains(&note) {
            scene.notes.push(note);
        }
    }
}

/// The gaps to fill: the last frame before each and the next one after it.
fn standing_gaps(track: &Track) -> Vec<[usize; 2]> {
    let valid: Vec<usize> = (0..track.valid.len()).filter(|frame| track.valid[*frame]).collect();
    let is_standing = |last: usize, next: usize| {
        let apart = distance(track.point(last), track.point(next));
        apart <= SAME_PLACE.min(STANDING * DT * (next - last) as f64)
    };
    let pairs = valid.windows(2).map(|pair| [pair[0], pair[1]]);
    pairs.filter(|[last, next]| next - last > 1 && is_standing(*last, *next)).collect()
}

/// Whether nobody else who is not held is recorded in the place of a road user during a gap: else it was not there, or has another
/// id.
fn is_place_free(scene: &Scene, is_held: &[bool], k: usize, [last, next]: [usize; 2]) -> bool {
    let area = scene.tracks[k].oriented_box(last);
    let is_in_place = |other: &Track| {
        (last + 1..next).filter(|frame| other.valid[*frame]).any(|frame| {
            let reach =
                area.half_length + 0.5 * other.size[frame][0].max(other.size[frame][1]) + area.half_width;
            distance(area.center, other.point(frame)) <= reach
                && area.overlap_depth(&other.oriented_box(frame)) > TOUCHING
        })
    };
    let mut others = scene.tracks.iter().enumerate().filter(|(other, _)| *other != k && !is_held[*other]);
    !others.any(|(_, other)| is_in_place(other))
}
