//! Layers with parameters. Each is built from a [`Scope`], which provides tensors by name. Those of one input are
//! candle's [`Module`], so they stand in a `candle_nn::Sequential`.
//!
//! A layer stores the tensors of its scope and nothing computed from them. So its results change when the
//! variables of its network are set.

use candle_core::{Module, Result, Tensor};

use super::{
    add_row::{add_row, add_row_in_place},
    groups::Groups,
    norm_relu::{norm_relu_by_group, norm_relu_in_place},
    softmax::softmax_in_place,
};
use crate::parameters::{Init, Scope};

/// `W x + b`.
#[derive(Clone, Debug)]
pub struct Linear {
    /// (outputs, inputs).
    pub weight: Tensor,
    /// (outputs).
    pub bias: Tensor,
}

impl Linear {
    /// Takes `weight` and `bias` from the scope.
    pub fn new(scope: &Scope, inputs: usize, outputs: usize) -> Result<Self> {
        Self::with_init(scope, inputs, outputs, Init::Uniform { fan_in: inputs })
    }

    /// A layer whose output is zero until it is trained.
    pub fn zero(scope: &Scope, inputs: usize, outputs: usize) -> Result<Self> {
        Self::with_init(scope, inputs, outputs, Init::Constant(0.0))
    }

    fn with_init(scope: &Scope, inputs: usize, outputs: usize, init: Init) -> Result<Self> {
        Ok(Self {
            weight: scope.tensor("weight", &[outputs, inputs], init)?,
            bias: scope.tensor("bias", &[outputs], init)?,
        })
    }

    /// `W x + b` for an input of several parts side by side. A part has either n rows or one row that all
    /// share; the product with a shared row is computed once.
    ///
    /// *Shapes*: `shared` (1, a), …, then `rows` (n, b), (n, c), …, in this order along the inputs; result
    /// (n, outputs).
    pub fn forward_parts(&self, shared: &[&Tensor], rows: &[&Tensor]) -> Result<Tensor> {
        let (product, row) = self.parts(shared, rows)?;
        add_row_in_place(product, &row)
    }

    /// The product over `rows`, and the row to add to each of its rows. The shared parts come first.
    fn parts(&self, shared: &[&Tensor], rows: &[&Tensor]) -> Result<(Tensor, Tensor)> {
        let mut at = 0;
        let mut slice = |part: &Tensor| -> Result<Tensor> {
            let width = part.dim(1)?;
            at += width;
            part.matmul(&self.weight.narrow(1, at - width, width)?.t()?)
        };
        let mut row = self.bias.unsqueeze(0)?;
        for part in shared {
            row = (row + slice(part)?)?;
        }
        let mut product: Option<Tensor> = None;
        for part in rows {
            let next = slice(part)?;
            product = Some(match product {
                Some(sum) => (sum + next)?,
                None => next,
            });
        }
        match product {
            Some(product) => Ok((product, row)),
            None => candle_core::bail!("a linear layer without rows"),
        }
    }
}

impl Module for Linear {
    /// *Shapes*: `x` (n, inputs); result (n, outputs).
    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        add_row_in_place(x.matmul(&self.weight.t()?)?, &self.bias)
    }
}

/// `max(0, norm(W x + b))`.
#[derive(Clone, Debug)]
pub struct Mlp {
    linear: Linear,
    gamma: Tensor,
    beta: Tensor,
}

impl Mlp {
    /// Takes `linear.*` and `layer_norm.*` from the scope.
    pub fn new(scope: &Scope, inputs: usize, outputs: usize) -> Result<Self> {
        let norm = scope.at("layer_norm");
        Ok(Self {
            linear: Linear::new(&scope.at("linear"), inputs, outputs)?,
            gamma: norm.tensor("weight", &[outputs], Init::Constant(1.0))?,
            beta: norm.tensor("bias", &[outputs], Init::Constant(0.0))?,
        })
    }

    // Stacked in every call, because a stored copy would not change with training.
    fn scale(&self) -> Result<Tensor> {
        Tensor::stack(&[&self.gamma, &self.beta], 0)
    }

