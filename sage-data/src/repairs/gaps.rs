//! Gaps of road users that stand: they are hidden for a while, and still there.

use sage_core::{
    geometry::distance,
    motion::DT,
    scene::{Held, Scene, Track},
};

/// Largest distance between both ends of a gap, metres, and speed between them, m/s.
const SAME_PLACE: f64 = 0.5;
const STANDING: f64 = 0.5;
/// How the note begins.
pub(crate) const NOTE: &str = "held-in-gap: ";
/// Names of road users in the note.
const NAMED: usize = 5;

/// Holds road users other than the ego through gaps at whose ends they are in the same place.
pub(super) fn hold(scene: &mut Scene) {
    let mut held: Vec<String> = Vec::new();
    for k in (0..scene.tracks.len()).filter(|k| *k != scene.ego) {
        let gaps = standing_gaps(&scene.tracks[k]);
        if !gaps.is_empty() {
            let track = &mut scene.tracks[k];
            held.push(format!("`{}`", track.id.escape_debug()));
            gaps.iter().for_each(|[last, next]| hold_between(track, *last, *next));
            scene.held.extend(gaps.iter().map(|[last, next]| Held { track: k, frames: last + 1..*next }));
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
        scene.notes.push(format!("{NOTE}{text}"));
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

fn hold_between(track: &mut Track, last: usize, next: usize) {
    for frame in last + 1..next {
        track.position[frame] = track.position[last];
        track.heading[frame] = track.heading[last];
        track.velocity[frame] = [0.0; 2];
        track.size[frame] = track.size[last];
        track.valid[frame] = true;
    }
}
