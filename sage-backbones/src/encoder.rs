//! Encoder from feature rows to states: one for each agent and each map polyline, and the target's.

use candle_core::{Module, Result, Tensor};

use crate::{
    nn::{Attention, Groups, Linear, Mlp, max_of_others, max_of_rows},
    parameters::Scope,
};

/// Layers of the polyline encoder.
const LAYERS: usize = 3;

pub(crate) struct Encoder {
    polyline: Vec<Mlp>,
    mixing: Mixing,
}

enum Mixing {
    Published(Box<Published>),
    Rounds(Vec<Round>),
}

/// Lane fusion and global graph as published.
struct Published {
    fusion: Attention,
    graph: [Attention; 2],
}

/// One round: `x + mlp([x ; attention(x)])`.
struct Round {
    heads: [Attention; 2],
    mlp: Mlp,
}

/// Output of the encoder.
pub(crate) struct Encoded {
    /// States after the polyline encoder (P, hidden).
    pub polylines: Tensor,
    /// States that goals attend to (P, hidden).
    pub elements: Tensor,
    /// States after the global graph (P, hidden).
    pub graph: Tensor,
    /// The target's state (1, hidden).
    pub target: Tensor,
}

/// Refuses sizes out of range.
///
/// *Errors*: the option and its value.
pub(crate) fn check_size(hidden: usize, rounds: usize) -> std::result::Result<(), String> {
    if !(8..=512).contains(&hidden) || hidden % 2 == 1 {
        return Err(format!("`hidden` is {hidden}; expected an even number from 8 to 512"));
    }
    if !(1..=16).contains(&rounds) {
        return Err(format!("`rounds` is {rounds}; expected 1 to 16"));
    }
    Ok(())
}

impl Encoder {
    /// An encoder from rows of `columns` numbers to states of `width`. States are mixed in `rounds` of
    /// attention, or as published for `None`.
    pub(crate) fn new(scope: &Scope, columns: usize, width: usize, rounds: Option<usize>) -> Result<Self> {
        let layers = scope.at("sub_graph").at("layers");
        let inputs = |layer| if layer == 0 { columns } else { width };
        let polyline =
            (0..LAYERS).map(|l| Mlp::new(&layers.at(l), inputs(l), width / 2)).collect::<Result<_>>()?;
        let mixing = match rounds {
            None => Mixing::Published(Box::new(Published::new(scope, width)?)),
            Some(rounds) => {
                let round = |k| Round::new(&scope.at("rounds").at(k), width);
                Mixing::Rounds((0..rounds).map(round).collect::<Result<_>>()?)
            }
        };
        Ok(Self { polyline, mixing })
    }

    /// States of the groups. In the published arrangement, attention also reads `padding_keys` rows of zeros,
    /// as in a padded batch.
    ///
    /// *Shapes*: `vectors` (rows, columns); results as in [`Encoded`].
    pub(crate) fn forward(
        &self,
        vectors: &Tensor,
        groups: &Groups,
        agents: usize,
        padding_keys: usize,
    ) -> Result<Encoded> {
        let mut x = vectors.clone();
        for layer in &self.polyline {
            x = max_of_others(&layer.forward(&x)?, groups)?;
        }
        let polylines = max_of_rows(&x, groups)?;
        match &self.mixing {
            Mixing::Published(published) => published.forward(polylines, agents, padding_keys),
            Mixing::Rounds(rounds) => {
                let mut x = polylines.clone();
                for round in rounds {
                    x = round.forward(&x)?;
                }
                let target = x.narrow(0, 0, 1)?;
                Ok(Encoded { polylines, elements: x.clone(), graph: x, target })
            }
        }
    }
}

impl Published {
    fn new(scope: &Scope, width: usize) -> Result<Self> {
        let graph = |name: &str| -> Result<[Attention; 2]> {
            let scope = scope.at(name);
            Ok([
                Attention::among(&scope.at("global_graph"), width, width / 2)?,
                Attention::among(&scope.at("global_graph2"), width, width / 2)?,
            ])
        };
        // The published weights contain three modules that are never read.
        graph("laneGCN_L2L")?;
        Attention::across(&scope.at("laneGCN_L2A"), width, width)?;
        let unread = scope.at("decoder").at("decoder");
        Mlp::new(&unread.at("mlp"), width, width)?;
        Linear::new(&unread.at("fc"), width, 2)?;
        Ok(Self {
            fusion: Attention::across(&scope.at("laneGCN_A2L"), width, width)?,
            graph: graph("global_graph")?,
        })
    }

    fn forward(&self, polylines: Tensor, agents: usize, padding_keys: usize) -> Result<Encoded> {
        let count = polylines.dim(0)?;
        let own = polylines.narrow(0, 0, agents)?;
        let elements = if count > agents {
            let map = polylines.narrow(0, agents, count - agents)?;
            let keys = Tensor::cat(&[&map, &own.narrow(0, 0, 1)?], 0)?;
            let map = (&map + self.fusion.forward(&map, &keys)?)?;
            Tensor::cat(&[&own, &map], 0)?
        } else {
            own
        };
        let keys = elements.pad_with_zeros(0, 0, padding_keys)?;
        let [a, b] = &self.graph;
        let graph = Tensor::cat(&[a.forward(&elements, &keys)?, b.forward(&elements, &keys)?], 1)?;
        let target = graph.narrow(0, 0, 1)?;
        Ok(Encoded { polylines, elements, graph, target })
    }
}

impl Round {
    fn new(scope: &Scope, width: usize) -> Result<Self> {
        let head = |k: usize| Attention::among(&scope.at(format!("head{k}")), width, width / 2);
        Ok(Self { heads: [head(0)?, head(1)?], mlp: Mlp::new(&scope.at("mlp"), 2 * width, width)? })
    }

    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let [a, b] = &self.heads;
        let change = self.mlp.forward_parts(&[], &[x, &a.forward(x, x)?, &b.forward(x, x)?])?;
        x + change
    }
}
