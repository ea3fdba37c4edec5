//! Skills: an encoder of windows of driving to a normal distribution over skills, and a decoder of an observation and
//! a skill to an action.
//!
//! The decoder is applied at every step with the same skill, so the driver reacts to what it observes. Sizes follow SEAL
//! (Stoler et al., 2025): 398 290 trained parameters in both.

use candle_core::{D, Device, Module as _, Result, Tensor};
use sage_backbones::{
    Error,
    nn::{BatchNorm, Linear, Lstm},
    parameters::Scope,
};

use super::{
    ACTION, OBSERVATION, SKILL, WINDOW,
    leaky_relu::leaky_relu,
    skill_windows::{Posteriors, SkillWindows},
};

/// Width of the recurrent state.
const STATE: usize = 256;
/// Windows that are encoded at a time; their gates fit into the processor's cache.
const CHUNK: usize = 64;

/// `leaky(norm(W x + b))`.
#[derive(Clone, Debug)]
struct Layer {
    linear: Linear,
    norm: BatchNorm,
}

/// Two layers and a linear one.
#[derive(Clone, Debug)]
struct Stack {
    layers: [Layer; 2],
    out: Linear,
}

impl Stack {
    /// Takes `layers.*` and `out` from the scope.
    fn new(scope: &Scope, [inputs, first, second, outputs]: [usize; 4]) -> Result<Self> {
        let layer = |k: usize, inputs, outputs| {
            let scope = scope.at("layers").at(k);
            let linear = Linear::new(&scope.at("linear"), inputs, outputs)?;
            Ok::<_, candle_core::Error>(Layer {
                linear,
                norm: BatchNorm::new(&scope.at("batch_norm"), outputs)?,
            })
        };
        Ok(Self {
            layers: [layer(0, inputs, first)?, layer(1, first, second)?],
            out: Linear::new(&scope.at("out"), second, outputs)?,
        })
    }

    fn forward(&self, x: &Tensor, is_training: bool) -> Result<Tensor> {
        let mut x = x.clone();
        for Layer { linear, norm } in &self.layers {
            let product = linear.forward(&x)?;
            x = if is_training { norm.forward_training(&product)? } else { norm.forward(&product)? };
            x = leaky_relu(&x)?;
        }
        self.out.forward(&x)
    }
}

/// Encoder of windows to distributions over skills.
#[derive(Clone, Debug)]
pub struct SkillEncoder {
    lstm: Lstm,
    stack: Stack,
}

impl SkillEncoder {
    /// Takes `lstm`, `layers.*` and `out` from the scope.
    ///
    /// *Errors*: a tensor that is missing or has another shape.
    pub fn new(scope: &Scope) -> Result<Self> {
        Ok(Self {
            lstm: Lstm::new(&scope.at("lstm"), OBSERVATION + ACTION, STATE)?,
            stack: Stack::new(scope, [STATE, 64, 32, 2 * SKILL])?,
        })
    }

    /// Means and natural logarithms of variances. In training mode, batch norms use the statistics of the batch and
    /// update the running ones in place.
    ///
    /// *Shapes*: `observations` ([`WINDOW`] · n, [`OBSERVATION`]) and `actions` ([`WINDOW`] · n, [`ACTION`]), all rows
    /// of the first step first; results (n, [`SKILL`]).
    pub(super) fn posterior(
        &self,
        observations: &Tensor,
        actions: &Tensor,
        is_training: bool,
    ) -> Result<[Tensor; 2]> {
        let inputs = Tensor::cat(&[observations, actions], 1)?;
        let out = self.stack.forward(&self.lstm.forward(&inputs, WINDOW)?, is_training)?;
        Ok([out.narrow(1, 0, SKILL)?, out.narrow(1, SKILL, SKILL)?])
    }

    /// Distributions of the skills of all windows, in their order (evaluation mode).
    ///
    /// *Errors*: those of [`SkillWindows::check`]; [`Error::NotFinite`] for a result that is not finite, with the number
    /// of its window.
    pub fn encode(&self, windows: &SkillWindows) -> std::result::Result<Posteriors, Error> {
        windows.check()?;
        let all: Vec<usize> = (0..windows.len()).collect();
        let mut posteriors = Posteriors::default();
        for chunk in all.chunks(CHUNK) {
            let [observations, actions] = windows.steps(chunk)?;
            let [mu, logvar] = self.posterior(&observations, &actions, false)?;
            posteriors.mu.extend(mu.flatten_all()?.to_vec1::<f32>()?);
            posteriors.logvar.extend(logvar.flatten_all()?.to_vec1::<f32>()?);
        }
        let bad = posteriors.mu.iter().zip(&posteriors.logvar).position(|(a, b)| !(a + b).is_finite());
        match bad {
            Some(index) => {
                Err(Error::NotFinite(format!("window {}: its skill is not finite", index / SKILL)))
            }
            None => Ok(posteriors),
        }
    }
}

