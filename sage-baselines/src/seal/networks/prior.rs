//! Prior of skills: a conditional RealNVP (Dinh et al., 2017) from skills to a standard normal distribution, given the
//! observation at the start of the skill.
//!
//! Four coupling layers change one half of the skill at a time; odd layers change the first half. SEAL (Stoler et al.,
//! 2025) uses a hidden width of 512 (2 551 840 parameters). The default here is 64 (89 632 parameters).

use candle_core::{Device, Result, Tensor};
use sage_backbones::{Error, parameters::Scope};

use super::{OBSERVATION, SKILL, coupling::Coupling};

/// Coupling layers.
const LAYERS: usize = 4;

/// A distribution of skills, given an observation.
#[derive(Clone, Debug)]
pub struct SkillPrior {
    layers: Vec<Coupling>,
}

impl SkillPrior {
    /// Takes `layers.*` from the scope; `hidden` is the width of the networks in the layers.
    ///
    /// *Errors*: a tensor that is missing or has another shape.
    pub fn new(scope: &Scope, hidden: usize) -> Result<Self> {
        let layer = |k: usize| Coupling::new(&scope.at("layers").at(k), hidden, k % 2 == 1);
        Ok(Self { layers: (0..LAYERS).map(layer).collect::<Result<_>>()? })
    }

    /// The noise of skills, and the logarithm of the determinant of its Jacobian.
    fn forward(&self, skills: &Tensor, observations: &Tensor) -> Result<[Tensor; 2]> {
        let mut noise = skills.clone();
        let mut log_determinant: Option<Tensor> = None;
        for layer in &self.layers {
            let [next, own] = layer.forward(&noise, observations)?;
            noise = next;
            log_determinant = Some(match log_determinant {
                Some(sum) => (sum + own)?,
                None => own,
            });
        }
        match log_determinant {
            Some(log_determinant) => Ok([noise, log_determinant]),
            None => candle_core::bail!("a flow without layers"),
        }
    }

    /// The skills of noise.
    fn inverse(&self, noise: &Tensor, observations: &Tensor) -> Result<Tensor> {
        let mut skills = noise.clone();
        for layer in self.layers.iter().rev() {
            skills = layer.inverse(&skills, observations)?;
        }
        Ok(skills)
    }

    /// Logarithms of the probability densities of skills.
    ///
    /// *Shapes*: `skills` (n, [`SKILL`]), `observations` (n, [`OBSERVATION`]); result (n).
    ///
    /// *Errors*: other shapes.
    pub fn log_prob(&self, skills: &Tensor, observations: &Tensor) -> Result<Tensor> {
        let [noise, log_determinant] = self.forward(skills, observations)?;
        let constant = SKILL as f64 / 2.0 * std::f64::consts::TAU.ln();
        (noise.sqr()?.sum(1)?.affine(-0.5, -constant)? + log_determinant)?.contiguous()
    }

