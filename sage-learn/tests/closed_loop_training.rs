//! Training in closed loop: the same bits however it is interrupted, and a stop before anything breaks.

#[path = "../../sage-sim/tests/chase/mod.rs"]
mod chase;
mod short_training;

use std::{collections::BTreeMap, path::Path};

use chase::Chase;
use insta::assert_snapshot;
use safetensors::SafeTensors;
use sage_learn::{
    Algorithm, BUFFER, CHECKPOINT, PpoOptions, Setting, Td3Options, Training, TrainingOptions, TrainingState,
};
use short_training::{Parts, scenes, small};

/// Trains with a checkpoint every `every` steps and a fresh process, so to say, after each; the files of the end.
fn trained(options: &TrainingOptions, every: u64, resumes: bool) -> BTreeMap<String, Vec<u8>> {
    trained_against(&Chase { is_broken: false, searches: false }, options, every, resumes)
}

fn trained_against(
    chase: &Chase,
    options: &TrainingOptions,
    every: u64,
    resumes: bool,
) -> BTreeMap<String, Vec<u8>> {
    let (training, evaluation) = (scenes(6, 0), scenes(3, 1));
    let folder = tempfile::tempdir().expect("a folder");
    let parts = Parts::of("adaptive", "prioritised");
    let setting =
        || Setting { attacker: Some(chase), examiner: Some(chase), ..parts.setting(&training, &evaluation) };
    let state = TrainingState::new(options, training.len()).expect("valid options");
    let mut run = Training::new(options.clone(), setting(), state);
    while !run.is_done() {
        run.advance(run.state().counters().steps + every, |_| ()).expect("nothing breaks");
        run.save(folder.path(), "test").expect("written");
        if resumes {
            // Rows of a kill between the rows and the checkpoint, and an unfinished file.
            for name in ["999999999999.rows", ".sage-killed.part"] {
                if folder.path().join(BUFFER).exists() {
                    std::fs::write(folder.path().join(BUFFER).join(name), [7; 100]).expect("written");
                }
            }
            let loaded = TrainingState::load(folder.path(), "test", options, training.len());
            let state = loaded.expect("a checkpoint").expect("there is one");
            run = Training::new(options.clone(), setting(), state);
        }
    }
    run.save(folder.path(), "test").expect("written");
    content(folder.path())
}

/// The tensors and the record of the checkpoint, and all rows: the same, however often checkpoints were written.
fn content(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let bytes = std::fs::read(folder.join(CHECKPOINT)).expect("a checkpoint");
    let (_, header) = SafeTensors::read_metadata(&bytes).expect("whole");
    let text = &header.metadata().as_ref().expect("a header")["checkpoint"];
    let mut record: serde_json::Value = serde_json::from_str(text).expect("JSON");
    record.as_object_mut().expect("an object").remove("hash").expect("a hash");
    let listed = record["learner"].as_object_mut().expect("an object").remove("buffer");
    let file = SafeTensors::deserialize(&bytes).expect("whole");
    let mut all: BTreeMap<String, Vec<u8>> =
        file.iter().map(|(name, tensor)| (name.to_owned(), tensor.data().to_vec())).collect();
    all.insert("record".to_owned(), record.to_string().into_bytes());
    let Some(listed) = listed else { return all };
    let mut names: Vec<_> = std::fs::read_dir(folder.join(BUFFER))
        .expect("a folder")
        .map(|entry| entry.expect("an entry").path())
        .collect();
    names.sort();
    assert_eq!(Some(names.len()), listed.as_array().map(Vec::len), "only listed files stay");
    let mut rows: Vec<u8> = names.iter().flat_map(|name| std::fs::read(name).expect("rows")).collect();
    // The first file may begin before the oldest row of the ring.
    let ring = 4 * (101 + 2 + 2) * (500 + 500 / 16);
    all.insert("rows".to_owned(), rows.split_off(rows.len().saturating_sub(ring)));
    all
}

