//! Errors of priors and of constant velocity in predicting recorded vehicles.

use std::sync::Arc;

use anyhow::{Result, bail};
use sage_backbones::{
    Backbone,
    candidates::Selection,
    prediction::{Distances, Predicted, Recorded, propose},
    training::{Example, Examples, recorded},
};
use sage_core::{
    geometry::Point,
    motion::{DT, HORIZON, NOW, Trajectory},
    objective::{Context, ContextOptions, Scorer},
    scene::SceneData,
    seed::Rng,
    statistics::{self, Estimate},
};
use serde::Serialize;

use crate::scenes::Scenes;

/// Numbers of candidates that are measured.
const KS: [usize; 3] = [1, 6, 32];
/// Resamples of an interval.
const RESAMPLES: usize = 2000;
/// An end point within this distance of a lane's centre line is on the lane, metres.
const ON_LANE: f64 = 2.0;
/// Candidates whose trajectories are evaluated as attacks.
const EVALUATED: usize = 32;

/// A prediction method.
pub(crate) enum Predictor<'n> {
    /// Constant velocity from *now*.
    ConstantVelocity,
    /// A prior with non-maximum suppression of its candidates.
    Prior {
        /// Name in the table.
        name: String,
        /// The network.
        network: &'n dyn Backbone,
        /// Minimum distance between end points of candidates, metres.
        radius: f32,
    },
}

impl Predictor<'_> {
    fn name(&self) -> &str {
        match self {
            Self::ConstantVelocity => "constant velocity",
            Self::Prior { name, .. } => name,
        }
    }
}

/// Errors of a predictor's best of `k` candidates for one group of vehicles.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Predictor.
    pub method: String,
    /// `interest` (egos and adversaries) or `all`.
    pub agents: &'static str,
    /// `any` or `moving` (more than 4 m in 8 s).
    pub motion: &'static str,
    /// Number of candidates.
    pub k: usize,
    /// Smallest mean distance (minADE), metres.
    pub min_ade: Estimate,
    /// Smallest end distance (minFDE), metres.
    pub min_fde: Estimate,
    /// Share of vehicles that every candidate misses by more than 2 m at the end.
    pub miss: Estimate,
    /// The same with WOMD's threshold.
    pub miss_womd: Estimate,
}

/// Quality of a prior's candidates.
#[derive(Clone, Debug, Serialize)]
pub struct Quality {
    /// Predictor.
    pub method: String,
    /// Share of end points of six candidates of egos and adversaries within 2 m of a motor lane.
    pub ends_on_lanes: Estimate,
    /// Median `P_kin` (`paper`) of the top 32 modes of the adversaries.
    pub median_kinematic: Option<f64>,
    /// Share of these modes that are feasible.
    pub feasible: Option<Estimate>,
    /// Share of 32 modes drawn at random that are feasible.
    pub feasible_random: Option<Estimate>,
}

/// Results of a run.
pub struct Report {
    /// Rows by predictor, group and number of candidates.
    pub rows: Vec<Row>,
    /// One row per prior.
    pub quality: Vec<Quality>,
}

/// Result of one vehicle.
struct VehicleResult {
    of_interest: bool,
    moves: bool,
    distances: [Distances; KS.len()],
    /// Number of the six end points that lie on a lane, and their total.
    on_lanes: (usize, usize),
}

/// Result of one scene.
#[derive(Default)]
struct SceneResult {
    vehicles: Vec<VehicleResult>,
    kinematic: Vec<f64>,
    feasible: Vec<f64>,
    feasible_random: Vec<f64>,
}

/// Measures predictors on all vehicles that are valid *now* and at the last step.
///
/// *Errors*: those of a network.
pub(crate) fn run(scenes: &Scenes, predictors: &[Predictor], done: impl FnMut()) -> Result<Report> {
    let of_scene = |data: &SceneData| -> Result<Vec<SceneResult>> {
        let examples = Examples::of(std::slice::from_ref(data)).filter(|e| e.is_whole);
        predictors.iter().map(|predictor| measure(predictor, data, examples.list())).collect()
    };
    let found = scenes.map(of_scene, done)?;
    if found.iter().flatten().all(|scene| scene.vehicles.is_empty()) {
        bail!("none of {} scenes has a vehicle that is valid at frames 10 and 90", scenes.len());
    }
    let mut report = Report { rows: Vec::new(), quality: Vec::new() };
    for (k, predictor) in predictors.iter().enumerate() {
        let found: Vec<&SceneResult> = found.iter().map(|scene| &scene[k]).collect();
        report.rows.extend(rows(predictor.name(), &found));
        if matches!(predictor, Predictor::Prior { .. }) {
            report.quality.extend(quality(predictor.name(), &found));
        }
    }
    Ok(report)
}

