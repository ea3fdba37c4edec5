//! A second kind of network: a fixed number of queries, each of which becomes one future.
//!
//! Queries start from anchors, which cover what a car can do by how much it speeds up and how far it
//! turns; they look at the scene and at each other, and each gives a probability, an end and a smooth
//! path. There is no lattice of goals: modes lie where the network puts them. In the spirit of Wayformer and
//! MTR (Nayakanti et al. 2022, Shi et al. 2022), far smaller.

use std::sync::Arc;

use candle_core::{DType, Device, Tensor};
use sage_core::{
    motion::HORIZON,
    registry::Entry,
    scene::{Scene, SceneIndex},
};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::{
    Error, Parameters,
    backbone::{Backbone, Encoding, Loss, Role, Sample, tensor},
    encoder::Encoder,
    features::{Features, VECTOR_COLUMNS},
    labels,
    nn::{Attention, Init, Linear, Mlp, log_softmax},
    parameters::{Scope, Wanted},
    smooth_path,
    steering_branch::{self, SteeringBranch},
};

/// Mean accelerations of the anchors, m/s².
const SPEEDS_UP: [f32; 8] = [-2.0, -1.2, -0.7, -0.3, 0.0, 0.3, 0.8, 1.5];
/// Turns of the anchors, radians.
const TURNS: [f32; 9] = [-1.6, -0.9, -0.4, -0.12, 0.0, 0.12, 0.4, 0.9, 1.6];
/// Number of queries.
const QUERIES: usize = SPEEDS_UP.len() * TURNS.len();
/// Numbers that describe an anchor.
const ANCHOR_COLUMNS: usize = 8;
/// Length of an end's move that the network asks for with 1, metres.
const UNIT: f64 = 10.0;

/// Options of [`QueryTransformer`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct QueryTransformerOptions {
    /// Width of the states, even.
    pub hidden: usize,
    /// Rounds of attention among agents and map.
    pub rounds: usize,
    /// Layers that the queries pass.
    pub layers: usize,
    /// Seed of the first weights.
    pub seed: u64,
}

impl Default for QueryTransformerOptions {
    fn default() -> Self {
        Self { hidden: 64, rounds: 2, layers: 2, seed: 0 }
    }
}

/// The network.
pub struct QueryTransformer {
    options: Value,
    shape: QueryTransformerOptions,
    wanted: Arc<[Wanted]>,
    parameters: Parameters,
    dtype: DType,
    parts: Parts,
}

struct Parts {
    encoder: Encoder,
    anchor: Mlp,
    /// What tells the queries apart beside their anchors (queries, hidden).
    own: Tensor,
    layers: Vec<Layer>,
    score: Mlp,
    score_out: Linear,
    end: Linear,
    path: Linear,
    steering: SteeringBranch,
}

/// `x + mlp([scene ; x ; what x sees ; what the other queries say])`.
struct Layer {
    scene: Attention,
    queries: Attention,
    mlp: Mlp,
}

impl Parts {
    fn new(scope: &Scope, shape: &QueryTransformerOptions) -> candle_core::Result<Self> {
        let width = shape.hidden;
        let layer = |k: usize| {
            let scope = scope.at("layers").at(k);
            Ok(Layer {
                scene: Attention::across(&scope.at("scene"), width, width)?,
                queries: Attention::among(&scope.at("queries"), width, width)?,
                mlp: Mlp::new(&scope.at("mlp"), 4 * width, width)?,
            })
        };
        let queries = scope.at("query");
        Ok(Self {
            encoder: Encoder::new(scope, VECTOR_COLUMNS, width, Some(shape.rounds))?,
            anchor: Mlp::new(&queries.at("anchor"), ANCHOR_COLUMNS, width)?,
            own: queries.tensor("own", &[QUERIES, width], Init::Uniform { fan_in: width })?,
            layers: (0..shape.layers).map(layer).collect::<candle_core::Result<_>>()?,
            score: Mlp::new(&scope.at("score").at("hidden"), 2 * width, width)?,
            score_out: Linear::new(&scope.at("score").at("out"), width, 1)?,
            end: Linear::new(&scope.at("end"), width, 2)?,
            path: Linear::new(&scope.at("path"), width, smooth_path::CHANGES)?,
            steering: SteeringBranch::new(&scope.at("steering"))?,
        })
    }
}

