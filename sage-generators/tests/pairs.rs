//! Properties of every generator of this crate, with the embedded experts.
#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

use std::sync::Arc;

use sage_backbones::{
    backbone::{finite, trajectories_in_world},
    backbones,
    candidates::ranked,
    forecast::features_with_forecast,
    subsampling::Subsampling,
    weights::Weights,
};
use sage_core::{
    generator::{Knowledge, Note, Observation, OperatingPoint, Proposal},
    motion::{NOW, Trajectory},
    objective::{Context, ContextOptions, Objective, ObjectiveSpec, Scorer, feasibilities, rewards},
    registry::Entry,
    scene::{Scene, SceneIndex, TrackKind},
};
use sage_data::procedural::{Kind, generate};
use sage_generators::{
    GeneratorInputs, GeneratorKind, Person, Placement, generators,
    proposers::{MixedExperts, ProposalOptions},
    selector::{CatSelector, Selector as _},
};
use sage_merging::{ExpertSet, mergers};

fn inputs(selection: &str) -> GeneratorInputs {
    let weights = Weights::Carried { name: "procedural", files: &sage_weights::PROCEDURAL };
    let (experts, _) = ExpertSet::load(&weights, &backbones().unwrap()).unwrap();
    let spec = ObjectiveSpec::preset(selection).unwrap();
    let selection = Objective::new(&spec, &rewards().unwrap(), &feasibilities().unwrap()).unwrap();
    GeneratorInputs {
        experts: Some(experts),
        merger: mergers().unwrap().build_default("linear").unwrap().into(),
        seed: 0,
        selection: Arc::new(selection),
    }
}

fn context(scene: &Arc<Scene>) -> Context {
    Context::new(scene, &SceneIndex::new(scene.map.clone()), &ContextOptions::default()).unwrap()
}

/// A scene for a generator: with a pedestrian as the adversary for the one that plans for people.
fn scene_for(generator: &str) -> Scene {
    let mut scene = generate(Kind::FourWay, 5, 1).unwrap();
    if generator == <Person as Entry<dyn GeneratorKind>>::NAME {
        let index = SceneIndex::new(scene.map.clone());
        let placed = Placement::default().tracks(&scene, &index, &TrackKind::Pedestrian).unwrap();
        scene.adversary = Some(scene.tracks.len());
        scene.tracks.extend(placed);
    }
    scene
}

/// The scene with another future of all tracks.
fn with_another_future(scene: &Scene) -> Scene {
    let mut other = scene.clone();
    for track in &mut other.tracks {
        for frame in NOW + 1..track.position.len() {
            track.position[frame][0] += 3.0;
            track.heading[frame] += 0.3;
        }
    }
    other
}

#[test]
fn an_attack_does_not_depend_on_other_operating_points() {
    let inputs = inputs("natural");
    let points = [0.0, 0.5, 1.0, 0.5].map(|lambda| OperatingPoint::at(lambda, 0.5 * lambda));
    let registry = generators().unwrap();
    for entry in registry.entries() {
        let scene = Arc::new(scene_for(entry.name));
        let ctx = context(&scene);
        let generator = registry.build_default(entry.name).unwrap().build(&inputs).unwrap();
        let together = generator.attacks(&ctx, &points, 3).unwrap();
        assert_eq!(together.len(), points.len(), "{}", entry.name);
        for (point, attack) in points.iter().zip(&together) {
            attack.check(&scene).unwrap();
            let alone = generator.attacks(&ctx, std::slice::from_ref(point), 3).unwrap();
            assert_eq!(alone[0], *attack, "{} at {point:?}", entry.name);
            // What a generator keeps of a scene changes nothing.
            if let Some(kept) = generator.prepare(&ctx).unwrap() {
                let again = generator.attacks_prepared(&*kept, &ctx, std::slice::from_ref(point), 3);
                assert_eq!(again.unwrap(), alone, "{} at {point:?}", entry.name);
            }
        }
        assert_eq!(together[1], together[3], "{}", entry.name);
    }
}

#[test]
fn generators_that_use_only_history_do_not_depend_on_the_future() {
    let (inputs, at) = (inputs("paper-selection"), [OperatingPoint::at(1.0, 1.0)]);
    let registry = generators().unwrap();
    let mut checked = 0;
    for entry in registry.entries() {
        let scene = Arc::new(scene_for(entry.name));
        let other = Arc::new(with_another_future(&scene));
        let [ctx, changed] = [&scene, &other].map(context);
        let kind = registry.build_default(entry.name).unwrap();
        let generator = kind.build(&inputs).unwrap();
        let [a, b] = [&ctx, &changed].map(|ctx| generator.attacks(ctx, &at, 0).unwrap());
        if kind.facts().knows == Knowledge::NOW {
            assert_eq!(a, b, "{}", entry.name);
            checked += 1;
        } else if kind.facts().plans_against_ego {
            assert_ne!(a, b, "{} declares that it plans against the ego", entry.name);
        } else if !kind.facts().is_upper_bound && kind.facts().needs_experts {
            // The proposals are equal; the selected one may differ.
            assert_eq!(a[0].candidates, b[0].candidates, "{}", entry.name);
        } else if !kind.facts().needs_experts {
            assert_ne!(a, b, "{} declares that it uses the future", entry.name);
        }
    }
    assert_eq!(checked, 1, "most-likely");
}

