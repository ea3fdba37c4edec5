//! A coupling layer of a conditional RealNVP (Dinh et al., 2017): one half of the numbers scales and shifts the other.
//!
//! `y₁ = x₁` and `y₂ = x₂ · exp(s) + t`, where two networks give `s = tanh(f([x₁, o]))` and `t = g([x₁, o])` for a
//! condition `o`. The log-determinant is the sum of `s`.

use candle_core::{Module as _, Result, Tensor};
use sage_backbones::{nn::Linear, parameters::Scope};

use super::{OBSERVATION, SKILL, leaky_relu::leaky_relu};

/// Size of a half.
const HALF: usize = SKILL / 2;

/// Three linear layers with leaky ReLUs between them.
#[derive(Clone, Debug)]
struct Net([Linear; 3]);

impl Net {
    fn new(scope: &Scope, hidden: usize) -> Result<Self> {
        let sizes = [HALF + OBSERVATION, hidden, hidden, HALF];
        let layer = |k: usize| Linear::new(&scope.at(k), sizes[k], sizes[k + 1]);
        Ok(Self([layer(0)?, layer(1)?, layer(2)?]))
    }

    fn forward(&self, x: &Tensor) -> Result<Tensor> {
        let [first, second, out] = &self.0;
        out.forward(&leaky_relu(&second.forward(&leaky_relu(&first.forward(x)?)?)?)?)
    }
}

/// A coupling layer.
#[derive(Clone, Debug)]
pub(super) struct Coupling {
    scale: Net,
    shift: Net,
    /// Whether the second half is the one that stays.
    is_swapped: bool,
}

impl Coupling {
    /// Takes `scale.*` and `shift.*` from the scope.
    pub(super) fn new(scope: &Scope, hidden: usize, is_swapped: bool) -> Result<Self> {
        Ok(Self {
            scale: Net::new(&scope.at("scale"), hidden)?,
            shift: Net::new(&scope.at("shift"), hidden)?,
            is_swapped,
        })
    }

    /// The half that stays and the one that changes.
    fn split(&self, x: &Tensor) -> Result<[Tensor; 2]> {
        let halves = [x.narrow(1, 0, HALF)?, x.narrow(1, HALF, HALF)?];
        let [first, second] = halves;
        Ok(if self.is_swapped { [second, first] } else { [first, second] })
    }

    fn join(&self, [kept, changed]: [&Tensor; 2]) -> Result<Tensor> {
        Tensor::cat(&if self.is_swapped { [changed, kept] } else { [kept, changed] }, 1)
    }

    /// Logarithm of the scale, and the shift.
    fn coefficients(&self, kept: &Tensor, condition: &Tensor) -> Result<[Tensor; 2]> {
        let inputs = Tensor::cat(&[kept, condition], 1)?;
        Ok([self.scale.forward(&inputs)?.tanh()?, self.shift.forward(&inputs)?])
    }

    /// The result, and the logarithm of the determinant of its Jacobian.
    ///
    /// *Shapes*: `x` (n, [`SKILL`]), `condition` (n, [`OBSERVATION`]); results (n, [`SKILL`]), (n).
    pub(super) fn forward(&self, x: &Tensor, condition: &Tensor) -> Result<[Tensor; 2]> {
        let [kept, changed] = self.split(x)?;
        let [scale, shift] = self.coefficients(&kept, condition)?;
        let changed = ((changed * scale.exp()?)? + shift)?;
        Ok([self.join([&kept, &changed])?, scale.sum(1)?])
    }

    /// The argument that [`Coupling::forward`] turns into `y`.
    pub(super) fn inverse(&self, y: &Tensor, condition: &Tensor) -> Result<Tensor> {
        let [kept, changed] = self.split(y)?;
        let [scale, shift] = self.coefficients(&kept, condition)?;
        let changed = ((changed - shift)? * scale.neg()?.exp()?)?;
        self.join([&kept, &changed])
    }
}
