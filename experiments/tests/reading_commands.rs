//! A long recording of which another frame is now; `commands/recordings.md` has recordings of other lengths, rates and quality.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod program;
mod recordings;

use program::*;
use sage_data::Recording;

#[test]
fn the_frame_that_is_now_is_frame_10_of_what_is_written() {
    let folder = tempfile::tempdir().unwrap();
    recordings::write(folder.path());
    let scene = folder.path().join("long.pkl");
    let out = folder.path().join("out");
    let arguments = ["generate", text(&scene), "--format", "native", "--now", "40", "--out", text(&out)];
    let run = sage(&[&arguments[..], &WEIGHTS].concat());
    assert!(run.status.success(), "{}", stderr(&run));
    let written = Recording::read(&out.join("long-now40-lambda1.00.safetensors")).unwrap().scene;
    let whole = Recording::read(&scene).unwrap().scene;
    assert_eq!(written.frames, 91);
    assert_eq!(written.tracks[0].position[..91], whole.tracks[0].position[30..121]);
}
