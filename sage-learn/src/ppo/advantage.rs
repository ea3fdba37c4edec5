//! Generalised advantage estimation (Schulman et al. 2016, arXiv 1506.02438).

/// How the stretch of an episode goes on after a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum After {
    /// By the next step of the batch.
    Next,
    /// The batch or a limit of steps cuts the episode off; the value of observation number `k` of those behind the cuts
    /// stands for what would have followed.
    Cut(usize),
    /// The episode ended by arrival or failure; nothing follows.
    End,
}

/// Advantages of all steps: `A_t = δ_t + γ λ A_{t+1}`, `δ_t = r_t + γ V(s_{t+1}) − V(s_t)`, where the sum stops at cuts
/// and ends, and `V(s_{t+1})` is 0 behind an end.
///
/// *Shapes*: `rewards`, `values` and `after` have a number per step; `cut_values` one per cut.
///
/// ```
/// use sage_learn::{After, advantages};
///
/// // Two steps of reward 1, and the end. With γ = 0.5 the first is worth 1.5; 1 was expected.
/// let found = advantages(&[1.0, 1.0], &[1.0, 1.0], &[After::Next, After::End], &[], [0.5, 1.0]);
/// assert_eq!(found, [0.5, 0.0]);
/// // Cut off at a limit of steps, the value behind the cut stands for what would have followed.
/// assert_eq!(advantages(&[1.0], &[1.0], &[After::Cut(0)], &[4.0], [0.5, 1.0]), [2.0]);
/// ```
pub fn advantages(
    rewards: &[f64],
    values: &[f64],
    after: &[After],
    cut_values: &[f64],
    [gamma, lambda]: [f64; 2],
) -> Vec<f64> {
    let mut advantages = vec![0.0; rewards.len()];
    let mut later = 0.0;
    for t in (0..rewards.len()).rev() {
        let (next, carried) = match after[t] {
            After::Next => (values[t + 1], later),
            After::Cut(k) => (cut_values[k], 0.0),
            After::End => (0.0, 0.0),
        };
        later = rewards[t] + gamma * next - values[t] + gamma * lambda * carried;
        advantages[t] = later;
    }
    advantages
}

#[cfg(test)]
mod tests {
    use sage_core::seed::Rng;

    use super::*;

    /// The definition: the sum of the discounted δ up to a cut or an end.
    fn naive(rewards: &[f64], values: &[f64], after: &[After], cuts: &[f64], [g, l]: [f64; 2]) -> Vec<f64> {
        let delta = |t: usize| {
            let next = match after[t] {
                After::Next => values[t + 1],
                After::Cut(k) => cuts[k],
                After::End => 0.0,
            };
            rewards[t] + g * next - values[t]
        };
        let sum = |start: usize| {
            let (mut sum, mut factor) = (0.0, 1.0);
            for (t, after) in after.iter().enumerate().skip(start) {
                sum += factor * delta(t);
                factor *= g * l;
                if *after != After::Next {
                    break;
                }
            }
            sum
        };
        (0..rewards.len()).map(sum).collect()
    }

    #[test]
    fn the_recursion_is_the_sum_of_the_definition() {
        let mut rng = Rng::new(3, "advantages", "test");
        let mut cuts = Vec::new();
        let after: Vec<After> = (0..200)
            .map(|t| match rng.below(9) {
                0 => After::End,
                _ if t % 32 == 31 || t == 199 || rng.below(12) == 0 => {
                    cuts.push(rng.uniform(-2.0, 2.0));
                    After::Cut(cuts.len() - 1)
                }
                _ => After::Next,
            })
            .collect();
        let mut draw = || -> Vec<f64> { (0..200).map(|_| rng.uniform(-1.0, 1.0)).collect() };
        let (rewards, values) = (draw(), draw());
        for discounts in [[0.97, 0.95], [1.0, 1.0], [0.9, 0.0]] {
            let found = advantages(&rewards, &values, &after, &cuts, discounts);
            let expected = naive(&rewards, &values, &after, &cuts, discounts);
            for (found, expected) in found.iter().zip(&expected) {
                assert!((found - expected).abs() < 1e-12, "{found} and {expected}");
            }
        }
    }

    #[test]
    fn a_cut_counts_what_would_follow_and_an_end_does_not() {
        let of = |after| advantages(&[1.0], &[0.5], &[after], &[10.0], [0.9, 0.95])[0];
        assert_eq!(of(After::End), 0.5);
        assert_eq!(of(After::Cut(0)), 9.5);
    }
}
