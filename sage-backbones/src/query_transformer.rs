//! Query transformer: up to 64 queries, each decoded to one trajectory.
//!
//! Queries start from anchors: a few goals far apart that need little acceleration. They attend to the scene
//! and to each other. Each query gives a probability, a shift of its end point and a smooth trajectory. So
//! the modes do not lie on a lattice, and each depends on the others. The design follows MTR and Wayformer
//! (Shi et al. 2022, Nayakanti et al. 2022) at a far smaller size.

use std::sync::Arc;

use candle_core::{DType, Module, Tensor};
use sage_core::{generator::Observation, motion::HORIZON, registry::Entry, seed::Rng};
use serde::{Deserialize, Serialize};

use crate::{
    Error, Parameters,
    backbone::{Backbone, Definition, Loss, MotionModel, ParameterGroup, Sample, Trainable, of_modes},
    candidates::suppressed,
    encoder::{Encoder, check_size},
    encoding::Encoding,
    features::{EdgeKinds, EgoForecast, Features, GOAL_COLUMNS, GoalColumn, STRIDE, Table, VECTOR_COLUMNS},
    interaction_head::{self, InteractionHead},
    labels,
    nn::{Attention, Linear, Mlp, log_softmax},
    parameters::Scope,
    smooth_path,
};

/// Maximum number of queries.
const QUERIES: usize = 64;
/// Shift of an end point for a network output of 1, metres.
const UNIT: f64 = 10.0;

/// Options of [`QueryTransformer`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct QueryTransformerOptions {
    /// Width of the states, even.
    pub hidden: usize,
    /// Rounds of attention among agents and map.
    pub rounds: usize,
    /// Attention layers of the queries.
    pub layers: usize,
    /// Edges in the features.
    pub edges: EdgeKinds,
    /// Seed of the initial weights.
    pub seed: u64,
}

impl Default for QueryTransformerOptions {
    fn default() -> Self {
        Self { hidden: 64, rounds: 2, layers: 2, edges: EdgeKinds::default(), seed: 0 }
    }
}

/// The query transformer.
pub struct QueryTransformer {
    definition: Definition,
    shape: QueryTransformerOptions,
    parts: Parts,
}

struct Parts {
    encoder: Encoder,
    anchor: Mlp,
    layers: Vec<Layer>,
    score: Mlp,
    score_out: Linear,
    end: Linear,
    path: Linear,
    interaction: InteractionHead,
}

/// `x + mlp([target ; x ; attention to the scene ; attention among the queries])`.
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
        Ok(Self {
            encoder: Encoder::new(scope, VECTOR_COLUMNS, width, Some(shape.rounds))?,
            anchor: Mlp::new(&scope.at("anchor"), GOAL_COLUMNS, width)?,
            layers: (0..shape.layers).map(layer).collect::<candle_core::Result<_>>()?,
            score: Mlp::new(&scope.at("score").at("hidden"), 2 * width, width)?,
            score_out: Linear::new(&scope.at("score").at("out"), width, 1)?,
            end: Linear::new(&scope.at("end"), width, 2)?,
            path: Linear::new(&scope.at("path"), width, smooth_path::CHANGES)?,
            interaction: InteractionHead::new(&scope.at("steering"))?,
        })
    }
}

impl QueryTransformer {
    fn over(definition: Definition, shape: QueryTransformerOptions) -> Result<Self, Error> {
        let parts = Parts::new(&definition.scope(), &shape)?;
        Ok(Self { definition, shape, parts })
    }

