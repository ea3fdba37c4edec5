//! How well priors predict what recorded vehicles did.

use std::sync::Arc;

use anyhow::{Result, bail};
use sage_backbones::{
    Backbone,
    candidates::Selection,
    prediction::{Distances, Predicted, Recorded, propose},
    training::{Example, Examples, SceneData, recorded},
};
use sage_core::{
    geometry::Point,
    motion::{DT, HORIZON, NOW, Trajectory},
    objective::{Context, ContextOptions, Scorer},
    seed::Rng,
    statistics::{self, Estimate},
};
use serde::Serialize;

use crate::scenes::Scenes;

/// Numbers of candidates that are measured.
const KS: [usize; 3] = [1, 6, 32];
/// Resamples of an interval.
const RESAMPLES: usize = 2000;
/// An end is on a lane within this distance of its centre line, metres.
const ON_LANE: f64 = 2.0;
/// Candidates whose paths are judged as attacks would be.
const JUDGED: usize = 32;

/// Something that predicts.
pub(crate) enum Method<'n> {
    /// Straight on at the present velocity.
    ConstantVelocity,
    /// A prior, with the distance that its candidates keep from each other, metres.
    Prior {
        /// Name in the table.
        name: String,
        /// The network.
        network: &'n dyn Backbone,
        /// Radius of suppression, metres.
        radius: f32,
    },
}

impl Method<'_> {
    fn name(&self) -> &str {
        match self {
            Self::ConstantVelocity => "constant velocity",
            Self::Prior { name, .. } => name,
        }
    }
}

/// Distances of one method's best of `k` for one group of vehicles.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// Method.
    pub method: String,
    /// `interest` (egos and adversaries) or `all`.
    pub agents: &'static str,
    /// `any` or `moving` (more than 4 m in 8 s).
    pub motion: &'static str,
    /// Number of candidates.
    pub k: usize,
    /// Least mean distance, metres.
    pub min_ade: Estimate,
    /// Least end distance, metres.
    pub min_fde: Estimate,
    /// Share of vehicles that every candidate misses by more than 2 m at the end.
    pub miss: Estimate,
    /// The same by WOMD's threshold.
    pub miss_womd: Estimate,
}

/// What a prior's candidates for the adversaries are like.
#[derive(Clone, Debug, Serialize)]
pub struct Quality {
    /// Method.
    pub method: String,
    /// Share of six ends of egos and adversaries that lie within 2 m of a motor lane.
    pub ends_on_lanes: Estimate,
    /// Median `P_kin` (`paper`) of the plain top 32 of the adversaries.
    pub median_kinematic: Option<f64>,
    /// Share of these that are feasible.
    pub feasible: Option<Estimate>,
    /// Share of 32 modes drawn at random that are feasible.
    pub feasible_random: Option<Estimate>,
}

/// All figures of a run.
pub struct Report {
    /// Rows by method, group and number of candidates.
    pub rows: Vec<Row>,
    /// One a prior.
    pub quality: Vec<Quality>,
}

/// What came of one vehicle.
struct Outcome {
    of_interest: bool,
    moves: bool,
    distances: [Distances; KS.len()],
    /// Six ends that lie on a lane, of how many.
    on_lanes: (usize, usize),
}

/// What came of one scene.
#[derive(Default)]
struct OfScene {
    vehicles: Vec<Outcome>,
    kinematic: Vec<f64>,
    feasible: Vec<f64>,
    feasible_random: Vec<f64>,
}

