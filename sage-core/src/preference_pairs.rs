//! Preference pairs: the training data of preference fine-tuning.
//!
//! A feasible candidate is preferred to an infeasible one; of two feasible candidates the one with the
//! higher reward is preferred. Source: SAGE (ICLR 2026), hierarchical group preference optimisation. In the
//! published code infeasible losers may take all pairs. Here they take at most half: pairs by feasibility
//! alone do not distinguish an adversarial expert from a realistic one.

use serde::{Deserialize, Serialize};

use crate::seed::Rng;

/// A candidate with its reward and feasibility.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ScoredCandidate {
    /// Value of the expert's objective.
    pub reward: f64,
    /// Whether it is feasible.
    pub is_feasible: bool,
}

/// One preference: indices into the candidates.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pair {
    /// The preferred candidate.
    pub winner: usize,
    /// The other candidate.
    pub loser: usize,
    /// Whether the loser is infeasible.
    pub by_feasibility: bool,
}

/// Rule by which pairs are formed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Pairing {
    /// Feasible over infeasible, then higher over lower reward among the feasible.
    Hierarchical,
    /// Higher over lower reward, regardless of feasibility.
    RewardOnly,
    /// The best over the worst: one pair by feasibility, one by reward (plain DPO).
    BestWorst,
}

/// Preference pairs of a group of candidates: at most `most`, drawn with a seed from those that differ by
/// more than `margin` in reward or in feasibility. Empty if no two candidates differ.
///
/// ```
/// use sage_core::{
///     preference_pairs::{Pairing, ScoredCandidate, preference_pairs},
///     seed::Rng,
/// };
///
/// // The infeasible candidate has the largest reward, and still loses.
/// let scored = [(2.0, true), (9.0, false), (1.0, true)];
/// let candidates = scored.map(|(reward, is_feasible)| ScoredCandidate { reward, is_feasible });
/// let pairs = preference_pairs(&candidates, Pairing::Hierarchical, 8, 0.2, &mut Rng::new(0, "scene", "pairs"));
/// assert!(pairs.iter().all(|pair| pair.winner != 1));
/// assert!(pairs.iter().any(|pair| (pair.winner, pair.loser, pair.by_feasibility) == (0, 2, false)));
/// ```
pub fn preference_pairs(
    candidates: &[ScoredCandidate],
    pairing: Pairing,
    most: usize,
    margin: f64,
    rng: &mut Rng,
) -> Vec<Pair> {
    let all: Vec<usize> = (0..candidates.len()).collect();
    let (feasible, infeasible): (Vec<usize>, Vec<usize>) = match pairing {
        Pairing::RewardOnly => (all, Vec::new()),
        _ => all.into_iter().partition(|&k| candidates[k].is_feasible),
    };
    if pairing == Pairing::BestWorst {
        return best_and_worst(candidates, &feasible, &infeasible, margin);
    }
    let mut pairs = Vec::with_capacity(most);
    if !feasible.is_empty() {
        let mut losers = infeasible;
        rng.shuffle(&mut losers);
        // A single feasible candidate gives no pairs by reward, so infeasible losers may take all pairs.
        let room = if feasible.len() > 1 { most.div_ceil(2) } else { most };
        for &loser in losers.iter().take(room) {
            let winner = feasible[rng.below(feasible.len())];
            pairs.push(Pair { winner, loser, by_feasibility: true });
        }
    }
    let mut by_reward = better_and_worse(candidates, &feasible, margin);
    rng.shuffle(&mut by_reward);
    by_reward.truncate(most - pairs.len());
    pairs.extend(by_reward);
    pairs
}

/// All pairs among some candidates whose rewards differ by more than a margin.
fn better_and_worse(candidates: &[ScoredCandidate], among: &[usize], margin: f64) -> Vec<Pair> {
    let mut pairs = Vec::new();
    for (rank, &a) in among.iter().enumerate() {
        for &b in &among[rank + 1..] {
            let lead = candidates[a].reward - candidates[b].reward;
            if lead.abs() > margin {
                let (winner, loser) = if lead > 0.0 { (a, b) } else { (b, a) };
                pairs.push(Pair { winner, loser, by_feasibility: false });
            }
        }
    }
    pairs
}

