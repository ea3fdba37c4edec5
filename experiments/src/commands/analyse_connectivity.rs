//! `sage analyse connectivity`: the geometry of the experts, rewards along the path between two of them, on the
//! plane through them and beyond it, and the test of weight against output mixing.

use std::time::Instant;

use anyhow::Result;
use sage_backbones::training::{Measures, PreparedScene};
use sage_bench::curve::{Curve as Sweep, Point as Measure};
use sage_core::{files, scene::SceneData};
use sage_merging::{ADVERSARIAL, Geometry, REALISTIC};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use crate::{
    Outcome, Registries,
    bench::{
        connectivity_report::{self as report, Connectivity},
        expert_path::{self, Measured, Points},
    },
    cli::ConnectivityArgs,
    networks,
    output::{self, Run, State},
    progress::{self, Progress},
    scene_windows::{self, RESULTS, SceneOutcome},
    scenes::Scenes,
};

/// Points of the landscape along each axis, from −0.25 to 1.25.
const LANDSCAPE: usize = 21;
/// Size limit of a page that an earlier run wrote, bytes.
const PAGE_LIMIT: u64 = 1 << 20;

/// Results of one scene.
#[derive(Serialize, Deserialize)]
struct SceneResult {
    scene: String,
    /// `None` if the scene cannot be attacked.
    measured: Option<Measured>,
}

impl SceneOutcome for SceneResult {
    fn scene(&self) -> &str {
        &self.scene
    }
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
    let plane = (0..LANDSCAPE).map(|k| -0.25 + 1.5 * k as f64 / (LANDSCAPE - 1) as f64).collect();
    let points = Points::with(plane);
    let models = expert_path::models(&experts, &geometry, &points, args.seed)?;
    let prior = &**experts.prior();
    let one = |data: &SceneData| -> Result<SceneResult> {
        let prepared = PreparedScene::new(prior, data, false, &measures)?;
        let measured = prepared.map(|prepared| models.measure(data, prior, &prepared)).transpose()?;
        Ok(SceneResult { scene: data.name.clone(), measured })
    };
    let mut progress = Progress::new("evaluated", scenes.len());
    let fits = |result: &SceneResult| {
        result.measured.as_ref().is_none_or(|m| {
            m.path.len() == points.lambdas.len() && m.plane.len() == points.plane.len().pow(2)
        })
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
        points,
    };
    found.write(folder)?;
    run.finish(&Value::Null, clock.elapsed().as_secs_f64())?;
    output::print(&found.page()?)?;
    progress::say(&format!(
        "{}, CSV files and pictures are in `{}`",
        report::PAGE,
        args.folder.out.display()
    ));
    Ok(scenes.outcome())
}
