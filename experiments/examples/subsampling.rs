//! Compares attacks with map and goal subsampling to attacks without it: selected trajectories and time.
//!
//! ```sh
//! RAYON_NUM_THREADS=1 CANDLE_NUM_THREADS=1 cargo run --release -p experiments --example subsampling -- \
//!     weights/waymo target/data/womd_cat500/dev '{}' '{"dense_goal_radius": 1e9}' > subsampling.md
//! ```
//!
//! Each further argument is a `sage_backbones::subsampling::Subsampling` as JSON. Times are ratios to the
//! time without subsampling, measured alternately. The other columns are at λ = μ = 0, 0.5 and 1 with the
//! selection `natural`.

#![allow(clippy::print_stdout, clippy::print_stderr)] // The program prints its table and its progress.

use std::{path::Path, sync::Arc, time::Instant};

use anyhow::{Context as _, Result};
use sage_backbones::{backbones, subsampling::Subsampling, weights::Weights};
use sage_core::{
    generator::{Mixture, Observation, Proposal, Proposer},
    geometry::distance,
    motion::Trajectory,
    objective::{Context, ContextOptions, Objective, ObjectiveSpec, feasibilities, rewards},
    scene::SceneIndex,
    statistics::median,
};
use sage_data::{Recording, folder};
use sage_generators::{
    GeneratorInputs,
    proposers::{MixedExperts, ProposalOptions},
    selector::{Best, Selector},
};
use sage_merging::{ExpertSet, mergers};

/// As in the program.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

/// Values of λ = μ.
const LAMBDAS: [f64; 3] = [0.0, 0.5, 1.0];
/// Largest distance at which two trajectories count as the same, metres.
const SAME: f64 = 0.5;
/// Number of timed runs of each attack; the shortest counts.
const TURNS: usize = 3;

fn main() -> Result<()> {
    run(&std::env::args().skip(1).collect::<Vec<_>>())
}

/// Result of one subsampling in one scene at one operating point.
struct Selected {
    trajectory: Trajectory,
    hits: bool,
    reward: f64,
    milliseconds: f64,
}

fn run(args: &[String]) -> Result<()> {
    let [weights, scenes, subsamplings @ ..] = args else {
        anyhow::bail!("expected WEIGHTS SCENES SUBSAMPLING …")
    };
    let mut all = vec![Subsampling::NONE];
    for text in subsamplings {
        let subsampling: Subsampling =
            serde_json::from_str(text).with_context(|| format!("subsampling `{text}`"))?;
        all.push(subsampling.check()?);
    }
    let (experts, _) = ExpertSet::load(&Weights::at(Path::new(weights)), &backbones()?)?;
    let natural = ObjectiveSpec::preset("natural").context("it is shipped")?;
    let inputs = GeneratorInputs {
        experts: Some(experts),
        merger: mergers()?.build_default("linear")?.into(),
        seed: 0,
        selection: Arc::new(Objective::new(&natural, &rewards()?, &feasibilities()?)?),
    };
    let proposers =
        all.iter().map(|subsampling| proposer(&inputs, *subsampling)).collect::<Result<Vec<_>>>()?;
    let files = folder::scene_files(scenes.as_ref())?;
    let mut results: Vec<Vec<Vec<Selected>>> = Vec::new();
    for (k, file) in files.iter().enumerate() {
        eprint!("\r{} of {}", k + 1, files.len());
        results.push(in_scene(file, &inputs, &proposers).with_context(|| format!("`{}`", file.display()))?);
    }
    eprintln!();
    println!(
        "| subsampling | time | same selection | mean distance m | R_adv − without subsampling | attack |"
    );
    println!("| --- | --- | --- | --- | --- | --- |");
    for (k, subsampling) in all.iter().enumerate() {
        let over = |of: &dyn Fn(&Selected, &Selected) -> f64| -> Vec<f64> {
            let mean = |point: usize| {
                let values = results.iter().map(|scene| of(&scene[k][point], &scene[0][point]));
                values.sum::<f64>() / results.len() as f64
            };
            (0..LAMBDAS.len()).map(mean).collect()
        };
        let times: Vec<f64> =
            results.iter().map(|scene| scene[k][2].milliseconds / scene[0][2].milliseconds).collect();
        let digits =
            |values: Vec<f64>| values.iter().map(|x| format!("{x:.3}")).collect::<Vec<_>>().join(" / ");
        println!(
            "| {} | {:.2} ({:.2} ms) | {} | {} | {} | {} |",
            serde_json::to_string(subsampling)?,
            median(&times).unwrap_or(f64::NAN),
            median(&results.iter().map(|scene| scene[k][2].milliseconds).collect::<Vec<_>>())
                .unwrap_or(f64::NAN),
            digits(over(&|a, full| f64::from(u8::from(
                largest_distance(&a.trajectory, &full.trajectory) <= SAME
            )))),
            digits(over(&|a, full| mean_distance(&a.trajectory, &full.trajectory))),
            digits(over(&|a, full| a.reward - full.reward)),
            digits(over(&|a, _| f64::from(u8::from(a.hits)))),
        );
    }
    Ok(())
}