#[test]
fn a_run_that_resumes_has_the_bits_of_one_that_did_not() {
    let whole = trained(&small(), 400, false);
    assert!(whole == trained(&small(), 400, false), "the same run twice");
    assert!(whole == trained(&small(), 150, false), "checkpoints alone change the run");
    assert!(whole == trained(&small(), 150, true), "resuming changes the run");
    let other = TrainingOptions { seed: 8, ..small() };
    assert!(whole != trained(&other, 400, false), "another seed gives the same run");
}

#[test]
fn several_environments_resume_too() {
    let options = TrainingOptions { environments: 3, ..small() };
    assert!(trained(&options, 300, false) == trained(&options, 170, true));
}

#[test]
fn a_run_by_ppo_resumes_too() {
    let options = TrainingOptions {
        mirrored: 0.5,
        evaluations: 3,
        drives: 2,
        refresh_after: Some(200),
        seed: 7,
        ..small_ppo()
    };
    let whole = trained(&options, 400, false);
    assert!(whole == trained(&options, 400, false), "the same run twice");
    assert!(whole == trained(&options, 130, true), "resuming changes the run");
    let other = TrainingOptions { mirrored: 0.0, ..options.clone() };
    assert!(whole != trained(&other, 400, false), "mirror images change nothing");
    // The teacher has a state of its own, and leaves in the middle of episodes.
    let ppo = PpoOptions { taught: 0.63, ..options.ppo.clone() };
    let taught = TrainingOptions { ppo, ..options.clone() };
    let with_teacher = trained(&taught, 400, false);
    assert!(with_teacher != whole, "the teacher changes nothing");
    assert!(with_teacher == trained(&taught, 130, true), "resuming changes what is taught");
    // A plan that was found with the policy of a moment is kept: the policy of a later moment would find another.
    let search = Chase { is_broken: false, searches: true };
    let searched = trained_against(&search, &options, 400, false);
    assert!(searched != whole, "the search changes nothing");
    assert!(searched == trained_against(&search, &options, 130, true), "resuming changes the attacks");
    // An attack that several episodes meet is planned again from the checkpoint.
    let renewed = TrainingOptions { renew_attack_after: 3, ..options.clone() };
    let seldom = trained(&renewed, 400, false);
    assert!(seldom != whole, "fewer attacks change nothing");
    assert!(seldom == trained(&renewed, 130, true), "resuming changes which attack is met");
    let searched = trained_against(&search, &renewed, 400, false);
    assert!(searched == trained_against(&search, &renewed, 130, true), "resuming changes the found attacks");
}

/// A training by PPO of a second.
fn small_ppo() -> TrainingOptions {
    let ppo = PpoOptions {
        hidden: [16, 16],
        environments: 6,
        horizon: 10,
        minibatch: 30,
        kept: 0.3,
        taught: 0.0,
        ..PpoOptions::default()
    };
    TrainingOptions {
        algorithm: Algorithm::Ppo,
        ppo,
        ppo_steps: 1500,
        evaluations: 3,
        ..TrainingOptions::default()
    }
}

/// Mean completion after a short training, for a share of it with a teacher.
fn completion_taught(taught: f64) -> f64 {
    let (training, evaluation) = (scenes(12, 0), scenes(6, 1));
    let parts = Parts::of("constant", "uniform");
    let ppo = PpoOptions { environments: 16, minibatch: 128, kept: 0.6, taught, ..PpoOptions::default() };
    let options = TrainingOptions {
        ppo,
        ppo_steps: 20_000,
        goes_on: true,
        mirrored: 0.5,
        evaluations: 1,
        ..small_ppo()
    };
    let state = TrainingState::new(&options, training.len()).expect("valid options");
    let mut run = Training::new(options, parts.setting(&training, &evaluation), state);
    run.advance(u64::MAX, |_| ()).expect("nothing breaks");
    let rows = &run.state().evaluations()[0].unchanged;
    rows.iter().map(|row| row.completion).sum::<f64>() / rows.len() as f64
}