/// Measures methods on all vehicles that are valid *now* and at the last step.
///
/// *Errors*: those of a network.
pub(crate) fn run(scenes: &Scenes, methods: &[Method], done: impl FnMut()) -> Result<Report> {
    let of_scene = |data: &SceneData| -> Result<Vec<OfScene>> {
        let examples = Examples::of(std::slice::from_ref(data)).filter(|e| e.is_whole);
        methods.iter().map(|method| measure(method, data, examples.list())).collect()
    };
    let found = scenes.map(of_scene, done)?;
    if found.iter().flatten().all(|scene| scene.vehicles.is_empty()) {
        bail!("none of {} scenes shows a vehicle that is valid at frames 10 and 90", scenes.len());
    }
    let mut report = Report { rows: Vec::new(), quality: Vec::new() };
    for (k, method) in methods.iter().enumerate() {
        let found: Vec<&OfScene> = found.iter().map(|scene| &scene[k]).collect();
        report.rows.extend(rows(method.name(), &found));
        if matches!(method, Method::Prior { .. }) {
            report.quality.extend(quality(method.name(), &found));
        }
    }
    Ok(report)
}

fn measure(method: &Method, data: &SceneData, examples: &[Example]) -> Result<OfScene> {
    let mut of_scene = OfScene::default();
    for example in examples {
        let track = &data.scene.tracks[example.track];
        let truth = recorded(track);
        let (distances, on_lanes) = match method {
            Method::ConstantVelocity => {
                let [x, y] = track.point(NOW);
                let [vx, vy] = track.velocity[NOW];
                let at = |step: usize| [x + step as f64 * DT * vx, y + step as f64 * DT * vy];
                let path: Vec<Point> = (1..=HORIZON).map(at).collect();
                ([truth.distances([&path[..]]); KS.len()], (0, 0))
            }
            Method::Prior { network, radius, .. } => {
                let name = |error: sage_backbones::Error| error.of(data, example.track);
                let features = network.features(&data.observe()?, example.track, None).map_err(name)?;
                let encoding = network.encode(Arc::new(features))?;
                let nms = Selection::Nms { radius: *radius };
                let propose = |k, selection| {
                    propose(*network, &encoding, k, selection, &mut Rng::new(0, "", "")).map_err(name)
                };
                let six = propose(6, nms)?;
                let all = propose(JUDGED, nms)?;
                let lanes = data.index.motor_lanes();
                let on = six.iter().filter(|p| lanes.nearest(end(p), ON_LANE, |_| true).is_some()).count();
                if Some(example.track) == data.scene.adversary {
                    let top = propose(JUDGED, Selection::TopK)?;
                    let random = random_modes(*network, &encoding, &data.name)?;
                    judge(data, top, random, &mut of_scene)?;
                }
                (
                    [distances(&truth, &six[..1]), distances(&truth, &six), distances(&truth, &all)],
                    (on, six.len()),
                )
            }
        };
        of_scene.vehicles.push(Outcome {
            of_interest: example.of_interest,
            moves: example.moves,
            distances,
            on_lanes,
        });
    }
    Ok(of_scene)
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
    order.truncate(JUDGED);
    let paths = network.trajectories(encoding, &order)?;
    Ok(sage_backbones::backbone::to_world(&paths, encoding.features())?)
}

/// Judges candidates of the adversary as attacks are, where the scene has an ego path to judge by.
fn judge(data: &SceneData, top: Vec<Predicted>, random: Vec<Trajectory>, into: &mut OfScene) -> Result<()> {
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

fn rows(method: &str, found: &[&OfScene]) -> Vec<Row> {
    let mut rows = Vec::new();
    for (agents, only_interest) in [("interest", true), ("all", false)] {
        for (motion, only_moving) in [("any", false), ("moving", true)] {
            for (slot, k) in KS.into_iter().enumerate() {
                let estimate = |value: fn(&Distances) -> f64| {
                    let of_scene = |scene: &OfScene| {
                        let chosen = scene
                            .vehicles
                            .iter()
                            .filter(|v| (v.of_interest || !only_interest) && (v.moves || !only_moving));
                        chosen.map(|v| value(&v.distances[slot])).collect()
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

fn quality(method: &str, found: &[&OfScene]) -> Option<Quality> {
    let estimate = |groups: Vec<Vec<f64>>| {
        statistics::bootstrap_grouped(&groups, RESAMPLES, &mut Rng::new(0, "quality", "prediction"))
    };
    let on_lanes = |scene: &OfScene| {
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
