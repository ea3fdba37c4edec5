//! `sage analyse connectivity`: the geometry of the experts, rewards along the path between two of them, on the
//! plane through them and beyond it, and the test of weight against output mixing.

use std::{sync::Arc, time::Instant};

use anyhow::Result;
use rayon::prelude::*;
use sage_backbones::{
    Backbone, MotionModel,
    backbone::finite,
    training::{Measures, PreparedScene, SceneData},
};
use sage_core::{
    files,
    motion::{HORIZON, NOW},
};
use sage_merging::{ADVERSARIAL, ExpertSet, Geometry, Linear, Merger, REALISTIC};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::{
    Outcome, Registries,
    bench::{
        connectivity_report::{self as report, Connectivity},
        pareto::{Measure, Sweep},
    },
    cli::ConnectivityArgs,
    networks,
    output::{self, Run, State},
    progress::{self, Progress},
    scene_windows::{self, RESULTS, SceneOutcome},
    scenes::Scenes,
};

/// Steps of λ along the path.
const STEPS: usize = 20;
/// Points of the landscape along each axis, from −0.25 to 1.25.
const LANDSCAPE: usize = 21;
/// Steps of an extrapolation, and their length as a share of the distance between the experts.
const BEYOND: usize = 12;
const STEP: f64 = 0.125;
/// λ at which weight mixing is compared with output mixing.
pub(crate) const COMPARED: [f64; 3] = [0.25, 0.5, 0.75];
/// Size limit of a page that an earlier run wrote, bytes.
const PAGE_LIMIT: u64 = 1 << 20;

/// Results of one scene.
#[derive(Serialize, Deserialize)]
struct SceneResult {
    scene: String,
    /// `None` if the scene cannot be attacked.
    measured: Option<Measured>,
}

#[derive(Serialize, Deserialize)]
struct Measured {
    path: Vec<Measure>,
    plane: Vec<Measure>,
    /// Along the adversarial vector, and along the line through the experts.
    beyond: [Vec<Measure>; 2],
    /// Loss of output mixing minus that of weight mixing at each compared λ; `None` without a whole log.
    mixing: Option<[f64; 3]>,
}

impl SceneOutcome for SceneResult {
    fn scene(&self) -> &str {
        &self.scene
    }
}

/// All models that are evaluated.
struct Models {
    path: Vec<Arc<dyn MotionModel>>,
    plane: Vec<Arc<dyn MotionModel>>,
    beyond: [Vec<Arc<dyn MotionModel>>; 2],
    /// The realistic and the adversarial expert, and the mixtures that are compared with their outputs.
    ends: [Arc<dyn MotionModel>; 2],
    compared: Vec<Arc<dyn MotionModel>>,
}

pub(crate) fn run(args: &ConnectivityArgs, registries: &Registries) -> Result<Outcome> {
    let clock = Instant::now();
    let all = networks::load_experts(&registries.backbones, &args.weights)?;
    let experts = all.only(&[REALISTIC, ADVERSARIAL])?;
    let geometry = Geometry::of(&experts)?;
    let scenes = Scenes::of(&args.paths, &args.split, 0, args.seed)?.attackable()?;
    let measures = Measures::of(&[], &registries.rewards, &registries.feasibilities)?;
    let tensors = all.experts().iter().map(|(name, weights)| Ok((name.clone(), weights.hash()?.into())));
    let identity = json!({
        "data": scenes.describe(), "prior": all.prior().parameters().hash()?, "seed": args.seed,
        "experts": tensors.collect::<Result<serde_json::Map<String, Value>>>()?,
        "version": env!("CARGO_PKG_VERSION"), "program": output::program(),
    });
    let (run, state) =
        Run::start(&args.folder.out, identity, args.folder.force, &[RESULTS], &[], &report::FILES)?;
    let folder = run.folder();
    if state == State::Done {
        output::print(&files::read_text(&folder.path().join(report::PAGE), PAGE_LIMIT)?)?;
        return Ok(Outcome::Done);
    }
    let lambdas: Vec<f64> = (0..=STEPS).map(|k| k as f64 / STEPS as f64).collect();
    let plane: Vec<f64> = (0..LANDSCAPE).map(|k| -0.25 + 1.5 * k as f64 / (LANDSCAPE - 1) as f64).collect();
    let steps: Vec<f64> = (0..=BEYOND).map(|k| STEP * k as f64).collect();
    let models = models(&experts, &geometry, &lambdas, &plane, &steps, args.seed)?;
    let prior = &**experts.prior();
    let one = |data: &SceneData| -> Result<SceneResult> {
        let prepared = PreparedScene::new(prior, data, false, &measures)?;
        let measured = prepared.map(|prepared| models.measure(data, prior, &prepared)).transpose()?;
        Ok(SceneResult { scene: data.name.clone(), measured })
    };
    let mut progress = Progress::new("evaluated", scenes.len());
    let fits = |result: &SceneResult| {
        result
            .measured
            .as_ref()
            .is_none_or(|m| m.path.len() == lambdas.len() && m.plane.len() == plane.len().pow(2))
    };
    let results = scene_windows::results(&run, &scenes, fits, one, || progress.step())?;
    let results: Vec<Measured> = results.into_iter().filter_map(|result| result.measured).collect();
    progress.finish(&format!("{} models on {} scenes", models.len(), results.len()));
    let sweep = |of: fn(&Measured) -> &Vec<Measure>| Sweep {
        scenes: results.iter().map(|result| of(result).clone()).collect(),
    };
    let found = Connectivity {
        all: &all,
        geometry,
        path: sweep(|m| &m.path),
        landscape: sweep(|m| &m.plane).front(),
        beyond: [sweep(|m| &m.beyond[0]), sweep(|m| &m.beyond[1])],
        mixing: results.iter().filter_map(|result| result.mixing).collect(),
        lambdas,
        plane,
        steps,
    };
    found.write(folder)?;
    run.finish(&Value::Null, clock.elapsed().as_secs_f64())?;
    output::print(&found.page()?)?;
    progress::say(&format!(
        "{}, CSV files and pictures are in `{}`",
        report::PAGE,
        args.folder.out.display()
    ));
    Ok(Outcome::Done)
}

