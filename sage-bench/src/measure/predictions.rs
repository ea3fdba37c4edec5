//! Errors of priors and of constant velocity in predicting recorded vehicles.

use std::sync::Arc;

use sage_backbones::{
    Backbone,
    candidates::Sampling,
    encoding::Encoding,
    prediction::{Distances, Predicted, Recorded, propose},
    training::{Example, Examples, recorded},
};
use sage_core::{
    geometry::Point,
    metric::{Metric, MetricInfo, Metrics},
    motion::{DT, HORIZON, NOW, Trajectory},
    objective::{Context, ContextOptions, Scorer},
    scene::SceneData,
    seed::Rng,
};

use super::{ExpertSource, Measurement, SceneResult, cell, infos};
use crate::{
    Registries, Result, in_one_line,
    rows::{Cell, Key, Subject},
    study::Study,
};

/// Numbers of candidates of which the best is measured.
const KS: [usize; 3] = [1, 6, 32];
/// An end point within this distance of a lane's centre line is on the lane, metres.
const ON_LANE: f64 = 2.0;
/// Candidates whose trajectories are evaluated as attacks.
const EVALUATED: usize = 32;
/// Groups of vehicles: name, whether only egos and adversaries, whether only those that move more than 4 m in 8 s.
const GROUPS: [(&str, bool, bool); 4] = [
    ("ego and adversary", true, false),
    ("ego and adversary, moving", true, true),
    ("all", false, false),
    ("all, moving", false, true),
];

/// A prediction method.
struct Predictor {
    name: String,
    /// The network and the minimum distance between ends of candidates, metres; `None` for constant velocity.
    network: Option<(Arc<dyn Backbone>, f32)>,
}

/// What was measured of one vehicle, or of one candidate of an adversary.
#[derive(Default)]
struct Measured {
    of_interest: bool,
    moves: bool,
    distances: Option<Distances>,
    /// Share of the six candidates that end on a lane.
    on_lanes: Option<f64>,
    /// Of one of the most likely candidates.
    top: Option<[f64; 2]>,
    /// Whether a random candidate is feasible.
    random: Option<bool>,
}

/// All metrics: the errors for each group of vehicles, then those of candidates.
fn metrics(registries: &Registries) -> Result<Metrics<Measured>> {
    let mut all = Metrics::default();
    for (group, only_interest, only_moving) in GROUPS {
        for metric in registries.metrics.prediction.all() {
            let mut metric = metric.of_part(move |m: &Measured| {
                let is_in = (m.of_interest || !only_interest) && (m.moves || !only_moving);
                m.distances.as_ref().filter(|_| is_in)
            });
            metric.info.name = format!("{}, {group}", metric.info.name).into();
            all = all.with(metric)?;
        }
    }
    Ok(all.with_all([
        Metric::mean("ends on lanes", |m: &Measured| m.on_lanes)
            .about("share of six candidates of an ego or adversary that end within 2 m of a motor lane")
            .more_is_better(),
        Metric::median("top 32: P_kin", |m: &Measured| Some(m.top?[0]))
            .about("P_kin of the most likely candidates of the adversary")
            .less_is_better(),
        Metric::share("top 32: feasible", |m: &Measured| Some(m.top?[1] == 1.0))
            .about("share of these that are feasible")
            .more_is_better(),
        Metric::share("random 32: feasible", |m: &Measured| m.random)
            .about("share of random candidates that are feasible")
            .more_is_better(),
    ])?)
}

/// Predictors of a study.
pub struct Predictions {
    predictors: Vec<Predictor>,
    keys: Vec<Key>,
    metrics: Vec<Metric<Measured>>,
}

impl Predictions {
    /// Constant velocity, then every prior with every radius of suppression.
    ///
    /// *Errors*: weights that cannot be used, or a metric that is not registered.
    pub fn new(study: &Study, registries: &Registries, source: &dyn ExpertSource) -> Result<Self> {
        let mut predictors = vec![Predictor { name: "constant velocity".to_owned(), network: None }];
        for weights in &study.weights {
            let network = source.network(weights)?;
            for radius in &study.radius {
                let name = match study.radius.len() {
                    1 => weights.clone(),
                    _ => format!("{weights}, {radius} m"),
                };
                predictors.push(Predictor { name, network: Some((network.clone(), *radius as f32)) });
            }
        }
        let listed = study.metrics.get(&Subject::Prediction).cloned().unwrap_or_default();
        let metrics = metrics(registries)?.by_names(&listed)?;
        let key = |predictor: &Predictor, k: usize| Key {
            target: Some(k as f64),
            ..Key::new(Subject::Prediction, &*predictor.name, study.seed)
        };
        let keys = predictors.iter().flat_map(|predictor| KS.map(|k| key(predictor, k))).collect();
        Ok(Self { predictors, keys, metrics })
    }