    /// The skill of a draw of standard normal noise.
    ///
    /// *Errors*: [`Error::NotFinite`].
    pub fn sample(
        &self,
        noise: &[f32; SKILL],
        observation: &[f32; OBSERVATION],
    ) -> std::result::Result<[f32; SKILL], Error> {
        let noise = Tensor::from_slice(noise, (1, SKILL), &Device::Cpu)?;
        let observation = Tensor::from_slice(observation, (1, OBSERVATION), &Device::Cpu)?;
        let skill = self.inverse(&noise, &observation)?.flatten_all()?.to_vec1::<f32>()?;
        match <[f32; SKILL]>::try_from(skill) {
            Ok(skill) if skill.iter().all(|x| x.is_finite()) => Ok(skill),
            Ok(skill) => Err(Error::NotFinite(format!("a drawn skill is {skill:?}"))),
            Err(skill) => Err(Error::Mismatch(format!("a skill of {} numbers", skill.len()))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::{DType, Var};
    use sage_backbones::Parameters;
    use sage_core::seed::Rng;

    fn prior(hidden: usize, dtype: DType) -> (Parameters, SkillPrior) {
        let specs = Scope::list(|scope| SkillPrior::new(scope, hidden)).unwrap();
        let parameters = Parameters::start(&specs, 2).unwrap().to_dtype(dtype).unwrap();
        let prior = SkillPrior::new(&Scope::of(&parameters), hidden).unwrap();
        (parameters, prior)
    }

    fn noise(rows: usize, columns: usize, seed: u64) -> Tensor {
        let mut rng = Rng::new(seed, "noise", "test");
        let numbers: Vec<f64> = (0..rows * columns).map(|_| rng.normal()).collect();
        Tensor::from_vec(numbers, (rows, columns), &Device::Cpu).unwrap()
    }

    /// Logarithm of the absolute determinant, by elimination.
    fn log_determinant(mut matrix: Vec<Vec<f64>>) -> f64 {
        let n = matrix.len();
        let mut log = 0.0;
        for k in 0..n {
            let pivot = (k..n).max_by(|a, b| matrix[*a][k].abs().total_cmp(&matrix[*b][k].abs())).unwrap();
            matrix.swap(k, pivot);
            log += matrix[k][k].abs().ln();
            let (done, below) = matrix.split_at_mut(k + 1);
            for row in below {
                let factor = row[k] / done[k][k];
                row.iter_mut().zip(&done[k]).for_each(|(x, pivot)| *x -= factor * pivot);
            }
        }
        log
    }

    fn assert_determinant(of: impl Fn(&Tensor) -> [Tensor; 2]) {
        for seed in 0..3 {
            let x = Var::from_tensor(&noise(1, SKILL, seed)).unwrap();
            let [y, stated] = of(&x);
            let row = |k: usize| {
                let store = y.narrow(1, k, 1).unwrap().sum_all().unwrap().backward().unwrap();
                store.get(&x).unwrap().flatten_all().unwrap().to_vec1::<f64>().unwrap()
            };
            let expected = log_determinant((0..SKILL).map(row).collect());
            let stated = stated.to_vec1::<f64>().unwrap()[0];
            assert!((stated - expected).abs() < 1e-6, "{stated} {expected}");
        }
    }

    #[test]
    fn widths_have_the_stated_numbers_of_parameters() {
        assert_eq!(prior(64, DType::F32).0.numbers(), 89_632);
        assert_eq!(prior(512, DType::F32).0.numbers(), 2_551_840);
    }

    #[test]
    fn the_inverse_gives_back_the_skills() {
        let (_, prior) = prior(16, DType::F64);
        let (skills, observations) = (noise(7, SKILL, 1), noise(7, OBSERVATION, 2));
        let [noise, _] = prior.forward(&skills, &observations).unwrap();
        let back = prior.inverse(&noise, &observations).unwrap();
        let difference = (back - &skills).unwrap().abs().unwrap().max_all().unwrap();
        assert!(difference.to_scalar::<f64>().unwrap() < 1e-6);
        assert!(
            (noise - skills).unwrap().abs().unwrap().max_all().unwrap().to_scalar::<f64>().unwrap() > 0.1
        );
    }

    #[test]
    fn determinants_are_those_of_the_jacobians() {
        let (_, prior) = prior(16, DType::F64);
        let observation = noise(1, OBSERVATION, 9);
        for layer in &prior.layers {
            assert_determinant(|x| layer.forward(x, &observation).unwrap());
        }
        assert_determinant(|x| prior.forward(x, &observation).unwrap());
    }

    #[test]
    fn a_sample_has_the_density_of_its_noise_over_the_determinant() {
        let (_, prior) = prior(16, DType::F32);
        let observation = [0.2; OBSERVATION];
        let noise = [0.1, -1.0, 0.5, 2.0, -0.3, 0.0, 0.7, -0.8];
        let skill = prior.sample(&noise, &observation).unwrap();
        let skill = Tensor::from_slice(&skill, (1, SKILL), &Device::Cpu).unwrap();
        let observations = Tensor::from_slice(&observation, (1, OBSERVATION), &Device::Cpu).unwrap();
        let [back, log_determinant] = prior.forward(&skill, &observations).unwrap();
        for (x, y) in back.to_vec2::<f32>().unwrap()[0].iter().zip(noise) {
            assert!((x - y).abs() < 1e-5);
        }
        let squares: f32 = noise.iter().map(|x| x * x).sum();
        let expected =
            -0.5 * squares - 4.0 * std::f32::consts::TAU.ln() + log_determinant.to_vec1::<f32>().unwrap()[0];
        let found = prior.log_prob(&skill, &observations).unwrap().to_vec1::<f32>().unwrap()[0];
        assert!((found - expected).abs() < 1e-4);
        assert!(matches!(prior.sample(&[f32::NAN; SKILL], &observation), Err(Error::NotFinite(_))));
    }
}
