//! A reward: a column of `score` and of tables, and a term of objectives.

use sage_core::{
    objective::{Reward, Situation},
    registry::{Entry, NoOptions},
};

/// Speed at the end less speed after the first step, m/s.
pub struct SpeedUp;

impl Entry<dyn Reward> for SpeedUp {
    const NAME: &'static str = "speed-up";
    const SUMMARY: &'static str = "how much faster the adversary is at the end";
    const SOURCE: &'static str = "own-crate";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Reward>, String> {
        Ok(Box::new(Self))
    }
}

impl Reward for SpeedUp {
    fn score(&self, situation: &Situation) -> Option<f64> {
        let speed = &situation.candidate.profile().speed;
        Some(speed.last()? - speed.first()?)
    }

    fn depends_on_ego(&self) -> bool {
        false
    }
}
