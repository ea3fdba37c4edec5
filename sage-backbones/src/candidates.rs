//! Selection of candidates among modes: the likeliest, a seeded draw, or the likeliest at a least distance.

use sage_core::seed::Rng;
use serde::{Deserialize, Serialize};

/// Rule that selects modes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Sampling {
    /// The likeliest: with dense goals a cluster of neighbours.
    TopK,
    /// A draw without replacement, each mode by its probability (Gumbel top-k).
    Gumbel,
    /// Non-maximum suppression: the likeliest modes in turn, none ending within `radius` metres of a selected
    /// one. If these are too few, the likeliest of the rest are added.
    Nms {
        /// Least distance of two ends, metres.
        radius: f32,
    },
}

/// Selects up to `k` modes, in descending order of log-probability, ties by lower index.
///
/// `ends` are the end points of the modes; only suppression reads them. Only the Gumbel draw uses `rng`.
///
/// ```
/// use sage_backbones::candidates::{Sampling, select};
/// use sage_core::seed::Rng;
///
/// // The two likeliest modes end 1 m apart.
/// let (log_probs, ends) = ([-0.5, -0.7, -2.0], [[40.0, 0.0], [41.0, 0.0], [20.0, 5.0]]);
/// let mut rng = Rng::new(0, "scene", "candidates");
/// assert_eq!(select(&log_probs, &ends, 2, Sampling::TopK, &mut rng), [0, 1]);
/// // With a radius of 5 m the second is a neighbour of the first, and the third is taken instead.
/// assert_eq!(select(&log_probs, &ends, 2, Sampling::Nms { radius: 5.0 }, &mut rng), [0, 2]);
/// ```
pub fn select(
    log_probs: &[f32],
    ends: &[[f32; 2]],
    k: usize,
    selection: Sampling,
    rng: &mut Rng,
) -> Vec<usize> {
    match selection {
        Sampling::TopK => first_k(log_probs, k),
        Sampling::Gumbel => {
            let mut selected = drawn(log_probs, k, rng);
            selected.sort_by(|a, b| by_rank(log_probs, *a, *b));
            selected
        }
        Sampling::Nms { radius } => {
            let order = ranked(log_probs);
            let mut selected = suppressed(&order, ends, k, radius);
            if selected.len() < k.min(order.len()) {
                let missing = k - selected.len();
                let mut taken = vec![false; order.len()];
                selected.iter().for_each(|&mode| taken[mode] = true);
                selected.extend(order.iter().copied().filter(|&mode| !taken[mode]).take(missing));
                selected.sort_by(|a, b| by_rank(log_probs, *a, *b));
            }
            selected
        }
    }
}

/// Up to `k` modes without replacement, each by its probability, in the order in which they are drawn: the first of them are a
/// draw too.
pub fn drawn(log_probs: &[f32], k: usize, rng: &mut Rng) -> Vec<usize> {
    let noisy: Vec<f32> = log_probs.iter().map(|p| (f64::from(*p) + gumbel(rng)) as f32).collect();
    first_k(&noisy, k)
}

/// The first modes of an order, none ending within `radius` of an earlier one; at most `k`.
pub fn suppressed(order: &[usize], ends: &[[f32; 2]], k: usize, radius: f32) -> Vec<usize> {
    let mut selected: Vec<usize> = Vec::with_capacity(k);
    for &mode in order {
        if selected.len() == k {
            break;
        }
        let [x, y] = ends[mode];
        let apart = |&other: &usize| {
            let [dx, dy] = [ends[other][0] - x, ends[other][1] - y];
            dx * dx + dy * dy >= radius * radius
        };
        if selected.iter().all(apart) {
            selected.push(mode);
        }
    }
    selected
}

/// All modes, the likeliest first.
pub fn ranked(log_probs: &[f32]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..log_probs.len()).collect();
    order.sort_unstable_by(|a, b| by_rank(log_probs, *a, *b));
    order
}

/// The `k` largest in descending order.
fn first_k(values: &[f32], k: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    if k < order.len() && k > 0 {
        order.select_nth_unstable_by(k - 1, |a, b| by_rank(values, *a, *b));
    }
    order.truncate(k);
    order.sort_unstable_by(|a, b| by_rank(values, *a, *b));
    order
}

fn by_rank(values: &[f32], a: usize, b: usize) -> std::cmp::Ordering {
    values[b].total_cmp(&values[a]).then(a.cmp(&b))
}

/// A draw from the standard Gumbel distribution.
fn gumbel(rng: &mut Rng) -> f64 {
    -(-(1.0 - rng.unit()).ln()).max(f64::MIN_POSITIVE).ln()
}

#[cfg(test)]
mod tests {
    use super::*;

    const LOG_PROBS: [f32; 5] = [-1.0, -0.5, -3.0, -0.5, -2.0];
    const ENDS: [[f32; 2]; 5] = [[0.0, 0.0], [1.0, 0.0], [10.0, 0.0], [2.0, 0.0], [5.0, 0.0]];

    fn rng() -> Rng {
        Rng::new(1, "candidates", "test")
    }

    #[test]
    fn top_k_selects_the_likeliest_and_the_first_of_equals() {
        assert_eq!(select(&LOG_PROBS, &ENDS, 3, Sampling::TopK, &mut rng()), [1, 3, 0]);
        assert_eq!(select(&LOG_PROBS, &ENDS, 9, Sampling::TopK, &mut rng()), [1, 3, 0, 4, 2]);
        assert!(select(&LOG_PROBS, &ENDS, 0, Sampling::TopK, &mut rng()).is_empty());
    }

    #[test]
    fn suppression_separates_ends_and_adds_the_likeliest_of_the_rest() {
        let nms = Sampling::Nms { radius: 3.0 };
        assert_eq!(select(&LOG_PROBS, &ENDS, 3, nms, &mut rng()), [1, 4, 2]);
        assert_eq!(select(&LOG_PROBS, &ENDS, 4, nms, &mut rng()), [1, 3, 4, 2], "one of the rest");
        assert_eq!(suppressed(&ranked(&LOG_PROBS), &ENDS, 9, 3.0), [1, 4, 2]);
    }

    #[test]
    fn gumbel_draws_by_probability_and_repeats_with_its_seed() {
        let p = [0.5_f32, 0.3, 0.2].map(f32::ln);
        let ends = [[0.0; 2]; 3];
        let mut counts = [0; 3];
        let mut rng = rng();
        for _ in 0..20_000 {
            counts[select(&p, &ends, 1, Sampling::Gumbel, &mut rng)[0]] += 1;
        }
        for (count, p) in counts.iter().zip([0.5, 0.3, 0.2]) {
            assert!((f64::from(*count) / 20_000.0 - p).abs() < 0.012, "{counts:?}");
        }
        let draw = || select(&LOG_PROBS, &ENDS, 3, Sampling::Gumbel, &mut self::rng());
        assert_eq!(draw(), draw());
    }
}
