//! AdamW (Loshchilov and Hutter, 2019), as PyTorch computes it, with a state that can be saved.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

/// Constants of [`AdamW`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct AdamWConfig {
    /// Weight decay: a share of the weight per unit of learning rate.
    pub weight_decay: f64,
    /// Decay rate of the mean gradient.
    pub beta1: f64,
    /// Decay rate of the mean squared gradient.
    pub beta2: f64,
    /// Added to the root of the mean square.
    pub epsilon: f64,
}

impl Default for AdamWConfig {
    fn default() -> Self {
        Self { weight_decay: 0.01, beta1: 0.9, beta2: 0.999, epsilon: 1e-8 }
    }
}

/// Running means of one parameter.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Moments {
    /// Mean gradient.
    pub first: Vec<f32>,
    /// Mean squared gradient.
    pub second: Vec<f32>,
}

/// The optimiser with its state, from which a training run resumes with the same bits.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AdamW {
    /// Constants.
    pub config: AdamWConfig,
    /// Number of steps so far.
    pub steps: u64,
    /// Running means by parameter.
    pub moments: BTreeMap<String, Moments>,
}

impl AdamW {
    /// An optimiser before its first step.
    pub fn new(config: AdamWConfig) -> Self {
        Self { config, ..Self::default() }
    }

    /// Begins the next step. Call it once before the parameters of the step are updated.
    pub fn begin_step(&mut self) {
        self.steps += 1;
    }

    /// Updates one parameter by its gradient.
    pub fn update(&mut self, name: &str, values: &mut [f32], gradient: &[f32], rate: f64) {
        let AdamWConfig { weight_decay, beta1, beta2, epsilon } = self.config;
        if !self.moments.contains_key(name) {
            let zeros = vec![0.0; values.len()];
            self.moments.insert(name.to_owned(), Moments { first: zeros.clone(), second: zeros });
        }
        let Some(moments) = self.moments.get_mut(name) else { return };
        let step = self.steps as f64;
        let decay = (1.0 - rate * weight_decay) as f32;
        let size = (rate / (1.0 - beta1.powf(step))) as f32;
        let root = (1.0 / (1.0 - beta2.powf(step)).sqrt()) as f32;
        let [b1, b2, epsilon] = [beta1, beta2, epsilon].map(|x| x as f32);
        let [c1, c2] = [1.0 - beta1, 1.0 - beta2].map(|x| x as f32);
        let rows = values.iter_mut().zip(gradient).zip(&mut moments.first).zip(&mut moments.second);
        for (((value, g), m), v) in rows {
            *m = b1 * *m + c1 * g;
            *v = b2 * *v + c2 * g * g;
            *value = decay * *value - size * *m / (v.sqrt() * root + epsilon);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_step_has_the_size_of_the_rate_against_the_gradient() {
        let mut adam = AdamW::new(AdamWConfig { weight_decay: 0.5, ..AdamWConfig::default() });
        let mut values = [1.0, 1.0];
        adam.begin_step();
        adam.update("w", &mut values, &[3.0, -0.01], 0.1);
        // 1 · (1 − 0.1 · 0.5) ∓ 0.1
        assert!((values[0] - 0.85).abs() < 1e-6 && (values[1] - 1.05).abs() < 1e-6, "{values:?}");
    }
}