/// The proposer with a subsampling.
fn proposer(inputs: &GeneratorInputs, subsampling: Subsampling) -> Result<Box<dyn Proposer>> {
    Ok(MixedExperts(ProposalOptions { subsampling, ..ProposalOptions::default() }).proposer(inputs)?)
}

/// Results of one scene, by proposer and operating point.
fn in_scene(
    file: &Path,
    inputs: &GeneratorInputs,
    proposers: &[Box<dyn Proposer>],
) -> Result<Vec<Vec<Selected>>> {
    let scene = Arc::new(Recording::read(file)?.scene);
    let index = SceneIndex::new(scene.map.clone());
    index.build_all();
    let ctx = Context::new(&scene, &index, &ContextOptions::default())?;
    let now = Observation::of(&scene, &index)?;
    let best = Best::new(inputs.selection.clone());
    let propose = |proposer: &dyn Proposer, lambda: f64| -> Result<(Vec<Proposal>, usize)> {
        let proposals = proposer.prepare(&now)?.propose(&Mixture::between(lambda), 0)?;
        let selected = best.select(&proposals, &ctx, lambda)?.chosen;
        Ok((proposals, selected))
    };
    let mut least = vec![f64::INFINITY; proposers.len()];
    for _ in 0..TURNS {
        for (proposer, least) in proposers.iter().zip(&mut least) {
            let clock = Instant::now();
            propose(&**proposer, LAMBDAS[LAMBDAS.len() - 1])?;
            *least = least.min(1e3 * clock.elapsed().as_secs_f64());
        }
    }
    let select = |proposer: &dyn Proposer, lambda: f64, milliseconds: f64| -> Result<Selected> {
        let (mut proposals, selected) = propose(proposer, lambda)?;
        let Proposal { trajectory, nll, .. } = proposals.swap_remove(selected);
        let candidate = ctx.candidate(trajectory.clone()).with_nll(nll);
        let evaluation = inputs.selection.evaluate(&candidate, &ctx);
        let (hits, reward) = (evaluation.is_attack(), evaluation.adversarial);
        Ok(Selected { trajectory, hits, reward, milliseconds })
    };
    let at_all = |proposer: &dyn Proposer, least: f64| {
        LAMBDAS.into_iter().map(|lambda| select(proposer, lambda, least)).collect()
    };
    proposers.iter().zip(&least).map(|(proposer, least)| at_all(&**proposer, *least)).collect()
}

fn distances<'a>(a: &'a Trajectory, b: &'a Trajectory) -> impl Iterator<Item = f64> + 'a {
    a.points().iter().zip(b.points()).map(|(a, b)| distance(*a, *b))
}

fn largest_distance(a: &Trajectory, b: &Trajectory) -> f64 {
    distances(a, b).fold(0.0, f64::max)
}

fn mean_distance(a: &Trajectory, b: &Trajectory) -> f64 {
    distances(a, b).sum::<f64>() / a.points().len() as f64
}
