//! How many training seeds a study takes, stated beforehand.

use sage_core::statistics::Estimate;

/// Seeds that are trained before the interval is looked at: fewer hardly tell how seeds differ.
pub const LEAST_SEEDS: usize = 5;
/// Seeds at which training ends, whatever the interval is.
pub const MOST_SEEDS: usize = 30;
/// Half-width of the 95 % interval of the primary measure that is enough, in the unit of the measure; a share has none.
pub const HALF_WIDTH: f64 = 0.02;

/// Whether a study adds a seed: until the half-width of the interval of its primary measure is at most [`HALF_WIDTH`], or there
/// are [`MOST_SEEDS`] seeds. The rule does not look at the value, so that it does not stop at what is significant.
///
/// It still stops earlier where seeds seem to differ less than they do: in 4 000 tables of each of three settings, 93 % of the
/// final 95 % intervals hold the true value (92.9, 92.9 and 93.2 %). If the interval is first looked at with 10 seeds, 94.2, 93.1
/// and 94.0 % do.
pub fn adds_a_seed(seeds: usize, primary: &Estimate) -> bool {
    let half_width = 0.5 * (primary.high - primary.low);
    seeds < MOST_SEEDS && (seeds < LEAST_SEEDS || !(half_width <= HALF_WIDTH))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seeds_are_added_until_the_interval_is_narrow() {
        let narrow = Estimate { value: 0.5, low: 0.49, high: 0.51, n: 60 };
        let wide = Estimate { low: 0.45, ..narrow };
        assert!(!adds_a_seed(LEAST_SEEDS, &narrow) && adds_a_seed(LEAST_SEEDS, &wide));
        assert!(adds_a_seed(LEAST_SEEDS - 1, &narrow) && !adds_a_seed(MOST_SEEDS, &wide));
        // Significant or not makes no difference.
        assert!(adds_a_seed(10, &Estimate { value: 0.5, low: 0.4, high: 0.6, n: 60 }));
        assert!(adds_a_seed(10, &Estimate { value: 0.0, low: -0.1, high: 0.1, n: 60 }));
    }
}
