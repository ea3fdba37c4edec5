//! Laws of a batch: the same bits at any number of threads, those of environments on their own, and three kinds of automatic
//! resets.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

#[path = "../../sage-sim/tests/chase/mod.rs"]
mod chase;
#[path = "../../sage-sim/tests/hand_made/mod.rs"]
mod hand_made;

use std::sync::Arc;

use chase::Chase;
use hand_made::prepared;
use insta::assert_snapshot;
use sage_core::seed::Rng;
use sage_data::procedural::{Kind, generate};
use sage_learn::curricula::curricula;
use sage_sim::{
    SimScene,
    batch::{
        Adversary, AutoReset, Batch, BatchOptions, BatchOutput, Reset, SceneOrder, SceneSource, Setting,
    },
    environment::EnvironmentOptions,
    observation::LENGTH,
};

/// Steps of the episodes: short, so that many end.
const STEPS: usize = 25;

fn scenes() -> Vec<Arc<SimScene>> {
    Kind::ALL.iter().filter_map(|kind| generate(*kind, 1, 0)).map(prepared).collect()
}

fn setting(curriculum: Option<&str>, order: SceneOrder) -> Setting {
    let adversary = curriculum.map(|name| {
        let curriculum = curricula().unwrap().build_default(name).unwrap();
        Adversary::new(Arc::new(Chase { is_broken: false, searches: false }), curriculum.into(), true, 1000)
    });
    let rules = EnvironmentOptions { max_steps: STEPS, ..EnvironmentOptions::training() };
    Setting { scenes: Arc::new(scenes()), order, rules: Arc::new(rules), adversary }
}

fn options(count: usize, auto_reset: AutoReset) -> BatchOptions {
    BatchOptions { count, auto_reset, share_experience: false, parallel: false }
}

fn action(seed: u64, step: usize, number: usize) -> [f32; 2] {
    let mut rng = Rng::new(seed + number as u64, &step.to_string(), "batch");
    [rng.uniform(-1.0, 1.0) as f32, rng.uniform(-0.5, 1.0) as f32]
}

/// Bits of all that a step gives of one environment.
fn bits(out: &BatchOutput, k: usize) -> (Vec<u32>, String) {
    let observation = out.observations[k * LENGTH..(k + 1) * LENGTH].iter().map(|x| x.to_bits()).collect();
    let rest = (out.rewards[k].to_bits(), out.terminated[k], out.truncated[k], out.rows[k]);
    (observation, format!("{rest:?}"))
}

#[test]
fn the_same_seeds_give_the_same_bits_at_any_number_of_threads() {
    for (curriculum, shared) in [(None, false), (Some("adaptive"), true), (Some("paper"), false)] {
        let run = |threads: usize, seed: u64| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let options = BatchOptions {
                share_experience: shared,
                parallel: threads > 1,
                ..options(13, AutoReset::SameStep)
            };
            let mut batch = Batch::new(setting(curriculum, SceneOrder::Random), options).unwrap();
            let (mut out, mut all) = (BatchOutput::default(), Vec::new());
            pool.install(|| batch.reset_all(seed, &mut out)).unwrap();
            for step in 0..4 * STEPS {
                let actions: Vec<_> = (0..batch.len()).map(|k| action(seed, step, k)).collect();
                pool.install(|| batch.step(&actions, &mut out)).unwrap();
                all.push((0..batch.len()).map(|k| bits(&out, k)).collect::<Vec<_>>());
            }
            assert_eq!(batch.take_notes(), []);
            all
        };
        let first = run(1, 5);
        assert!(first == run(2, 5) && first == run(5, 5));
        assert!(first != run(1, 6), "another seed gives other scenes");
    }
}