#[test]
fn any_frame_may_be_now() {
    let scene = generate(Kind::Merge, 5, 1).unwrap();
    let index = SceneIndex::new(scene.map.clone());
    let proposer = MixedExperts::default().proposer(&inputs("paper-selection")).unwrap();
    for now in [NOW, 25, 60] {
        let observation = Observation::at(&scene, &index, now).unwrap();
        let adversary = observation.scene().adversary().unwrap();
        assert_eq!(adversary.point(NOW), scene.adversary().unwrap().point(now));
        if !adversary.is_valid(NOW) {
            continue;
        }
        let at = OperatingPoint::at(0.5, 0.5).mixture;
        let proposals = proposer.prepare(&observation).unwrap().propose(&at, 0).unwrap();
        assert_eq!(proposals.len(), 48);
        let [x, y] = adversary.point(NOW);
        let far = |p: [f64; 2]| (p[0] - x).hypot(p[1] - y);
        assert!(proposals.iter().all(|p| far(p.trajectory.points()[0]) < 4.0), "from its position at {now}");
    }
    assert!(Observation::at(&scene, &index, 9).is_err() && Observation::at(&scene, &index, 9999).is_err());
}

#[test]
fn published_candidates_are_the_likeliest_goals_in_their_order() {
    let scene = Arc::new(generate(Kind::FourWay, 5, 1).unwrap());
    let inputs = inputs("paper-selection");
    let observation = Observation::at(&scene, &SceneIndex::new(scene.map.clone()), NOW).unwrap();
    let propose = |options: ProposalOptions| {
        let proposer = MixedExperts(options).proposer(&inputs).unwrap();
        let at = OperatingPoint::at(1.0, 1.0).mixture;
        proposer.prepare(&observation).unwrap().propose(&at, 0).unwrap()
    };
    let published = propose(ProposalOptions::published());
    // The same network and the same goals, without the generator.
    let experts = inputs.experts.clone().unwrap();
    let prior = experts.prior();
    let adversary = scene.adversary_index().unwrap();
    let features = features_with_forecast(&**prior, &observation, adversary, Subsampling::NONE).unwrap();
    let encoding = prior.encode(Arc::new(features)).unwrap();
    let weights = experts.experts().iter().find(|(name, _)| &**name == "adversarial").unwrap();
    let model = experts.model(weights.1.clone()).unwrap();
    let log_probs: Vec<f32> = finite(&model.log_probs(&encoding).unwrap()).unwrap();
    let best = &ranked(&log_probs)[..32];
    let expected =
        trajectories_in_world(&model.trajectories(&encoding, best).unwrap(), encoding.features()).unwrap();
    assert_eq!(published.len(), 32);
    for (proposal, (mode, trajectory)) in published.iter().zip(best.iter().zip(&expected)) {
        assert_eq!(proposal.log_prob, Some(f64::from(log_probs[*mode])));
        let gap = proposal.trajectory.points().iter().zip(trajectory.points());
        assert!(gap.map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1])).all(|gap| gap < 1e-9));
    }
    // Each option does something on its own.
    let default = || ProposalOptions { candidates: Some(32), ..ProposalOptions::default() };
    let others = [
        ProposalOptions { apart: 0.0, ..default() },
        ProposalOptions { retime: false, ..default() },
        ProposalOptions { drivable: false, ..default() },
    ];
    for options in others {
        assert_ne!(propose(options.clone()), propose(default()), "{options:?}");
    }
}

