//! PPO's step in double precision: gradients by candle's automatic differentiation of the losses, everything else in
//! plain loops, with injected faults.
//!
//! The density is that of the action `tanh(u)`, with the correction for the hyperbolic tangent, which the learner leaves
//! out because it cancels.

use std::{collections::BTreeMap, f64::consts::TAU};

use candle_core::{Device, Result, Tensor, Var};
use sage_learn::{ActorCritic, Minibatch, PpoOptions, Real};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mistake {
    MaxForMin,
    NoClip,
    ClipWithoutMin,
    OnlyTheUpperBound,
    AdvantageNotNormalised,
    AdvantageNotCentred,
    SampleDeviation,
    RatioWithoutOldDensity,
    MeanOverActions,
    TanhCorrectionTurned,
    DeviationForPrecision,
    NoDeviationGradient,
    EntropySignTurned,
    SumForMean,
    CriticLossWithoutHalf,
    ImitationBeforeTanh,
    ExperienceNotReduced,
    JointNorm,
    DeviationsApart,
    NoNormCut,
    AlwaysAtTheNorm,
    NoBiasCorrection,
    EpsilonInsideTheRoot,
    EpsilonBeforeTheCorrection,
}

impl Mistake {
    /// Mistakes in the losses: their gradients differ.
    pub const LOSSES: [Self; 17] = [
        Self::MaxForMin,
        Self::NoClip,
        Self::ClipWithoutMin,
        Self::OnlyTheUpperBound,
        Self::AdvantageNotNormalised,
        Self::AdvantageNotCentred,
        Self::SampleDeviation,
        Self::RatioWithoutOldDensity,
        Self::MeanOverActions,
        Self::TanhCorrectionTurned,
        Self::DeviationForPrecision,
        Self::NoDeviationGradient,
        Self::EntropySignTurned,
        Self::SumForMean,
        Self::CriticLossWithoutHalf,
        Self::ImitationBeforeTanh,
        Self::ExperienceNotReduced,
    ];
    /// Mistakes in what is done with the gradients.
    pub const STEPS: [Self; 7] = [
        Self::JointNorm,
        Self::DeviationsApart,
        Self::NoNormCut,
        Self::AlwaysAtTheNorm,
        Self::NoBiasCorrection,
        Self::EpsilonInsideTheRoot,
        Self::EpsilonBeforeTheCorrection,
    ];
}

const PARTS: [&str; 6] = ["l1.weight", "l1.bias", "l2.weight", "l2.bias", "l3.weight", "l3.bias"];
const LOG_DEVIATIONS: &str = "log_deviations";

/// Names of the tensors of actor, log deviations and critic, in the order of the learner's gradients.
pub fn groups() -> [Vec<String>; 3] {
    let of = |network: &str| PARTS.iter().map(|part| format!("{network}.{part}")).collect();
    [of("actor"), vec![LOG_DEVIATIONS.to_owned()], of("critic")]
}

#[derive(Clone)]
struct Parameter {
    shape: Vec<usize>,
    numbers: Vec<f64>,
    first: Vec<f64>,
    second: Vec<f64>,
}

/// Losses of actor and critic, and the gradient of each tensor by its name.
pub struct Gradients {
    pub losses: [f64; 2],
    pub of: BTreeMap<String, Vec<f64>>,
}

pub struct Reference {
    options: PpoOptions,
    mistake: Option<Mistake>,
    parameters: BTreeMap<String, Parameter>,
    steps: i32,
    /// Norms of the gradients of actor and critic in each step, before their cut.
    pub norms: Vec<[f64; 2]>,
}

/// A batch in double precision.
struct Wide {
    observations: Tensor,
    actions: Tensor,
    log_densities: Tensor,
    returns: Tensor,
    /// Teacher's actions, and the weight of their imitation.
    taught: (Tensor, f64),
    /// As they are.
    advantages: Vec<f64>,
}

