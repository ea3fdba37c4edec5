//! Windows of driving, from which skills are learned.

use candle_core::{Device, Tensor};
use sage_backbones::Error;

use super::{ACTION, OBSERVATION, SKILL, WINDOW};

/// Windows of [`WINDOW`] successive steps of one driver.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SkillWindows {
    /// (n, [`WINDOW`], [`OBSERVATION`]), row by row.
    pub observations: Vec<f32>,
    /// (n, [`WINDOW`], [`ACTION`]), row by row: steering, throttle. Values beyond ±1 count as ±1.
    pub actions: Vec<f32>,
    /// (n): the roll-out of each window. Training and validation share no roll-out.
    pub groups: Vec<u32>,
}

/// Distributions of the skills of windows: normal and independent.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Posteriors {
    /// (n, [`SKILL`]): means.
    pub mu: Vec<f32>,
    /// (n, [`SKILL`]): natural logarithms of variances.
    pub logvar: Vec<f32>,
}

impl SkillWindows {
    /// Number of windows.
    pub fn len(&self) -> usize {
        self.groups.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.groups.is_empty()
    }

    /// *Errors*: [`Error::Mismatch`] if the lists belong to different numbers of windows, [`Error::NotFinite`] for a
    /// number that is not finite.
    pub fn check(&self) -> Result<(), Error> {
        let n = self.len();
        check_numbers("observations", &self.observations, n * WINDOW * OBSERVATION)?;
        check_numbers("actions", &self.actions, n * WINDOW * ACTION)
    }

    /// Observations and actions of some windows, all rows of the first step first.
    ///
    /// *Shapes*: results ([`WINDOW`] · n, [`OBSERVATION`]) and ([`WINDOW`] · n, [`ACTION`]).
    pub(super) fn steps(&self, windows: &[usize]) -> candle_core::Result<[Tensor; 2]> {
        let rows = |values: &[f32], width: usize| -> Vec<f32> {
            let mut rows = Vec::with_capacity(windows.len() * WINDOW * width);
            for step in 0..WINDOW {
                for window in windows {
                    let first = (window * WINDOW + step) * width;
                    rows.extend_from_slice(&values[first..first + width]);
                }
            }
            rows
        };
        let observations = rows(&self.observations, OBSERVATION);
        let mut actions = rows(&self.actions, ACTION);
        actions.iter_mut().for_each(|action| *action = action.clamp(-1.0, 1.0));
        let n = windows.len() * WINDOW;
        Ok([
            Tensor::from_vec(observations, (n, OBSERVATION), &Device::Cpu)?,
            Tensor::from_vec(actions, (n, ACTION), &Device::Cpu)?,
        ])
    }
}

impl Posteriors {
    /// Number of distributions.
    pub fn len(&self) -> usize {
        self.mu.len() / SKILL
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.mu.is_empty()
    }
}

/// Whether a list of training data has the expected length and finite numbers only.
pub(super) fn check_numbers(what: &str, values: &[f32], expected: usize) -> Result<(), Error> {
    if values.len() != expected {
        return Err(Error::Mismatch(format!("{what}: {} numbers, expected {expected}", values.len())));
    }
    match values.iter().position(|x| !x.is_finite()) {
        Some(index) => Err(Error::NotFinite(format!("{what}: number {index} is {}", values[index]))),
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps_come_first_and_actions_are_limited() {
        let mut windows = SkillWindows {
            observations: (0..2 * WINDOW * OBSERVATION).map(|k| k as f32).collect(),
            actions: vec![0.5; 2 * WINDOW * ACTION],
            groups: vec![0, 1],
        };
        windows.actions[0] = -3.0;
        windows.check().unwrap();
        let [observations, actions] = windows.steps(&[1, 0]).unwrap();
        let first = observations.narrow(1, 0, 1).unwrap().flatten_all().unwrap().to_vec1::<f32>().unwrap();
        assert_eq!(first[..3], [1010.0, 0.0, 1111.0]);
        assert_eq!(actions.to_vec2::<f32>().unwrap()[1], [-1.0, 0.5]);
        windows.actions.pop();
        assert_eq!(windows.check().unwrap_err().to_string(), "actions: 39 numbers, expected 40");
    }
}