    fn finish(&self, product: Tensor, row: &Tensor) -> Result<Tensor> {
        norm_relu_in_place(product, row, &self.scale()?)
    }

    /// As [`Linear::forward_parts`].
    pub fn forward_parts(&self, shared: &[&Tensor], rows: &[&Tensor]) -> Result<Tensor> {
        let (product, row) = self.linear.parts(shared, rows)?;
        self.finish(product, &row)
    }

    /// As [`Mlp::forward`], for rows followed by one shared row along the inputs.
    ///
    /// *Shapes*: `rows` (n, a), `shared` (1, b); result (n, outputs).
    pub fn forward_rows_then(&self, rows: &Tensor, shared: &Tensor) -> Result<Tensor> {
        let [a, b] = [rows.dim(1)?, shared.dim(1)?];
        let weight = &self.linear.weight;
        let product = rows.matmul(&weight.narrow(1, 0, a)?.t()?)?;
        let row = (self.linear.bias.unsqueeze(0)? + shared.matmul(&weight.narrow(1, a, b)?.t()?)?)?;
        self.finish(product, &row)
    }

    /// As [`Mlp::forward`], for rows followed along the inputs by one row that all rows of a group share. The
    /// product with it is computed once a group.
    ///
    /// *Shapes*: `rows` (n, a), `shared` (groups, b); result (n, outputs).
    pub fn forward_by_group(&self, rows: &Tensor, shared: &Tensor, groups: &Groups) -> Result<Tensor> {
        let [a, b] = [rows.dim(1)?, shared.dim(1)?];
        let weight = &self.linear.weight;
        let product = rows.matmul(&weight.narrow(1, 0, a)?.t()?)?;
        let biases = add_row(&shared.matmul(&weight.narrow(1, a, b)?.t()?)?, &self.linear.bias)?;
        norm_relu_by_group(product, &biases, &self.scale()?, groups)
    }
}

impl Module for Mlp {
    /// *Shapes*: `x` (n, inputs); result (n, outputs).
    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        self.finish(x.matmul(&self.linear.weight.t()?)?, &self.linear.bias)
    }
}

/// One head of attention: `softmax(q kᵀ / √d) v`, without output projection.
#[derive(Clone, Debug)]
pub struct Attention {
    query: Linear,
    key: Linear,
    value: Linear,
    has_key_bias: bool,
}

/// Keys and values of one set of states, ready for any number of queries.
#[derive(Clone, Debug)]
pub struct Memory {
    /// (d, m).
    keys: Tensor,
    /// (m, d).
    values: Tensor,
}

impl Attention {
    /// Attention among states. It takes `query`, `key` and `value` from the scope; `key.bias` is in
    /// the published parameters and is not used.
    pub fn among(scope: &Scope, inputs: usize, width: usize) -> Result<Self> {
        Self::new(scope, inputs, width, false)
    }

    /// Attention of queries to other states. The key bias has no effect on the result.
    pub fn across(scope: &Scope, inputs: usize, width: usize) -> Result<Self> {
        Self::new(scope, inputs, width, true)
    }

    fn new(scope: &Scope, inputs: usize, width: usize, has_key_bias: bool) -> Result<Self> {
        Ok(Self {
            query: Linear::new(&scope.at("query"), inputs, width)?,
            key: Linear::new(&scope.at("key"), inputs, width)?,
            value: Linear::new(&scope.at("value"), inputs, width)?,
            has_key_bias,
        })
    }

    /// Keys and values of states.
    ///
    /// *Shapes*: `states` (m, inputs).
    pub fn remember(&self, states: &Tensor) -> Result<Memory> {
        let keys = if self.has_key_bias {
            self.key.forward(states)?
        } else {
            states.matmul(&self.key.weight.t()?)?
        };
        Ok(Memory { keys: keys.t()?, values: self.value.forward(states)? })
    }

    /// *Shapes*: `queries` (n, inputs); result (n, width).
    pub fn recall(&self, queries: &Tensor, memory: &Memory) -> Result<Tensor> {
        let q = self.query.forward(queries)?;
        let scale = 1.0 / (q.dim(1)? as f64).sqrt();
        softmax_in_place(q.matmul(&memory.keys)?, scale)?.matmul(&memory.values)
    }

