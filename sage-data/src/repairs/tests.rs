//! Invented files of every frame rate and length, and what must come of them.

mod tracks;

use std::path::Path;

use sage_core::{
    geometry::{distance, wrap_angle},
    motion::{DT, NOW},
    scene::{LightState, Scene},
};

use super::{
    made::{Made, beside, circle, speeding_up},
    resample::check_size,
};
use crate::{ReadOptions, checks};

fn kinds(scene: &Scene) -> Vec<&'static str> {
    checks::warnings(scene).into_iter().map(|warning| warning.kind).collect()
}

fn times(count: usize, step: f64) -> Vec<f64> {
    (0..count).map(|frame| frame as f64 * step).collect()
}

/// What must come of a file.
enum Expected<'e> {
    /// Its own frames.
    Untouched(usize),
    /// So many frames at 10 Hz, with a note.
    Resampled(usize),
    /// An error with all these words.
    Refused(&'e [&'e str]),
}
use Expected::{Refused, Resampled, Untouched};

#[test]
fn the_times_of_a_file_decide_its_rate() {
    let even = |count, step| times(count, step);
    let jitter = |step: f64| -> Vec<f64> {
        (0..91).map(|f| f as f64 * step + 0.02 * step * ((f * 7 % 5) as f64 - 2.0)).collect()
    };
    let mapped = |map: fn(f64) -> f64| -> Vec<f64> { times(91, 0.1).into_iter().map(map).collect() };
    let mut late = even(91, 0.1);
    late.iter_mut().skip(40).for_each(|time| *time += 0.12);
    let mut twice = even(91, 0.1);
    twice[50] = twice[49];
    let mut twice_fast = even(181, 0.05);
    twice_fast[50] = twice_fast[49];
    let cases: Vec<(&str, Vec<f64>, Option<f64>, Expected)> = vec![
        ("10 Hz", even(91, 0.1), None, Untouched(91)),
        ("10 Hz as a period", even(91, 0.1), Some(0.1), Untouched(91)),
        ("10 Hz as a rate", even(91, 0.1), Some(10.0), Untouched(91)),
        ("10 Hz from a large clock", mapped(|t| t + 1.6e9), None, Untouched(91)),
        ("10 Hz, 4 % slow", even(91, 0.104), None, Untouched(91)),
        ("10 Hz, 4 % fast", even(91, 0.096), None, Untouched(91)),
        ("10 Hz with jitter", jitter(0.1), None, Untouched(91)),
        ("10 Hz with a late frame", late, None, Untouched(91)),
        ("10 Hz with a time twice", twice, None, Untouched(91)),
        ("20 Hz", even(181, 0.05), None, Resampled(91)),
        ("20 Hz as a period", even(181, 0.05), Some(0.05), Resampled(91)),
        ("20 Hz as a rate", even(181, 0.05), Some(20.0), Resampled(91)),
        ("25 Hz", even(226, 0.04), None, Resampled(91)),
        ("30 Hz", even(271, 1.0 / 30.0), None, Resampled(91)),
        ("60 Hz", even(541, 1.0 / 60.0), None, Resampled(91)),
        ("100 Hz", even(901, 0.01), None, Resampled(91)),
        ("12.5 Hz", even(113, 0.08), None, Resampled(90)),
        ("5 Hz", even(46, 0.2), None, Resampled(91)),
        ("20 Hz with jitter", jitter(0.05), None, Resampled(46)),
        ("4 Hz", even(46, 0.25), None, Refused(&["ts", "4 Hz", "--resample"])),
        ("2 Hz", even(20, 0.5), None, Refused(&["ts", "2 Hz", "--resample"])),
        ("2 Hz, and the rate says 10", even(91, 0.5), Some(0.1), Refused(&["2 Hz"])),
        ("1 Hz", even(20, 1.0), None, Refused(&["1 Hz"])),
        ("200 Hz", even(400, 0.005), None, Refused(&["200 Hz", "5 to 100 Hz"])),
        ("milliseconds", mapped(|t| 1e3 * t), None, Untouched(91)),
        ("microseconds", mapped(|t| 1e6 * t + 1.5e15), None, Untouched(91)),
        ("nanoseconds", mapped(|t| 1e9 * t), None, Untouched(91)),
        ("microseconds at 20 Hz", even(181, 5e4), None, Resampled(91)),
        ("constant", vec![0.0; 91], None, Untouched(91)),
        ("constant, 20 Hz by the rate", vec![7.0; 181], Some(20.0), Resampled(91)),
        ("reversed", mapped(|t| 9.0 - t), None, Refused(&["ts", "increase", "backwards"])),
        ("20 Hz with a time twice", twice_fast, None, Refused(&["increase", "frame 50"])),
    ];
    assert!(cases.len() >= 30);
    for (name, times, rate, expected) in cases {
        let seconds: Vec<f64> = (0..times.len()).map(|frame| 0.1 * frame as f64).collect();
        let mut made = Made::at(&seconds, beside);
        let clock = made.array(&[times.len()], &times);
        made.set_metadata("ts", clock);
        made = match rate {
            Some(rate) => made.with_number("sample_rate", rate),
            None => made,
        };
        match (made.read(), expected) {
            (Ok(scene), Untouched(frames)) => {
                assert_eq!(scene.frames, frames, "{name}");
                assert_eq!(scene.tracks[0].position.len(), frames, "{name}");
                let is_odd = ["seconds", "constant"].iter().any(|word| name.contains(word));
                assert_eq!(kinds(&scene).contains(&"frame-rate"), is_odd, "{name}: {:?}", scene.notes);
                if name.contains("microseconds") {
                    assert!(
                        scene.notes.iter().any(|note| note.to_string().contains("microseconds")),
                        "{:?}",
                        scene.notes
                    );
                    assert!(
                        (scene.timestamps[10] - 1.0).abs() < 1e-6,
                        "{name}: {:?}",
                        &scene.timestamps[..12]
                    );
                }
            }
            (Ok(scene), Resampled(frames)) => {
                assert_eq!(scene.frames, frames, "{name}");
                assert!(kinds(&scene).contains(&"frame-rate"), "{name}: {:?}", scene.notes);
                assert!((scene.timestamps[10] - scene.timestamps[0] - 1.0).abs() < 1e-6, "{name}");
            }
            (Err(error), Refused(words)) => {
                let text = error.to_string();
                words.iter().for_each(|word| assert!(text.contains(word), "{name}: `{word}` in {text}"));
            }
            (found, _) => panic!("{name}: {:?}", found.map(|scene| scene.frames)),
        }
    }
}

