//! GOOSE against a driver and against a recording.

#![cfg(feature = "baselines")]
#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

use std::{cell::Cell, path::Path, sync::Arc};

use advsage::{Registries, generators::Generators, part::Part, selection::Selection};
use sage_backbones::{Parameters, parameters::Header, weights::Weights};
use sage_baselines::goose::{
    RepeatedEgo, Trial, TrialScene,
    networks::{ACTION, GooseOptions, GooseWeights},
    tried,
};
use sage_core::{
    Error,
    generator::{DrivenEgo, DriverUnderTest, OperatingPoint},
    geometry::distance,
    motion::{NOW, Trajectory},
    objective::{Context, ContextOptions},
    scene::SceneIndex,
};
use sage_data::procedural::{Kind, generate};
use sage_generators::GeneratorInputs;
use sage_merging::ExpertSet;
use sage_sim::{
    SimScene,
    attack_test::AttackTest,
    policy::{Replay, policies},
    queried::QueriedDriver,
};

const KINDS: [Kind; 4] = [Kind::FourWay, Kind::Straight, Kind::Roundabout, Kind::Curve];

fn scene(kind: Kind, seed: u64) -> Arc<SimScene> {
    let scene = Arc::new(generate(kind, seed, 0).unwrap());
    SimScene::new(scene.clone(), SceneIndex::new(scene.map.clone())).unwrap()
}

#[test]
fn a_repeated_ego_does_what_the_simulation_of_a_recording_does() {
    let (mut trials, mut hits) = (0, 0);
    for kind in KINDS {
        for seed in 1..=8 {
            let scene = scene(kind, seed);
            let ctx = Context::new(scene.scene(), scene.index(), &ContextOptions::default()).unwrap();
            let test = AttackTest::new(&Replay, &scene, 0).unwrap();
            let trial_scene = TrialScene::new(&ctx, &GooseOptions::default()).unwrap();
            // To the other side of the road, and faster.
            let act = |trial: &Trial| -> Result<[f64; ACTION], Error> {
                let side = if trial.curve.points[4][1] >= 0.0 { -1.0 } else { 1.0 };
                Ok(std::array::from_fn(|k| if k < 8 { 0.5 } else { 3.0 * side }))
            };
            let simulated = tried(&trial_scene, &QueriedDriver::new(&test), 6, act).unwrap();
            let geometric = tried(&trial_scene, &RepeatedEgo(&ctx), 6, act).unwrap();
            assert_eq!(simulated.len(), geometric.len(), "{kind:?} {seed}");
            for (a, b) in simulated.iter().zip(&geometric) {
                assert_eq!((a.is_hit, a.outcome.is_done), (b.is_hit, b.outcome.is_done), "{kind:?} {seed}");
                assert!((a.achieved[0] - b.achieved[0]).abs() < 1e-9, "{kind:?} {seed}");
                assert_eq!(a.rows.len(), b.rows.len());
                let mut numbers = a.rows.as_flattened().iter().zip(b.rows.as_flattened());
                assert!(numbers.all(|(a, b)| (a - b).abs() < 1e-3), "{kind:?} {seed}");
                trials += 1;
                hits += usize::from(a.is_hit);
            }
        }
    }
    assert!(trials > 40 && hits > 3, "{trials} trials, {hits} hits");
}