/// Decoder of an observation and a skill to an action.
#[derive(Clone, Debug)]
pub struct SkillDecoder {
    stack: Stack,
}

impl SkillDecoder {
    /// Takes `layers.*` and `out` from the scope.
    ///
    /// *Errors*: a tensor that is missing or has another shape.
    pub fn new(scope: &Scope) -> Result<Self> {
        Ok(Self { stack: Stack::new(scope, [OBSERVATION + SKILL, 64, 32, ACTION])? })
    }

    /// Actions in [−1, 1]. For the training mode see [`SkillEncoder::posterior`]; its statistics are over all rows, so
    /// over windows and steps.
    ///
    /// *Shapes*: `observations` (n, [`OBSERVATION`]), `skills` (n, [`SKILL`]); result (n, [`ACTION`]).
    pub(super) fn forward(
        &self,
        observations: &Tensor,
        skills: &Tensor,
        is_training: bool,
    ) -> Result<Tensor> {
        let inputs = Tensor::cat(&[observations, skills], D::Minus1)?;
        self.stack.forward(&inputs, is_training)?.tanh()
    }

    /// Steering and throttle in [−1, 1] (evaluation mode).
    ///
    /// *Errors*: [`Error::NotFinite`].
    pub fn action(
        &self,
        observation: &[f32; OBSERVATION],
        skill: &[f32; SKILL],
    ) -> std::result::Result<[f64; ACTION], Error> {
        let observation = Tensor::from_slice(observation, (1, OBSERVATION), &Device::Cpu)?;
        let skill = Tensor::from_slice(skill, (1, SKILL), &Device::Cpu)?;
        let action = self.forward(&observation, &skill, false)?.flatten_all()?.to_vec1::<f32>()?;
        match action[..] {
            [steering, throttle] if steering.is_finite() && throttle.is_finite() => {
                Ok([steering, throttle].map(f64::from))
            }
            _ => Err(Error::NotFinite(format!("the action of a skill is {action:?}"))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sage_backbones::{Parameters, nn::is_running};

    fn parameters() -> Parameters {
        let specs = Scope::list(|scope| {
            Ok((SkillEncoder::new(&scope.at("encoder"))?, SkillDecoder::new(&scope.at("decoder"))?))
        });
        Parameters::start(&specs.unwrap(), 1).unwrap()
    }

    #[test]
    fn the_networks_have_the_published_number_of_parameters() {
        let counts = |running| -> usize {
            let all = parameters();
            let of = all.iter().filter(|(name, _)| is_running(name) == running);
            of.map(|(_, tensor)| tensor.elem_count()).sum()
        };
        assert_eq!([counts(false), counts(true)], [398_290, 2 * 2 * (64 + 32)]);
    }

    #[test]
    fn one_action_equals_that_of_a_batch_and_lies_within_its_limits() {
        let decoder = SkillDecoder::new(&Scope::of(&parameters()).at("decoder")).unwrap();
        let mut observation = [0.3; OBSERVATION];
        observation[7] = -9.0;
        let skill = [0.5, -1.0, 2.0, 0.0, 0.1, 0.2, -0.3, 1.5];
        let action = decoder.action(&observation, &skill).unwrap();
        let tensor = |row: &[f32]| Tensor::from_slice(row, (1, row.len()), &Device::Cpu).unwrap();
        let repeat = |row: Tensor| Tensor::cat(&[&row; 5], 0).unwrap();
        let rows = decoder.forward(&repeat(tensor(&observation)), &repeat(tensor(&skill)), false).unwrap();
        for row in rows.to_vec2::<f32>().unwrap() {
            for (x, y) in row.iter().zip(action) {
                assert!((f64::from(*x) - y).abs() < 1e-6 && y.abs() <= 1.0);
            }
        }
        observation[0] = f32::NAN;
        assert!(matches!(decoder.action(&observation, &skill), Err(Error::NotFinite(_))));
    }

    #[test]
    fn windows_are_encoded_in_their_order() {
        let encoder = SkillEncoder::new(&Scope::of(&parameters()).at("encoder")).unwrap();
        let n = CHUNK + 3;
        let windows = SkillWindows {
            observations: (0..n * WINDOW * OBSERVATION).map(|k| (k % 977) as f32 / 977.0).collect(),
            actions: vec![0.1; n * WINDOW * ACTION],
            groups: vec![0; n],
        };
        let all = encoder.encode(&windows).unwrap();
        assert_eq!((all.len(), all.logvar.len()), (n, n * SKILL));
        let size = WINDOW * OBSERVATION;
        let last = SkillWindows {
            observations: windows.observations[(n - 1) * size..].to_vec(),
            actions: vec![0.1; WINDOW * ACTION],
            groups: vec![0],
        };
        let last = encoder.encode(&last).unwrap();
        for (x, y) in last.mu.iter().zip(&all.mu[(n - 1) * SKILL..]) {
            assert!((x - y).abs() < 1e-5);
        }
    }
}