    /// The three states of an encoding: queries, the target, trajectories of all modes.
    fn states<'e>(&self, encoding: &'e Encoding) -> Result<&'e [Tensor; 3], Error> {
        encoding.states_of(self.tag())
    }

    /// Scores before the softmax, without the interaction head.
    fn raw_scores(&self, queries: &Tensor, target: &Tensor) -> candle_core::Result<Tensor> {
        let hidden = self.parts.score.forward_parts(&[target], &[queries])?;
        self.parts.score_out.forward(&hidden)?.squeeze(1)
    }

    /// Inputs of the interaction head for all modes.
    fn described<'e>(
        &self,
        encoding: &'e Encoding,
        trajectories: &Tensor,
    ) -> Result<Option<&'e Tensor>, Error> {
        encoding.head_inputs(|| {
            let points = smooth_path::every(&trajectories.detach(), STRIDE)?;
            Ok(interaction_head::describe(&points, encoding.features())?)
        })
    }

    /// Trajectories to the anchors, changed and shifted by the network's outputs.
    ///
    /// *Shapes*: (queries, 80, 2).
    fn decode(
        &self,
        queries: &Tensor,
        anchors: &[usize],
        features: &Features,
    ) -> candle_core::Result<Tensor> {
        let ends: Vec<[f32; 2]> = anchors.iter().map(|&goal| features.goals[goal]).collect();
        let n = ends.len();
        let to_anchors = smooth_path::paths(&self.parts.path.forward(queries)?, &ends, features.velocity[0])?;
        let shift = self.definition.constant(&smooth_path::end_shift()[..], (1, HORIZON))?;
        let moved = (self.parts.end.forward(queries)? * UNIT)?.reshape((2 * n, 1))?.matmul(&shift)?;
        to_anchors + moved.reshape((n, 2, HORIZON))?.transpose(1, 2)?
    }
}

impl Backbone for QueryTransformer {
    fn definition(&self) -> &Definition {
        &self.definition
    }

    fn with_parameters(&self, parameters: Parameters) -> Result<Box<dyn Backbone>, Error> {
        Ok(Box::new(Self::over(self.definition.with(parameters), self.shape.clone())?))
    }

    fn features(
        &self,
        now: &Observation,
        target: usize,
        ego: Option<&EgoForecast>,
    ) -> Result<Features, Error> {
        Features::of(now, target, ego, self.shape.edges)
    }

    fn encode(&self, features: Arc<Features>) -> Result<Encoding, Error> {
        let vectors = self.definition.tensor(&features.vectors)?;
        let encoded = self.parts.encoder.forward(&vectors, &features.groups, features.agents, 0)?;
        let anchors = anchors(&features);
        let rows: Vec<f32> =
            anchors.iter().flat_map(|&goal| features.goal_features.row(goal)).copied().collect();
        let rows = Table { columns: GOAL_COLUMNS, values: rows };
        let mut queries = self.parts.anchor.forward(&self.definition.tensor(&rows)?)?;
        for layer in &self.parts.layers {
            let scene = layer.scene.forward(&queries, &encoded.elements)?;
            let others = layer.queries.forward(&queries, &queries)?;
            let change = layer.mlp.forward_parts(&[&encoded.target], &[&queries, &scene, &others])?;
            queries = (queries + change)?;
        }
        let trajectories = self.decode(&queries, &anchors, &features)?;
        Ok(Encoding::new(self.tag(), features, vec![queries, encoded.target, trajectories]))
    }

    fn trainable(&self) -> Option<&dyn Trainable> {
        Some(self)
    }
}

impl Trainable for QueryTransformer {
    fn group_of(&self, name: &str) -> ParameterGroup {
        let among = name.starts_with("rounds.") || name.contains(".queries.");
        match name {
            "score.out.bias" => ParameterGroup::WithoutEffect,
            _ if name.ends_with("key.bias") => {
                if among {
                    ParameterGroup::Unused
                } else {
                    ParameterGroup::WithoutEffect
                }
            }
            _ if name.starts_with("steering.") => ParameterGroup::Interaction,
            _ if name.starts_with("score.") => ParameterGroup::Scoring,
            _ => ParameterGroup::Prior,
        }
    }

    fn mirrored(&self, features: &Features) -> Option<Features> {
        Some(features.mirrored())
    }

    fn loss(&self, sample: &Sample, _: &mut Rng) -> Result<Loss, Error> {
        let encoding = self.encode(sample.features.clone())?;
        let [queries, target, trajectories] = self.states(&encoding)?;
        let end = labels::end(&sample.future, &sample.valid);
        let ends = self.mode_ends(&encoding)?;
        let features = &sample.features;
        let anchor_ends: Vec<[f32; 2]> =
            anchors(features).into_iter().map(|goal| features.goals[goal]).collect();
        // The loss trains the trajectory that ends nearest and the one whose anchor is nearest. Without the
        // second, queries far from the recorded ends would never get a gradient.
        let winners = [labels::nearest(&ends, end.position), labels::nearest(&anchor_ends, end.position)];
        let log_probs = log_softmax(&self.raw_scores(queries, target)?)?;
        let goals = labels::cross_entropy(&log_probs, &labels::soft(&ends, end))?;
        let error = |mode: usize| labels::smooth_l1(&trajectories.narrow(0, mode, 1)?, sample);
        let trajectory = (error(winners[0])? + (error(winners[1])? * 0.3)?)?;
        Loss::of(vec![("goal", goals), ("trajectory", trajectory)])
    }
}

