//! A preference between two rewards, and the coefficients of two experts in it.

/// A user's preference μ, and the experts' own β.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Preference {
    /// Weight of the adversarial reward, 0 to 1.
    pub mu: f64,
    /// Weight of each expert's own reward, in (0.5, 1].
    pub beta: f64,
}

impl Preference {
    /// `c_1` and `c_2` with `R_μ = c_1 R_1 + c_2 R_2`; they sum to 1 and are positive for μ inside [1 − β, β].
    pub fn coefficients(&self) -> [f64; 2] {
        let Self { mu, beta } = *self;
        let width = 2.0 * beta - 1.0;
        [(mu + beta - 1.0) / width, (beta - mu) / width]
    }

    /// The nearest preference that the experts enclose.
    pub fn clipped(&self) -> f64 {
        self.mu.clamp(1.0 - self.beta, self.beta)
    }
}
