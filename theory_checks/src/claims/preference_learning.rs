//! T17: preference learning as reward maximisation.

use nalgebra::{DMatrix, DVector};
use sage_core::{
    preference_pairs::{Pairing, ScoredCandidate, preference_pairs},
    registry::{Entry, NoOptions},
    seed::Rng,
    statistics,
};

use crate::{
    Agreement::ThreeStandardErrors,
    Check, Figure, Number, Report, Series, Setup, Table, Tally, Verdict, optimum,
    random::normals,
    reward::{Concave, Curvature},
};

/// Items, and temperatures `kl_beta`.
const ITEMS: usize = 10;
const TEMPERATURES: [f64; 3] = [0.05, 0.5, 1.0];
const TOLERANCE: f64 = 1e-10;
/// Sampled labels with the ratio of the error to the Fisher prediction of an independent implementation.
const SAMPLED: [(usize, f64); 6] = [
    (300, 0.271 / 0.281),
    (1000, 0.144 / 0.154),
    (3000, 0.0956 / 0.0888),
    (10_000, 0.0483 / 0.0486),
    (30_000, 0.0275 / 0.0281),
    (100_000, 0.0160 / 0.0154),
];
const SEEDS: usize = 40;
/// Labels from which on the ratio must be near 1.
const MANY: usize = 1000;
/// Deterministic pairs: items, temperature, then steps, spread of the log-ratios, loss and probability of the best.
const RANKED: usize = 6;
const TEMPERATURE: f64 = 0.5;
const DESCENT: [(usize, [f64; 3]); 4] = [
    (100, [7.78, 0.205, 0.80]),
    (1000, [20.8, 0.045, 0.990]),
    (10_000, [39.9, 6.4e-3, 0.9998]),
    (100_000, [62.1, 6.9e-4, 0.999997]),
];
/// Adjacent gaps after the last step, over their mean.
const GAPS: [f64; 5] = [1.05, 0.97, 0.955, 0.97, 1.05];

/// The claim T17.
pub struct PreferenceLearning;

impl Entry<dyn Check> for PreferenceLearning {
    const NAME: &'static str = "T17";
    const SUMMARY: &'static str =
        "preference learning maximises the reward that made the labels, less a KL penalty";
    const SOURCE: &'static str = "DPO (NeurIPS 2023); SAGE (ICLR 2026), assumption on HGPO";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Check>, String> {
        Ok(Box::new(Self))
    }
}

fn sigmoid(x: f64) -> f64 {
    1.0 / (1.0 + (-x).exp())
}

fn log_sigmoid(x: f64) -> f64 {
    x.min(0.0) - (-x.abs()).exp().ln_1p()
}

pub(super) fn softmax(logits: &DVector<f64>) -> DVector<f64> {
    let most = logits.max();
    let shares = logits.map(|logit| (logit - most).exp());
    &shares / shares.sum()
}

fn centred(values: &DVector<f64>) -> DVector<f64> {
    values.add_scalar(-values.mean())
}

/// The objective of preference learning: log-likelihood of labels, per label and times a scale, as a function of the
/// logits of a policy, whose implicit rewards are `kl_beta log(π/π_ref)`. The mean of these rewards, which the labels
/// leave free, is drawn to 0.
struct Labels {
    /// Share of all labels by which the row beats the column.
    wins: DMatrix<f64>,
    /// log π_ref.
    reference: DVector<f64>,
    /// kl_beta.
    temperature: f64,
}

const SCALE: f64 = 100.0;

impl Labels {
    /// Labels of a policy without reference, whose logits are its rewards.
    fn of_rewards(wins: DMatrix<f64>) -> Self {
        let reference = DVector::zeros(wins.nrows());
        Self { wins, reference, temperature: 1.0 }
    }

    fn rewards(&self, logits: &DVector<f64>) -> DVector<f64> {
        self.temperature * (logits - &self.reference)
    }
}

impl Labels {
    fn pairs(&self) -> impl Iterator<Item = (usize, usize, f64)> {
        let count = self.wins.nrows();
        (0..count).flat_map(move |i| (0..count).map(move |j| (i, j, SCALE * self.wins[(i, j)])))
    }
}

impl Concave for Labels {
    fn dimension(&self) -> usize {
        self.wins.nrows()
    }