impl QueryTransformer {
    fn build(
        options: Value,
        shape: QueryTransformerOptions,
        wanted: Arc<[Wanted]>,
        parameters: Parameters,
    ) -> Result<Self, Error> {
        let parts = Parts::new(&Scope::of(&parameters), &shape)?;
        let dtype = parameters.iter().next().map_or(DType::F32, |(_, tensor)| tensor.dtype());
        Ok(Self { options, shape, wanted, parameters, dtype, parts })
    }

    /// The three states of an encoding: queries, the target, paths of all modes.
    fn states<'e>(&self, encoding: &'e Encoding) -> Result<[&'e Tensor; 3], Error> {
        let [queries, target, paths] = encoding.states() else { return Err(encoding.foreign()) };
        Ok([queries, target, paths])
    }

    /// Scores before the softmax, without the steering branch.
    fn raw_scores(&self, queries: &Tensor, target: &Tensor) -> candle_core::Result<Tensor> {
        let hidden = self.parts.score.forward_parts(&[target], &[queries])?;
        self.parts.score_out.forward(&hidden)?.squeeze(1)
    }

    fn constant(&self, values: Vec<f64>, shape: (usize, usize)) -> candle_core::Result<Tensor> {
        Tensor::from_vec(values, shape, &Device::Cpu)?.to_dtype(self.dtype)
    }

    /// Paths (queries, 80, 2): to the anchors, moved by what the network asks for.
    fn paths(&self, queries: &Tensor, features: &Features) -> candle_core::Result<Tensor> {
        let ends = anchors(features.speed());
        let plain = smooth_path::paths(&self.parts.path.forward(queries)?, &ends, features.velocity[0])?;
        let shift = self.constant(smooth_path::end_shift(), (1, HORIZON))?;
        let moved = (self.parts.end.forward(queries)? * UNIT)?.reshape((2 * QUERIES, 1))?.matmul(&shift)?;
        plain + moved.reshape((QUERIES, 2, HORIZON))?.transpose(1, 2)?
    }
}

impl Backbone for QueryTransformer {
    fn name(&self) -> &'static str {
        <Self as Entry<dyn Backbone>>::NAME
    }

    fn options(&self) -> &Value {
        &self.options
    }

    fn wanted(&self) -> &[Wanted] {
        &self.wanted
    }

    fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    fn rebuilt(&self, parameters: Parameters) -> Result<Box<dyn Backbone>, Error> {
        let (options, wanted) = (self.options.clone(), self.wanted.clone());
        Ok(Box::new(Self::build(options, self.shape.clone(), wanted, parameters)?))
    }

    fn role(&self, name: &str) -> Role {
        let among = name.starts_with("rounds.") || name.contains(".queries.");
        match name {
            "score.out.bias" => Role::WithoutEffect,
            _ if name.ends_with("key.bias") => {
                if among {
                    Role::Unused
                } else {
                    Role::WithoutEffect
                }
            }
            _ if name.starts_with("steering.") => Role::Steering,
            _ if name.starts_with("score.") => Role::Scoring,
            _ => Role::Prior,
        }
    }

    fn features(&self, scene: &Scene, index: &SceneIndex, target: usize) -> Result<Features, Error> {
        Features::of(scene, index, target)
    }

    fn encode(&self, features: Arc<Features>) -> Result<Encoding, Error> {
        let vectors = tensor(&features.vectors, self.dtype)?;
        let encoded = self.parts.encoder.forward(&vectors, &features.groups, features.agents, 0)?;
        let rows = self.constant(describe(features.speed()), (QUERIES, ANCHOR_COLUMNS))?;
        let mut queries = (self.parts.anchor.forward(&rows)? + &self.parts.own)?;
        for layer in &self.parts.layers {
            let seen = layer.scene.forward(&queries, &encoded.elements)?;
            let heard = layer.queries.forward(&queries, &queries)?;
            let change = layer.mlp.forward_parts(&[&encoded.target], &[&queries, &seen, &heard])?;
            queries = (queries + change)?;
        }
        let paths = self.paths(&queries, &features)?;
        Ok(Encoding::new(features, vec![queries, encoded.target, paths]))
    }

    fn log_probs(&self, encoding: &Encoding) -> Result<Tensor, Error> {
        let [queries, target, paths] = self.states(encoding)?;
        let mut scores = self.raw_scores(queries, target)?;
        if !self.parts.steering.is_silent()?
            && let Some(rows) = encoding.described(|| Ok(steering_branch::describe(&paths.detach(), encoding.features())?))?
        {
            scores = (scores + self.parts.steering.forward(rows)?)?;
        }
        Ok(log_softmax(&scores)?)
    }

    fn mode_ends(&self, encoding: &Encoding) -> Result<Vec<[f32; 2]>, Error> {
        let [.., paths] = self.states(encoding)?;
        let ends = paths.narrow(1, HORIZON - 1, 1)?.flatten_all()?.to_dtype(DType::F32)?.to_vec1::<f32>()?;
        Ok(ends.as_chunks::<2>().0.to_vec())
    }

    fn trajectories(&self, encoding: &Encoding, modes: &[usize]) -> Result<Tensor, Error> {
        let [.., paths] = self.states(encoding)?;
        let index: Vec<u32> = modes.iter().map(|&mode| mode as u32).collect();
        Ok(paths.index_select(&Tensor::from_vec(index, modes.len(), &Device::Cpu)?, 0)?)
    }

    fn loss(&self, sample: &Sample) -> Result<Loss, Error> {
        let encoding = self.encode(sample.features.clone())?;
        let [queries, target, paths] = self.states(&encoding)?;
        let end = labels::end(&sample.future, &sample.valid);
        let ends = self.mode_ends(&encoding)?;
        // The path that ends nearest learns the way, and so does the one whose anchor is nearest, or
        // far queries would never learn anything.
        let winners = [
            labels::nearest(&ends, end.position),
            labels::nearest(&anchors(sample.features.speed()), end.position),
        ];
        let log_probs = log_softmax(&self.raw_scores(queries, target)?)?;
        let goals = labels::cross_entropy(&log_probs, &labels::soft(&ends, end))?;
        let path = |mode: usize| labels::smooth_l1(&paths.narrow(0, mode, 1)?, sample);
        let way = (path(winners[0])? + (path(winners[1])? * 0.3)?)?;
        Loss::of(vec![("goal", goals), ("path", way)])
    }
}

