//! What is mended or left out when a scene file is read, each case named in the notes of the scene.
//!
//! - [`clock`]: what the times of a file say about its frame rate.
//! - [`resample`]: recordings at another rate are resampled to 10 Hz.
//! - `gaps`: road users that stand and are not seen for a while.
//! - `edges`: road edges at heights that cannot be true.
//! - [`window`]: another frame becomes *now*.
//! - [`motion`]: velocities and headings from positions, if asked for.
//! - [`sizes`]: road users without a size.
//!
//! The file keeps everything: writing an unchanged scene back gives the original frames.

pub mod clock;
mod edges;
pub(crate) mod gaps;
pub mod motion;
pub mod resample;
pub mod sizes;
pub mod window;

#[cfg(test)]
mod made;
#[cfg(test)]
mod tests;

use std::path::Path;

use sage_core::{
    motion::{DT, HISTORY, NOW},
    scene::{AdversaryOrigin, Levels, Note, Scene, Track, TrackKind, is_copy_of_ego, select_adversary},
};

pub use sage_core::scene::Repair;

use crate::{Error, ReadOptions, Recording, metadrive::MAX_FRAMES};
use clock::Clock;

/// What was mended or left out in a recording, with its file.
pub fn notes_of(recording: &Recording) -> impl Iterator<Item = String> {
    let file = recording.path.display();
    recording
        .scene
        .notes
        .iter()
        .filter(|note| note.repair().is_some())
        .map(move |note| format!("`{file}`: {note}"))
}

/// A scene with the frames of its file, before anything is mended.
pub(crate) struct Draft {
    /// The scene; its adversary is not selected yet.
    pub(crate) scene: Scene,
    /// The adversary that the file names.
    pub(crate) named: Option<usize>,
    /// Ids of road users who were added to the recording.
    pub(crate) added: Vec<String>,
    /// The file's `sample_rate`: frames per second, or seconds per frame.
    pub(crate) sample_rate: Option<f64>,
    /// The file's `current_time_index`.
    pub(crate) now_index: Option<i64>,
}

/// A scene as it is used, and its relation to the frames of its file.
#[derive(Debug)]
pub struct Decoded {
    /// The scene, at 10 Hz.
    pub scene: Scene,
    /// The frame of the file nearest to each frame of the scene; `None` if they are the same.
    pub frames: Option<Vec<usize>>,
    /// Whether the user asked for a part of the recording, or for frames that the file does not have.
    pub is_chosen: bool,
}

/// Mends a scene: copies of the ego, frame rate, window, motion; then selects the adversary.
///
/// *Errors*: [`Error::Field`] for times that cannot be used, a recording that is too short, or an ego that is not
/// valid *now*.
pub(crate) fn finish(draft: Draft, options: &ReadOptions, path: &Path) -> Result<Decoded, Error> {
    let Draft { mut scene, mut named, added, sample_rate, now_index } = draft;
    let clock = Clock::of(&mut scene, sample_rate, options, path)?;
    if let Clock::Other { times, step } = &clock {
        resample::check_size(&scene, times, *step, path)?;
    }
    let mut frames = None;
    if options.trust_positions {
        motion::recompute(&mut scene, &clock);
    }
    if let Clock::Other { times, step } = &clock {
        let text = format!("recorded at {:.3} Hz; resampled to 10 Hz", 1.0 / step);
        scene.notes.push(Repair::FrameRate.note(text.replace(".000", "")));
        frames = Some(resample::to_ten_hertz(&mut scene, times, *step));
    }
    if let Some(now) = options.now {
        let kept = window::around(&mut scene, now, path)?;
        frames = Some(match frames {
            Some(frames) => frames[kept].to_vec(),
            None => kept.collect(),
        });
    } else if let Some(index) = now_index {
        let is_now = match &clock {
            Clock::Ten => index == NOW as i64,
            Clock::Other { times, .. } => usize::try_from(index)
                .ok()
                .and_then(|index| times.get(index))
                .is_some_and(|time| (time - times[0] - NOW as f64 * DT).abs() < 0.5 * DT),
        };
        if !is_now {
            let now = match &clock {
                Clock::Ten => format!("frame {NOW} is taken as now"),
                Clock::Other { .. } => "now is 1.0 s after the first frame".to_owned(),
            };
            scene.notes.push(Note::Other(format!("the file's current_time_index is {index}; {now}")));
        }
    }
    leave_out_copies(&mut scene, &mut named);
    gaps::hold(&mut scene);
    let wrong = |field: &str, found: String, expected: String| Error::Field {
        path: path.to_owned(),
        field: field.to_owned(),
        found,
        expected,
    };
    if scene.frames < HISTORY {
        let found = match clock {
            Clock::Ten => scene.frames.to_string(),
            Clock::Other { .. } => format!("{} at 10 Hz", scene.frames),
        };
        return Err(wrong("length", found, format!("a number of frames from {HISTORY} to {MAX_FRAMES}")));
    }
    if !scene.ego().is_valid(NOW) {
        let found = format!("`{}`, which is not valid at frame {NOW}", scene.ego().id);
        return Err(wrong("metadata/sdc_id", found, "an ego that is valid at that frame".to_owned()));
    }
    edges::leave_out(&mut scene);
    let has_history = |track: &Track| track.valid[..=NOW].contains(&true);
    named = pass_over(&mut scene, named, &added);
    (scene.adversary, scene.adversary_origin) = match named.filter(|track| has_history(&scene.tracks[*track]))
    {
        Some(track) => (Some(track), AdversaryOrigin::File),
        None => select_adversary(&scene.as_observed().tracks, scene.ego, &Levels::of(&scene.map)),
    };
    let is_chosen = options.now.is_some() || options.resample && frames.is_some();
    Ok(Decoded { scene, frames, is_chosen })
}

/// The road user that the file names as the adversary, if it is a vehicle or was added to the recording.
fn pass_over(scene: &mut Scene, named: Option<usize>, added: &[String]) -> Option<usize> {
    let track = &scene.tracks[named?];
    if track.kind == TrackKind::Vehicle || added.contains(&track.id) {
        return named;
    }
    let text = format!(
        "the file names `{}`, a {}, as object of interest; only vehicles are chosen as the adversary, and --adversary names any",
        track.id.escape_debug(),
        track.kind.name().escape_debug()
    );
    scene.notes.push(Repair::NamedAdversary.note(text));
    None
}

/// Leaves out vehicles that are a second recording of the ego: the ego would meet itself.
fn leave_out_copies(scene: &mut Scene, named: &mut Option<usize>) {
    let levels = Levels::of(&scene.map);
    let is_copy = |k: usize| {
        let (track, ego) = (&scene.tracks[k], scene.ego());
        k != scene.ego && is_copy_of_ego(track, ego, &levels)
    };
    let copies: Vec<usize> = (0..scene.tracks.len()).filter(|k| is_copy(*k)).collect();
    for k in copies.into_iter().rev() {
        let track = scene.tracks.remove(k);
        let text = format!("track `{}` is a second recording of the ego; it is left out", track.id);
        scene.notes.push(Repair::EgoCopy.note(text));
        scene.ego -= usize::from(scene.ego > k);
        *named = named.filter(|index| *index != k).map(|index| index - usize::from(index > k));
    }
}
