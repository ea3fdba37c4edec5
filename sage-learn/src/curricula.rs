//! The curricula by name.

mod adaptive;
mod constant;
mod paper;
mod release;

use sage_core::{Error, registry::Registry};
use sage_sim::curriculum::Curriculum;

pub use adaptive::Adaptive;
pub use constant::Constant;
pub use paper::Paper;
pub use release::Release;

/// All curricula of this crate. Add a line here to make a new one known everywhere.
///
/// *Errors*: two have the same name.
///
/// ```
/// use sage_core::seed::Rng;
/// use sage_learn::curricula::curricula;
/// use sage_sim::curriculum::{Progress, SuccessRates};
///
/// // The paper's curriculum attacks one episode in ten at first, and nine at the end.
/// let (paper, success) = (curricula()?.build_default("paper")?, SuccessRates::default());
/// let attacked = |share: f64| {
///     let mut rng = Rng::new(0, "training", "curriculum");
///     (0..1000).filter(|_| paper.draw(&Progress { share, success: &success }, &mut rng).is_some()).count()
/// };
/// assert!((80..120).contains(&attacked(0.0)) && (880..920).contains(&attacked(1.0)));
/// # Ok::<(), sage_core::Error>(())
/// ```
pub fn curricula() -> Result<Registry<dyn Curriculum>, Error> {
    Registry::new("curriculum").with::<Paper>()?.with::<Release>()?.with::<Constant>()?.with::<Adaptive>()
}

/// A number from 0 to 1, or the message that names it.
fn check_share(name: &str, value: f64) -> Result<(), String> {
    if (0.0..=1.0).contains(&value) {
        return Ok(());
    }
    Err(format!("`{name}` is {value}; expected a number from 0 to 1"))
}

#[cfg(test)]
mod tests {
    use sage_core::seed::Rng;
    use sage_sim::curriculum::{Progress, SuccessRates};

    use super::*;

    /// Share of attacks and mean intensity of many draws.
    pub(super) fn drawn(curriculum: &dyn Curriculum, share: f64, success: &SuccessRates) -> (f64, f64) {
        let mut rng = Rng::new(1, "curriculum", "test");
        let all: Vec<f64> =
            (0..20_000).filter_map(|_| curriculum.draw(&Progress { share, success }, &mut rng)).collect();
        (all.len() as f64 / 20_000.0, all.iter().sum::<f64>() / all.len().max(1) as f64)
    }

    #[test]
    fn schedules_have_the_published_shapes() {
        let success = SuccessRates::default();
        let registry = curricula().expect("names differ");
        let near = |found: (f64, f64), expected: (f64, f64)| {
            assert!((found.0 - expected.0).abs() < 0.02, "{found:?} and {expected:?}");
            assert!((found.1 - expected.1).abs() < 1e-9, "{found:?} and {expected:?}");
        };
        let paper = registry.build_default("paper").expect("registered");
        for (share, expected) in
            [(0.0, (0.1, 0.5)), (0.25, (0.5, 0.625)), (0.5, (0.9, 0.75)), (1.0, (0.9, 1.0))]
        {
            near(drawn(&*paper, share, &success), expected);
        }
        let release = registry.build_default("release").expect("registered");
        for (share, expected) in [(0.1, (0.18, 0.575)), (0.5, (0.9, 0.875)), (1.0, (0.9, 1.0))] {
            near(drawn(&*release, share, &success), expected);
        }
        let constant = registry.build_default("constant").expect("registered");
        near(drawn(&*constant, 0.3, &success), (0.5, 1.0));
    }

    #[test]
    fn the_adaptive_curriculum_avoids_what_is_sure_and_what_is_hopeless() {
        let adaptive = curricula().expect("names differ").build_default("adaptive").expect("registered");
        let success = SuccessRates { rates: [1.0, 1.0, 1.0, 0.5, 0.0, 0.0] };
        let (attacked, mean) = drawn(&*adaptive, 0.5, &success);
        assert!((0.85..0.95).contains(&attacked), "{attacked}");
        assert!((mean - 0.5).abs() < 0.05, "{mean}");
    }
}
