//! TD3's update by candle's automatic differentiation, with injected faults.

use std::collections::BTreeMap;

use candle_core::{DType, Device, Result, Tensor, Var, WithDType};
use sage_learn::{Real, Td3Learner, Td3Options, TransitionBatch};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mistake {
    MaxForMin,
    NoNoiseClip,
    NoActionClamp,
    TerminalsIgnored,
    LossHalved,
    EpsilonInsideTheRoot,
    NoBiasCorrection,
    ActorCountsAllUpdates,
    SwappedRates,
    TauTurnedRound,
    TanhWithoutScale,
    TargetsEveryUpdate,
    WeightDecay,
    OnlineActorInTheTarget,
    CriticBeforeItsStep,
    SharedStorage,
}

impl Mistake {
    pub const ALL: [Self; 16] = [
        Self::MaxForMin,
        Self::NoNoiseClip,
        Self::NoActionClamp,
        Self::TerminalsIgnored,
        Self::LossHalved,
        Self::EpsilonInsideTheRoot,
        Self::NoBiasCorrection,
        Self::ActorCountsAllUpdates,
        Self::SwappedRates,
        Self::TauTurnedRound,
        Self::TanhWithoutScale,
        Self::TargetsEveryUpdate,
        Self::WeightDecay,
        Self::OnlineActorInTheTarget,
        Self::CriticBeforeItsStep,
        Self::SharedStorage,
    ];
}

const NETWORKS: [&str; 3] = ["actor", "critic.q1", "critic.q2"];
const PARTS: [&str; 6] = ["l1.weight", "l1.bias", "l2.weight", "l2.bias", "l3.weight", "l3.bias"];

struct Part {
    online: Vec<Var>,
    target: Vec<Tensor>,
    first: Vec<Tensor>,
    second: Vec<Tensor>,
}

pub struct Reference {
    options: Td3Options,
    sizes: [usize; 2],
    mistake: Option<Mistake>,
    parts: Vec<Part>,
    updates: u64,
}

fn forward<W: AsRef<Tensor>>(w: &[W], x: &Tensor) -> Result<Tensor> {
    let w: Vec<&Tensor> = w.iter().map(AsRef::as_ref).collect();
    let h = x.matmul(&w[0].t()?)?.broadcast_add(w[1])?.relu()?;
    let h = h.matmul(&w[2].t()?)?.broadcast_add(w[3])?.relu()?;
    h.matmul(&w[4].t()?)?.broadcast_add(w[5])
}

struct Plain(Tensor);
impl AsRef<Tensor> for Plain {
    fn as_ref(&self) -> &Tensor {
        &self.0
    }
}

fn plain(tensors: &[Tensor]) -> Vec<Plain> {
    tensors.iter().cloned().map(Plain).collect()
}

fn online(vars: &[Var]) -> Vec<Plain> {
    vars.iter().map(|var| Plain(var.as_tensor().clone())).collect()
}

impl Reference {
    pub fn of<T: Real + WithDType>(learner: &Td3Learner<T>, mistake: Option<Mistake>) -> Result<Self> {
        let all: BTreeMap<String, (Vec<usize>, Vec<T>)> =
            learner.tensors().into_iter().map(|t| (t.name, (t.shape, t.numbers.to_vec()))).collect();
        let get = |name: String| {
            let (shape, numbers) = &all[&name];
            Tensor::from_vec(numbers.clone(), shape.clone(), &Device::Cpu)
        };
        let parts = NETWORKS.iter().map(|network| {
            let each = |prefix: &str| -> Result<Vec<Tensor>> {
                PARTS.iter().map(|part| get(format!("{prefix}{network}.{part}"))).collect()
            };
            let online = each("")?.iter().map(Var::from_tensor).collect::<Result<Vec<_>>>()?;
            let target = match mistake {
                Some(Mistake::SharedStorage) => online.iter().map(|var| var.as_tensor().clone()).collect(),
                _ => each("target.")?,
            };
            let zeros = || online.iter().map(|var| var.zeros_like()).collect::<Result<Vec<_>>>();
            Ok(Part { first: zeros()?, second: zeros()?, target, online })
        });
        let parts = parts.collect::<Result<_>>()?;
        let sizes = [learner.actor().shape().inputs, learner.actor().shape().outputs];
        Ok(Self { options: learner.options().clone(), sizes, mistake, parts, updates: 0 })
    }

    fn is(&self, mistake: Mistake) -> bool {
        self.mistake == Some(mistake)
    }