#[test]
fn without_times_the_rate_decides_and_without_both_it_is_ten_hertz() {
    for (rate, frames, expected) in [
        (None, 91, 91),
        (Some(10.0), 91, 91),
        (Some(0.1), 91, 91),
        (Some(0.05), 181, 91),
        (Some(50.0), 451, 91),
    ] {
        let mut made = Made::at(&times(frames, 0.1), beside).without_metadata("ts");
        if let Some(rate) = rate {
            made = made.with_number("sample_rate", rate);
        }
        assert_eq!(made.read().unwrap().frames, expected, "{rate:?}");
    }
    let slow = Made::at(&times(91, 0.1), beside).without_metadata("ts").with_number("sample_rate", 0.5);
    let error = slow.read().unwrap_err().to_string();
    assert!(error.contains("sample_rate") && error.contains("2 Hz"), "{error}");
}

#[test]
fn resampled_motion_is_the_motion() {
    // The cubic through positions and velocities is exact for constant acceleration, and off by v⁴h⁴/(384 r³) on a circle.
    let steps = [0.01, 0.016, 0.02, 0.025, 1.0 / 30.0, 0.04, 0.05, 0.06, 0.08, 0.125, 0.16, 0.2];
    for (path, tolerance) in
        [(beside as _, 1e-9), (speeding_up as _, 1e-9), (circle as super::made::Path2, 5e-6)]
    {
        for step in steps {
            let scene = Made::lasting(9.6, step, path).read().unwrap();
            assert!((95..=97).contains(&scene.frames), "{step}: {}", scene.frames);
            let car = &scene.tracks[1];
            for frame in 0..scene.frames {
                let (position, heading, velocity) = path(frame as f64 * DT);
                assert!(distance(car.point(frame), position) < tolerance, "step {step}, frame {frame}");
                assert!(wrap_angle(car.heading[frame] - heading).abs() < 1e-6, "step {step}, frame {frame}");
                // Velocities are linear between frames: off by a h²/8 of a turn.
                assert!(distance(car.velocity[frame], velocity) < 0.01, "step {step}, frame {frame}");
                assert!(car.valid[frame]);
            }
        }
    }
}

#[test]
fn a_frame_is_valid_if_both_neighbours_are() {
    // At 12.5 Hz frame 1 lies between the frames at 0.08 and 0.16 s.
    let valid = |missing: usize| {
        let made = Made::lasting(9.6, 0.08, beside).with_value("car", "valid", missing, 0.0);
        let scene = made.read().unwrap();
        (0..6).filter(|frame| !scene.tracks[1].valid[*frame]).collect::<Vec<_>>()
    };
    assert_eq!(valid(0), [0]);
    assert_eq!(valid(1), [1]);
    assert_eq!(valid(2), [1, 2]);
    assert_eq!(valid(3), [2, 3]);
    // Frame 4 falls on the frame at 0.4 s.
    assert_eq!(valid(5), [4]);
    assert_eq!(valid(4), [3]);
}

#[test]
fn lights_keep_the_state_of_the_last_recorded_frame() {
    let scene = Made::lasting(9.0, 0.05, beside).read().unwrap();
    let first_go = scene.lights[0].states.iter().position(|state| *state == LightState::Go);
    assert_eq!(first_go, Some(46), "the light of 181 frames turns at frame 91, 4.55 s");
}

#[test]
fn slow_recordings_are_read_on_demand() {
    let options = ReadOptions { resample: true, ..ReadOptions::default() };
    for step in [0.25, 0.4, 0.5, 1.0, 2.0] {
        let made = Made::lasting(20.0, step, speeding_up);
        assert!(made.read().is_err());
        let scene = made.read_as(&options).unwrap().scene;
        assert_eq!(scene.frames, 201, "{step}");
        assert!(distance(scene.tracks[1].point(33), speeding_up(3.3).0) < 1e-9);
    }
    let error = Made::lasting(60.0, 3.0, beside).read_as(&options).unwrap_err().to_string();
    assert!(error.contains("every 3 s"), "{error}");
}

