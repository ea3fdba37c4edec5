//! How near the choices from a coarser view come to those from the full one, and in which time.
//!
//! ```sh
//! RAYON_NUM_THREADS=1 CANDLE_NUM_THREADS=1 cargo run --release -p experiments --example views -- \
//!     weights/waymo target/data/womd_cat500/dev '{}' '{"near": 1e9}' > views.md
//! ```
//!
//! The views are `sage_backbones::subsampling::Subsampling` as JSON. Times are ratios to the full view, taken in
//! turn with it; the rest is read at λ = μ = 0, 0.5 and 1 with the natural choice.

#![allow(clippy::print_stdout, clippy::print_stderr)] // A program of its own: its table, its progress.

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
    GeneratorInputs, ProposerKind,
    proposers::MixedExperts,
    select::{Best, Selector},
};
use sage_merging::{ExpertSet, mergers};

/// As in the program.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

const PLACES: [f64; 3] = [0.0, 0.5, 1.0];
/// Trajectories are the same if they are never farther apart, metres.
const SAME: f64 = 0.5;
/// Each attack is timed so often, and the least time taken.
const TURNS: usize = 3;

fn main() -> Result<()> {
    run(&std::env::args().skip(1).collect::<Vec<_>>())
}

/// What a view gave in one scene at one place of the dial.
struct Seen {
    chosen: Trajectory,
    hits: bool,
    reward: f64,
    milliseconds: f64,
}

fn run(args: &[String]) -> Result<()> {
    let [weights, scenes, views @ ..] = args else { anyhow::bail!("expected WEIGHTS SCENES VIEW …") };
    let mut all = vec![Subsampling::NONE];
    for view in views {
        let view: Subsampling = serde_json::from_str(view).with_context(|| format!("view `{view}`"))?;
        all.push(view.check()?);
    }
    let (experts, _) = ExpertSet::load(&Weights::at(Path::new(weights)), &backbones()?)?;
    let natural = ObjectiveSpec::preset("natural").context("it is shipped")?;
    let inputs = GeneratorInputs {
        experts: Some(experts),
        merger: mergers()?.build_default("linear")?.into(),
        seed: 0,
        selection: Arc::new(Objective::new(&natural, &rewards()?, &feasibilities()?)?),
    };
    let proposers = all.iter().map(|view| proposer(&inputs, *view)).collect::<Result<Vec<_>>>()?;
    let files = folder::scene_files(scenes.as_ref())?;
    let mut seen: Vec<Vec<Vec<Seen>>> = Vec::new();
    for (k, file) in files.iter().enumerate() {
        eprint!("\r{} of {}", k + 1, files.len());
        seen.push(in_scene(file, &inputs, &proposers).with_context(|| format!("`{}`", file.display()))?);
    }
    eprintln!();
    println!("| view | time | same choice | mean distance m | R_adv − full | attack |");
    println!("| --- | --- | --- | --- | --- | --- |");
    for (k, view) in all.iter().enumerate() {
        let over = |of: &dyn Fn(&Seen, &Seen) -> f64| -> Vec<f64> {
            let mean = |place: usize| {
                let values = seen.iter().map(|scene| of(&scene[k][place], &scene[0][place]));
                values.sum::<f64>() / seen.len() as f64
            };
            (0..PLACES.len()).map(mean).collect()
        };
        let times: Vec<f64> =
            seen.iter().map(|scene| scene[k][2].milliseconds / scene[0][2].milliseconds).collect();
        let digits =
            |values: Vec<f64>| values.iter().map(|x| format!("{x:.3}")).collect::<Vec<_>>().join(" / ");
        println!(
            "| {} | {:.2} ({:.2} ms) | {} | {} | {} | {} |",
            serde_json::to_string(view)?,
            median(&times).unwrap_or(f64::NAN),
            median(&seen.iter().map(|scene| scene[k][2].milliseconds).collect::<Vec<_>>())
                .unwrap_or(f64::NAN),
            digits(over(&|a, full| f64::from(u8::from(most_apart(&a.chosen, &full.chosen) <= SAME)))),
            digits(over(&|a, full| mean_distance(&a.chosen, &full.chosen))),
            digits(over(&|a, full| a.reward - full.reward)),
            digits(over(&|a, _| f64::from(u8::from(a.hits)))),
        );
    }
    Ok(())
}

/// A view's proposer.
fn proposer(inputs: &GeneratorInputs, view: Subsampling) -> Result<Box<dyn Proposer>> {
    let options = serde_json::from_value::<MixedExperts>(serde_json::json!({"view": view}))?;
    Ok(options.build(inputs)?)
}

/// What each view gives at each place.
fn in_scene(file: &Path, inputs: &GeneratorInputs, views: &[Box<dyn Proposer>]) -> Result<Vec<Vec<Seen>>> {
    let scene = Arc::new(Recording::read(file)?.scene);
    let index = SceneIndex::new(scene.map.clone());
    index.build_all();
    let ctx = Context::new(&scene, &index, &ContextOptions::default())?;
    let now = Observation::of(&scene, &index)?;
    let best = Best::new(inputs.selection.clone());
    let propose = |view: &dyn Proposer, lambda: f64| -> Result<(Vec<Proposal>, usize)> {
        let proposals = view.prepare(&now)?.propose(&Mixture::between(lambda), 0)?;
        let chosen = best.select(&proposals, &ctx, lambda)?.chosen;
        Ok((proposals, chosen))
    };
    let mut least = vec![f64::INFINITY; views.len()];
    for _ in 0..TURNS {
        for (view, least) in views.iter().zip(&mut least) {
            let clock = Instant::now();
            propose(&**view, PLACES[PLACES.len() - 1])?;
            *least = least.min(1e3 * clock.elapsed().as_secs_f64());
        }
    }
    let see = |view: &dyn Proposer, lambda: f64, milliseconds: f64| -> Result<Seen> {
        let (mut proposals, chosen) = propose(view, lambda)?;
        let Proposal { trajectory, nll, .. } = proposals.swap_remove(chosen);
        let candidate = ctx.candidate(trajectory.clone()).with_nll(nll);
        let evaluation = inputs.selection.evaluate(&candidate, &ctx);
        let (hits, reward) = (evaluation.is_attack(), evaluation.adversarial);
        Ok(Seen { chosen: trajectory, hits, reward, milliseconds })
    };
    let of_view =
        |view: &dyn Proposer, least: f64| PLACES.into_iter().map(|lambda| see(view, lambda, least)).collect();
    views.iter().zip(&least).map(|(view, least)| of_view(&**view, *least)).collect()
}

fn distances<'a>(a: &'a Trajectory, b: &'a Trajectory) -> impl Iterator<Item = f64> + 'a {
    a.points().iter().zip(b.points()).map(|(a, b)| distance(*a, *b))
}

fn most_apart(a: &Trajectory, b: &Trajectory) -> f64 {
    distances(a, b).fold(0.0, f64::max)
}

fn mean_distance(a: &Trajectory, b: &Trajectory) -> f64 {
    distances(a, b).sum::<f64>() / a.points().len() as f64
}
