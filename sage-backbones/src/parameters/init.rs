//! Initial values of parameters, from a seed. candle's own generator cannot be seeded on a CPU.

use candle_core::Shape;
use candle_nn::init::NormalOrUniform;
use sage_core::seed::Rng;

/// Initialisation of a parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Init {
    /// Uniform in ±1/√fan-in, as PyTorch initialises the weights and biases of linear layers.
    Uniform {
        /// Number of inputs that are summed.
        fan_in: usize,
    },
    /// Uniform between two numbers.
    Between(f64, f64),
    /// Normal with a mean and a standard deviation.
    Normal(f64, f64),
    /// The same number everywhere.
    Constant(f32),
}

impl Init {
    /// What a layer of candle-nn asks for.
    pub(super) fn of_candle(init: candle_nn::Init, shape: &Shape) -> Self {
        match init {
            candle_nn::Init::Const(value) => Self::Constant(value as f32),
            candle_nn::Init::Uniform { lo, up } => Self::Between(lo, up),
            candle_nn::Init::Randn { mean, stdev } => Self::Normal(mean, stdev),
            candle_nn::Init::Kaiming { dist, fan, non_linearity } => {
                let deviation = non_linearity.gain() / (fan.for_shape(shape).max(1) as f64).sqrt();
                let bound = 3.0_f64.sqrt() * deviation;
                match dist {
                    NormalOrUniform::Uniform => Self::Between(-bound, bound),
                    NormalOrUniform::Normal => Self::Normal(0.0, deviation),
                }
            }
        }
    }

    /// `count` values for the parameter of this name; they depend on seed and name alone.
    pub fn values(self, count: usize, seed: u64, name: &str) -> Vec<f32> {
        let mut rng = Rng::new(seed, name, "initial values");
        let mut draw: Box<dyn FnMut() -> f64> = match self {
            Self::Constant(value) => return vec![value; count],
            Self::Uniform { fan_in } => {
                let bound = 1.0 / (fan_in.max(1) as f64).sqrt();
                Box::new(move || rng.uniform(-bound, bound))
            }
            Self::Between(low, high) => Box::new(move || rng.uniform(low, high)),
            Self::Normal(mean, deviation) => Box::new(move || mean + deviation * rng.normal()),
        };
        (0..count).map(|_| draw() as f32).collect()
    }
}
