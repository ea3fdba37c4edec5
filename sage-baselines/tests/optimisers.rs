//! KING and AdvTrajOpt on scenes with known traits, and the fit of the bicycle on recorded ones.
#![allow(clippy::unwrap_used, clippy::print_stderr)] // A failed unwrap is a failed test.

use std::{path::PathBuf, sync::Arc};

use sage_baselines::with_baselines;
use sage_core::{
    generator::{Attack, Note, OperatingPoint},
    geometry::distance,
    motion::NOW,
    objective::{Context, ContextOptions},
    scene::{Scene, SceneIndex},
    statistics,
};
use sage_data::{
    Recording, folder,
    procedural::{Kind, generate},
};
use sage_generators::{GeneratorInputs, generators};
use sage_merging::mergers;
use serde_json::{Value, json};

const OPTIMISERS: [&str; 4] = ["king", "king-published", "adv-traj-opt", "adv-traj-opt-published"];

fn inputs() -> GeneratorInputs {
    let spec = sage_core::objective::ObjectiveSpec::preset("natural").unwrap();
    let (rewards, rules) =
        (sage_core::objective::rewards().unwrap(), sage_core::objective::feasibilities().unwrap());
    GeneratorInputs {
        experts: None,
        merger: mergers().unwrap().build_default("linear").unwrap().into(),
        seed: 0,
        selection: Arc::new(sage_core::objective::Objective::new(&spec, &rewards, &rules).unwrap()),
    }
}

fn attack(scene: &Arc<Scene>, name: &str, options: &Value) -> Result<Attack, String> {
    let index = SceneIndex::new(scene.map.clone());
    let ctx = Context::new(scene, &index, &ContextOptions::default()).unwrap();
    let kind = with_baselines(generators().unwrap())
        .unwrap()
        .build(name, options)
        .map_err(|error| error.to_string())?;
    let generator = kind.build(&inputs()).map_err(|error| error.to_string())?;
    let attacks = generator.attacks(&ctx, &[OperatingPoint::at(1.0, 1.0)], 0);
    attacks.map(|mut attacks| attacks.remove(0)).map_err(|error| error.to_string())
}

/// The start of KING's search: without a weight, nothing is better.
fn fitted(scene: &Arc<Scene>) -> Attack {
    let idle = json!({"adversarial": 0, "realism": 0, "clearance": 0, "steps": 1});
    attack(scene, "king", &idle).unwrap()
}

#[test]
fn the_bicycle_follows_recordings_to_centimetres() {
    let Ok(data) = std::env::var("SAGE_DATA") else {
        return eprintln!("left out: SAGE_DATA is not set");
    };
    let files = folder::scene_files(&PathBuf::from(data).join("val")).unwrap();
    let error = |file: &PathBuf| {
        let scene = Arc::new(Recording::read(file).unwrap().scene);
        let track = scene.adversary().unwrap();
        if !track.is_valid(NOW) {
            return None;
        }
        let fit = fitted(&scene);
        let points = fit.trajectory().points().iter().enumerate();
        let known = points.filter(|(k, _)| track.is_valid(NOW + 1 + k));
        let errors: Vec<f64> = known.map(|(k, p)| distance(*p, track.point(NOW + 1 + k))).collect();
        statistics::mean(&errors)
    };
    let errors: Vec<f64> = files.iter().filter_map(error).collect();
    let mean = statistics::mean(&errors).unwrap();
    eprintln!("{} scenes, mean error {mean:.3} m", errors.len());
    assert!(errors.len() > 50 && mean <= 0.05, "{mean}");
}

#[test]
fn an_adversary_that_stands_in_a_gap_or_is_hardly_recorded_is_no_trouble() {
    let scene = generate(Kind::ALL[0], 3, 0).unwrap();
    let adversary = scene.adversary.unwrap();
    let mut standing = scene.clone();
    let track = &mut standing.tracks[adversary];
    for frame in 0..track.position.len() {
        (track.position[frame], track.velocity[frame]) = (track.position[NOW], [0.0; 2]);
        track.heading[frame] = track.heading[NOW];
    }
    let mut short = scene.clone();
    for frame in 0..short.frames {
        short.tracks[adversary].valid[frame] = frame == NOW;
    }
    for (what, scene) in [("standing", standing), ("short", short)] {
        let scene = Arc::new(scene);
        for name in OPTIMISERS {
            let found =
                attack(&scene, name, &json!({})).unwrap_or_else(|error| panic!("{what} {name}: {error}"));
            assert!(found.trajectory().points().iter().flatten().all(|x| x.is_finite()), "{what} {name}");
        }
    }
}

#[test]
fn a_search_that_finds_nothing_better_says_so() {
    let scene = Arc::new(generate(Kind::ALL[0], 3, 0).unwrap());
    let note = Some(Note::Other("the search found nothing better than its start".to_owned()));
    assert_eq!(fitted(&scene).note, note);
    assert_eq!(attack(&scene, "king", &json!({})).unwrap().note, None);
}

#[test]
fn options_are_checked_by_name() {
    let scene = Arc::new(generate(Kind::ALL[0], 3, 0).unwrap());
    for (name, options, problem) in [
        ("king", json!({"steps": 0}), "`steps` is 0; expected 1 to 10000"),
        ("king", json!({"rate": -1}), "`rate` is -1; expected a number above 0"),
        ("king-published", json!({"clearances": 1}), "unknown field `clearances`"),
        ("king", json!({"realism": 1e9}), "`realism` is 1000000000; expected a weight from 0 to 100"),
        ("adv-traj-opt", json!({"deviation": 0}), "`deviation` is 0; expected metres above 0"),
        ("adv-traj-opt", json!({"smoothing": -1}), "`smoothing` is -1; expected 0 to 1e9"),
        ("king", json!({"start": "sage"}), "generator `sage` needs a prior with experts"),
    ] {
        let error = attack(&scene, name, &options).unwrap_err();
        assert!(error.contains(problem), "{name} {options}: {error}");
    }
}
