//! Times TD3's update: batch 256, 101 observations, 2 actions, drawn from 100 000 transitions.
//!
//! `cargo run --release -p sage-sim --example td3_speed -- [UPDATES]`

use std::time::Instant;

use sage_core::seed::Rng;
use sage_sim::rl::{Learner, ReplayBuffer, SingleRow, Td3Options, Transition, TransitionBatch};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let updates: usize = std::env::args().nth(1).map_or(Ok(1000), |n| n.parse())?;
    let options = Td3Options::default();
    let mut learner = Learner::<f32>::new(options.clone(), [101, 2], 0)?;
    let mut rng = Rng::new(0, "speed", "data");
    let mut buffer = ReplayBuffer::new(100_000, [101, 2]);
    let mut observation = || -> Vec<f32> { (0..101).map(|_| rng.unit() as f32).collect() };
    let mut at = buffer.start(&observation());
    for _ in 0..100_000 {
        let next = observation();
        at = buffer.step(&Transition {
            from: at,
            action: &[0.1, -0.2],
            reward: 0.5,
            is_terminal: false,
            next: &next,
        });
    }
    let mut batch = TransitionBatch::new(options.batch, 101, 2);
    let (mut rows, mut noise) = (Rng::new(0, "speed", "batch"), Rng::new(0, "speed", "noise"));
    let mut best = 0.0_f64;
    for _ in 0..5 {
        let start = Instant::now();
        for _ in 0..updates {
            if !buffer.draw(&mut rows, &mut batch) {
                return Err("an empty buffer".into());
            }
            batch.noise.fill_with(|| noise.normal() as f32);
            learner.update(&batch);
        }
        best = best.max(updates as f64 / start.elapsed().as_secs_f64());
    }
    println!("{best:.0} updates/s");
    let (mut memory, mut action) = (SingleRow::default(), [0.0; 2]);
    let start = Instant::now();
    for _ in 0..10_000 {
        learner.act(&batch.observations[..101], &mut memory, &mut action);
    }
    println!("{:.4} ms an action", start.elapsed().as_secs_f64() / 10.0);
    Ok(())
}
