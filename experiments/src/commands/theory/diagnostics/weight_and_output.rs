//! Weight mixing against output mixing of two experts in a scene.

use std::sync::Arc;

use anyhow::Result;
use sage_backbones::{Backbone, MotionModel, backbone::finite, training::PreparedScene};
use sage_core::{
    motion::{HORIZON, NOW},
    scene::SceneData,
};

/// λ at which weight mixing is compared with output mixing.
pub(super) const COMPARED: [f64; 3] = [0.25, 0.5, 0.75];

/// Both mixtures at a λ. The loss is half the mean squared distance of the policy's mean trajectory from the log, m².
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Comparison {
    /// Loss of weight mixing.
    pub(super) weight: f64,
    /// Loss of output mixing: of the mixed mean trajectories.
    pub(super) output: f64,
    /// Loss on the chord between the experts.
    pub(super) chord: f64,
    /// `λ (1 − λ)/2` times the mean squared distance of the experts' mean trajectories.
    pub(super) diversity: f64,
    /// Negative log-likelihood of the mode that ends nearest to the log, by weight mixing and by mixing of the
    /// probabilities, which is output mixing of the policy.
    pub(super) nll: [f64; 2],
}

impl Comparison {
    /// Loss of output mixing minus that of weight mixing: positive where weight mixing is better. By the exact
    /// identity this is the height of the chord above weight mixing, less the diversity.
    pub(super) fn gain(&self) -> f64 {
        self.output - self.weight
    }
}

/// What a policy predicts for the log.
struct Prediction {
    /// Positions of the mean trajectory, metres.
    mean: Vec<f64>,
    /// Log-probability of the mode that ends nearest to the log.
    log_prob: f64,
}

/// Compares both mixtures of the realistic and the adversarial expert at each λ; `None` without a whole log.
///
/// *Errors*: those of the networks.
pub(super) fn compare(
    data: &SceneData,
    prior: &dyn Backbone,
    prepared: &PreparedScene,
    [realistic, adversarial]: &[Arc<dyn MotionModel>; 2],
    compared: &[Arc<dyn MotionModel>],
) -> Result<Option<[Comparison; 3]>> {
    let log = data.scene.adversary()?;
    if log.count_valid(NOW + 1..NOW + HORIZON + 1) < HORIZON {
        return Ok(None);
    }
    let encoding = prepared.encoding();
    let frame = encoding.features().frame;
    let target: Vec<f64> =
        (NOW + 1..=NOW + HORIZON).flat_map(|step| frame.frame_from_world(log.point(step))).collect();
    let modes: Vec<usize> = (0..prior.mode_ends(encoding)?.len()).collect();
    let trajectories: Vec<f32> = prior.trajectories(encoding, &modes)?.flatten_all()?.to_vec1()?;
    let trajectories = || trajectories.chunks_exact(2 * HORIZON);
    let from_log = |trajectory: &[f32]| -> f64 {
        let (end, goal) = (&trajectory[2 * HORIZON - 2..], &target[2 * HORIZON - 2..]);
        end.iter().zip(goal).map(|(x, y)| (f64::from(*x) - y).powi(2)).sum()
    };
    let distances: Vec<f64> = trajectories().map(from_log).collect();
    let nearest = (0..modes.len()).min_by(|a, b| distances[*a].total_cmp(&distances[*b])).unwrap_or(0);
    let prediction = |model: &Arc<dyn MotionModel>| -> Result<Prediction> {
        let log_probs = finite::<f64>(&model.log_probs(encoding)?)?;
        let mut mean = vec![0.0; 2 * HORIZON];
        for (trajectory, log_prob) in trajectories().zip(&log_probs) {
            let weight = log_prob.exp();
            mean.iter_mut().zip(trajectory).for_each(|(mean, x)| *mean += weight * f64::from(*x));
        }
        Ok(Prediction { mean, log_prob: log_probs[nearest] })
    };
    let squared = |f: &[f64], y: &[f64]| -> f64 {
        f.iter().zip(y).map(|(f, y)| (f - y).powi(2)).sum::<f64>() / HORIZON as f64
    };
    let loss = |f: &[f64]| 0.5 * squared(f, &target);
    let (real, adversarial) = (prediction(realistic)?, prediction(adversarial)?);
    let at = |lambda: f64, model: &Arc<dyn MotionModel>| -> Result<Comparison> {
        let weight = prediction(model)?;
        let mixed: Vec<f64> =
            real.mean.iter().zip(&adversarial.mean).map(|(r, a)| (1.0 - lambda) * r + lambda * a).collect();
        // Relative to the larger probability, so that small ones do not vanish.
        let most = real.log_prob.max(adversarial.log_prob);
        let share =
            (1.0 - lambda) * (real.log_prob - most).exp() + lambda * (adversarial.log_prob - most).exp();
        Ok(Comparison {
            weight: loss(&weight.mean),
            output: loss(&mixed),
            chord: (1.0 - lambda) * loss(&real.mean) + lambda * loss(&adversarial.mean),
            diversity: 0.5 * lambda * (1.0 - lambda) * squared(&real.mean, &adversarial.mean),
            nll: [-weight.log_prob, -(most + share.ln())],
        })
    };
    let [first, second, third] = COMPARED;
    let [a, b, c] = compared else { return Ok(None) };
    Ok(Some([at(first, a)?, at(second, b)?, at(third, c)?]))
}