#[test]
fn an_environment_of_a_batch_does_what_one_on_its_own_does() {
    for curriculum in [None, Some("constant"), Some("adaptive")] {
        let mut batch =
            Batch::new(setting(curriculum, SceneOrder::Random), options(4, AutoReset::SameStep)).unwrap();
        let mut late =
            Batch::new(setting(curriculum, SceneOrder::Random), options(4, AutoReset::NextStep)).unwrap();
        let mut alone: Vec<_> = (0..4)
            .map(|_| {
                let mut setting = setting(curriculum, SceneOrder::Random);
                setting.adversary = setting.adversary.map(|adversary| {
                    Adversary::new(
                        adversary.attacker.clone(),
                        adversary.curriculum.clone(),
                        true,
                        adversary.total_steps / 4,
                    )
                });
                Batch::new(setting, options(1, AutoReset::Off)).unwrap()
            })
            .collect();
        let (mut out, mut out_late, mut own) =
            (BatchOutput::default(), BatchOutput::default(), BatchOutput::default());
        batch.reset_all(9, &mut out).unwrap();
        late.reset_all(9, &mut out_late).unwrap();
        // What each environment gives, resets among them.
        let mut expected: Vec<Vec<_>> = vec![Vec::new(); 4];
        for (k, single) in alone.iter_mut().enumerate() {
            single.reset_all(9 + k as u64, &mut own).unwrap();
            assert_eq!(bits(&out, k), bits(&own, 0));
        }
        let mut found: Vec<Vec<_>> = vec![Vec::new(); 4];
        let mut ended = 0;
        for step in 0..4 * STEPS {
            let actions: Vec<_> = (0..4).map(|k| action(1, step, k)).collect();
            batch.step(&actions, &mut out).unwrap();
            for (k, single) in alone.iter_mut().enumerate() {
                single.step(&[actions[k]], &mut own).unwrap();
                expected[k].push((bits(&own, 0), actions[k]));
                assert_eq!((own.rewards[0], own.truncated[0]), (out.rewards[k], out.truncated[k]));
                if let [0] = single.need_reset()[..] {
                    ended += 1;
                    let last = out.last[k].as_ref().unwrap();
                    assert_eq!((last.row, &last.observation[..]), (own.rows[0], &own.observations[..]));
                    single.reset(&[Reset { number: 0, seed: None, scene: None }], &mut own).unwrap();
                    expected[k].push((bits(&own, 0), [0.0; 2]));
                } else {
                    assert!(out.last.get(k).is_none_or(Option::is_none));
                }
                let seen = &out.observations[k * LENGTH..(k + 1) * LENGTH];
                assert_eq!((seen, out.rows[k]), (&own.observations[..], own.rows[0]));
            }
        }
        assert!(ended > 12, "{ended}");
        // With the reset in a step of its own the same rows come, one after another.
        for step in 0.. {
            let actions: Vec<_> =
                (0..4).map(|k| expected[k].get(step).map_or([0.0; 2], |row| row.1)).collect();
            if (0..4).all(|k| step >= expected[k].len()) {
                break;
            }
            late.step(&actions, &mut out_late).unwrap();
            (0..4).for_each(|k| found[k].push(bits(&out_late, k)));
        }
        for k in 0..4 {
            let rows = expected[k].iter().map(|row| &row.0);
            assert!(rows.eq(found[k].iter().take(expected[k].len())), "environment {k}");
        }
    }
}

#[test]
fn a_roll_out_gives_the_rows_of_its_steps() {
    for auto in [AutoReset::SameStep, AutoReset::NextStep] {
        let new = || Batch::new(setting(Some("constant"), SceneOrder::Random), options(3, auto)).unwrap();
        let (mut stepped, mut rolled) = (new(), new());
        let (mut out, mut all) = (BatchOutput::default(), BatchOutput::default());
        stepped.reset_all(2, &mut out).unwrap();
        rolled.reset_all(2, &mut all).unwrap();
        let steps = 3 * STEPS;
        let actions: Vec<_> = (0..3).flat_map(|k| (0..steps).map(move |step| action(7, step, k))).collect();
        rolled.roll_out(steps, &actions, &mut all).unwrap();
        for step in 0..steps {
            let now: Vec<_> = (0..3).map(|k| actions[k * steps + step]).collect();
            stepped.step(&now, &mut out).unwrap();
            for k in 0..3 {
                assert_eq!(bits(&out, k), bits(&all, k * steps + step));
                let [one, other] = [(&out, k), (&all, k * steps + step)]
                    .map(|(out, k)| out.last.get(k).and_then(|last| last.as_ref().map(|last| last.row)));
                assert_eq!(one, other);
            }
        }
    }
}

#[test]
fn scenes_in_sequence_are_shared_out_among_workers() {
    let order = SceneOrder::Sequential { first: 1, workers: 3 };
    let mut batch = Batch::new(setting(None, order), options(2, AutoReset::Off)).unwrap();
    let mut out = BatchOutput::default();
    batch.reset_all(0, &mut out).unwrap();
    let mut seen = vec![[out.rows[0].scene, out.rows[1].scene]];
    for _ in 0..3 {
        let resets: Vec<_> = (0..2).map(|number| Reset { number, seed: None, scene: None }).collect();
        batch.reset(&resets, &mut out).unwrap();
        seen.push([out.rows[0].scene, out.rows[1].scene]);
    }
    assert_eq!(seen, [[1, 2], [4, 5], [1, 2], [4, 5]]);
}