#[test]
fn the_curve_of_a_short_recording_ends_with_it() {
    let mut short = generate(Kind::FourWay, 1, 0).unwrap();
    const FRAMES: usize = 31;
    short.frames = FRAMES;
    short.timestamps.truncate(FRAMES);
    for track in &mut short.tracks {
        track.position.truncate(FRAMES);
        track.heading.truncate(FRAMES);
        track.velocity.truncate(FRAMES);
        track.size.truncate(FRAMES);
        track.valid.truncate(FRAMES);
    }
    short.lights.iter_mut().for_each(|light| light.states.truncate(FRAMES));
    let short = Arc::new(short);
    let scene = SimScene::new(short.clone(), SceneIndex::new(short.map.clone())).unwrap();
    let ctx = Context::new(scene.scene(), scene.index(), &ContextOptions::default()).unwrap();
    let trial_scene = TrialScene::new(&ctx, &GooseOptions::default()).unwrap();
    let trial = trial_scene.trial(trial_scene.first_curve().clone(), &RepeatedEgo(&ctx)).unwrap();
    let end = ctx.adversary().point(FRAMES - 1);
    assert!(distance(trial.plan.points()[FRAMES - 2 - NOW], end) < 1e-9);
    // It stays there, and its stop beyond the recording is no acceleration.
    assert!(distance(trial.plan.points()[79], end) < 1e-9);
    assert!(trial.achieved[1] < 20.0, "{:?}", trial.achieved);
    assert_eq!(trial.rows.len(), 5);
}

/// Counts the drives of a driver.
struct Counted<'d>(&'d dyn DriverUnderTest, Cell<usize>);

impl DriverUnderTest for Counted<'_> {
    fn drive(&self, plan: &Trajectory) -> Result<DrivenEgo, Error> {
        self.1.set(self.1.get() + 1);
        self.0.drive(plan)
    }
}

/// Inputs with the procedural prior and a random policy beside it.
fn inputs(folder: &Path, registries: &Registries) -> GeneratorInputs {
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("../weights/procedural");
    for name in ["prior.safetensors", "realistic.safetensors", "adversarial.safetensors"] {
        std::fs::copy(shipped.join(name), folder.join(name)).unwrap();
    }
    let specs = GooseWeights::parameter_specs().unwrap();
    let header = Header {
        backbone: "goose".to_owned(),
        options: serde_json::to_value(GooseOptions::default()).unwrap(),
        ..Header::default()
    };
    Parameters::start(&specs, 1).unwrap().save(&header, &folder.join("goose.safetensors")).unwrap();
    let selection = Selection::of(registries, "natural", None).unwrap();
    let (experts, _) = ExpertSet::load(&Weights::at(folder), &registries.backbones).unwrap();
    let generators = Generators::new(registries, &Part::named("linear"), &selection, 0).unwrap();
    generators.with_experts(&experts).inputs().clone()
}

#[test]
fn a_driver_is_asked_as_often_as_the_attack_says() {
    let folder = tempfile::tempdir().unwrap();
    let registries = Registries::shipped().unwrap();
    let inputs = inputs(folder.path(), &registries);
    let generator = registries.generators.build_default("goose").unwrap().build(&inputs).unwrap();
    let policy = policies().unwrap().build_default("idm").unwrap();
    let point = [OperatingPoint::at(1.0, 1.0)];
    let mut asked = 0;
    for kind in KINDS {
        let scene = scene(kind, 1);
        let test = AttackTest::new(&*policy, &scene, 0).unwrap();
        let ctx = test.context().unwrap();
        let driver = QueriedDriver::new(&test);
        let counted = Counted(&driver, Cell::new(0));
        let attack = generator.attacks_on(&ctx, &counted, &point, 0).unwrap().remove(0);
        let queries = attack.extension.as_ref().unwrap().value.as_u64().unwrap() as usize;
        assert_eq!((queries, attack.candidates.len()), (counted.1.get(), counted.1.get()));
        assert_eq!(attack.chosen, attack.candidates.len() - 1);
        assert!((1..=6).contains(&queries));
        asked += queries;
        // Once more gives the same bits, and a recording is not asked.
        assert_eq!(generator.attacks_on(&ctx, &driver, &point, 0).unwrap()[0], attack);
        assert_eq!(generator.attacks(&ctx, &point, 0).unwrap()[0].extension, None);
        // The plan begins where the adversary is now.
        let first = attack.candidates[0].trajectory.points()[0];
        assert!(distance(ctx.adversary().point(NOW), first) < 5.0);
    }
    assert!(asked > KINDS.len(), "the policy changes curves");
}
