//! Properties of weighted objectives: one evaluation suffices for every μ, and several ego paths give a
//! mean.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod scenes;

use std::sync::Arc;

use approx::assert_relative_eq;
use insta::assert_snapshot;
use sage_core::{
    objective::{
        Candidate, Context, ContextOptions, EgoPaths, Encounter, Feasibility, MapFeasibility, Objective,
        ObjectiveSpec, PRESETS, Weight, feasibilities, realism_penalty, rewards,
    },
    scene::{Scene, SceneIndex},
};
use scenes::{candidate, scene};

fn objective(json: &str) -> Objective {
    let spec: ObjectiveSpec = serde_json::from_str(json).unwrap();
    Objective::new(&spec, &rewards().unwrap(), &feasibilities().unwrap()).unwrap()
}

fn preset(name: &str) -> Objective {
    let spec = ObjectiveSpec::preset(name).unwrap();
    Objective::new(&spec, &rewards().unwrap(), &feasibilities().unwrap()).unwrap()
}

fn context(scene: &Arc<Scene>) -> Context {
    Context::new(scene, &SceneIndex::new(scene.map.clone()), &ContextOptions::default()).unwrap()
}

/// All seeded candidates of some seeded scenes.
fn each(mut check: impl FnMut(&Context, &Candidate)) {
    for seed in 0..40 {
        let scene = Arc::new(scene(seed));
        let ctx = context(&scene);
        for k in 0..4 {
            check(&ctx, &ctx.candidate(candidate(&scene, k)));
        }
    }
}

#[test]
fn the_papers_selection_equals_its_formula_and_one_evaluation_gives_every_mu() {
    let objective = preset("paper-selection");
    each(|ctx, candidate| {
        let evaluation = objective.evaluate(candidate, ctx);
        let reward = Encounter::of(candidate, ctx.ego()).reward(ctx.convention());
        let penalty = realism_penalty(candidate.profile());
        for mu in [0.0, 0.3, 1.0] {
            assert_eq!(objective.value(&evaluation, mu), mu * reward - (1.0 - mu) * penalty);
        }
        assert_eq!(evaluation.violations, MapFeasibility::default().violations(candidate, ctx));
        assert!(objective.value_at_most(candidate, ctx, 0.3) >= objective.value(&evaluation, 0.3));
    });
}

