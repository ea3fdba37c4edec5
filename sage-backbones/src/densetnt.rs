//! DenseTNT (Gu et al., 2021): dense goals are scored, and each decodes to a trajectory.
//!
//! Polylines are encoded and mixed by attention. Goals attend to the resulting states. The published network
//! and ours have the same modules in two arrangements; `docs/method.md` explains the differences.

mod head;
mod scorer;

use std::sync::Arc;

use candle_core::Tensor;
use sage_core::{generator::Observation, geometry::Point, registry::Entry, seed::Rng};
use serde::{Deserialize, Serialize};

use crate::{
    Error, Parameters,
    backbone::{Backbone, Definition, Loss, MotionModel, ParameterGroup, Sample, Trainable, of_modes},
    encoder::{Encoder, check_size},
    encoding::Encoding,
    features::{EdgeKinds, EgoForecast, Features, GOAL_COLUMNS, STRIDE, VECTOR_COLUMNS, cat},
    interaction_head::{InteractionHead, describe},
    labels,
    nn::log_softmax,
    parameters::Scope,
};
use head::Head;
use scorer::Scorer;

pub use head::HeadKind;

/// Arrangement and sizes of the modules.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Shape {
    hidden: usize,
    vector_columns: usize,
    goal_columns: usize,
    /// Rounds of attention among the elements; `None` for the published lane fusion and graph.
    rounds: Option<usize>,
    head: HeadKind,
    interaction: bool,
    edges: EdgeKinds,
}

/// Options of our own arrangement.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DenseTntOptions {
    /// Width of the states, even.
    pub hidden: usize,
    /// Rounds of attention among agents and map.
    pub rounds: usize,
    /// How a goal is decoded to a trajectory.
    pub head: HeadKind,
    /// Edges in the features.
    pub edges: EdgeKinds,
    /// Seed of the initial weights.
    pub seed: u64,
}

impl Default for DenseTntOptions {
    fn default() -> Self {
        Self { hidden: 64, rounds: 3, head: HeadKind::Bernstein, edges: EdgeKinds::default(), seed: 0 }
    }
}

/// Options of the published arrangement.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CatOptions {
    /// Seed of the initial weights.
    pub seed: u64,
}

/// The network, in either arrangement.
pub struct DenseTnt {
    definition: Definition,
    shape: Shape,
    encoder: Encoder,
    scorer: Scorer,
    head: Head,
}

impl DenseTnt {
    fn untrained<N: Entry<dyn Backbone>>(
        options: &N::Options,
        shape: Shape,
        seed: u64,
    ) -> Result<Self, Error> {
        Self::over(Definition::of::<N, _>(options, seed, |scope| Parts::new(scope, &shape))?, shape)
    }

    fn over(definition: Definition, shape: Shape) -> Result<Self, Error> {
        let Parts { encoder, scorer, head } = Parts::new(&definition.scope(), &shape)?;
        Ok(Self { definition, shape, encoder, scorer, head })
    }

    fn is_published(&self) -> bool {
        self.shape.rounds.is_none()
    }

    /// Encodes one target as the published code does in a batch of several targets. That code pads all
    /// targets to the same number of polylines; `padding_keys` is the number of padding polylines of this
    /// target.
    ///
    /// *Errors*: [`Error::Tensor`] for features of another network.
    pub fn encode_padded(&self, features: &Arc<Features>, padding_keys: usize) -> Result<Encoding, Error> {
        let vectors = self.definition.tensor(&features.vectors)?;
        let encoded = self.encoder.forward(&vectors, &features.groups, features.agents, padding_keys)?;
        let goals = self.definition.tensor(&features.goal_features)?;
        Ok(Encoding::new(
            self.tag(),
            features.clone(),
            vec![encoded.elements, encoded.target, goals, encoded.polylines, encoded.graph],
        ))
    }

    /// Scores of all or of some goals, before the softmax and without the interaction head.
    ///
    /// *Shapes*: (n).
    /// *Errors*: an encoding of another network.
    fn raw_scores(&self, encoding: &Encoding, modes: Option<&[usize]>) -> Result<Tensor, Error> {
        let [elements, target, goals] = encoding.states_of(self.tag())?;
        Ok(match modes {
            Some(modes) => self.scorer.forward(&of_modes(goals, modes)?, elements, target)?,
            None => self.scorer.forward(goals, elements, target)?,
        })
    }