    /// Unknown; only the scale of what Newton's method may leave.
    fn curvature(&self) -> Curvature {
        Curvature { m: 0.0, l: 0.0 }
    }

    fn value(&self, logits: &DVector<f64>) -> f64 {
        let rewards = self.rewards(logits);
        let likelihood: f64 =
            self.pairs().map(|(i, j, share)| share * log_sigmoid(rewards[i] - rewards[j])).sum();
        likelihood - 0.5 * rewards.sum().powi(2)
    }

    fn gradient(&self, logits: &DVector<f64>) -> DVector<f64> {
        let rewards = self.rewards(logits);
        let mut gradient = DVector::from_element(rewards.len(), -rewards.sum());
        for (i, j, share) in self.pairs() {
            let push = share * sigmoid(rewards[j] - rewards[i]);
            gradient[i] += push;
            gradient[j] -= push;
        }
        self.temperature * gradient
    }

    fn hessian(&self, logits: &DVector<f64>) -> DMatrix<f64> {
        let rewards = self.rewards(logits);
        let mut hessian = DMatrix::from_element(rewards.len(), rewards.len(), 1.0);
        for (i, j, share) in self.pairs() {
            let p = sigmoid(rewards[i] - rewards[j]);
            let weight = share * p * (1.0 - p);
            hessian[(i, i)] += weight;
            hessian[(j, j)] += weight;
            hessian[(i, j)] -= weight;
            hessian[(j, i)] -= weight;
        }
        self.temperature * self.temperature * hessian
    }
}

/// Probability that the row beats the column, each unordered pair with the same weight.
fn bradley_terry(rewards: &DVector<f64>) -> DMatrix<f64> {
    let count = rewards.len();
    let pairs = (count * (count - 1) / 2) as f64;
    let p = |i: usize, j: usize| if i == j { 0.0 } else { sigmoid(rewards[i] - rewards[j]) / pairs };
    DMatrix::from_fn(count, count, p)
}

/// The learnt policy for labels in proportion to their probability: Newton's method against the closed form.
fn population(instance: usize, rng: &mut Rng, tally: &mut Tally, injected: Option<usize>) {
    let temperature = TEMPERATURES[instance % TEMPERATURES.len()];
    let (rewards, reference) = (normals(rng, ITEMS), softmax(&normals(rng, ITEMS)));
    let start = reference.map(f64::ln);
    let labels = Labels { wins: bradley_terry(&rewards), reference: start.clone(), temperature };
    let Some(logits) = optimum(&labels, start) else { return tally.add_unsolved() };
    let policy = softmax(&logits);
    // It maximises the expected reward less kl_beta times the KL divergence: its gradient is 0, and no other is better.
    let objective = |policy: &DVector<f64>| -> f64 {
        let terms = policy.iter().zip(&reference).zip(&rewards);
        terms.map(|((p, q), r)| if *p > 0.0 { p * (r - temperature * (p / q).ln()) } else { 0.0 }).sum()
    };
    let own = objective(&policy);
    let slopes = rewards.zip_zip_map(&policy, &reference, |r, p, q| r - temperature * (p / q).ln());
    let gradient = policy.zip_map(&slopes, |p, slope| p * (slope - own));
    tally.equal(gradient.amax(), 0.0, TOLERANCE);
    for _ in 0..3 {
        let other = softmax(&(&logits + normals(rng, ITEMS)));
        tally.at_most(objective(&other), own, TOLERANCE);
    }
    // The closed form of KL-regularised reward maximisation.
    let bonus = if injected == Some(1) { &rewards * temperature } else { &rewards / temperature };
    let base = if injected == Some(0) { DVector::zeros(ITEMS) } else { reference.map(f64::ln) };
    let best = softmax(&(base + bonus));
    tally.equal((policy.map(f64::ln) - best.map(f64::ln)).amax(), 0.0, TOLERANCE / temperature);
    let learnt = temperature * policy.zip_map(&reference, |p, r| (p / r).ln());
    let (learnt, made) =
        if injected == Some(2) { (learnt, rewards) } else { (centred(&learnt), centred(&rewards)) };
    tally.equal((learnt - made).amax(), 0.0, TOLERANCE);
}

