//! What is done with a scene that was read: everything that a later command would meet.

use std::{path::Path, sync::Arc};

use sage_core::{
    motion::{HORIZON, NOW, Trajectory},
    objective::{Context, ContextOptions, Convention, Scorer},
    scene::{Scene, SceneIndex},
};
use sage_data::{Error, Recording, Source, checks::Summary, repairs::Repair, womd};

/// Reads, summarises, scores and writes a scene, if it is one. Panics if a written scene reads as another one.
pub fn consume(path: &Path, bytes: &[u8]) -> Result<(), Error> {
    let recording = Recording::from_bytes(path, bytes.to_vec())?;
    let summary = Summary::of("mutant", &recording.scene);
    assert_eq!(summary.map_points, recording.scene.map.points.len());
    score(&recording.scene);
    let keeps_notes = matches!(recording.source, Source::Pickle(_) | Source::Record(_));
    // A record without an id gets one and a note; a pickle of it has an id and no such note.
    let plain = |scene: &Scene| {
        let kept = |note: &&_| keeps_notes && sage_core::scene::Note::repair(note) != Some(Repair::NoId);
        Scene { notes: scene.notes.iter().filter(kept).cloned().collect(), ..scene.clone() }
    };
    let expected = plain(&recording.scene);
    // A scene without an id has the name of its file.
    let read = |ending: &str, bytes: Vec<u8>| {
        Recording::from_bytes(&path.with_extension(ending), bytes).map(|read| plain(&read.scene))
    };
    // A damaged native file can disagree with its own source; then writing returns an error.
    let native = recording.to_native()?;
    assert!(read("safetensors", native)? == expected, "the scene differs as a native file");
    let pickled = read("pkl", recording.to_pickle()?)?;
    match recording.source {
        Source::Native(_) => {}
        // Which road user is the adversary is no value of these.
        Source::Argoverse2(_) => assert!(pickled.tracks == expected.tracks, "the tracks differ as a pickle"),
        _ => assert!(pickled == expected, "the scene differs as a pickle"),
    }
    match recording.source {
        Source::Record(_) => {
            let encoded = recording.to_scenario()?;
            let again = read("tfrecord#0", womd::frame(&encoded.data)).expect("what is written is read");
            // What was mended needs no mending again, so the scenes differ in their notes.
            let same = Scene { notes: Vec::new(), ..again } == Scene { notes: Vec::new(), ..expected };
            assert!(same || !encoded.notes.is_empty(), "the scene differs as a record");
        }
        Source::GpuDrive(_) => {
            read("json", recording.to_gpudrive()?.json).expect("what is written is read");
        }
        _ => {}
    }
    Ok(())
}

/// Scores the logged future, if there is one; rewards must be finite for any scene.
fn score(scene: &Scene) {
    let Ok(adversary) = scene.adversary() else { return };
    if scene.frames <= NOW + HORIZON {
        return;
    }
    let points = (NOW + 1..=NOW + HORIZON).map(|f| adversary.point(f)).collect();
    // Frames that are not valid may lie anywhere.
    let Ok(log) = Trajectory::new("log", points) else {
        let is_whole = adversary.count_valid(NOW + 1..NOW + HORIZON + 1) == HORIZON;
        assert!(!is_whole, "the reader bounds coordinates and steps");
        return;
    };
    let index = SceneIndex::new(scene.map.clone());
    for convention in [Convention::Paper, Convention::Release] {
        let options = ContextOptions { convention, ..ContextOptions::default() };
        let ctx = Context::new(&Arc::new(scene.clone()), &index, &options)
            .expect("it has an adversary and all frames");
        let s = Scorer::new(&ctx).scores(&ctx.candidate(log.clone()));
        for value in [s.adversarial_reward, s.kinematic_penalty, s.behavior_penalty] {
            assert!(value.is_finite(), "{convention:?}: {s:?}");
        }
    }
}