    /// Trajectories to goals.
    ///
    /// *Shapes*: `rows` (n, columns) describe goals at `ends`; result (n, 80 / `stride`, 2), target frame.
    /// *Errors*: an encoding of another network.
    fn decode(
        &self,
        encoding: &Encoding,
        rows: &Tensor,
        ends: &[[f32; 2]],
        stride: usize,
    ) -> Result<Tensor, Error> {
        let [elements, target] = encoding.states_of(self.tag())?;
        Ok(self.head.forward(rows, ends, elements, target, encoding.features().velocity, stride)?)
    }

    /// The interaction head and its inputs for all goals; `None` if its output is zero or it has no inputs.
    fn interaction<'e>(
        &'e self,
        encoding: &'e Encoding,
    ) -> Result<Option<(&'e InteractionHead, &'e Tensor)>, Error> {
        match self.scorer.interaction() {
            Some(head) if !head.is_zero()? => Ok(self.described(encoding)?.map(|rows| (head, rows))),
            _ => Ok(None),
        }
    }

    /// Inputs of the interaction head for all goals, computed once per encoding, without gradient.
    fn described<'e>(&self, encoding: &'e Encoding) -> Result<Option<&'e Tensor>, Error> {
        encoding.head_inputs(|| {
            let [_, _, goals] = encoding.states_of(self.tag())?;
            let points = self.decode(encoding, goals, &encoding.features().goals, STRIDE)?.detach();
            Ok(describe(&points, encoding.features())?)
        })
    }
}

struct Parts {
    encoder: Encoder,
    scorer: Scorer,
    head: Head,
}

impl Parts {
    fn new(scope: &Scope, shape: &Shape) -> candle_core::Result<Self> {
        Ok(Self {
            encoder: Encoder::new(scope, shape.vector_columns, shape.hidden, shape.rounds)?,
            scorer: Scorer::new(&scope.at("decoder"), shape)?,
            head: Head::new(&scope.at("decoder"), shape)?,
        })
    }
}

impl Backbone for DenseTnt {
    fn definition(&self) -> &Definition {
        &self.definition
    }

    fn with_parameters(&self, parameters: Parameters) -> Result<Box<dyn Backbone>, Error> {
        Ok(Box::new(Self::over(self.definition.with(parameters), self.shape)?))
    }

    fn features(
        &self,
        now: &Observation,
        target: usize,
        ego: Option<&EgoForecast>,
    ) -> Result<Features, Error> {
        if self.is_published() {
            cat::features(now.scene(), target)
        } else {
            Features::of(now, target, ego, self.shape.edges)
        }
    }

    fn encode(&self, features: Arc<Features>) -> Result<Encoding, Error> {
        self.encode_padded(&features, 0)
    }

    fn trainable(&self) -> Option<&dyn Trainable> {
        Some(self)
    }
}

impl Trainable for DenseTnt {
    fn group_of(&self, name: &str) -> ParameterGroup {
        const UNUSED: [&str; 3] = ["laneGCN_L2L.", "laneGCN_L2A.", "decoder.decoder."];
        let among = name.starts_with("global_graph.") || name.starts_with("rounds.");
        if UNUSED.iter().any(|prefix| name.starts_with(prefix)) || (among && name.ends_with("key.bias")) {
            ParameterGroup::Unused
        } else if name.ends_with("key.bias") || name == "decoder.goals_2D_decoder.fc.bias" {
            ParameterGroup::WithoutEffect
        } else if name.starts_with("decoder.steering.") {
            ParameterGroup::Interaction
        } else if name.starts_with("decoder.goals_2D_") && !name.starts_with("decoder.goals_2D_mlps.") {
            ParameterGroup::Scoring
        } else {
            ParameterGroup::Prior
        }
    }

    fn labelled_features(&self, now: &Observation, target: usize, end: Point) -> Result<Features, Error> {
        if self.is_published() {
            cat::features(now.scene(), target)
        } else {
            Features::with_label(now, target, self.shape.edges, end)
        }
    }

    fn mirrored(&self, features: &Features) -> Option<Features> {
        (!self.is_published()).then(|| features.mirrored())
    }

    fn loss(&self, sample: &Sample, _: &mut Rng) -> Result<Loss, Error> {
        let features = &sample.features;
        let encoding = self.encode(features.clone())?;
        let log_probs = log_softmax(&self.raw_scores(&encoding, None)?)?;
        let end = labels::end(&sample.future, &sample.valid);
        let (weights, trajectory) = match &features.label {
            Some((label, row)) if !self.is_published() => {
                let row = self.definition.tensor(row)?;
                (labels::soft(&features.goals, end), self.decode(&encoding, &row, &[*label], 1)?)
            }
            _ => {
                let nearest = labels::nearest(&features.goals, end.position);
                let mut hard = vec![0.0; features.modes()];
                hard[nearest] = 1.0;
                (hard, self.trajectories(&encoding, &[nearest])?)
            }
        };
        let goals = labels::cross_entropy(&log_probs, &weights)?;
        let trajectory = labels::smooth_l1(&trajectory, sample)?;
        Loss::of(vec![("goal", goals), ("trajectory", trajectory)])
    }
}