fn measure(predictor: &Predictor, data: &SceneData, examples: &[Example]) -> Result<SceneResult> {
    let mut result = SceneResult::default();
    for example in examples {
        let track = &data.scene.tracks[example.track];
        let truth = recorded(track);
        let (distances, on_lanes) = match predictor {
            Predictor::ConstantVelocity => {
                let [x, y] = track.point(NOW);
                let [vx, vy] = track.velocity[NOW];
                let at = |step: usize| [x + step as f64 * DT * vx, y + step as f64 * DT * vy];
                let trajectory: Vec<Point> = (1..=HORIZON).map(at).collect();
                ([truth.distances([&trajectory[..]]); KS.len()], (0, 0))
            }
            Predictor::Prior { network, radius, .. } => {
                let name = |error: sage_backbones::Error| error.of(data, example.track);
                let features = network.features(&data.observe()?, example.track, None).map_err(name)?;
                let encoding = network.encode(Arc::new(features))?;
                let nms = Selection::Nms { radius: *radius };
                let propose = |k, selection| {
                    propose(*network, &encoding, k, selection, &mut Rng::new(0, "", "")).map_err(name)
                };
                let six = propose(6, nms)?;
                let all = propose(EVALUATED, nms)?;
                let lanes = data.index.motor_lanes();
                let on = six.iter().filter(|p| lanes.nearest(end(p), ON_LANE, |_| true).is_some()).count();
                if Some(example.track) == data.scene.adversary {
                    let top = propose(EVALUATED, Selection::TopK)?;
                    let random = random_modes(*network, &encoding, &data.name)?;
                    evaluate(data, top, random, &mut result)?;
                }
                (
                    [distances(&truth, &six[..1]), distances(&truth, &six), distances(&truth, &all)],
                    (on, six.len()),
                )
            }
        };
        result.vehicles.push(VehicleResult {
            of_interest: example.of_interest,
            moves: example.moves,
            distances,
            on_lanes,
        });
    }
    Ok(result)
}

fn end(predicted: &Predicted) -> Point {
    predicted.trajectory.points()[HORIZON - 1]
}

fn distances(truth: &Recorded, candidates: &[Predicted]) -> Distances {
    truth.distances(candidates.iter().map(|p| p.trajectory.points()))
}

fn random_modes(
    network: &dyn Backbone,
    encoding: &sage_backbones::encoding::Encoding,
    scene: &str,
) -> Result<Vec<Trajectory>> {
    let modes = network.mode_ends(encoding)?.len();
    let mut order: Vec<usize> = (0..modes).collect();
    Rng::new(0, scene, "random modes").shuffle(&mut order);
    order.truncate(EVALUATED);
    let trajectories = network.trajectories(encoding, &order)?;
    Ok(sage_backbones::backbone::to_world(&trajectories, encoding.features())?)
}

/// Evaluates candidates of the adversary as attacks, if the scene has an ego path.
fn evaluate(
    data: &SceneData,
    top: Vec<Predicted>,
    random: Vec<Trajectory>,
    into: &mut SceneResult,
) -> Result<()> {
    let Ok(ctx) = Context::new(&data.scene, &data.index, &ContextOptions::default()) else { return Ok(()) };
    let scorer = Scorer::new(&ctx);
    for predicted in top {
        let scores = scorer.scores(&ctx.candidate(predicted.trajectory));
        into.kinematic.push(scores.kinematic_penalty);
        into.feasible.push(f64::from(u8::from(scores.feasible)));
    }
    for trajectory in random {
        let scores = scorer.scores(&ctx.candidate(trajectory));
        into.feasible_random.push(f64::from(u8::from(scores.feasible)));
    }
    Ok(())
}

fn rows(method: &str, found: &[&SceneResult]) -> Vec<Row> {
    let mut rows = Vec::new();
    for (agents, only_interest) in [("interest", true), ("all", false)] {
        for (motion, only_moving) in [("any", false), ("moving", true)] {
            for (slot, k) in KS.into_iter().enumerate() {
                let estimate = |value: fn(&Distances) -> f64| {
                    let of_scene = |scene: &SceneResult| {
                        let vehicles = scene
                            .vehicles
                            .iter()
                            .filter(|v| (v.of_interest || !only_interest) && (v.moves || !only_moving));
                        vehicles.map(|v| value(&v.distances[slot])).collect()
                    };
                    let groups: Vec<Vec<f64>> = found.iter().copied().map(of_scene).collect();
                    statistics::bootstrap_grouped(&groups, RESAMPLES, &mut Rng::new(0, agents, "prediction"))
                };
                if let (Some(min_ade), Some(min_fde), Some(miss), Some(miss_womd)) = (
                    estimate(|d| d.min_ade),
                    estimate(|d| d.min_fde),
                    estimate(|d| f64::from(u8::from(d.misses))),
                    estimate(|d| f64::from(u8::from(d.misses_womd))),
                ) {
                    let method = method.to_owned();
                    rows.push(Row { method, agents, motion, k, min_ade, min_fde, miss, miss_womd });
                }
            }
        }
    }
    rows
}

fn quality(method: &str, found: &[&SceneResult]) -> Option<Quality> {
    let estimate = |groups: Vec<Vec<f64>>| {
        statistics::bootstrap_grouped(&groups, RESAMPLES, &mut Rng::new(0, "quality", "prediction"))
    };
    let on_lanes = |scene: &SceneResult| {
        let of_interest = scene.vehicles.iter().filter(|v| v.of_interest);
        of_interest.map(|v| v.on_lanes.0 as f64 / v.on_lanes.1.max(1) as f64).collect()
    };
    let kinematic: Vec<f64> = found.iter().flat_map(|s| s.kinematic.iter().copied()).collect();
    Some(Quality {
        method: method.to_owned(),
        ends_on_lanes: estimate(found.iter().copied().map(on_lanes).collect())?,
        median_kinematic: statistics::median(&kinematic),
        feasible: estimate(found.iter().map(|s| s.feasible.clone()).collect()),
        feasible_random: estimate(found.iter().map(|s| s.feasible_random.clone()).collect()),
    })
}