    /// *Shapes*: `queries` (n, inputs), `states` (m, inputs); result (n, width).
    pub fn forward(&self, queries: &Tensor, states: &Tensor) -> Result<Tensor> {
        self.recall(queries, &self.remember(states)?)
    }
}

/// `W [x ; mlp(x)] + b`.
#[derive(Clone, Debug)]
pub struct ResCat {
    mlp: Mlp,
    fc: Linear,
}

impl ResCat {
    /// Takes `mlp.*` and `fc.*` from the scope.
    pub fn new(scope: &Scope, inputs: usize, hidden: usize, outputs: usize) -> Result<Self> {
        Ok(Self {
            mlp: Mlp::new(&scope.at("mlp"), inputs, hidden)?,
            fc: Linear::new(&scope.at("fc"), inputs + hidden, outputs)?,
        })
    }

    /// *Shapes*: as [`Linear::forward_parts`]; result (n, outputs).
    pub fn forward_parts(&self, shared: &[&Tensor], rows: &[&Tensor]) -> Result<Tensor> {
        let hidden = self.mlp.forward_parts(shared, rows)?;
        let rows: Vec<&Tensor> = rows.iter().copied().chain([&hidden]).collect();
        self.fc.forward_parts(shared, &rows)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::{DType, Device, Var};

    fn noise(shape: (usize, usize)) -> Tensor {
        Tensor::randn(0.0_f32, 1.0, shape, &Device::Cpu).unwrap()
    }

    /// Bits of all elements, row by row.
    fn bits(tensor: &Tensor) -> Vec<u32> {
        let numbers = tensor.to_dtype(DType::F32).unwrap().flatten_all().unwrap().to_vec1::<f32>().unwrap();
        numbers.into_iter().map(f32::to_bits).collect()
    }

    #[test]
    fn layers_stand_in_a_sequence_of_candle_nn() {
        let linear = |outputs, inputs| Linear {
            weight: noise((outputs, inputs)),
            bias: noise((1, outputs)).squeeze(0).unwrap(),
        };
        let (first, second, x) = (linear(5, 6), linear(2, 5), noise((7, 6)));
        let sequence = candle_nn::seq().add(first.clone()).add(second.clone());
        let composed = second.forward(&first.forward(&x).unwrap()).unwrap();
        assert_eq!(bits(&sequence.forward(&x).unwrap()), bits(&composed));
    }

    #[test]
    fn layers_give_the_same_bits_with_and_without_gradients_and_do_not_change_their_inputs() {
        let x = noise((7, 6));
        let before = bits(&x);
        let plain = Linear { weight: noise((5, 6)), bias: noise((1, 5)).squeeze(0).unwrap() };
        let tracked = Linear {
            weight: Var::from_tensor(&plain.weight).unwrap().as_tensor().clone(),
            bias: Var::from_tensor(&plain.bias).unwrap().as_tensor().clone(),
        };
        let mlp = |linear: &Linear| Mlp {
            linear: linear.clone(),
            gamma: Tensor::full(1.5_f32, 5, &Device::Cpu).unwrap(),
            beta: Tensor::full(-0.2_f32, 5, &Device::Cpu).unwrap(),
        };
        let attention = |linear: &Linear| Attention {
            query: linear.clone(),
            key: linear.clone(),
            value: linear.clone(),
            has_key_bias: true,
        };
        let (own, other) = (plain.forward(&x).unwrap(), tracked.forward(&x).unwrap());
        assert!(!own.track_op() && other.track_op());
        assert_eq!(bits(&own), bits(&other));
        assert_eq!(bits(&mlp(&plain).forward(&x).unwrap()), bits(&mlp(&tracked).forward(&x).unwrap()));
        let [a, b] = [&plain, &tracked].map(|linear| attention(linear).forward(&x, &x).unwrap());
        assert_eq!(bits(&a), bits(&b));
        assert_eq!(bits(&x), before);
        assert_eq!(bits(&plain.bias), bits(&tracked.bias));
    }
}
