//! Compares a search's refinement with two known optimisers that spend the same drives: the cross-entropy method and NSGA-II, both
//! over the six numbers of a deformation.
//!
//! ```sh
//! cargo run --release -p experiments --example evolution_by_drives -- idm waymo target/data/womd_cat500/dev > table.md
//! ```
//!
//! All drive against 48 plans of the pool first. In a scene without a failure so far each has 16 drives more: `refined` as in
//! `sage search`, the two others from the drive that met the most clauses or came nearest. Their fitness is that of a real drive:
//! twelve for each clause that it meets, and the paper's reward. NSGA-II also asks for a small deformation. What no car can drive
//! is drawn again and costs no drive.

#![allow(clippy::print_stdout, clippy::print_stderr)] // The program prints its table and its progress.

use std::{path::Path, sync::Arc};

use advsage::{DriverInScene, Ego, NamedSearch, Recording, Registries, SearchOptions, SearchSpec};
use anyhow::{Context as _, Result};
use rayon::prelude::*;
use sage_core::{
    deformation::Deformable, generator::Proposal, objective::is_within_limits, seed::Rng, statistics::wilson,
};
use sage_sim::search::{Clause, Evaluated, PlanDrives, Pool, SearchResult};

const BUDGET: usize = 64;
/// Drives of a generation, and generations after the 48 drives.
const GENERATION: usize = 8;
/// Best of a generation from which the cross-entropy method draws the next.
const ELITE: usize = 3;
/// As in `sage_core::deformation`.
const SCALES: [f64; 6] = [5.0, 7.5, 1.75, 3.75, 1.0, 1.25];
/// Standard deviation of the first generation, in scales.
const FIRST: f64 = 0.5;
/// Draws for a plan that a car can drive.
const DRAWS: usize = 50;

type Numbers = [f64; 6];

/// How good a drive is.
fn fitness(driven: &Evaluated) -> f64 {
    let met = Clause::ALL.into_iter().filter(|clause| driven.clauses.reach(*clause)).count();
    12.0 * met as f64 + driven.reward
}

fn is_failure(driven: &Evaluated) -> bool {
    Clause::ALL.into_iter().all(|clause| driven.clauses.holds(clause))
}

/// Deformations of one plan, driven against.
struct Deformations<'s> {
    driven: &'s DriverInScene<'s>,
    drives: PlanDrives<'s>,
    plan: Deformable,
    rng: Rng,
    found: bool,
}

impl Deformations<'_> {
    /// Drives against the first plan of some draws that a car can drive; `None` if there is none.
    fn drive(&mut self, mut draw: impl FnMut(&mut Rng) -> Numbers) -> Result<Option<(Numbers, f64)>> {
        for _ in 0..DRAWS {
            let z = draw(&mut self.rng);
            let Ok(trajectory) = self.plan.deformed(&z) else { continue };
            if !is_within_limits(self.driven.ctx.candidate(trajectory.clone()).profile()) {
                continue;
            }
            let Some(evaluated) = self.drives.evaluate(0, &Proposal::of(trajectory))? else { continue };
            self.found |= is_failure(&evaluated);
            return Ok(Some((z, fitness(&evaluated))));
        }
        Ok(None)
    }

    /// The cross-entropy method: each generation is drawn from the mean and the spread of the best of the one before.
    fn cross_entropy(mut self) -> Result<bool> {
        let (mut mean, mut spread) = ([0.0; 6], SCALES.map(|scale| FIRST * scale));
        for _ in 0..2 {
            let mut all = Vec::new();
            for _ in 0..GENERATION {
                let draw = |rng: &mut Rng| std::array::from_fn(|k| mean[k] + spread[k] * rng.normal());
                all.extend(self.drive(draw)?);
            }
            all.sort_by(|a, b| b.1.total_cmp(&a.1));
            all.truncate(ELITE);
            if all.is_empty() {
                break;
            }
            let n = all.len() as f64;
            mean = std::array::from_fn(|k| all.iter().map(|(z, _)| z[k]).sum::<f64>() / n);
            spread = std::array::from_fn(|k| {
                let variance = all.iter().map(|(z, _)| (z[k] - mean[k]).powi(2)).sum::<f64>() / n;
                variance.sqrt().max(0.1 * SCALES[k])
            });
        }
        Ok(self.found)
    }

    /// NSGA-II (Deb and others, 2002): fitness, and little deformation. A generation of parents and one of children.
    fn nsga2(mut self) -> Result<bool> {
        let first = |rng: &mut Rng| SCALES.map(|scale| FIRST * scale * rng.normal());
        let mut parents = Vec::new();
        for _ in 0..GENERATION {
            parents.extend(self.drive(first)?);
        }
        if parents.is_empty() {
            return Ok(self.found);
        }
        let ranks = ranks(&parents);
        for _ in 0..GENERATION {
            let child = |rng: &mut Rng| {
                let mut chosen = || {
                    let [a, b] = [rng.below(parents.len()), rng.below(parents.len())];
                    if ranks[a] <= ranks[b] { a } else { b }
                };
                let [a, b] = [chosen(), chosen()].map(|k| parents[k].0);
                std::array::from_fn(|k| crossed(a[k], b[k], SCALES[k], rng))
            };
            self.drive(child)?;
        }
        Ok(self.found)
    }
}

