//! The fused update of TD3 against the published values of PyTorch and against candle's automatic differentiation.

mod td3;

use std::path::Path;

use sage_core::seed::Rng;
use sage_learn::{Real, Td3Learner, Td3Options, TransitionBatch};
use td3::{
    fixture::Fixture,
    reference::{Mistake, Reference},
};

/// Factors of the targets' weights.
const OTHER_TARGETS: [f64; 2] = [0.5, 3.0];

/// Sizes at which mistakes show within five updates: as in the fixture.
fn small() -> (Td3Options, [usize; 2]) {
    let options = Td3Options {
        hidden: [16, 16],
        batch: 32,
        tau: 0.05,
        actor_rate: 1e-3,
        critic_rate: 2e-3,
        max_action: 1.5,
        ..Td3Options::default()
    };
    (options, [7, 2])
}

fn random_batch<T: Real>(options: &Td3Options, [o, a]: [usize; 2], rng: &mut Rng) -> TransitionBatch<T> {
    let rows = options.batch;
    let mut draw = |n: usize, low: f64, high: f64| -> Vec<T> {
        (0..n).map(|_| T::of(f64::from(rng.uniform(low, high) as f32))).collect()
    };
    let mut batch = TransitionBatch {
        observations: draw(rows * o, 0.0, 1.0),
        actions: draw(rows * a, -options.max_action, options.max_action),
        next_observations: draw(rows * o, 0.0, 1.0),
        rewards: draw(rows, -1.0, 2.0),
        not_terminal: draw(rows, 0.0, 1.0),
        noise: draw(rows * a, -4.0, 4.0),
    };
    for (k, go_on) in batch.not_terminal.iter_mut().enumerate() {
        *go_on = T::of(if k % 7 == 3 { 0.0 } else { 1.0 });
    }
    batch
}

/// Largest difference of any tensor between learner and reference.
fn difference<T: Real>(learner: &Td3Learner<T>, reference: &Reference) -> f64 {
    let ours = learner.tensors();
    let theirs = reference.tensors();
    let mut worst = 0.0_f64;
    for tensor in ours {
        let Some(expected) = theirs.get(&tensor.name) else {
            assert!(tensor.name.starts_with("m.") || tensor.name.starts_with("v."), "{}", tensor.name);
            continue;
        };
        assert_eq!(tensor.numbers.len(), expected.len(), "{}", tensor.name);
        for (x, y) in tensor.numbers.iter().zip(expected) {
            let gap = (x.wide() - y).abs();
            worst = if gap.is_nan() { f64::INFINITY } else { worst.max(gap) };
        }
    }
    worst
}

/// Difference after some updates of the same batches from the same weights.
fn after_updates<T: Real + candle_core::WithDType>(
    options: &Td3Options,
    sizes: [usize; 2],
    updates: usize,
    targets: [f64; 2],
    seed: u64,
    mistake: Option<Mistake>,
) -> f64 {
    let mut learner = Td3Learner::<T>::new(options.clone(), sizes, 5).expect("valid options");
    // Targets that differ from the online networks, by factors in this range, show more mistakes.
    let mut rng = Rng::new(seed, "update", "test");
    let moved = learner.tensors().into_iter().map(|tensor| {
        let mut numbers = tensor.numbers.to_vec();
        if tensor.name.starts_with("target.") {
            numbers.iter_mut().for_each(|x| *x = T::of(x.wide() * rng.uniform(targets[0], targets[1])));
        }
        (tensor.name, numbers)
    });
    let owned = moved.collect();
    learner.set_tensors(&owned, 0).expect("its own tensors");
    let mut reference = Reference::of(&learner, mistake).expect("tensors");
    for _ in 0..updates {
        let batch = random_batch::<T>(options, sizes, &mut rng);
        learner.update(&batch);
        reference.update(&batch).expect("candle");
    }
    difference(&learner, &reference)
}

#[test]
fn the_update_is_that_of_automatic_differentiation() {
    let (options, sizes) = small();
    let wide = after_updates::<f64>(&options, sizes, 5, OTHER_TARGETS, 9, None);
    assert!(wide <= 1e-12, "{wide:e}");
    let narrow = after_updates::<f32>(&options, sizes, 5, OTHER_TARGETS, 9, None);
    assert!(narrow <= 1e-6, "{narrow:e}");
}

#[test]
fn a_hundred_updates_at_full_size_agree() {
    let after = |seed| after_updates::<f64>(&Td3Options::default(), [101, 2], 100, [1.0, 1.0], seed, None);
    let wide = after(14);
    assert!(wide <= 1e-10, "{wide:e}");
    // In single precision, the input of one of 26 million ReLUs now and then rounds to the other side of 0 in one
    // implementation, and from then on they part. It happens in four of five seeds, to either implementation, and
    // depends on the processor; an error in a formula would show in all seeds.
    let after = |seed| after_updates::<f32>(&Td3Options::default(), [101, 2], 100, [1.0, 1.0], seed, None);
    let narrow: Vec<f64> = [14, 19, 12, 9, 13].into_iter().map(after).collect();
    assert!(narrow.iter().any(|gap| *gap <= 1e-5), "{narrow:?}");
    assert!(narrow.iter().all(|gap| *gap <= 0.02), "{narrow:?}");
}

#[test]
fn injected_faults_are_found() {
    let (options, sizes) = small();
    for mistake in Mistake::ALL {
        let gap = after_updates::<f64>(&options, sizes, 5, OTHER_TARGETS, 9, Some(mistake));
        assert!(gap > 1e-6, "{mistake:?} is not found: {gap:e}");
    }
}

#[test]
fn the_update_has_the_published_values() {
    let Some(folder) = std::env::var_os("SAGE_REFERENCE") else {
        println!("SAGE_REFERENCE is not set: the values of PyTorch are left out");
        return;
    };
    let fixture = Fixture::read(&Path::new(&folder).join("fixtures/td3_update.safetensors"));
    let (options, sizes) = small();
    let mut wide = Td3Learner::<f64>::new(options.clone(), sizes, 0).expect("valid options");
    fixture.check("f64", &mut wide, 1e-12);
    let mut narrow = Td3Learner::<f32>::new(options, sizes, 0).expect("valid options");
    fixture.check("f32", &mut narrow, 1e-6);
}