#[test]
fn unchanged_scenes_keep_the_frames_of_their_file_and_changed_ones_get_ten_hertz() {
    for step in [0.02, 0.04, 0.05, 0.2] {
        let made = Made::lasting(9.0, step, speeding_up);
        let recording = made.recording(&ReadOptions::default());
        assert_eq!(recording.to_pickle().unwrap(), made.document.to_pickle(), "{step}");
        // A native file holds the scene at 10 Hz.
        let native = recording.to_native().unwrap();
        let back = crate::Recording::from_bytes("made.safetensors".as_ref(), native).unwrap();
        assert_eq!(back.scene.frames, 91);
        let mut changed = recording.clone();
        changed.scene.tracks[1].position[50][1] += 0.25;
        let written =
            crate::Recording::from_bytes("made.pkl".as_ref(), changed.to_pickle().unwrap()).unwrap();
        assert_eq!(written.scene.frames, 91);
        assert_eq!(written.scene.timestamps.len(), 91);
        assert!(!kinds(&written.scene).contains(&"frame-rate"), "{:?}", written.scene.notes);
        for (new, old) in written.scene.tracks.iter().zip(&changed.scene.tracks) {
            assert_eq!((&new.position, &new.valid, &new.heading), (&old.position, &old.valid, &old.heading));
        }
        assert_eq!(written.scene.lights, changed.scene.lights);
        let message = recording.to_scenario().unwrap();
        let record = crate::womd::frame(&message.data);
        let again = crate::Recording::from_bytes("made.tfrecord#0".as_ref(), record).unwrap();
        assert_eq!(again.scene.frames, 91);
    }
}

#[test]
fn a_window_is_the_recording_around_its_now() {
    let made = Made::lasting(20.0, 0.1, speeding_up);
    let whole = made.read().unwrap();
    for now in [10, 11, 40, 90, 120, 150, 190, 200] {
        let options = ReadOptions { now: Some(now), ..ReadOptions::default() };
        let window = made.read_as(&options).unwrap().scene;
        assert_eq!(window.frames, 91.min(201 - (now - NOW)), "{now}");
        assert_eq!(window.horizon(), 80.min(200 - now), "{now}");
        for (part, all) in window.tracks.iter().zip(&whole.tracks) {
            assert_eq!(part.position[..], all.position[now - NOW..now - NOW + window.frames]);
        }
        let written = made.recording(&options).to_pickle().unwrap();
        let again = crate::Recording::from_bytes("window.pkl".as_ref(), written).unwrap().scene;
        assert_eq!(
            (again.frames, again.tracks[1].position[NOW]),
            (window.frames, whole.tracks[1].position[now])
        );
    }
    for now in [0, 9, 201, 500] {
        let options = ReadOptions { now: Some(now), ..ReadOptions::default() };
        let error = made.read_as(&options).unwrap_err().to_string();
        assert!(error.contains(&format!("frame {now} cannot be now")), "{error}");
    }
    // At 20 Hz frames count at 10 Hz.
    let options = ReadOptions { now: Some(40), ..ReadOptions::default() };
    let fast = Made::lasting(20.0, 0.05, speeding_up).read_as(&options).unwrap().scene;
    assert!(distance(fast.tracks[1].point(NOW), speeding_up(4.0).0) < 1e-9);
}

#[test]
fn short_recordings_are_read_with_their_horizon() {
    for frames in [11, 12, 15, 20, 21, 22, 31, 50, 66, 81, 88, 90, 91, 92, 120, 199] {
        let scene = Made::at(&times(frames, 0.1), speeding_up).read().unwrap();
        assert_eq!(scene.horizon(), 80.min(frames - 11), "{frames}");
        assert_eq!(scene.attackable_horizon().is_ok(), frames >= 21, "{frames}");
        assert_eq!(scene.adversary, Some(1), "{frames}");
        assert_eq!(kinds(&scene).contains(&"short-recording"), frames < 91, "{frames}");
    }
    for frames in [2, 5, 10] {
        let error = Made::at(&times(frames, 0.1), speeding_up).read().unwrap_err().to_string();
        assert!(error.contains("`length`") && error.contains("11"), "{error}");
    }
}

#[test]
fn a_slow_recording_of_many_road_users_is_not_resampled_to_gigabytes() {
    let mut scene = Made::at(&times(91, 0.1), beside).read().unwrap();
    let slow: Vec<f64> = times(91, 0.5);
    let refused = |scene: &Scene| check_size(scene, &slow, 0.5, Path::new("slow.pkl")).err();
    assert!(refused(&scene).is_none());
    scene.tracks = vec![scene.tracks[0].clone(); 4000].into();
    let error = refused(&scene).expect("1.8 million states").to_string();
    assert!(error.contains("slow.pkl") && error.contains("1500000 states"), "{error}");
}
