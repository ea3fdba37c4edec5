//! `sage analyse connectivity`: the geometry of the experts, rewards along the path between them and on the plane
//! through them, and the test of weight against output mixing.

use std::{fmt::Write as _, sync::Arc};

use anyhow::{Context as _, Result, bail};
use rayon::prelude::*;
use sage_backbones::{
    Backbone, MotionModel,
    backbone::finite,
    training::{Measures, PreparedScene, SceneData},
};
use sage_core::{
    generator::Mixture,
    motion::{HORIZON, NOW},
    seed::Rng,
    statistics::{self, Estimate},
};
use sage_merging::{ExpertSet, Geometry, Linear, Merger};
use serde_json::json;

use crate::{
    Outcome, Registries,
    bench::{
        connectivity::{Path, VALUES, heights},
        heat_map::{self, Grid},
        line_chart,
        pareto::{Measure, Sweep},
    },
    cli::ConnectivityArgs,
    networks,
    output::{self, Folder},
    progress::{self, Progress},
    scenes::Scenes,
};

/// Steps of λ along the path.
const STEPS: usize = 20;
/// Points of the landscape along each axis, from −0.25 to 1.25.
const LANDSCAPE: usize = 21;
/// λ at which weight mixing is compared with output mixing.
const COMPARED: [f64; 3] = [0.25, 0.5, 0.75];
/// Resamples of an interval.
const RESAMPLES: usize = 2000;

pub(crate) fn run(args: &ConnectivityArgs, registries: &Registries) -> Result<Outcome> {
    let experts = networks::load_experts(&registries.backbones, &args.weights)?;
    if experts.names().len() != 2 {
        bail!(
            "`{}` has {} experts; the plane goes through a prior and two",
            args.weights,
            experts.names().len()
        );
    }
    let out = Folder::make(&args.folder.out, args.folder.force)?;
    let geometry = Geometry::of(&experts)?;
    let scenes = Scenes::of(&args.paths, &args.split, 0, args.seed)?.attackable()?;
    let measures = Measures::of(&[], &registries.rewards, &registries.feasibilities)?;
    let lambdas: Vec<f64> = (0..=STEPS).map(|k| k as f64 / STEPS as f64).collect();
    let along =
        |lambda: &f64| (&Linear as &dyn Merger).merge(&experts, &experts.between(*lambda)?, args.seed);
    let path: Vec<Arc<dyn MotionModel>> = lambdas.iter().map(along).collect::<Result<_, _>>()?;
    let coordinates: Vec<f64> =
        (0..LANDSCAPE).map(|k| -0.25 + 1.5 * k as f64 / (LANDSCAPE - 1) as f64).collect();
    let plane = plane(&experts, &coordinates)?;
    let compared = COMPARED.map(|lambda| along(&lambda));
    let compared = compared.into_iter().collect::<Result<Vec<_>, _>>()?;
    let ends = [along(&0.0)?, along(&1.0)?];
    let one = |data: &SceneData| -> Result<Option<SceneResult>> {
        let Some(prepared) = PreparedScene::new(&**experts.prior(), data, false, &measures)? else {
            return Ok(None);
        };
        let measured = |models: &[Arc<dyn MotionModel>]| -> Result<Vec<Measure>> {
            let one = |model: &Arc<dyn MotionModel>| {
                let e = prepared.expectation(&**model)?;
                Ok(Measure {
                    reward: e.reward,
                    penalty: e.penalty,
                    attack: e.attack,
                    believable: e.believable,
                })
            };
            models.par_iter().map(one).collect()
        };
        let mixing = mixing(data, &**experts.prior(), &prepared, &ends, &compared)?;
        Ok(Some(SceneResult { path: measured(&path)?, plane: measured(&plane)?, mixing }))
    };
    let mut progress = Progress::new("evaluated", scenes.len());
    let results: Vec<SceneResult> = scenes.map(one, || progress.step())?.into_iter().flatten().collect();
    progress.finish(&format!("{} models on {} scenes", path.len() + plane.len(), results.len()));
    let along_path = Sweep { scenes: results.iter().map(|result| result.path.clone()).collect() };
    let landscape = Sweep { scenes: results.iter().map(|result| result.plane.clone()).collect() }.front();
    let mixing: Vec<[f64; 3]> = results.iter().filter_map(|result| result.mixing).collect();
    let markdown = page(&geometry, &experts, &along_path, &mixing)?;
    out.write("connectivity.md", markdown.as_bytes())?;
    out.write("path.csv", path_csv(&geometry, &along_path, &lambdas)?.as_bytes())?;
    out.write("layers.csv", layers_csv(&geometry)?.as_bytes())?;
    out.write("landscape.csv", landscape_csv(&landscape, &coordinates)?.as_bytes())?;
    let line = |(name, value): &(&str, fn(&Measure) -> f64)| {
        let heights = heights(&along_path.front(), *value);
        let points = heights.iter().zip(&lambdas[1..]).map(|(height, lambda)| [*lambda, *height]);
        ((*name).to_owned(), points.collect())
    };
    let lines: Vec<_> = VALUES.iter().map(line).collect();
    out.write("path.svg", line_chart::draw(["lambda", "height above the chord"], &lines)?.as_bytes())?;
    let marks = [("prior", [0.0, 0.0]), ("adversarial", [1.0, 0.0]), ("realistic", [0.0, 1.0])];
    for (file, title, value) in [
        ("landscape-reward.svg", "R_adv", (|m| m.reward) as fn(&Measure) -> f64),
        ("landscape-penalty.svg", "P_real", |m| m.penalty),
    ] {
        let grid = Grid {
            title,
            axes: ["share of the adversarial vector", "share of the realistic vector"],
            at: &coordinates,
            values: landscape.iter().map(value).collect(),
            marks: &marks,
        };
        out.write(file, heat_map::draw(&grid)?.as_bytes())?;
    }
    let record = json!({
        "command": output::command(), "weights": args.weights, "scenes": scenes.describe(),
        "seed": args.seed, "version": env!("CARGO_PKG_VERSION"),
    });
    out.write("run.json", format!("{record:#}\n").as_bytes())?;
    output::print(&markdown)?;
    progress::say(&format!("connectivity.md, CSV files and charts are in `{}`", args.folder.out.display()));
    Ok(Outcome::Done)
}

