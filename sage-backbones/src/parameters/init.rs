//! Initial values of parameters, from a seed. candle's own generator cannot be seeded on a CPU.

use sage_core::seed::Rng;

/// Initialisation of a parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Init {
    /// Uniform in ±1/√fan-in, as PyTorch initialises the weights and biases of linear layers.
    Uniform {
        /// Number of inputs that are summed.
        fan_in: usize,
    },
    /// The same number everywhere.
    Constant(f32),
}

impl Init {
    /// `count` values for the parameter of this name; they depend on seed and name alone.
    pub fn values(self, count: usize, seed: u64, name: &str) -> Vec<f32> {
        match self {
            Self::Constant(value) => vec![value; count],
            Self::Uniform { fan_in } => {
                let mut rng = Rng::new(seed, name, "initial values");
                let bound = 1.0 / (fan_in.max(1) as f64).sqrt();
                (0..count).map(|_| rng.uniform(-bound, bound) as f32).collect()
            }
        }
    }
}