fn wide<T: Real>(numbers: &[T]) -> Vec<f64> {
    numbers.iter().map(|x| x.wide()).collect()
}

fn column(numbers: &[f64]) -> Result<Tensor> {
    Tensor::from_slice(numbers, (numbers.len(), 1), &Device::Cpu)
}

impl Wide {
    fn of<T: Real>(batch: &Minibatch<T>) -> Result<Self> {
        let rows = batch.advantages.len();
        let matrix = |x: &[T]| Tensor::from_vec(wide(x), (rows, x.len() / rows), &Device::Cpu);
        Ok(Self {
            observations: matrix(&batch.observations)?,
            actions: matrix(&batch.actions)?,
            log_densities: column(&batch.log_densities)?,
            returns: column(&batch.returns)?,
            taught: (matrix(&batch.taught.actions)?, batch.taught.weight),
            advantages: batch.advantages.clone(),
        })
    }
}

/// Multilayer perceptron of a network's tensors.
fn forward(vars: &BTreeMap<String, Var>, network: &str, x: &Tensor) -> Result<Tensor> {
    let [w1, b1, w2, b2, w3, b3] = PARTS.map(|part| vars[&format!("{network}.{part}")].as_tensor());
    let h = x.matmul(&w1.t()?)?.broadcast_add(b1)?.relu()?;
    let h = h.matmul(&w2.t()?)?.broadcast_add(b2)?.relu()?;
    h.matmul(&w3.t()?)?.broadcast_add(b3)
}

/// Square root of the squared differences from a centre by a divisor.
fn spread(numbers: &[f64], centre: f64, divisor: f64) -> f64 {
    (numbers.iter().map(|x| (x - centre).powi(2)).sum::<f64>() / divisor).sqrt()
}

impl Reference {
    pub fn of<T: Real>(learner: &ActorCritic<T>, mistake: Option<Mistake>) -> Self {
        let all: BTreeMap<String, (Vec<usize>, Vec<f64>)> =
            learner.tensors().into_iter().map(|t| (t.name, (t.shape, wide(t.numbers)))).collect();
        let parameters = groups().concat().into_iter().map(|name| {
            let numbers = |prefix: &str| all[&format!("{prefix}{name}")].1.clone();
            let (first, second) = (numbers("m."), numbers("v."));
            let parameter = Parameter { shape: all[&name].0.clone(), numbers: numbers(""), first, second };
            (name, parameter)
        });
        Self {
            options: learner.options().clone(),
            mistake,
            parameters: parameters.collect(),
            steps: 0,
            norms: Vec::new(),
        }
    }

    fn is(&self, mistake: Mistake) -> bool {
        self.mistake == Some(mistake)
    }

    fn vars(&self) -> Result<BTreeMap<String, Var>> {
        let var = |p: &Parameter| Var::from_slice(&p.numbers, p.shape.as_slice(), &Device::Cpu);
        self.parameters.iter().map(|(name, p)| Ok((name.clone(), var(p)?))).collect()
    }

    /// Ratios of the densities of the actions now and when they were drawn: a column.
    fn ratio(&self, vars: &BTreeMap<String, Var>, batch: &Wide) -> Result<Tensor> {
        let log_deviations = vars[LOG_DEVIATIONS].as_tensor();
        let log_deviations = match self.is(Mistake::NoDeviationGradient) {
            true => log_deviations.detach(),
            false => log_deviations.clone(),
        };
        let deviations = log_deviations.exp()?;
        let errors = (&batch.actions - forward(vars, "actor", &batch.observations)?)?;
        let z = match self.is(Mistake::DeviationForPrecision) {
            true => errors.broadcast_mul(&deviations)?,
            false => errors.broadcast_div(&deviations)?,
        };
        let normal = z.sqr()?.affine(-0.5, -0.5 * TAU.ln())?.broadcast_sub(&log_deviations)?;
        // The logarithm of the derivative of the hyperbolic tangent.
        let correction = batch.actions.tanh()?.sqr()?.affine(-1.0, 1.0)?.log()?;
        let before = (&batch.log_densities - correction.sum_keepdim(1)?)?;
        let sign = if self.is(Mistake::TanhCorrectionTurned) { -1.0 } else { 1.0 };
        let each = (normal - correction.affine(sign, 0.0)?)?;
        let now = match self.is(Mistake::MeanOverActions) {
            true => each.mean_keepdim(1)?,
            false => each.sum_keepdim(1)?,
        };
        if self.is(Mistake::RatioWithoutOldDensity) { now.exp() } else { (now - before)?.exp() }
    }