/// Results of one scene.
struct SceneResult {
    path: Vec<Measure>,
    plane: Vec<Measure>,
    /// Loss of output mixing minus that of weight mixing at each compared λ; `None` without a whole log.
    mixing: Option<[f64; 3]>,
}

/// Models on the plane through prior and experts: `prior + a Δ_adv + b Δ_real`, row by row of b.
fn plane(experts: &ExpertSet, coordinates: &[f64]) -> Result<Vec<Arc<dyn MotionModel>>> {
    let points: Vec<[f64; 2]> =
        coordinates.iter().flat_map(|b| coordinates.iter().map(move |a| [*a, *b])).collect();
    let model = |[a, b]: &[f64; 2]| -> Result<Arc<dyn MotionModel>> {
        let phi = json!({"base": "prior", "phi": {"adversarial": a, "realistic": b}});
        let merger = sage_merging::mergers()?.build("vector-extrapolation", &phi)?;
        Ok(merger.merge(experts, &experts.between(0.5)?, 0)?)
    };
    points.par_iter().map(model).collect()
}

/// Loss of output mixing minus that of weight mixing: half the mean squared distance, m², of the policy's mean
/// trajectory from the log. By the exact identity this is `k |f_1 − f_0|²` less than the height of the chord.
fn mixing(
    data: &SceneData,
    prior: &dyn Backbone,
    prepared: &PreparedScene,
    [realistic, adversarial]: &[Arc<dyn MotionModel>; 2],
    compared: &[Arc<dyn MotionModel>],
) -> Result<Option<[f64; 3]>> {
    let log = data.scene.adversary()?;
    if log.count_valid(NOW + 1..NOW + HORIZON + 1) < HORIZON {
        return Ok(None);
    }
    let encoding = prepared.encoding();
    let frame = encoding.features().frame;
    let target: Vec<f64> =
        (NOW + 1..=NOW + HORIZON).flat_map(|step| frame.to_local(log.point(step))).collect();
    let modes: Vec<usize> = (0..prior.mode_ends(encoding)?.len()).collect();
    let trajectories: Vec<f32> = prior.trajectories(encoding, &modes)?.flatten_all()?.to_vec1()?;
    let mean = |model: &Arc<dyn MotionModel>| -> Result<Vec<f64>> {
        let log_probs = finite::<f64>(&model.log_probs(encoding)?)?;
        let mut mean = vec![0.0; 2 * HORIZON];
        for (trajectory, log_prob) in trajectories.chunks_exact(2 * HORIZON).zip(log_probs) {
            let weight = log_prob.exp();
            mean.iter_mut().zip(trajectory).for_each(|(mean, x)| *mean += weight * f64::from(*x));
        }
        Ok(mean)
    };
    let loss = |f: &[f64]| {
        let squares: f64 = f.iter().zip(&target).map(|(f, y)| (f - y).powi(2)).sum();
        0.5 * squares / HORIZON as f64
    };
    let (real, adversarial) = (mean(realistic)?, mean(adversarial)?);
    let mut differences = [0.0; 3];
    for ((difference, lambda), model) in differences.iter_mut().zip(COMPARED).zip(compared) {
        let mixed: Vec<f64> =
            real.iter().zip(&adversarial).map(|(r, a)| (1.0 - lambda) * r + lambda * a).collect();
        *difference = loss(&mixed) - loss(&mean(model)?);
    }
    Ok(Some(differences))
}