    pub fn update<T: Real + WithDType>(&mut self, batch: &TransitionBatch<T>) -> Result<()> {
        let o = self.options.clone();
        self.updates += 1;
        let rows = o.batch;
        let of = |numbers: &[T], width: usize| Tensor::from_slice(numbers, (rows, width), &Device::Cpu);
        let (s, s2) = (of(&batch.observations, self.sizes[0])?, of(&batch.next_observations, self.sizes[0])?);
        let (a, z) = (of(&batch.actions, self.sizes[1])?, of(&batch.noise, self.sizes[1])?);
        let (r, go_on) = (of(&batch.rewards, 1)?, of(&batch.not_terminal, 1)?);
        let bound = o.max_action;
        let scale = if self.is(Mistake::TanhWithoutScale) { 1.0 } else { bound };
        let act = |w: &[Plain], s: &Tensor| -> Result<Tensor> { forward(w, s)?.tanh()?.affine(scale, 0.0) };
        let clip = if self.is(Mistake::NoNoiseClip) { 1e9 } else { o.noise_clip * bound };
        let noise = z.affine(o.target_noise * bound, 0.0)?.clamp(-clip, clip)?;
        let policy = if self.is(Mistake::OnlineActorInTheTarget) {
            online(&self.parts[0].online)
        } else {
            plain(&self.parts[0].target)
        };
        let mut a2 = (act(&policy, &s2)? + noise)?;
        if !self.is(Mistake::NoActionClamp) {
            a2 = a2.clamp(-bound, bound)?;
        }
        let x2 = Tensor::cat(&[&s2, &a2], 1)?;
        let [q1, q2] = [1, 2].map(|k| forward(&plain(&self.parts[k].target), &x2));
        let least = if self.is(Mistake::MaxForMin) { q1?.maximum(&q2?)? } else { q1?.minimum(&q2?)? };
        let go_on = if self.is(Mistake::TerminalsIgnored) { go_on.ones_like()? } else { go_on };
        let y = (r + (go_on * least)?.affine(o.gamma, 0.0)?)?.detach();
        let x = Tensor::cat(&[&s, &a], 1)?;
        let before = online(&self.parts[1].online).into_iter().map(|Plain(t)| t.copy().map(Plain));
        let before = before.collect::<Result<Vec<_>>>()?;
        let mse = |k: usize| (forward(&online(&self.parts[k].online), &x)? - &y)?.sqr()?.mean_all();
        let mut loss = (mse(1)? + mse(2)?)?;
        if self.is(Mistake::LossHalved) {
            loss = loss.affine(0.5, 0.0)?;
        }
        let gradients = loss.backward()?;
        let [actor_rate, critic_rate] = match self.is(Mistake::SwappedRates) {
            true => [o.critic_rate, o.actor_rate],
            false => [o.actor_rate, o.critic_rate],
        };
        for k in [1, 2] {
            self.adam(k, &gradients, critic_rate, self.updates)?;
        }
        let acts = self.updates.is_multiple_of(o.policy_delay);
        if acts {
            let critic = match self.is(Mistake::CriticBeforeItsStep) {
                true => before,
                false => online(&self.parts[1].online),
            };
            let action = act(&online(&self.parts[0].online), &s)?;
            let loss = forward(&critic, &Tensor::cat(&[&s, &action], 1)?)?.mean_all()?.neg()?;
            let gradients = loss.backward()?;
            let step = if self.is(Mistake::ActorCountsAllUpdates) {
                self.updates
            } else {
                self.updates / o.policy_delay
            };
            self.adam(0, &gradients, actor_rate, step)?;
        }
        if (acts || self.is(Mistake::TargetsEveryUpdate)) && !self.is(Mistake::SharedStorage) {
            let tau = if self.is(Mistake::TauTurnedRound) { 1.0 - o.tau } else { o.tau };
            for part in &mut self.parts {
                for (target, online) in part.target.iter_mut().zip(&part.online) {
                    *target = (online.affine(tau, 0.0)? + target.affine(1.0 - tau, 0.0)?)?.detach();
                }
            }
        }
        Ok(())
    }

    fn adam(
        &mut self,
        part: usize,
        gradients: &candle_core::backprop::GradStore,
        rate: f64,
        step: u64,
    ) -> Result<()> {
        let [b1, b2] = self.options.betas;
        let epsilon = self.options.epsilon;
        let t = step as i32;
        let (c1, c2) = match self.is(Mistake::NoBiasCorrection) {
            true => (1.0, 1.0),
            false => (1.0 - b1.powi(t), 1.0 - b2.powi(t)),
        };
        let (inside, decays) = (self.is(Mistake::EpsilonInsideTheRoot), self.is(Mistake::WeightDecay));
        let part = &mut self.parts[part];
        for (k, var) in part.online.iter().enumerate() {
            let Some(mut g) = gradients.get(var).cloned() else { continue };
            if decays {
                g = (g + var.affine(0.01, 0.0)?)?;
            }
            part.first[k] = (part.first[k].affine(b1, 0.0)? + g.affine(1.0 - b1, 0.0)?)?.detach();
            part.second[k] = (part.second[k].affine(b2, 0.0)? + g.sqr()?.affine(1.0 - b2, 0.0)?)?.detach();
            let root = match inside {
                // As large as the second moments, so that it shows in five updates.
                true => part.second[k].affine(1.0 / c2, epsilon)?.sqrt()?,
                false => part.second[k].sqrt()?.affine(1.0 / c2.sqrt(), epsilon)?,
            };
            let step = (part.first[k].affine(rate / c1, 0.0)? / root)?;
            var.set(&(var.as_tensor() - step)?.detach())?;
        }
        Ok(())
    }

    /// All tensors by the learner's names.
    pub fn tensors(&self) -> BTreeMap<String, Vec<f64>> {
        let mut all = BTreeMap::new();
        let numbers = |tensor: &Tensor| -> Vec<f64> {
            let flat = tensor.flatten_all().and_then(|t| t.to_dtype(DType::F64)).and_then(|t| t.to_vec1());
            flat.expect("a tensor on the CPU")
        };
        for (network, part) in NETWORKS.iter().zip(&self.parts) {
            for (k, name) in PARTS.iter().enumerate() {
                all.insert(format!("{network}.{name}"), numbers(part.online[k].as_tensor()));
                all.insert(format!("target.{network}.{name}"), numbers(&part.target[k]));
                all.insert(format!("m.{network}.{name}"), numbers(&part.first[k]));
                all.insert(format!("v.{network}.{name}"), numbers(&part.second[k]));
            }
        }
        all
    }
}