#[test]
fn a_union_measures_the_terms_of_all_its_objectives() {
    let all = PRESETS.map(|(name, _)| preset(name));
    for (rule, count) in [("paper", 2), ("drivable", 10)] {
        let same: Vec<&Objective> = all.iter().filter(|o| o.spec().feasibility.name == rule).collect();
        let union = Objective::union(&same).unwrap().unwrap();
        assert_eq!(union.spec().terms.len(), count, "{rule}");
        each(|ctx, candidate| {
            let together = union.evaluate(candidate, ctx);
            for own in &same {
                let evaluation = own.evaluate(candidate, ctx);
                let positions = own.term_indices_in(&union).unwrap();
                let terms: Vec<_> = positions.iter().map(|position| together.terms[*position]).collect();
                assert_eq!(terms, evaluation.terms);
                assert_eq!(own.value_of(&terms, together.cost(), 0.4), own.value(&evaluation, 0.4));
            }
        });
    }
    let paper = preset("paper-selection");
    let drivable =
        objective(r#"{"terms": [{"name": "realism", "weight": -1}], "feasibility": {"name": "drivable"}}"#);
    assert_snapshot!(Objective::union(&[&paper, &drivable]).err().unwrap(), @"options of objective `feasibility`: objectives that are evaluated together have the rules `paper` and `drivable`; expected one rule");
    assert_eq!(drivable.term_indices_in(&paper), Some(vec![1]));
    let other = objective(r#"{"terms": [{"name": "impact-speed", "weight": 1}]}"#);
    assert_eq!(other.term_indices_in(&paper), None);
}

#[test]
fn violation_weights_and_terms_only_for_feasible_candidates_are_applied() {
    let plain = objective(r#"{"terms": [{"name": "realism", "weight": -1}]}"#);
    let weighed = objective(
        r#"{"terms": [{"name": "realism", "weight": -1}, {"name": "lane-distance", "weight": -1, "only_feasible": true}],
            "violation_weight": 0.5}"#,
    );
    let (mut broken, mut whole) = (0, 0);
    each(|ctx, candidate| {
        let (a, b) = (plain.evaluate(candidate, ctx), weighed.evaluate(candidate, ctx));
        if b.is_feasible() {
            whole += 1;
            assert!(b.terms[1].is_some());
        } else {
            broken += 1;
            assert_eq!(b.terms[1], None);
            let expected = plain.value(&a, 0.0) - 0.5 * a.cost();
            assert_relative_eq!(weighed.value(&b, 0.0), expected, max_relative = 1e-12);
        }
    });
    assert!(broken > 0 && whole > 0);
}

#[test]
fn several_ego_paths_give_a_weighted_mean_and_share_the_index() {
    let terms = r#"{"terms": [{"name": "adversarial", "weight": 1}, {"name": "realism", "weight": -1}]}"#;
    let objective = objective(terms);
    each(|ctx, candidate| {
        let own = ctx.ego().positions().to_vec();
        let aside: Vec<[f64; 2]> = own.iter().map(|[x, y]| [x + 7.0, y - 3.0]).collect();
        let one = |path: &Vec<[f64; 2]>| {
            let ego = EgoPaths::one("ego", path.clone(), None).unwrap();
            objective.evaluate(candidate, &ctx.with_ego(&ego).unwrap())
        };
        let both = EgoPaths::one("ego", own.clone(), None).unwrap();
        let both = both.and("ego", 3.0, aside.clone(), None).unwrap();
        let sibling = ctx.with_ego(&both).unwrap();
        assert!(std::ptr::eq(&**sibling.index(), &**ctx.index()));
        let (a, b, mean) = (one(&own), one(&aside), objective.evaluate(candidate, &sibling));
        let expected = 0.25 * a.terms[0].unwrap() + 0.75 * b.terms[0].unwrap();
        assert_relative_eq!(mean.terms[0].unwrap(), expected, max_relative = 1e-12);
        assert_eq!(mean.terms[1], a.terms[1], "realism does not depend on the ego's path");
        assert_eq!((mean.contact, mean.adversarial), (a.contact, a.adversarial), "of the first path");
    });
}

#[test]
fn an_ego_path_may_end_early_and_the_ego_is_absent_afterwards() {
    let objective = preset("paper-selection");
    each(|ctx, candidate| {
        let whole = ctx.ego().positions().to_vec();
        let full = EgoPaths::one("ego", whole.clone(), None).unwrap();
        let full = Encounter::of(candidate, ctx.with_ego(&full).unwrap().ego());
        for length in [1, 2, 30] {
            let ego = EgoPaths::one("ego", whole[..length].to_vec(), None).unwrap();
            let short = ctx.with_ego(&ego).unwrap();
            let found = Encounter::of(candidate, short.ego());
            assert!(found.contact.is_none_or(|step| step <= length));
            if length == 30 && full.contact.is_some_and(|step| step < 30) {
                assert_eq!(found.contact, full.contact);
            }
            assert!(objective.value(&objective.evaluate(candidate, &short), 0.5).is_finite());
        }
    });
}

#[test]
fn invalid_objectives_are_refused_by_name() {
    let build = |json: &str| -> String {
        let spec: ObjectiveSpec = serde_json::from_str(json).unwrap();
        let built = Objective::new(&spec, &rewards().unwrap(), &feasibilities().unwrap());
        built.err().unwrap().to_string()
    };
    let many = format!(r#"{{"terms": [{}]}}"#, vec![r#"{"name": "realism", "weight": 1}"#; 65].join(","));
    let wrong = [
        r#"{"terms": []}"#,
        r#"{"terms": [{"name": "nice", "weight": 1}]}"#,
        r#"{"terms": [{"name": "realism", "weight": 1, "options": {"much": 1}}]}"#,
        r#"{"terms": [{"name": "realism", "weight": 1}], "feasibility": {"name": "none"}}"#,
        r#"{"terms": [{"name": "realism", "weight": 1}], "violation_weight": -1}"#,
        r#"{"terms": [{"name": "realism", "weight": 1}], "violation_weight": 1e300}"#,
        &many,
    ];
    let mut said: Vec<String> = wrong.iter().map(|json| format!("{json:.120} -> {}", build(json))).collect();
    for weight in [
        Weight::Constant(f64::NAN),
        Weight::Constant(1e308),
        Weight::Linear { mu0: 0.0, mu1: -1e10 },
        Weight::Linear { mu0: f64::MAX, mu1: -f64::MAX },
    ] {
        let mut spec = ObjectiveSpec::preset("natural").unwrap();
        spec.terms[0].weight = weight;
        let error = Objective::new(&spec, &rewards().unwrap(), &feasibilities().unwrap()).err().unwrap();
        said.push(format!("{weight:?} -> {error}"));
    }
    assert_snapshot!("invalid_objectives", said.join("\n"));
    for (positions, headings) in
        [(vec![], None), (vec![[0.0; 2]; 81], None), (vec![[0.0; 2]; 3], Some(vec![0.0]))]
    {
        assert!(EgoPaths::one("ego", positions, headings).is_err());
    }
    assert!(EgoPaths::one("ego", vec![[f64::NAN, 0.0]], None).is_err());
    let path = EgoPaths::one("ego", vec![[0.0; 2]], None).unwrap();
    assert!(path.and("ego", 0.0, vec![[0.0; 2]], None).is_err());
}