fn cell(e: &Estimate) -> String {
    format!("{:.3} [{:.3}, {:.3}]", e.value, e.low, e.high)
}

fn page(geometry: &Geometry, experts: &ExpertSet, path: &Sweep, mixing: &[[f64; 3]]) -> Result<String> {
    let at = |lambda: f64| -> Result<Mixture> { Ok(experts.between(lambda)?) };
    let (real, adversarial) = (at(0.0)?, at(1.0)?);
    let cosine = geometry.cosine(real.weights(), adversarial.weights());
    let [of_real, of_adversarial] = [&real, &adversarial].map(|mixture| geometry.norm(mixture.weights()));
    let difference: Vec<f64> = adversarial.weights().iter().zip(real.weights()).map(|(a, r)| a - r).collect();
    let values: usize = geometry.tensors().iter().map(|tensor| tensor.size).sum();
    let ratio = of_adversarial.max(of_real) / of_adversarial.min(of_real);
    let mut out = format!(
        "Linear mode connectivity of two experts.\n\n| geometry | value |\n| --- | --- |\n\
        | tuned values | {values} in {} tensors |\n| norm of the realistic vector | {of_real:.3} |\n\
        | norm of the adversarial vector | {of_adversarial:.3} |\n| norm of their difference | {:.3} |\n\
        | angle | {:.2}° |\n| ratio of the norms; 1 / cos | {ratio:.3}; {:.3} |\n",
        geometry.tensors().len(),
        geometry.norm(&difference),
        cosine.acos().to_degrees(),
        1.0 / cosine,
    );
    out += "\nExpectations under the interpolated policy, above the chord between the experts:\n\n\
        | value | least height | mean height | concave at % of lambda |\n| --- | --- | --- | --- |\n";
    for (name, value) in VALUES {
        let path = Path::of(path, value).context("no scene could be evaluated")?;
        let cells = [&path.least, &path.mean, &path.concave].map(cell);
        writeln!(out, "| {name} | {} |", cells.join(" | "))?;
    }
    out += "\nWeight mixing against output mixing, by the mean trajectory of the policy and the log: loss of output \
        mixing minus that of weight mixing, m² (positive: weight mixing is better).\n\n| lambda | N | difference |\n\
        | --- | --- | --- |\n";
    for (k, lambda) in COMPARED.iter().enumerate() {
        let differences: Vec<f64> = mixing.iter().map(|scene| scene[k]).collect();
        let mut rng = Rng::new(0, "mixing", "connectivity");
        let estimate = statistics::bootstrap_mean(&differences, RESAMPLES, &mut rng);
        let shown = estimate.as_ref().map_or("-".to_owned(), cell);
        writeln!(out, "| {lambda} | {} | {shown} |", differences.len())?;
    }
    out += "\nIntervals: 95 %, bootstrap over scenes. The chord is what probability mixing attains. A least height below 0 \
        is a barrier. Selection among candidates is outside all of this.\n";
    Ok(out)
}

fn path_csv(geometry: &Geometry, path: &Sweep, lambdas: &[f64]) -> Result<String> {
    let mut out = "lambda,norm,cosine_to_adversarial,reward,penalty,attack,believable\n".to_owned();
    for (lambda, m) in lambdas.iter().zip(path.front()) {
        let at = [1.0 - lambda, *lambda];
        let (norm, cosine) = (geometry.norm(&at), geometry.cosine(&at, &[0.0, 1.0]));
        writeln!(out, "{lambda},{norm},{cosine},{},{},{},{}", m.reward, m.penalty, m.attack, m.believable)?;
    }
    Ok(out)
}

/// Share of each tensor in the squared length of each vector.
fn layers_csv(geometry: &Geometry) -> Result<String> {
    let mut out = "tensor,values,share_of_realistic,share_of_adversarial,cosine\n".to_owned();
    for tensor in geometry.tensors() {
        let p = &tensor.products;
        let shares = [0, 1].map(|k| p[k][k] / geometry.product(k, k));
        let cosine = p[0][1] / (p[0][0] * p[1][1]).sqrt();
        writeln!(out, "{},{},{},{},{cosine}", tensor.name, tensor.size, shares[0], shares[1])?;
    }
    Ok(out)
}

fn landscape_csv(landscape: &[Measure], coordinates: &[f64]) -> Result<String> {
    let mut out = "adversarial,realistic,reward,penalty,attack,believable\n".to_owned();
    for (k, m) in landscape.iter().enumerate() {
        let (a, b) = (coordinates[k % coordinates.len()], coordinates[k / coordinates.len()]);
        writeln!(out, "{a},{b},{},{},{},{}", m.reward, m.penalty, m.attack, m.believable)?;
    }
    Ok(out)
}