#[test]
fn wrong_calls_are_refused_before_any_step() {
    let new = |auto| Batch::new(setting(None, SceneOrder::Random), options(2, auto)).unwrap();
    let mut batch = new(AutoReset::Off);
    let mut out = BatchOutput::default();
    let still = [[0.0, 0.0]; 2];
    assert_snapshot!(batch.step(&still, &mut out).unwrap_err(), @"environment 0 was never reset; reset it before its first step");
    batch.reset_all(1, &mut out).unwrap();
    assert_snapshot!(batch.step(&still[..1], &mut out).unwrap_err(), @"there are 1 actions; expected 2, a pair of numbers each");
    assert_snapshot!(batch.step(&[[0.0, 0.0], [0.0, f32::NAN]], &mut out).unwrap_err(), @"the action of environment 1 is [0.0, NaN]; expected finite numbers");
    assert_snapshot!(batch.roll_out(1, &still, &mut out).unwrap_err(), @"a roll-out needs an automatic reset, and an adversary that knows each environment alone");
    for _ in 0..STEPS {
        batch.step(&still, &mut out).unwrap();
    }
    assert!(out.truncated.iter().all(|cut| *cut));
    assert_snapshot!(batch.step(&still, &mut out).unwrap_err(), @"the episode of environment 0 is over; reset it before its next step");
    let to = |number, scene| Reset { number, seed: None, scene: Some(scene) };
    batch.reset(&[to(0, 4), to(1, 4)], &mut out).unwrap();
    batch.step(&still, &mut out).unwrap();
    assert_eq!(out.rows.iter().map(|row| (row.scene, row.steps)).collect::<Vec<_>>(), [(4, 1), (4, 1)]);
    assert_snapshot!(batch.reset(&[to(0, 99)], &mut out).unwrap_err(), @"environment 0 in scene 99 cannot be reset; there are 2 environments and 7 scenes, numbered from 0");
    assert!(batch.reset(&[to(2, 0)], &mut out).is_err());
    let none = Setting { scenes: Arc::new(Vec::<Arc<SimScene>>::new()), ..setting(None, SceneOrder::Random) };
    assert_snapshot!(Batch::new(none, options(1, AutoReset::Off)).err().unwrap(), @"there are no scenes; give at least one");
    assert!(Batch::new(setting(None, SceneOrder::Random), options(0, AutoReset::Off)).is_err());
}

/// Scenes of which every second one cannot be used.
struct Broken(Vec<Arc<SimScene>>);

impl SceneSource for Broken {
    fn count(&self) -> usize {
        self.0.len()
    }

    fn scene(&self, number: usize) -> Result<Arc<SimScene>, sage_sim::Error> {
        let problem = "is damaged".to_owned();
        match number % 2 {
            0 => Ok(self.0[number].clone()),
            _ => Err(sage_sim::Error::Scene { scene: format!("number {number}"), problem }),
        }
    }
}

#[test]
fn scenes_that_cannot_be_used_or_attacked_are_noted() {
    let broken = Setting { scenes: Arc::new(Broken(scenes())), ..setting(None, SceneOrder::Random) };
    let mut batch = Batch::new(broken, options(8, AutoReset::SameStep)).unwrap();
    let mut out = BatchOutput::default();
    batch.reset_all(0, &mut out).unwrap();
    assert!(out.rows.iter().all(|row| row.scene % 2 == 0));
    let notes = batch.take_notes();
    assert!(!notes.is_empty() && notes.iter().all(|note| note.problem.contains("is damaged")), "{notes:?}");
    let only = Reset { number: 0, seed: None, scene: Some(1) };
    assert_snapshot!(batch.reset(&[only], &mut out).unwrap_err(), @"scene `number 1`: is damaged");

    let mut attacked = setting(Some("constant"), SceneOrder::Random);
    let curriculum = curricula().unwrap().build_default("constant").unwrap();
    attacked.adversary = Some(Adversary::new(
        Arc::new(Chase { is_broken: true, searches: false }),
        curriculum.into(),
        true,
        1000,
    ));
    let mut batch = Batch::new(attacked, options(8, AutoReset::Off)).unwrap();
    batch.reset_all(0, &mut out).unwrap();
    assert!(out.rows.iter().all(|row| row.intensity.is_none()));
    assert!(batch.take_notes()[0].problem.ends_with("the episode has no attack"));
}