/// Error of the rewards learnt from sampled labels over the Fisher prediction.
fn sampled(count: usize, rng: &mut Rng, tally: &mut Tally) {
    let rewards = normals(rng, ITEMS);
    let mut wins = DMatrix::zeros(ITEMS, ITEMS);
    for _ in 0..count {
        let i = rng.below(ITEMS);
        let j = (i + 1 + rng.below(ITEMS - 1)) % ITEMS;
        let (winner, loser) = if rng.unit() < sigmoid(rewards[i] - rewards[j]) { (i, j) } else { (j, i) };
        wins[(winner, loser)] += 1.0 / count as f64;
    }
    // An item that always loses has no finite estimate.
    let Some(learnt) = optimum(&Labels::of_rewards(wins), DVector::zeros(ITEMS)) else {
        return tally.holds(count < MANY);
    };
    let error = (centred(&learnt) - centred(&rewards)).norm() / (ITEMS as f64).sqrt();
    // Information of one label; the direction of equal shifts has none.
    let labels = Labels::of_rewards(bradley_terry(&rewards));
    let information = (labels.hessian(&rewards).add_scalar(-1.0)) / SCALE;
    let eigenvalues = information.symmetric_eigenvalues();
    let inverse: f64 = eigenvalues.iter().filter(|value| **value > 1e-9).map(|value| 1.0 / value).sum();
    let predicted = (inverse / (count as f64 * ITEMS as f64)).sqrt();
    tally.sample(format!("{count}"), error / predicted);
    tally.sample(format!("{count} error"), error);
}

/// Gradient descent on pairs that the higher reward always wins: log-ratios after each number of steps.
fn deterministic() -> Vec<(usize, DVector<f64>)> {
    let pairs: Vec<(usize, usize)> = (0..RANKED).flat_map(|i| (0..i).map(move |j| (i, j))).collect();
    let mut ratios: DVector<f64> = DVector::zeros(RANKED);
    let mut found = Vec::new();
    for step in 1..=DESCENT[DESCENT.len() - 1].0 {
        let mut gradient = DVector::zeros(RANKED);
        for &(winner, loser) in &pairs {
            let push = TEMPERATURE * sigmoid(TEMPERATURE * (ratios[loser] - ratios[winner]));
            gradient[winner] += push / pairs.len() as f64;
            gradient[loser] -= push / pairs.len() as f64;
        }
        ratios += gradient;
        if DESCENT.iter().any(|(steps, _)| *steps == step) {
            found.push((step, ratios.clone()));
        }
    }
    found
}

/// The pairs of fine-tuning do not change when rewards do in an order-preserving way.
fn order_alone(rng: &mut Rng, tally: &mut Tally) {
    let rewards = normals(rng, RANKED);
    let seed = rng.clone();
    let pairs = |of: &dyn Fn(f64) -> f64| {
        let scored: Vec<ScoredCandidate> =
            rewards.iter().map(|r| ScoredCandidate { reward: of(*r), is_feasible: true }).collect();
        preference_pairs(&scored, Pairing::Hierarchical, RANKED * RANKED, 0.0, &mut seed.clone())
    };
    let same = pairs(&|r| r) == pairs(&|r| r.exp()) && !pairs(&|r| r).is_empty();
    tally.holds(same);
    // Other rewards with the same labels: no learner can tell them apart.
    tally.exception(same);
}

fn stored(tally: &mut Tally) {
    let rewards = DVector::from_row_slice(&[0.0, 1.0, 2.0]);
    let reference = DVector::from_row_slice(&[0.5, 0.3, 0.2]);
    let policy = |temperature: f64| softmax(&(reference.map(f64::ln) + &rewards / temperature));
    let at_half = policy(0.5);
    for (found, known) in at_half.iter().zip([0.03666671184, 0.16255943445, 0.800773853709]) {
        tally.compare_stored(*found, known, 1e-11);
    }
    tally.compare_stored(at_half.dot(&rewards), 1.76410714, 1e-8);
    let divergence: f64 = at_half.iter().zip(&reference).map(|(p, r)| p * (p / r).ln()).sum();
    tally.compare_stored(divergence, 0.91547549, 1e-8);
    tally.compare_stored(1.0 - policy(0.05)[2], 3.09e-9, 1e-11);
}