fn best_and_worst(
    candidates: &[ScoredCandidate],
    feasible: &[usize],
    infeasible: &[usize],
    margin: f64,
) -> Vec<Pair> {
    let by_reward = |a: &&usize, b: &&usize| candidates[**a].reward.total_cmp(&candidates[**b].reward);
    let (Some(&best), Some(&worst)) = (feasible.iter().max_by(by_reward), feasible.iter().min_by(by_reward))
    else {
        return Vec::new();
    };
    let mut pairs = Vec::new();
    if let Some(&loser) = infeasible.iter().min_by(by_reward) {
        pairs.push(Pair { winner: best, loser, by_feasibility: true });
    }
    if candidates[best].reward - candidates[worst].reward > margin {
        pairs.push(Pair { winner: best, loser: worst, by_feasibility: false });
    }
    pairs
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scored(items: &[(f64, bool)]) -> Vec<ScoredCandidate> {
        items.iter().map(|&(reward, is_feasible)| ScoredCandidate { reward, is_feasible }).collect()
    }

    fn pairs(items: &[(f64, bool)], pairing: Pairing, most: usize) -> Vec<Pair> {
        preference_pairs(&scored(items), pairing, most, 0.2, &mut Rng::new(1, "pairs", "test"))
    }

    const MIXED: [(f64, bool); 6] =
        [(5.0, true), (1.0, false), (3.0, true), (9.0, false), (2.95, true), (0.0, false)];

    #[test]
    fn feasible_candidates_win_and_of_two_the_higher_reward() {
        let found = pairs(&MIXED, Pairing::Hierarchical, 32);
        for pair in &found {
            let [winner, loser] = [MIXED[pair.winner], MIXED[pair.loser]];
            assert!(winner.1, "only the feasible win");
            assert_eq!(pair.by_feasibility, !loser.1);
            assert!(!loser.1 || winner.0 > loser.0 + 0.2);
        }
        assert_eq!(found.iter().filter(|p| p.by_feasibility).count(), 3, "every infeasible one loses once");
        assert_eq!(found.iter().filter(|p| !p.by_feasibility).count(), 2, "3.0 and 2.95 are alike");
    }

    #[test]
    fn infeasible_losers_take_half_of_the_pairs() {
        let items: Vec<(f64, bool)> = (0..32).map(|k| (f64::from(k), k % 2 == 0)).collect();
        let found = pairs(&items, Pairing::Hierarchical, 8);
        assert_eq!((found.len(), found.iter().filter(|p| p.by_feasibility).count()), (8, 4));
        let one: Vec<(f64, bool)> = (0..32).map(|k| (f64::from(k), k == 7)).collect();
        assert_eq!(pairs(&one, Pairing::Hierarchical, 8).len(), 8, "no other pair exists");
    }

    #[test]
    fn equal_candidates_give_no_pairs() {
        assert!(pairs(&[(1.0, true), (1.1, true)], Pairing::Hierarchical, 8).is_empty());
        assert!(pairs(&[(1.0, false), (5.0, false)], Pairing::Hierarchical, 8).is_empty());
        assert!(pairs(&[], Pairing::RewardOnly, 8).is_empty());
    }

    #[test]
    fn ablations_form_the_documented_pairs() {
        let reward_only = pairs(&MIXED, Pairing::RewardOnly, 32);
        assert!(reward_only.iter().any(|p| p.winner == 3) && reward_only.iter().all(|p| !p.by_feasibility));
        let best_worst = pairs(&MIXED, Pairing::BestWorst, 32);
        let expected = [
            Pair { winner: 0, loser: 5, by_feasibility: true },
            Pair { winner: 0, loser: 4, by_feasibility: false },
        ];
        assert_eq!(best_worst, expected);
    }
}