/// Simulated binary crossover (index 15) and a polynomial mutation of one number in six (index 20).
fn crossed(a: f64, b: f64, scale: f64, rng: &mut Rng) -> f64 {
    let u = rng.unit();
    let beta = if u <= 0.5 { (2.0 * u).powf(1.0 / 16.0) } else { (2.0 - 2.0 * u).powf(-1.0 / 16.0) };
    let mut child = 0.5 * ((1.0 + beta) * a + (1.0 - beta) * b);
    if rng.unit() < 1.0 / 6.0 {
        let u = rng.unit();
        let delta =
            if u < 0.5 { (2.0 * u).powf(1.0 / 21.0) - 1.0 } else { 1.0 - (2.0 - 2.0 * u).powf(1.0 / 21.0) };
        child += 4.0 * scale * delta;
    }
    child
}

/// Number of others that dominate each: at least as good in both, and better in one.
fn ranks(all: &[(Numbers, f64)]) -> Vec<usize> {
    let size = |z: &Numbers| z.iter().zip(SCALES).map(|(z, scale)| (z / scale).powi(2)).sum::<f64>();
    let values: Vec<[f64; 2]> = all.iter().map(|(z, fitness)| [*fitness, -size(z)]).collect();
    let dominates = |a: &[f64; 2], b: &[f64; 2]| a[0] >= b[0] && a[1] >= b[1] && a != b;
    values.iter().map(|own| values.iter().filter(|other| dominates(other, own)).count()).collect()
}

/// Whether each method finds a failure: the pool, refined, cross-entropy, NSGA-II.
fn scene(file: &Path, ego: &Ego, search: &NamedSearch) -> Result<[bool; 4]> {
    let scene = Arc::new(Recording::read(file)?.scene);
    let driven = DriverInScene::of(&scene, ego, 0)?;
    let whole = SearchOptions { budget: BUDGET, ..SearchOptions::default() };
    let pool_drives = BUDGET - 2 * GENERATION;
    let searched =
        |options: &SearchOptions| -> Result<(Pool, SearchResult)> { Ok(search.search(&driven, options, 0)?) };
    let (pool, before) = searched(&SearchOptions { budget: pool_drives, refine: 0.0, ..whole })?;
    if !before.failures.is_empty() {
        return Ok([true; 4]);
    }
    let more = !searched(&SearchOptions { refine: 0.0, ..whole })?.1.failures.is_empty();
    let refined = !searched(&whole)?.1.failures.is_empty();
    let drives = before.driven.iter().filter(|evaluated| evaluated.error.is_none());
    let Some(best) = drives.reduce(|a, b| if fitness(b) > fitness(a) { b } else { a }) else {
        return Ok([more, refined, false, false]);
    };
    let candidate = &pool.plans[best.plan].candidate;
    let rule = search.rule.objective.rule();
    let deformations = |purpose: &str| -> Result<Deformations> {
        Ok(Deformations {
            driven: &driven,
            drives: PlanDrives::new(&driven.test, &driven.ctx, rule, &whole)?,
            plan: Deformable::new(candidate.trajectory(), candidate.start()),
            rng: Rng::new(0, &scene.id, purpose),
            found: false,
        })
    };
    let cross_entropy = deformations("cross-entropy")?.cross_entropy()?;
    let nsga2 = deformations("nsga2")?.nsga2()?;
    Ok([more, refined, cross_entropy, nsga2])
}

/// A 95 % interval of a mean, by resampling.
fn interval(values: &[f64]) -> [f64; 2] {
    const SAMPLES: usize = 2000;
    let mut rng = Rng::new(0, "table", "bootstrap");
    let mut mean =
        || (0..values.len()).map(|_| values[rng.below(values.len())]).sum::<f64>() / values.len() as f64;
    let mut means: Vec<f64> = (0..SAMPLES).map(|_| mean()).collect();
    means.sort_by(f64::total_cmp);
    [means[SAMPLES / 40], means[SAMPLES - 1 - SAMPLES / 40]]
}

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [ego, weights, folders @ ..] = &arguments[..] else {
        anyhow::bail!("give a driver, weights, and folders of scenes");
    };
    let registries = Registries::shipped()?;
    let ego = Ego::named(ego, &registries)?;
    let mut spec = SearchSpec::default();
    spec.generator.weights = Some(weights.clone());
    let search = spec.build(&registries)?;
    let mut files = Vec::new();
    for folder in folders {
        for entry in std::fs::read_dir(folder).with_context(|| folder.clone())? {
            files.push(entry?.path());
        }
    }
    files.sort();
    let found: Vec<Option<[bool; 4]>> = files
        .par_iter()
        .map(|file| {
            let found = scene(file, &ego, &search);
            found.map_err(|error| eprintln!("{}: {error:#}", file.display())).ok()
        })
        .collect();
    let found: Vec<[bool; 4]> = found.into_iter().flatten().collect();
    println!(
        "| `{}`, {} drives, N = {} | scenes with a failure, % | less the pool, points |",
        ego.label,
        BUDGET,
        found.len()
    );
    println!("| --- | --- | --- |");
    for (k, name) in ["pool alone", "refined", "cross-entropy", "NSGA-II"].iter().enumerate() {
        let count = found.iter().filter(|found| found[k]).count();
        let share_of = wilson(count, found.len()).context("no scene")?;
        let [low, high] = [share_of.low, share_of.high].map(|x| 100.0 * x);
        let share = |is: bool| f64::from(u8::from(is));
        let differences: Vec<f64> =
            found.iter().map(|found| 100.0 * (share(found[k]) - share(found[0]))).collect();
        let mean = differences.iter().sum::<f64>() / differences.len() as f64;
        let [from, to] = interval(&differences);
        println!(
            "| {name} | {:.1} [{low:.1}, {high:.1}] | {mean:+.1} [{from:.1}, {to:.1}] |",
            100.0 * count as f64 / found.len() as f64
        );
    }
    Ok(())
}
