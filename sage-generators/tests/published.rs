//! CAT's selection and the rule against values of the published code.
//!
//! `tests/data/cat_select.safetensors` holds the results of CAT's own routine on eight artificial cases and
//! no recorded scene. The rule's check values are for recorded scenes, which are not part of this project;
//! they are compared if `SAGE_DATA` is set.
#![allow(clippy::unwrap_used, clippy::print_stderr)] // A failed unwrap is a failed test.

use std::{path::Path, sync::Arc};

use safetensors::{Dtype, SafeTensors};
use sage_core::{
    geometry::Point,
    motion::NOW,
    objective::{Context, ContextOptions, Convention, behavior_penalty, kinematic_penalty, release_reward},
    scene::SceneIndex,
};
use sage_generators::{
    bezier, logged_future,
    selector::{cat_plan, cat_select},
};

struct Case<'f> {
    file: &'f SafeTensors<'f>,
    number: usize,
}

impl Case<'_> {
    fn numbers(&self, name: &str) -> Vec<f64> {
        let tensor = self.file.tensor(&format!("case{}/{name}", self.number)).unwrap();
        let chunks = tensor.data().as_chunks::<8>().0;
        match tensor.dtype() {
            Dtype::F64 => chunks.iter().map(|c| f64::from_le_bytes(*c)).collect(),
            Dtype::I64 => chunks.iter().map(|c| i64::from_le_bytes(*c) as f64).collect(),
            other => panic!("{other:?}"),
        }
    }

    fn trajectories(&self, name: &str) -> Vec<Vec<Point>> {
        let shape = self.file.tensor(&format!("case{}/{name}", self.number)).unwrap().shape().to_vec();
        let points: Vec<Point> = self.numbers(name).as_chunks::<2>().0.to_vec();
        points.chunks(shape[1]).map(<[Point]>::to_vec).collect()
    }

    fn size(&self, name: &str) -> [f64; 2] {
        self.numbers(name).try_into().unwrap()
    }
}

#[test]
fn selection_scores_and_plan_of_the_eight_cases_are_as_published() {
    let bytes = std::fs::read("tests/data/cat_select.safetensors").unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    for number in 0..8 {
        let case = Case { file: &file, number };
        let (candidates, ego) = (case.trajectories("candidates"), case.trajectories("ego"));
        let candidates: Vec<&[Point]> = candidates.iter().map(Vec::as_slice).collect();
        let ego: Vec<_> = ego.iter().map(Vec::as_slice).zip(case.numbers("ego_prob")).collect();
        let found = cat_select(
            &candidates,
            &case.numbers("log_prob"),
            &ego,
            case.size("adv_size"),
            case.size("ego_size"),
        );
        assert_eq!(found.chosen as f64, case.numbers("chosen")[0], "case {number}");
        assert_eq!(f64::from(u8::from(found.collides)), case.numbers("collides")[0], "case {number}");
        for (a, b) in found.scores.iter().zip(case.numbers("score")) {
            assert!((a - b).abs() <= 1e-12, "case {number}: score {a}, published {b}");
        }
        for (a, b) in found.probabilities.iter().zip(case.numbers("prob")) {
            assert!((a - b).abs() <= 1e-12, "case {number}: probability {a}, published {b}");
        }
        let whole: Vec<f64> = found.whole_metres.iter().map(|d| *d as f64).collect();
        assert_eq!(whole, case.numbers("min_dist"), "case {number}");
        let contacts = found.first_contact.iter().flatten().map(|c| c.map_or(-1.0, |frame| frame as f64));
        assert_eq!(contacts.collect::<Vec<_>>(), case.numbers("first_hit"), "case {number}");
        let history: Vec<Point> = case.numbers("adv_past").as_chunks::<2>().0.to_vec();
        let plan = cat_plan(&history, candidates[found.chosen]);
        for (a, b) in plan.iter().flatten().zip(case.numbers("adv_traj")) {
            assert!((a - b).abs() <= 1e-9, "case {number}: plan {a}, published {b}");
        }
    }
}

/// The rule's own 79 points in `release`, the convention of the check values.
fn released(path: &Path) -> [f64; 3] {
    let scene = Arc::new(sage_data::Recording::read(path).unwrap().scene);
    let index = SceneIndex::new(scene.map.clone());
    let options = ContextOptions { convention: Convention::Release, ..ContextOptions::default() };
    let ctx = Context::new(&scene, &index, &options).unwrap();
    let track = scene.adversary().unwrap();
    let at = |frame: usize| {
        let valid = (NOW..track.valid.len()).filter(|f| track.is_valid(*f));
        track.point(valid.min_by_key(|f| (f.abs_diff(frame), *f)).unwrap())
    };
    let first = if track.is_valid(11) { track.point(11) } else { track.point(10) };
    let ego = ctx.ego().positions();
    let future = bezier(first, at(31), ego);
    assert_eq!(future.len(), 79);
    let (reward, _) = release_reward(&future, ctx.size(), ego, ctx.ego_size());
    let profile = sage_core::motion::kinematics::release::profile(&future);
    [reward, kinematic_penalty(&profile), behavior_penalty(&profile)]
}

#[test]
fn the_rule_reproduces_its_check_values() {
    let Some(data) = std::env::var_os("SAGE_DATA") else {
        return eprintln!("left out: SAGE_DATA is not set");
    };
    let data = Path::new(&data);
    let find = |number: usize| {
        let name = format!("{number}.pkl");
        ["pretrain", "dev", "val"]
            .map(|split| data.join(split).join(&name))
            .into_iter()
            .find(|p| p.is_file())
            .unwrap()
    };
    for (number, expected) in [
        (8, [4.936709, 2.631600, 0.548048]),
        (17, [6.708861, 1.928950, 0.220826]),
        (21, [4.810127, 2.573608, 0.544445]),
        (57, [5.569620, 3.790107, 10.772849]),
        (77, [4.430380, 3.526219, 8.042418]),
    ] {
        for (found, expected) in released(&find(number)).into_iter().zip(expected) {
            assert!((found - expected).abs() < 1e-5, "scene {number}: {found}, expected {expected}");
        }
    }
    for (split, expected) in [("val", [5.283, 2.583, 1.772]), ("dev", [5.401, 2.637, 1.392])] {
        let files = sage_data::folder::scene_files(&data.join(split)).unwrap();
        let mut sums = [0.0; 3];
        for file in &files {
            for (sum, value) in sums.iter_mut().zip(released(file)) {
                *sum += value / files.len() as f64;
            }
        }
        for (found, expected) in sums.into_iter().zip(expected) {
            assert!((found - expected).abs() < 6e-4, "{split}: {found}, expected {expected}");
        }
    }
}

#[test]
fn a_log_with_gaps_repeats_the_last_position() {
    let mut scene = sage_data::procedural::generate(sage_data::procedural::Kind::Straight, 1, 0).unwrap();
    let adversary = scene.adversary.unwrap();
    for frame in 20..30 {
        scene.tracks[adversary].valid[frame] = false;
        scene.tracks[adversary].position[frame] = [0.0; 3];
    }
    let trajectory = logged_future(&scene).unwrap();
    let position = scene.tracks[adversary].point(19);
    assert_eq!(trajectory.points()[18], position);
    assert_eq!(trajectory.points()[19], scene.tracks[adversary].point(30));
}
