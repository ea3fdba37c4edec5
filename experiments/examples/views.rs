//! How near the choices from a coarser view come to those from the full one, and in which time.
//!
//! ```sh
//! RAYON_NUM_THREADS=1 CANDLE_NUM_THREADS=1 cargo run --release -p experiments --example views -- \
//!     weights/waymo target/data/womd_cat500/dev '{}' '{"near": 1e9}' > views.md
//! ```
//!
//! The views are `sage_backbones::foresight::View` as JSON. Times are ratios to the full view, taken in
//! turn with it; the rest is read at λ = μ = 0, 0.5 and 1 with the natural choice.

#![allow(clippy::print_stdout, clippy::print_stderr)] // A program of its own: its table, its progress.

use std::{path::Path, time::Instant};

use anyhow::{Context as _, Result};
use sage_backbones::{Parameters, backbones, foresight::View};
use sage_core::{
    generator::Generator as _,
    geometry::distance,
    motion::Trajectory,
    objective::{Context, ContextOptions},
    scene::SceneIndex,
    statistics::median,
};
use sage_data::{Recording, folder};
use sage_generators::{Choice, Setting, Steered, SteeredOptions};
use sage_merging::{ExpertFile, Experts, mergers};

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
    let mut all = vec![View::FULL];
    for view in views {
        let view: View = serde_json::from_str(view).with_context(|| format!("view `{view}`"))?;
        all.push(view.check().map_err(anyhow::Error::msg)?);
    }
    let experts = experts(Path::new(weights))?;
    let generators = all.iter().map(|view| steered(&experts, *view)).collect::<Result<Vec<_>>>()?;
    let files = folder::scene_files(scenes.as_ref())?;
    let mut seen: Vec<Vec<Vec<Seen>>> = Vec::new();
    for (k, file) in files.iter().enumerate() {
        eprint!("\r{} of {}", k + 1, files.len());
        seen.push(in_scene(file, &generators).with_context(|| format!("`{}`", file.display()))?);
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

/// The prior with its experts in a folder.
fn experts(weights: &Path) -> Result<Experts> {
    let file = |name: &str| weights.join(format!("{name}.safetensors"));
    let (prior, header) = Parameters::load(&file("prior"))?;
    let network = backbones()?.build(&header.backbone, &header.options)?;
    let prior = network.with_parameters(prior, "the prior")?;
    let [realistic, adversarial] = ["realistic", "adversarial"].map(|name| ExpertFile::load(file(name)));
    Ok(Experts::of_files(prior, realistic?, adversarial?)?)
}

/// A view's generators at the places of the dial.
fn steered(experts: &Experts, view: View) -> Result<Vec<Steered>> {
    let merger = mergers()?.build_default("linear")?;
    let options = SteeredOptions { view, ..SteeredOptions::default() };
    let at = |lambda: f64| {
        let setting = Setting {
            experts,
            merger: &*merger,
            lambda,
            mu: lambda,
            label: "",
            choice: Choice::Natural,
            strict: false,
        };
        options.over(String::new(), setting.mixture()?, &setting)
    };
    PLACES.into_iter().map(at).collect::<Result<_, String>>().map_err(anyhow::Error::msg)
}

/// What each view gives at each place.
fn in_scene(file: &Path, views: &[Vec<Steered>]) -> Result<Vec<Vec<Seen>>> {
    let scene = Recording::read(file)?.scene;
    let index = SceneIndex::new(scene.map.clone());
    index.build_all();
    let ctx = Context::new(&scene, &index, &ContextOptions::default())?;
    let mut least = vec![f64::INFINITY; views.len()];
    for _ in 0..TURNS {
        for (view, least) in views.iter().zip(&mut least) {
            let clock = Instant::now();
            view[PLACES.len() - 1].generate(&ctx, 0)?;
            *least = least.min(1e3 * clock.elapsed().as_secs_f64());
        }
    }
    let see = |generator: &Steered, milliseconds: f64| -> Result<Seen> {
        let (candidates, judged) = generator.propose(&ctx, 0)?;
        let (chosen, _) = generator.judge.choose(&judged);
        let (hits, reward) = (judged[chosen].hits && judged[chosen].is_feasible(), judged[chosen].reward);
        Ok(Seen { chosen: candidates[chosen].trajectory.clone(), hits, reward, milliseconds })
    };
    let of_view = |(view, least): (&Vec<Steered>, &f64)| view.iter().map(|g| see(g, *least)).collect();
    views.iter().zip(&least).map(of_view).collect()
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