#[test]
fn few_drawn_candidates_follow_the_distribution_of_the_mixture() {
    let scene = Arc::new(generate(Kind::FourWay, 5, 1).unwrap());
    let inputs = inputs("natural-adversarial");
    let observation = Observation::at(&scene, &SceneIndex::new(scene.map.clone()), NOW).unwrap();
    let options = |candidates| ProposalOptions {
        candidates: Some(candidates),
        drivable: false,
        ..ProposalOptions::few_drawn()
    };
    let prepared = |options| MixedExperts(options).proposer(&inputs).unwrap().prepare(&observation).unwrap();
    let at = |lambda: f64| OperatingPoint::at(lambda, 1.0).mixture;
    let one = prepared(options(1));
    // The mean log-probability of a draw is minus the entropy of the distribution.
    let experts = inputs.experts.clone().unwrap();
    let adversary = scene.adversary_index().unwrap();
    let features =
        features_with_forecast(&**experts.prior(), &observation, adversary, Subsampling::default()).unwrap();
    let encoding = experts.prior().encode(Arc::new(features)).unwrap();
    for (lambda, name) in [(0.0, "realistic"), (1.0, "adversarial")] {
        let weights = experts.experts().iter().find(|(known, _)| &**known == name).unwrap();
        let model = experts.model(weights.1.clone()).unwrap();
        let log_probs: Vec<f32> = finite(&model.log_probs(&encoding).unwrap()).unwrap();
        let expected: f64 = log_probs.iter().map(|p| f64::from(p.exp()) * f64::from(*p)).sum();
        let found: Vec<f64> =
            (0..400).map(|seed| one.propose(&at(lambda), seed).unwrap()[0].log_prob.unwrap()).collect();
        let mean = found.iter().sum::<f64>() / 400.0;
        let deviation = (found.iter().map(|p| (p - mean).powi(2)).sum::<f64>() / 400.0).sqrt();
        assert!((mean - expected).abs() < 4.0 * deviation / 20.0, "{name}: {mean} for {expected}");
    }
    // The first of four draws is the one draw of the same seed; a draw is repeated by its seed.
    let four = prepared(options(4));
    let points = |proposals: &[Proposal], k: usize| proposals[k].trajectory.points().to_vec();
    for seed in 0..5 {
        let drawn = four.propose(&at(0.5), seed).unwrap();
        assert_eq!(drawn.len(), 4);
        // Products of other sizes are rounded otherwise.
        let alone = points(&one.propose(&at(0.5), seed).unwrap(), 0);
        let gaps = points(&drawn, 0).into_iter().zip(alone).map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1]));
        assert!(gaps.fold(0.0, f64::max) < 1e-4);
        assert_eq!(points(&drawn, 3), points(&four.propose(&at(0.5), seed).unwrap(), 3));
    }
    let retimed = ProposalOptions { retime: true, ..ProposalOptions::few_drawn() };
    let text = serde_json::to_value(retimed).unwrap();
    let error = generators().unwrap().build("sage", &text).err().unwrap().to_string();
    assert!(error.contains("`retime`"), "{error}");
}

#[test]
fn missing_inputs_are_named() {
    let none = GeneratorInputs { experts: None, ..inputs("natural") };
    let registry = generators().unwrap();
    for entry in registry.entries() {
        let kind = registry.build_default(entry.name).unwrap();
        let built = kind.build(&none);
        assert_eq!(built.is_err(), kind.facts().needs_experts, "{}", entry.name);
        if let Err(error) = built {
            // The message names the kind of generator of a preset.
            let kind = entry.name.trim_end_matches("-published").trim_end_matches("-drawn");
            assert!(error.to_string().starts_with(&format!("generator `{kind}` needs")), "{error}");
        }
    }
}

#[test]
fn the_note_of_cat_agrees_with_the_scores() {
    let scene = Arc::new(generate(Kind::FourWay, 5, 1).unwrap());
    let ctx = context(&scene);
    let selector = CatSelector;
    let scorer = Scorer::new(&ctx);
    let ego = ctx.ego().positions();
    let mut nearest = 0;
    // Crosses the ego's path at 25 m/s, in one of 30 frames: CAT compares every fifth.
    for (step, [ex, ey]) in ego.iter().enumerate().skip(20).take(30) {
        let cross = |past: bool| {
            let at = |k: usize| {
                let along = 2.5 * (k as f64 - step as f64) + if past { 400.0 } else { 0.0 };
                [ex + 0.6 * along, ey + 0.8 * along]
            };
            let path = Trajectory::new("cross", (0..80).map(at).collect()).unwrap();
            Proposal { log_prob: Some(-1.0), ..Proposal::of(path) }
        };
        for proposals in [vec![cross(false)], vec![cross(true)], vec![cross(true), cross(false)]] {
            let chosen = selector.select(&proposals, &ctx, 0.0).unwrap();
            let touches = |proposal: &Proposal| {
                scorer.scores(&ctx.candidate(proposal.trajectory.clone())).collision == Some(true)
            };
            match chosen.note {
                Some(Note::NoContact) => assert!(!proposals.iter().any(touches), "step {step}"),
                Some(Note::Nearest) => {
                    nearest += 1;
                    assert!(proposals.iter().any(touches), "step {step}");
                }
                note => assert_eq!(note, None),
            }
        }
    }
    assert!(nearest > 5, "{nearest}");
    assert!(!Note::Nearest.to_string().contains("contact"), "a row may say contact beside it");
}