impl MotionModel for QueryTransformer {
    fn log_probs(&self, encoding: &Encoding) -> Result<Tensor, Error> {
        let [queries, target, trajectories] = self.states(encoding)?;
        let mut scores = self.raw_scores(queries, target)?;
        if !self.parts.interaction.is_zero()?
            && let Some(rows) = self.described(encoding, trajectories)?
        {
            scores = (scores + self.parts.interaction.forward(rows)?)?;
        }
        Ok(log_softmax(&scores)?)
    }

    fn log_probs_along(
        &self,
        encoding: &Encoding,
        log_probs: &Tensor,
        modes: &[usize],
        points: &Tensor,
    ) -> Result<Tensor, Error> {
        let [.., trajectories] = self.states(encoding)?;
        if !self.parts.interaction.is_zero()?
            && let Some(rows) = self.described(encoding, trajectories)?
        {
            return Ok(self.parts.interaction.along(log_probs, modes, rows, points, encoding.features())?);
        }
        Ok(of_modes(log_probs, modes)?)
    }

    fn mode_ends(&self, encoding: &Encoding) -> Result<Vec<[f32; 2]>, Error> {
        let [.., trajectories] = self.states(encoding)?;
        let ends = trajectories.narrow(1, HORIZON - 1, 1)?.flatten_all()?;
        let ends = ends.to_dtype(DType::F32)?.to_vec1::<f32>()?;
        Ok(ends.as_chunks::<2>().0.to_vec())
    }

    fn trajectories(&self, encoding: &Encoding, modes: &[usize]) -> Result<Tensor, Error> {
        let [.., trajectories] = self.states(encoding)?;
        Ok(of_modes(trajectories, modes)?)
    }
}

impl Entry<dyn Backbone> for QueryTransformer {
    const NAME: &'static str = "query-transformer";
    const SUMMARY: &'static str =
        "64 queries attend to the scene and to each other; each is decoded to one trajectory";
    const SOURCE: &'static str = "after Shi et al. 2022 (MTR), Nayakanti et al. 2022 (Wayformer)";
    type Options = QueryTransformerOptions;

    fn build(options: QueryTransformerOptions) -> Result<Box<dyn Backbone>, String> {
        let QueryTransformerOptions { hidden, rounds, layers, seed, .. } = options;
        check_size(hidden, rounds)?;
        if !(1..=16).contains(&layers) {
            return Err(format!("`layers` is {layers}; expected 1 to 16"));
        }
        let definition = Definition::of::<Self, _>(&options, seed, |scope| Parts::new(scope, &options))?;
        Ok(Box::new(Self::over(definition, options)?))
    }
}

/// Goals that queries start from: those that need the least acceleration and the fewest lane changes, at a
/// least distance from each other that grows with speed.
fn anchors(features: &Features) -> Vec<usize> {
    let effort = |goal: &usize| {
        let row = features.goal_features.row(*goal);
        let column = |c: GoalColumn| row[c as usize];
        let offset = 0.2 * column(GoalColumn::LaneOffset).abs();
        if column(GoalColumn::Reachable) > 0.0 {
            column(GoalColumn::RouteAcceleration).abs() + column(GoalColumn::Changes) + offset
        } else {
            1.5 + column(GoalColumn::StraightAcceleration).abs()
                + column(GoalColumn::LateralAcceleration).abs()
                + offset
        }
    };
    let mut order: Vec<usize> = (0..features.modes()).collect();
    order.sort_by(|a, b| effort(a).total_cmp(&effort(b)).then(a.cmp(b)));
    suppressed(&order, &features.goals, QUERIES, 3.5 + 0.25 * features.speed())
}