impl MotionModel for DenseTnt {
    fn log_probs(&self, encoding: &Encoding) -> Result<Tensor, Error> {
        let mut scores = self.raw_scores(encoding, None)?;
        if let Some((head, rows)) = self.interaction(encoding)? {
            scores = (scores + head.forward(rows)?)?;
        }
        Ok(log_softmax(&scores)?)
    }

    fn relative_log_probs(&self, encoding: &Encoding, modes: &[usize]) -> Result<Tensor, Error> {
        let scores = self.raw_scores(encoding, Some(modes))?;
        if let Some((head, rows)) = self.interaction(encoding)? {
            return Ok((scores + head.forward(&of_modes(rows, modes)?)?)?);
        }
        Ok(scores)
    }

    fn log_probs_along(
        &self,
        encoding: &Encoding,
        log_probs: &Tensor,
        modes: &[usize],
        points: &Tensor,
    ) -> Result<Tensor, Error> {
        if let Some((head, rows)) = self.interaction(encoding)? {
            return Ok(head.along(log_probs, modes, rows, points, encoding.features())?);
        }
        Ok(of_modes(log_probs, modes)?)
    }

    fn mode_ends(&self, encoding: &Encoding) -> Result<Vec<[f32; 2]>, Error> {
        Ok(encoding.features().goals.clone())
    }

    fn trajectories(&self, encoding: &Encoding, modes: &[usize]) -> Result<Tensor, Error> {
        let [_, _, goals] = encoding.states_of(self.tag())?;
        let rows = of_modes(goals, modes)?;
        let ends: Vec<[f32; 2]> = modes.iter().map(|&mode| encoding.features().goals[mode]).collect();
        self.decode(encoding, &rows, &ends, 1)
    }
}

impl Entry<dyn Backbone> for DenseTnt {
    const NAME: &'static str = "densetnt";
    const SUMMARY: &'static str = "dense goals along the lanes, scored and decoded to smooth trajectories";
    const SOURCE: &'static str = "Gu et al. 2021, rearranged for one CPU core";
    type Options = DenseTntOptions;

    fn build(options: DenseTntOptions) -> Result<Box<dyn Backbone>, String> {
        let DenseTntOptions { hidden, rounds, head, edges, seed } = options;
        check_size(hidden, rounds)?;
        let shape = Shape {
            hidden,
            vector_columns: VECTOR_COLUMNS,
            goal_columns: GOAL_COLUMNS,
            rounds: Some(rounds),
            head,
            interaction: true,
            edges,
        };
        Ok(Box::new(Self::untrained::<Self>(&options, shape, seed)?))
    }
}

/// The published arrangement: CAT's options without the raster branch.
pub struct Cat;

impl Cat {
    /// The network with initial weights from a seed.
    ///
    /// *Errors*: options out of range.
    pub fn untrained(options: &CatOptions) -> Result<DenseTnt, Error> {
        let shape = Shape {
            hidden: 128,
            vector_columns: 128,
            goal_columns: 2,
            rounds: None,
            head: HeadKind::Waypoints,
            interaction: false,
            edges: EdgeKinds::default(),
        };
        DenseTnt::untrained::<Self>(options, shape, options.seed)
    }

    /// The network with weights of the published names and shapes; `what` names their source.
    ///
    /// *Errors*: [`Error::Weights`] with every missing, extra and misshapen tensor.
    pub fn with_weights(weights: Parameters, what: &str) -> Result<DenseTnt, Error> {
        let untrained = Self::untrained(&CatOptions::default())?;
        let problems = weights.mismatches(&untrained.definition.specs);
        if !problems.is_empty() {
            return Err(Error::Weights { what: what.to_owned(), problems });
        }
        DenseTnt::over(untrained.definition.with(weights), untrained.shape)
    }
}

impl Entry<dyn Backbone> for Cat {
    const NAME: &'static str = "densetnt-cat";
    const SUMMARY: &'static str = "the published network of CAT, quirks included, without raster";
    const SOURCE: &'static str = "Zhang et al. 2023 (CAT), Gu et al. 2021";
    type Options = CatOptions;

    fn build(options: CatOptions) -> Result<Box<dyn Backbone>, String> {
        Ok(Box::new(Self::untrained(&options)?))
    }
}
