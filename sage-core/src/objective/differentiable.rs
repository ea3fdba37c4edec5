//! Smooth surrogates of rewards, with gradients, for generators that optimise a trajectory.
//!
//! A contact is a step in the reward, so its gradient says nothing. A [`DifferentiableReward`] is a smooth function that
//! orders trajectories nearly as the reward does. Optimisers maximise it; reports use the reward itself.

use super::Context;
use crate::{geometry::Point, motion::Pose};

/// Gradient with respect to the poses of the steps 1 to T.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PoseGradient {
    /// With respect to positions, 1/m.
    pub position: Vec<Point>,
    /// With respect to headings, 1/rad.
    pub heading: Vec<f64>,
}

impl PoseGradient {
    /// Zeros for a number of steps.
    pub fn zeros(steps: usize) -> Self {
        Self { position: vec![[0.0; 2]; steps], heading: vec![0.0; steps] }
    }

    fn clear(&mut self) {
        self.position.fill([0.0; 2]);
        self.heading.fill(0.0);
    }

    fn is_finite(&self) -> bool {
        let positions = self.position.iter().flatten();
        positions.chain(&self.heading).all(|value| value.is_finite())
    }

    fn add(&mut self, other: &Self, weight: f64) {
        for (mine, theirs) in self.position.iter_mut().zip(&other.position) {
            (0..2).for_each(|k| mine[k] += weight * theirs[k]);
        }
        self.heading.iter_mut().zip(&other.heading).for_each(|(mine, theirs)| *mine += weight * theirs);
    }
}

/// A smooth function of the adversary's poses against the ego's first path.
///
/// Implementations are pure: the same poses and context give the same bits.
pub trait DifferentiableReward: Send + Sync {
    /// Name of the term in messages.
    fn name(&self) -> &str;

    /// Value of the poses at the steps 1 to T. Adds its gradient to `gradient`, which has T entries or more.
    fn value(&self, poses: &[Pose], ctx: &Context, gradient: &mut PoseGradient) -> f64;
}

/// A weighted sum of differentiable rewards.
pub struct SmoothObjective {
    terms: Vec<(f64, Box<dyn DifferentiableReward>)>,
    scratch: PoseGradient,
}

impl SmoothObjective {
    /// The sum of terms with their weights; those of weight 0 are left out.
    pub fn new(terms: Vec<(f64, Box<dyn DifferentiableReward>)>) -> Self {
        let terms = terms.into_iter().filter(|(weight, _)| *weight != 0.0).collect();
        Self { terms, scratch: PoseGradient::default() }
    }

    /// Value of the poses up to the context's horizon. Writes its gradient, of all poses, to `gradient`.
    ///
    /// *Errors*: the name of a term whose value or gradient is not finite.
    pub fn value(
        &mut self,
        poses: &[Pose],
        ctx: &Context,
        gradient: &mut PoseGradient,
    ) -> Result<f64, String> {
        *gradient = PoseGradient::zeros(poses.len());
        // What lies beyond the recording is not scored, so nothing pulls at it.
        let scored = &poses[..poses.len().min(ctx.horizon())];
        self.scratch.position.resize(poses.len(), [0.0; 2]);
        self.scratch.heading.resize(poses.len(), 0.0);
        let mut sum = 0.0;
        for (weight, term) in &self.terms {
            self.scratch.clear();
            let value = term.value(scored, ctx, &mut self.scratch);
            if !(value.is_finite() && self.scratch.is_finite()) {
                return Err(term.name().to_owned());
            }
            sum += weight * value;
            gradient.add(&self.scratch, *weight);
        }
        Ok(sum)
    }
}
