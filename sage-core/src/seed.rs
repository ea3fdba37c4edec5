//! Random numbers that depend on a seed, a scene and a purpose only.
//!
//! There is one generator per (seed, scene, purpose) and none is shared. Results therefore do not depend on
//! the order of work or the number of threads. Conversions to floats, ranges and orders are implemented
//! here on plain 64-bit draws, so that an upgrade of a library cannot change them.

use rand_core::{Rng as _, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// A seeded generator.
///
/// ```
/// use sage_core::seed::Rng;
///
/// // Equal names give equal numbers, on any machine and in any order of work.
/// let mut rng = Rng::new(1, "scene", "noise");
/// let draws = [rng.unit(), rng.unit()];
/// assert_eq!(draws, [Rng::new(1, "scene", "noise").unit(), draws[1]]);
/// // Another purpose gives other numbers, so a new use of randomness changes no result.
/// assert_ne!(Rng::new(1, "scene", "shuffle").unit(), draws[0]);
/// assert!((0.0..1.0).contains(&draws[0]) && rng.below(6) < 6);
/// ```
#[derive(Clone, Debug)]
pub struct Rng(Pcg64Mcg);

impl Rng {
    /// The generator of a seed for one scene and one purpose.
    pub fn new(seed: u64, scene: &str, purpose: &str) -> Self {
        let mut hasher = blake3::Hasher::new();
        hasher.update(&seed.to_le_bytes());
        // Lengths distinguish ("ab", "c") from ("a", "bc").
        hasher.update(&(scene.len() as u64).to_le_bytes());
        hasher.update(scene.as_bytes());
        hasher.update(purpose.as_bytes());
        let mut state = [0; 16];
        state.copy_from_slice(&hasher.finalize().as_bytes()[..16]);
        Self(Pcg64Mcg::from_seed(state))
    }

    /// 64 random bits.
    pub fn bits(&mut self) -> u64 {
        self.0.next_u64()
    }

    /// A number in [0, 1) with 53 random bits.
    pub fn unit(&mut self) -> f64 {
        (self.bits() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
    }

    /// A number in [low, high).
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// An index below `n`, 0 if `n` is 0. Its bias is below n / 2⁶⁴.
    pub fn below(&mut self, n: usize) -> usize {
        ((u128::from(self.bits()) * n as u128) >> 64) as usize
    }

    /// A draw from the standard normal distribution (Box and Muller's transform).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * (1.0 - self.unit()).ln()).sqrt();
        radius * (std::f64::consts::TAU * self.unit()).cos()
    }

    /// Shuffles a slice (Fisher and Yates).
    pub fn shuffle<T>(&mut self, items: &mut [T]) {
        for last in (1..items.len()).rev() {
            items.swap(last, self.below(last + 1));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_names_give_equal_draws_and_other_names_other_draws() {
        let draws = |seed, scene: &str, purpose: &str| Rng::new(seed, scene, purpose).bits();
        assert_eq!(draws(7, "a", "b"), draws(7, "a", "b"));
        let all = [draws(7, "a", "b"), draws(8, "a", "b"), draws(7, "ab", ""), draws(7, "a", "c")];
        for (k, x) in all.iter().enumerate() {
            assert!(!all[..k].contains(x));
        }
    }

    #[test]
    fn draws_are_pinned_so_that_results_survive_upgrades() {
        let mut rng = Rng::new(1, "scene", "purpose");
        assert_eq!([rng.bits(), rng.bits()], PINNED);
    }
    const PINNED: [u64; 2] = [4_457_149_804_606_990_069, 5_339_980_173_494_446_071];

    #[test]
    fn moments_match_the_distributions() {
        let mut rng = Rng::new(3, "moments", "test");
        let n = 100_000;
        let uniform = (0..n).map(|_| rng.uniform(2.0, 4.0)).sum::<f64>() / n as f64;
        assert!((uniform - 3.0).abs() < 0.01, "{uniform}");
        let normal: Vec<f64> = (0..n).map(|_| rng.normal()).collect();
        let variance = normal.iter().map(|x| x * x).sum::<f64>() / n as f64;
        assert!((variance - 1.0).abs() < 0.02, "{variance}");
    }

    #[test]
    fn a_shuffle_is_a_permutation() {
        let mut items: Vec<usize> = (0..100).collect();
        Rng::new(4, "shuffle", "test").shuffle(&mut items);
        assert_ne!(items, (0..100).collect::<Vec<_>>());
        items.sort_unstable();
        assert_eq!(items, (0..100).collect::<Vec<_>>());
    }
}
