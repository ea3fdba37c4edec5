//! `sage predict`: predicts candidate trajectories of an agent.

use std::{io::Write, sync::Arc};

use advsage::{Registries, weights::NamedNetwork};
use anyhow::{Context as _, Result};
use sage_backbones::{
    candidates::Sampling,
    device,
    prediction::{Predicted, predict},
};
use sage_core::{
    generator::Observation,
    geometry::Point,
    motion::{NOW, Trajectory},
    scene::{Scene, SceneIndex, TrackKind},
    seed::Rng,
};
use sage_data::{Recording, checks};
use sage_run::{Outcome, input, networks, output::OutputFile, progress, terminal};
use sage_view::drawing::{self, DrawnPath, Picture};
use serde::Serialize;

use crate::cli::{PredictArgs, SelectArg};

#[derive(Serialize)]
struct PredictionRow<'p> {
    rank: usize,
    log_prob: f32,
    goal: Point,
    trajectory: &'p Trajectory,
}

pub(crate) fn run(args: &PredictArgs, registries: &Registries) -> Result<Outcome> {
    let out = args.out.as_deref().map(|path| OutputFile::claim(path, args.force)).transpose()?;
    let recording = Recording::read_as(&args.scene, &args.reading.options())?;
    for warning in checks::important(&recording.scene) {
        progress::say(&format!("warning: {warning}"));
    }
    let loaded = NamedNetwork::load(&registries.backbones, &args.weights)?;
    networks::announce(&loaded);
    let network = device::on(&*loaded.network, &args.device)?;
    let mut scene = recording.scene;
    let target = match &args.agent {
        Some(id) => scene.track_index(id),
        None => scene.adversary_index(),
    }
    .with_context(|| format!("`{}`", args.scene.display()))?;
    let index = SceneIndex::new(scene.map.clone());
    let features = network.features(&Observation::of(&scene, &index)?, target, None)?;
    if !features.has_lanes {
        progress::say("note: no motor lane is within range of the agent; goals lie on a regular grid");
    }
    if scene.tracks[target].kind != TrackKind::Vehicle {
        progress::say(
            "note: the agent is not a vehicle, and the shipped networks were trained on vehicles only",
        );
    }
    let selection = match args.select {
        SelectArg::TopK => Sampling::TopK,
        SelectArg::Gumbel => Sampling::Gumbel,
        SelectArg::Nms => Sampling::Nms { radius: args.radius },
    };
    let mut rng = Rng::new(args.seed, &scene.id, "prediction");
    let predicted = predict(&*network, Arc::new(features), args.k, selection, &mut rng)?;
    if predicted.len() < args.k {
        progress::say(&format!("note: the network has only {} modes for this agent", predicted.len()));
    }
    if let Some(out) = &out {
        scene.adversary = Some(target).filter(|t| *t != scene.ego).or(scene.adversary);
        let title = input::scene_name(&args.scene)?;
        let picture = Picture { title, candidates: drawn(&scene, target, &predicted), ..Picture::default() };
        out.write(drawing::draw(&scene, &picture).as_bytes())?;
        if out.is_stdout() {
            return Ok(Outcome::Done);
        }
    }
    print(&predicted, args.json)?;
    Ok(Outcome::Done)
}

fn print(predicted: &[Predicted], as_json: bool) -> Result<()> {
    let mut out = std::io::stdout().lock();
    if !as_json {
        writeln!(
            out,
            "{:>4} {:>9} {:>12} {:>12} {:>8} {:>9}",
            "rank", "log p", "goal x", "goal y", "length m", "end m/s"
        )?;
    }
    for (k, Predicted { log_prob, goal, trajectory, .. }) in predicted.iter().enumerate() {
        if as_json {
            let row = PredictionRow { rank: k + 1, log_prob: *log_prob, goal: *goal, trajectory };
            terminal::json_line(&mut out, &row)?;
            continue;
        }
        let points = trajectory.points();
        let step = |w: &[Point]| sage_core::geometry::distance(w[0], w[1]);
        let length: f64 = points.windows(2).map(step).sum();
        let speed = points.windows(2).next_back().map_or(0.0, step) * 10.0;
        writeln!(
            out,
            "{:>4} {log_prob:>9.3} {:>12.2} {:>12.2} {length:>8.1} {speed:>9.1}",
            k + 1,
            goal[0],
            goal[1]
        )?;
    }
    Ok(())
}

/// Trajectories from the agent's position *now*, named by rank and probability.
fn drawn(scene: &Scene, target: usize, predicted: &[Predicted]) -> Vec<DrawnPath> {
    let start = scene.tracks[target].point(NOW);
    let trajectory = |(k, p): (usize, &Predicted)| DrawnPath {
        name: format!("{}: p = {:.3}", k + 1, p.log_prob.exp()),
        points: std::iter::once(start).chain(p.trajectory.points().iter().copied()).collect(),
        contact: None,
    };
    predicted.iter().enumerate().map(trajectory).collect()
}
