//! Instances that several claims share.

use nalgebra::DVector;
use sage_core::seed::Rng;

use crate::{
    Experts, Preference,
    random::{log_uniform, normals},
    reward::{Concave, Curvature, FAMILIES, Family},
};

/// Values of β, in turn.
const BETAS: [f64; 5] = [0.51, 0.6, 0.75, 0.9, 1.0];

/// A preference inside, outside or at a border of what the experts enclose.
pub fn preference(rng: &mut Rng, instance: usize) -> Preference {
    let beta = BETAS[instance % BETAS.len()];
    let mu = match rng.below(8) {
        0 => 0.0,
        1 => 1.0,
        2 => 1.0 - beta,
        3 => beta,
        _ => rng.unit(),
    };
    Preference { mu, beta }
}

/// R_adv and R_real of random families and constants.
pub struct Pair {
    rewards: [Box<dyn Concave>; 2],
    start: DVector<f64>,
}

impl Pair {
    /// The pair of families with a number, from 0 to 24 and round again.
    pub fn families(number: usize) -> [Family; 2] {
        let count = FAMILIES.len();
        [FAMILIES[number % count], FAMILIES[number / count % count]]
    }

    /// Rewards of the pair of families with a number.
    pub fn draw(rng: &mut Rng, number: usize, dimension: usize) -> Self {
        let curvatures = [(); 2].map(|()| {
            let m = log_uniform(rng, [-1.0, 0.5]);
            Curvature { m, l: m * log_uniform(rng, [0.0, 1.5]) }
        });
        let scale = log_uniform(rng, [-1.0, 0.5]);
        Self::with(rng, Self::families(number), curvatures, scale, dimension)
    }

    /// Rewards of given families and constants around normal points with a scale.
    pub fn with(
        rng: &mut Rng,
        families: [Family; 2],
        curvatures: [Curvature; 2],
        scale: f64,
        dimension: usize,
    ) -> Self {
        let centers = [(); 2].map(|()| scale * normals(rng, dimension));
        let start = 0.5 * (&centers[0] + &centers[1]);
        let [first, second] = centers;
        let rewards =
            [families[0].draw(rng, curvatures[0], first), families[1].draw(rng, curvatures[1], second)];
        Self { rewards, start }
    }

    /// Both rewards.
    pub fn rewards(&self) -> [&dyn Concave; 2] {
        [&*self.rewards[0], &*self.rewards[1]]
    }

    /// Their experts; `None` if an optimum is not found.
    pub fn experts(&self, beta: f64) -> Option<Experts<'_>> {
        Experts::of(self.rewards(), beta, &self.start)
    }
}