    fn advantages(&self, batch: &Wide) -> Vec<f64> {
        let (all, rows) = (&batch.advantages, batch.advantages.len() as f64);
        if self.is(Mistake::AdvantageNotNormalised) {
            return all.clone();
        }
        let mean = all.iter().sum::<f64>() / rows;
        let divisor = if self.is(Mistake::SampleDeviation) { rows - 1.0 } else { rows };
        let size = spread(all, mean, divisor) + 1e-8;
        let centre = if self.is(Mistake::AdvantageNotCentred) { 0.0 } else { mean };
        all.iter().map(|a| (a - centre) / size).collect()
    }

    /// Number of rows of each kind: ratio above or below its bounds, for advantages above and below the mean.
    pub fn cut_rows<T: Real>(&self, batch: &Minibatch<T>) -> Result<[[usize; 2]; 2]> {
        let batch = Wide::of(batch)?;
        let ratios: Vec<f64> = self.ratio(&self.vars()?, &batch)?.flatten_all()?.to_vec1()?;
        let mut counts = [[0; 2]; 2];
        for (ratio, advantage) in ratios.iter().zip(self.advantages(&batch)) {
            let of = &mut counts[usize::from(advantage < 0.0)];
            of[0] += usize::from(*ratio > 1.0 + self.options.clip);
            of[1] += usize::from(*ratio < 1.0 - self.options.clip);
        }
        Ok(counts)
    }

    /// Logarithms of the densities of a batch's actions before the hyperbolic tangent, for a batch whose own are 0.
    pub fn log_densities<T: Real>(&self, batch: &Minibatch<T>) -> Result<Vec<f64>> {
        self.ratio(&self.vars()?, &Wide::of(batch)?)?.log()?.flatten_all()?.to_vec1()
    }

    pub fn gradients<T: Real>(&self, batch: &Minibatch<T>) -> Result<Gradients> {
        let (vars, batch, o) = (self.vars()?, Wide::of(batch)?, &self.options);
        let ratio = self.ratio(&vars, &batch)?;
        let advantage = column(&self.advantages(&batch))?;
        let least = if self.is(Mistake::OnlyTheUpperBound) { 0.0 } else { 1.0 - o.clip };
        let free = (&ratio * &advantage)?;
        let cut = (ratio.clamp(least, 1.0 + o.clip)? * &advantage)?;
        let gains = match self.mistake {
            Some(Mistake::MaxForMin) => free.maximum(&cut)?,
            Some(Mistake::NoClip) => free,
            Some(Mistake::ClipWithoutMin) => cut,
            _ => free.minimum(&cut)?,
        };
        let gain = if self.is(Mistake::SumForMean) { gains.sum_all()? } else { gains.mean_all()? };
        let weight = if self.is(Mistake::EntropySignTurned) { -o.entropy } else { o.entropy };
        let entropy = vars[LOG_DEVIATIONS].sum_all()?.affine(weight, 0.0)?;
        let (taught, share) = &batch.taught;
        let outputs = forward(&vars, "actor", &batch.observations)?;
        let imitated = if self.is(Mistake::ImitationBeforeTanh) { outputs } else { outputs.tanh()? };
        let imitation = (imitated - taught)?.sqr()?.sum(1)?.mean_all()?;
        let experience = if self.is(Mistake::ExperienceNotReduced) { 1.0 } else { 1.0 - share };
        let actor = (imitation.affine(5.0 * share, 0.0)? - (gain + entropy)?.affine(experience, 0.0)?)?;
        let errors = (forward(&vars, "critic", &batch.observations)? - &batch.returns)?;
        let half = if self.is(Mistake::CriticLossWithoutHalf) { 1.0 } else { 0.5 };
        let critic = errors.sqr()?.mean_all()?.affine(half, 0.0)?;
        let (of_actor, of_critic) = (actor.backward()?, critic.backward()?);
        let of = vars.iter().map(|(name, var)| {
            let found = if name.starts_with("critic") { of_critic.get(var) } else { of_actor.get(var) };
            // candle leaves out what has the weight 0.
            let none = || vec![0.0; var.elem_count()];
            Ok((name.clone(), found.map_or_else(|| Ok(none()), |found| found.flatten_all()?.to_vec1())?))
        });
        Ok(Gradients { losses: [actor.to_scalar()?, critic.to_scalar()?], of: of.collect::<Result<_>>()? })
    }