/// Models on the path, on the plane `prior + a Δ_adv + b Δ_real` row by row of b, and beyond the adversarial
/// expert at equal step lengths, which are shares of the distance between the experts.
fn models(
    experts: &ExpertSet,
    geometry: &Geometry,
    lambdas: &[f64],
    plane: &[f64],
    steps: &[f64],
    seed: u64,
) -> Result<Models> {
    let along = |lambda: &f64| -> Result<Arc<dyn MotionModel>> {
        Ok((&Linear as &dyn Merger).merge(experts, &experts.between(*lambda)?, seed)?)
    };
    let mergers = sage_merging::mergers()?;
    let step = |name: &str, options: Value| -> Result<Arc<dyn MotionModel>> {
        Ok(mergers.build(name, &options)?.merge(experts, &experts.between(1.0)?, seed)?)
    };
    let on_plane = |k: usize| {
        let (a, b) = (plane[k % plane.len()], plane[k / plane.len()]);
        let phi = json!({ADVERSARIAL: a, REALISTIC: b});
        step("vector-extrapolation", json!({"base": "prior", "phi": phi}))
    };
    let of_vector = geometry.norm(&[-1.0, 1.0]) / geometry.norm(&[0.0, 1.0]);
    let vector = |s: &f64| step("vector-extrapolation", json!({"phi": {ADVERSARIAL: s * of_vector}}));
    let direct = |s: &f64| step("direct-extrapolation", json!({"phi": s}));
    Ok(Models {
        path: lambdas.iter().map(along).collect::<Result<_>>()?,
        plane: (0..plane.len().pow(2)).into_par_iter().map(on_plane).collect::<Result<_>>()?,
        beyond: [
            steps.iter().map(vector).collect::<Result<_>>()?,
            steps.iter().map(direct).collect::<Result<_>>()?,
        ],
        ends: [along(&0.0)?, along(&1.0)?],
        compared: COMPARED.iter().map(along).collect::<Result<_>>()?,
    })
}

impl Models {
    fn len(&self) -> usize {
        self.path.len() + self.plane.len() + self.beyond[0].len() + self.beyond[1].len()
    }

    fn measure(&self, data: &SceneData, prior: &dyn Backbone, prepared: &PreparedScene) -> Result<Measured> {
        let measured = |models: &[Arc<dyn MotionModel>]| -> Result<Vec<Measure>> {
            let one = |model: &Arc<dyn MotionModel>| Ok(prepared.expectation(&**model)?.into());
            models.par_iter().map(one).collect()
        };
        Ok(Measured {
            path: measured(&self.path)?,
            plane: measured(&self.plane)?,
            beyond: [measured(&self.beyond[0])?, measured(&self.beyond[1])?],
            mixing: mixing(data, prior, prepared, &self.ends, &self.compared)?,
        })
    }
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