impl Entry<dyn Backbone> for QueryTransformer {
    const NAME: &'static str = "query-transformer";
    const SUMMARY: &'static str = "72 queries look at the scene, and each becomes one future";
    const SOURCE: &'static str = "after Shi et al. 2022 (MTR), Nayakanti et al. 2022 (Wayformer)";
    type Options = QueryTransformerOptions;

    fn build(options: QueryTransformerOptions) -> Result<Box<dyn Backbone>, String> {
        let QueryTransformerOptions { hidden, rounds, layers, seed } = options;
        if !(8..=512).contains(&hidden) || hidden % 2 == 1 {
            return Err(format!("`hidden` is {hidden}; expected an even number from 8 to 512"));
        }
        if !(1..=16).contains(&rounds) || !(1..=16).contains(&layers) {
            return Err(format!("`rounds` is {rounds} and `layers` {layers}; expected 1 to 16"));
        }
        let build = || {
            let wanted = Scope::list(|scope| Parts::new(scope, &options))?;
            let parameters = Parameters::start(&wanted, seed)?;
            let json = serde_json::to_value(&options).unwrap_or_default();
            Self::build(json, options.clone(), wanted.into(), parameters)
        };
        Ok(Box::new(build().map_err(|e| e.to_string())?))
    }
}

/// Where the anchors end at a speed *now*: on arcs, after a way that a steady acceleration gives.
fn anchors(speed: f32) -> Vec<[f32; 2]> {
    let mut ends = Vec::with_capacity(QUERIES);
    for gain in SPEEDS_UP {
        // A car that would stand still before the eight seconds are over stops.
        let steady = 8.0 * speed + 32.0 * gain;
        let stopping = if gain < 0.0 { speed * speed / (-2.0 * gain) } else { 0.0 };
        let way = if gain < 0.0 && speed < -8.0 * gain { stopping } else { steady };
        for turn in TURNS {
            let (along, across) =
                if turn.abs() < 1e-3 { (1.0, 0.0) } else { (turn.sin() / turn, (1.0 - turn.cos()) / turn) };
            ends.push([way * along, way * across]);
        }
    }
    ends
}

/// A row an anchor.
fn describe(speed: f32) -> Vec<f64> {
    let turn = |k: usize| TURNS[k % TURNS.len()];
    let row = |(k, end): (usize, [f32; 2])| {
        let way = end[0].hypot(end[1]);
        [
            end[0] / 40.0,
            end[1] / 40.0,
            way / 40.0,
            SPEEDS_UP[k / TURNS.len()] / 2.0,
            turn(k).sin(),
            turn(k).cos(),
            speed / 10.0,
            (-way / 4.0).exp(),
        ]
    };
    anchors(speed).into_iter().enumerate().flat_map(row).map(f64::from).collect()
}