impl Check for PreferenceLearning {
    fn formula(&self) -> &'static str {
        "labels i over j with probability σ(r_i − r_j): π ∝ π_ref exp(r/kl_beta), so kl_beta log(π/π_ref) = r + const"
    }

    fn experiment(&self) -> &'static str {
        "150 tables of 10 items with normal rewards and logits, kl_beta in {0.05, 0.5, 1}, logits fitted by Newton's method, and the objective of reward and KL at the fit; 40 seeds for each number of sampled labels; 100 000 steps of gradient descent on 6 items whose higher reward always wins; 200 groups through the pairing of `sage finetune`"
    }

    fn caveat(&self) -> &'static str {
        "pairs that the higher reward always wins, as in HGPO, teach only the order: log-ratios grow without end, their gaps equalise, kl_beta scales time, and early stopping regularises. At kl_beta 0.05 a reward difference of 1 is 20 in log-odds"
    }

    fn injected(&self) -> &'static [&'static str] {
        &["without π_ref", "kl_beta r in place of r/kl_beta", "rewards compared without centring"]
    }

    fn expected(&self) -> Verdict {
        Verdict::HoldsIf
    }

    fn run(&self, setup: &Setup, injected: Option<usize>) -> Report {
        let mut tally =
            setup.each("T17", 150, |instance, rng, tally| population(instance, rng, tally, injected));
        tally = tally.and(setup.each("T17 order", 200, |_, rng, tally| order_alone(rng, tally)));
        let mut labels = Table::new(
            "Sampled labels, 10 items with normal rewards: root mean square error of the rewards over the Fisher prediction √(tr I⁺/(n K)), and the median error",
            &["labels", "ratio", "error"],
        );
        for (count, known) in SAMPLED {
            let measured = setup
                .whole()
                .each(&format!("T17 {count}"), SEEDS, |_, rng, tally| sampled(count, rng, tally));
            let ratio = Number::root_mean_square(measured.samples(&format!("{count}")));
            if count >= MANY {
                tally.equal(ratio.value, 1.0, 0.2);
            }
            let error = Number::quantiles(measured.samples(&format!("{count} error")), [0.5])[0];
            labels.row(format!("{count}"), [ratio.beside(known, ThreeStandardErrors), error]);
            tally = tally.and(measured);
        }
        let mut pairs = Table::new(
            "Pairs that the higher reward always wins: 6 items, kl_beta 0.5, uniform π_ref, gradient descent of step 1",
            &["steps", "spread of the log-ratios", "loss", "probability of the best"],
        );
        let mut spreads = Vec::new();
        for ((steps, ratios), (_, known)) in deterministic().iter().zip(DESCENT) {
            let spread = ratios.max() - ratios.min();
            let losses = (0..RANKED).flat_map(|i| (0..i).map(move |j| (i, j)));
            let losses: Vec<f64> =
                losses.map(|(i, j)| -log_sigmoid(TEMPERATURE * (ratios[i] - ratios[j]))).collect();
            let found = [spread, statistics::mean(&losses).unwrap_or(f64::NAN), softmax(ratios).max()];
            let digits = [0.005, 0.015, 0.005].map(|share: f64| share);
            for ((found, known), digits) in found.iter().zip(known).zip(digits) {
                tally.compare_stored(*found, known, digits * known);
            }
            pairs.row(format!("{steps}"), found.map(Number::new));
            spreads.push([*steps as f64, spread]);
            if *steps == DESCENT[DESCENT.len() - 1].0 {
                let mean = spread / (RANKED - 1) as f64;
                for (k, known) in GAPS.iter().enumerate() {
                    tally.compare_stored((ratios[k + 1] - ratios[k]) / mean, *known, 0.006);
                }
            }
        }
        stored(&mut tally);
        let limit = (RANKED - 1) as f64 * 10f64.ln() / TEMPERATURE;
        let line = vec![[1e3, spreads[1][1]], [1e5, spreads[1][1] + 2.0 * limit]];
        let figure = Figure::new(
            "Pairs that the higher reward always wins: the log-ratios spread without end",
            ["steps of gradient descent", "spread of log(π/π_ref)"],
            vec![
                Series::line("measured", spreads),
                Series::line(format!("limit: {limit:.1} a decade"), line),
            ],
        );
        tally.report(vec![labels, pairs], vec![figure.logarithmic([true, false])])
    }
}
