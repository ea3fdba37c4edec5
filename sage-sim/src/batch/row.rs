//! What is known of an environment of a batch.

use crate::{environment::Outcome, observation::LENGTH};

/// What is known of an environment after a step or a reset.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Row {
    /// The step; after a reset all but the completion is 0.
    pub outcome: Outcome,
    /// Reward of the progress in the step, before it is replaced.
    pub progress_reward: f64,
    /// Whether the episode ended because the car drove backwards.
    pub drove_backwards: bool,
    /// Number of the scene.
    pub scene: usize,
    /// Steps of the episode so far.
    pub steps: usize,
    /// Sum of the rewards of the episode so far.
    pub episode_return: f64,
    /// Whether the limit of steps or the end of the log is reached, whether or not that is a truncation.
    pub is_at_limit: bool,
    /// Whether the car is on a road edge.
    pub on_edge: bool,
    /// Whether the car is on a solid line.
    pub on_line: bool,
    /// Distance across the route, metres, positive to the right.
    pub across: f64,
    /// Length of the route, metres.
    pub route_length: f64,
    /// Length and width of the car, metres.
    pub size: [f64; 2],
    /// Intensity of the attack; `None` without one.
    pub intensity: Option<f64>,
    /// Scenes in which an episode of this environment began.
    pub scenes_begun: usize,
    /// Sum over these scenes of whether the last episode arrived.
    pub arrivals: usize,
    /// Sum over these scenes of the completion of the last episode.
    pub completions: f64,
}

/// A scene that could not be used, or an attack that could not be planned.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Note {
    /// Number of the scene.
    pub scene: usize,
    /// Why, in words.
    pub problem: String,
}

/// How an episode ended that the same step has replaced by the next one.
pub struct Last {
    /// What is known after its last step.
    pub row: Row,
    /// Its last observation.
    pub observation: Box<[f32; LENGTH]>,
}