#[test]
fn who_is_taught_drives_sooner() {
    let [alone, taught] = [0.0, 1.0].map(completion_taught);
    println!("completion {alone:.2} alone, {taught:.2} taught");
    assert!(taught > 0.9 && taught > alone, "{alone} alone, {taught} taught");
}

/// What a test breaks.
#[derive(Clone, Copy, PartialEq)]
enum Broken {
    Nothing,
    Generator,
    Reward,
    Weight,
    Observation,
}

/// Runs until the training stops; says why it stopped.
fn stopped(options: &TrainingOptions, broken: Broken) -> String {
    let training = scenes(6, 0);
    let parts = Parts::of("constant", "uniform");
    let chase = Chase { is_broken: broken == Broken::Generator, searches: false };
    let setting = Setting { attacker: Some(&chase), ..parts.setting(&training, &[]) };
    let mut state = TrainingState::new(options, training.len()).expect("valid options");
    if broken == Broken::Weight {
        state.break_weight("actor.l2.weight");
    }
    let mut rules = options.rules();
    if broken == Broken::Reward {
        rules.rewards.out_of_road = f64::NAN;
    }
    let mut run = Training::new(options.clone(), setting, state).with_rules(rules);
    if broken == Broken::Observation {
        run = run.with_observation(|environment, out| {
            environment.observe(out);
            if environment.world().step_count() == 30 {
                out[47] = f32::NAN;
            }
        });
    }
    let stop = run.advance(u64::MAX, |_| ()).expect_err("a run that breaks");
    assert!(run.state().learner().is_finite(), "something broken is in the buffer");
    stop.to_string()
}

#[test]
fn what_is_not_a_number_stops_the_run_by_scene_step_and_tensor() {
    for (broken, what) in [
        (Broken::Generator, "chase"),
        (Broken::Reward, "reward is not a number"),
        (Broken::Weight, " of the training: tensor `actor.l2.weight` is not a number"),
        (Broken::Observation, "number 47 of the observation is not a number"),
    ] {
        for options in [small(), small_ppo()] {
            let stop = stopped(&options, broken);
            assert!(stop.contains("scene `") && stop.contains(" step ") && stop.contains(what), "{stop}");
        }
    }
}

#[test]
fn divergence_stops_the_run() {
    let td3 = Td3Options { hidden: [256, 256], actor_rate: 1.0, critic_rate: 1.0, ..small().td3 };
    let stop = stopped(&TrainingOptions { td3, updates: 1000, ..small() }, Broken::Nothing);
    assert!(stop.contains("diverges"), "{stop}");
    let ppo = PpoOptions { rate: 1e6, ..small_ppo().ppo };
    let stop = stopped(&TrainingOptions { ppo, ..small_ppo() }, Broken::Nothing);
    assert!(stop.contains("diverges") || stop.contains("is not finite"), "{stop}");
}

#[test]
fn options_out_of_range_are_named() {
    let problem = |options: TrainingOptions| options.check().expect_err("out of range").to_string();
    assert_snapshot!(problem(TrainingOptions { ratio: 0.0, ..small() }), @"`ratio` is 0; expected a number from 1/64 to 64");
    assert_snapshot!(problem(TrainingOptions { updates: 10, ..small() }), @"10 updates at a ratio of 0.5 are 20 steps, fewer than the 200 random steps at the start; give more updates or fewer random steps");
    assert_snapshot!(problem(TrainingOptions { evaluations: 0, ..small() }), @"`evaluations` is 0; expected a number from 1 to 1000");
    let td3 = Td3Options { gamma: 1.5, ..Td3Options::default() };
    assert_snapshot!(problem(TrainingOptions { td3, ..small() }), @"`gamma` is 1.5; expected a number from 0 to 1");
}