    pub fn step<T: Real>(&mut self, batch: &Minibatch<T>, rate: f64) -> Result<()> {
        let mut gradients = self.gradients(batch)?.of;
        let [actor, deviations, critic] = groups();
        let norm = |gradients: &BTreeMap<String, Vec<f64>>, names: &[String]| {
            names.iter().flat_map(|name| &gradients[name]).map(|g| g * g).sum::<f64>().sqrt()
        };
        let together = [&actor[..], &deviations].concat();
        self.norms.push([norm(&gradients, &together), norm(&gradients, &critic)]);
        let sets = match self.mistake {
            Some(Mistake::JointNorm) => vec![[&together[..], &critic].concat()],
            Some(Mistake::DeviationsApart) => vec![actor, deviations, critic],
            Some(Mistake::NoNormCut) => Vec::new(),
            _ => vec![together, critic],
        };
        for names in sets {
            let (norm, most) = (norm(&gradients, &names), self.options.gradient_norm);
            if norm > most || self.is(Mistake::AlwaysAtTheNorm) {
                for name in names {
                    gradients.get_mut(&name).expect("a gradient").iter_mut().for_each(|g| *g *= most / norm);
                }
            }
        }
        self.steps += 1;
        let [b1, b2] = self.options.betas;
        let (c1, c2) = match self.is(Mistake::NoBiasCorrection) {
            true => (1.0, 1.0),
            false => (1.0 - b1.powi(self.steps), 1.0 - b2.powi(self.steps)),
        };
        let (epsilon, mistake) = (self.options.epsilon, self.mistake);
        for (name, p) in &mut self.parameters {
            for (k, g) in gradients[name].iter().enumerate() {
                p.first[k] = b1 * p.first[k] + (1.0 - b1) * g;
                p.second[k] = b2 * p.second[k] + (1.0 - b2) * g * g;
                let root = match mistake {
                    Some(Mistake::EpsilonInsideTheRoot) => (p.second[k] / c2 + epsilon).sqrt(),
                    Some(Mistake::EpsilonBeforeTheCorrection) => (p.second[k].sqrt() + epsilon) / c2.sqrt(),
                    _ => (p.second[k] / c2).sqrt() + epsilon,
                };
                p.numbers[k] -= rate * p.first[k] / c1 / root;
            }
        }
        Ok(())
    }

    /// All tensors by the learner's names.
    pub fn tensors(&self) -> BTreeMap<String, &[f64]> {
        let all = self.parameters.iter().flat_map(|(name, p)| {
            let columns = [("", &p.numbers), ("m.", &p.first), ("v.", &p.second)];
            columns.map(|(prefix, numbers)| (format!("{prefix}{name}"), &numbers[..]))
        });
        all.collect()
    }
}
