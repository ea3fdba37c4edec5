//! An update of TD3 at the published sizes: ours, and candle's operations with automatic differentiation. Both run on
//! one thread with `RAYON_NUM_THREADS=1`.

#[path = "../tests/td3/reference.rs"]
#[allow(dead_code, reason = "the tests inject faults and read the tensors")]
mod reference;

use criterion::{Criterion, criterion_group, criterion_main};
use reference::Reference;
use sage_core::seed::Rng;
use sage_learn::{Td3Learner, Td3Options, TransitionBatch};
use sage_sim::observation::LENGTH;

fn random_batch(rows: usize) -> TransitionBatch<f32> {
    let mut batch = TransitionBatch::new(rows, LENGTH, 2);
    let mut rng = Rng::new(0, "bench", "batch");
    for numbers in [&mut batch.observations, &mut batch.next_observations, &mut batch.actions] {
        numbers.fill_with(|| rng.unit() as f32);
    }
    for numbers in [&mut batch.rewards, &mut batch.noise] {
        numbers.fill_with(|| rng.normal() as f32);
    }
    batch.not_terminal.fill(1.0);
    batch
}

fn update(c: &mut Criterion) {
    let options = Td3Options::default();
    let mut learner =
        Td3Learner::<f32>::new(options.clone(), [LENGTH, 2], 0).expect("the defaults are in range");
    let mut reference = Reference::of(&learner, None).expect("the learner has all tensors");
    let batch = random_batch(options.batch);
    let mut group = c.benchmark_group("td3 update");
    group.sample_size(20);
    group.bench_function("ours", |b| b.iter(|| learner.update(&batch)));
    group.bench_function("candle", |b| b.iter(|| reference.update(&batch).expect("the shapes fit")));
    group.finish();
}

criterion_group!(benches, update);
criterion_main!(benches);