    fn of_predictor(&self, number: usize, data: &SceneData, examples: &[Example]) -> Result<Vec<Cell>> {
        let first = number * KS.len();
        let mut cells = Vec::new();
        for example in examples {
            let track = &data.scene.tracks[example.track];
            let truth = recorded(track);
            let vehicle =
                Measured { of_interest: example.of_interest, moves: example.moves, ..Measured::default() };
            let mut push = |k: usize, agent: String, measured: Measured| {
                cells.push(Cell { agent, ..cell(first + k, &self.metrics, &measured) });
            };
            let Some((network, radius)) = &self.predictors[number].network else {
                let [x, y] = track.point(NOW);
                let [vx, vy] = track.velocity[NOW];
                let at = |step: usize| [x + step as f64 * DT * vx, y + step as f64 * DT * vy];
                let trajectory: Vec<Point> = (1..=HORIZON).map(at).collect();
                let distances = truth.distances([&trajectory[..]]);
                for k in 0..KS.len() {
                    push(k, track.id.clone(), Measured { distances: Some(distances), ..vehicle.copied() });
                }
                continue;
            };
            let name = |error: sage_backbones::Error| error.of(data, example.track);
            let features = network.features(&data.observe()?, example.track, None).map_err(name)?;
            let encoding = network.encode(Arc::new(features))?;
            let propose = |k, selection| {
                propose(&**network, &encoding, k, selection, &mut Rng::new(0, "", "")).map_err(name)
            };
            let six = propose(6, Sampling::Nms { radius: *radius })?;
            let all = propose(EVALUATED, Sampling::Nms { radius: *radius })?;
            let lanes = data.index.motor_lanes();
            let on = six.iter().filter(|p| lanes.nearest(end(p), ON_LANE, |_| true).is_some()).count();
            let on_lanes = example.of_interest.then(|| on as f64 / six.len().max(1) as f64);
            for (k, of) in [&six[..1], &six, &all].into_iter().enumerate() {
                let (distances, on_lanes) = (Some(distances(&truth, of)), on_lanes.filter(|_| k == 0));
                push(k, track.id.clone(), Measured { distances, on_lanes, ..vehicle.copied() });
            }
            if Some(example.track) == data.scene.adversary {
                let top = propose(EVALUATED, Sampling::TopK)?;
                let random = random_modes(&**network, &encoding, &data.name)?;
                for (n, measured) in evaluated(data, top, random).into_iter().enumerate() {
                    push(0, format!("candidate {}", n + 1), measured);
                }
            }
        }
        Ok(cells)
    }
}

impl Measured {
    fn copied(&self) -> Self {
        Self { of_interest: self.of_interest, moves: self.moves, ..Self::default() }
    }
}

fn end(predicted: &Predicted) -> Point {
    predicted.trajectory.points()[HORIZON - 1]
}

fn distances(truth: &Recorded, candidates: &[Predicted]) -> Distances {
    truth.distances(candidates.iter().map(|p| p.trajectory.points()))
}

fn random_modes(network: &dyn Backbone, encoding: &Encoding, scene: &str) -> Result<Vec<Trajectory>> {
    let modes = network.mode_ends(encoding)?.len();
    let mut order: Vec<usize> = (0..modes).collect();
    Rng::new(0, scene, "random modes").shuffle(&mut order);
    order.truncate(EVALUATED);
    let trajectories = network.trajectories(encoding, &order)?;
    Ok(sage_backbones::backbone::trajectories_in_world(&trajectories, encoding.features())?)
}

/// Evaluates candidates of the adversary as attacks, if the scene has an ego path.
fn evaluated(data: &SceneData, top: Vec<Predicted>, random: Vec<Trajectory>) -> Vec<Measured> {
    let Ok(ctx) = Context::new(&data.scene, &data.index, &ContextOptions::default()) else {
        return Vec::new();
    };
    let scorer = Scorer::new(&ctx);
    let of_top = top.into_iter().map(|predicted| {
        let scores = scorer.scores(&ctx.candidate(predicted.trajectory));
        let top = Some([scores.kinematic_penalty, f64::from(u8::from(scores.feasible))]);
        Measured { top, ..Measured::default() }
    });
    let of_random = random.into_iter().map(|trajectory| {
        let random = Some(scorer.scores(&ctx.candidate(trajectory)).feasible);
        Measured { random, ..Measured::default() }
    });
    of_top.chain(of_random).collect()
}

impl Measurement for Predictions {
    fn keys(&self) -> &[Key] {
        &self.keys
    }

    fn metrics(&self) -> Vec<(Subject, Vec<MetricInfo>)> {
        vec![(Subject::Prediction, infos(&self.metrics))]
    }

    fn measure(&self, data: &SceneData) -> SceneResult {
        let examples = Examples::of(std::slice::from_ref(data)).filter(|example| example.is_whole);
        let mut result = SceneResult::default();
        for number in 0..self.predictors.len() {
            match self.of_predictor(number, data, examples.list()) {
                Ok(cells) => result.cells.extend(cells),
                Err(error) => {
                    let first = number * KS.len();
                    let failed = |k| Cell::failed(first + k, in_one_line(&error));
                    result.cells.extend((0..KS.len()).map(failed));
                }
            }
        }
        result
    }
}
