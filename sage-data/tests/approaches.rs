//! The required deceleration of approaches in scenes of the folder `SAGE_REFERENCE`.

#![allow(clippy::unwrap_used, clippy::print_stderr)] // A failed unwrap is a failed test.

use std::{path::Path, sync::Arc};

use sage_core::{
    motion::Trajectory,
    objective::{
        Context, ContextOptions, Scorer, Scores,
        criticality::{Criticality, FULL_BRAKING},
    },
    scene::SceneIndex,
};
use sage_data::Recording;
use serde_json::Value;

/// Names and scores of the candidates of a case; `None` without the folder.
fn scores(case: &str) -> Option<Vec<(String, Scores)>> {
    let Some(folder) = std::env::var_os("SAGE_REFERENCE") else {
        eprintln!("left out: SAGE_REFERENCE is not set");
        return None;
    };
    let path = Path::new(&folder).join("cases").join(case);
    let scene = Arc::new(Recording::read(&path).unwrap().scene);
    let index = SceneIndex::new(scene.map.clone());
    let ctx = Context::new(&scene, &index, &ContextOptions::default()).unwrap();
    let scorer = Scorer::new(&ctx);
    let candidates: Vec<Value> =
        serde_json::from_slice(&std::fs::read(path.with_extension("json")).unwrap()).unwrap();
    let score = |candidate: &Value| {
        let name = candidate["name"].as_str().unwrap().to_owned();
        let points: Vec<[f64; 2]> = serde_json::from_value(candidate["trajectory"].clone()).unwrap();
        let candidate = ctx.candidate(Trajectory::new(&name, points).unwrap());
        (name, scorer.scores(&candidate))
    };
    Some(candidates.iter().map(score).collect())
}

#[test]
fn gaps_that_differ_by_a_centimetre_have_one_value() {
    let Some(scores) = scores("decel.pkl") else { return };
    for (name, scores) in &scores {
        let Criticality { required_deceleration, impact_speed, .. } = scores.criticality;
        assert!((impact_speed.unwrap() - 2.0).abs() < 1e-6, "{name}");
        assert_eq!(required_deceleration, Some(FULL_BRAKING), "{name}");
    }
}

#[test]
fn what_is_on_no_collision_course_needs_no_deceleration() {
    let Some(scores) = scores("ttc.pkl") else { return };
    for (name, scores) in &scores {
        let expected = (name == "rear-ends ego").then_some(FULL_BRAKING);
        assert_eq!(scores.criticality.required_deceleration, expected, "{name}");
    }
}
