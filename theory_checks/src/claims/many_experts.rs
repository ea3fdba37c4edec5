//! T19: any number of experts.

use nalgebra::{DMatrix, DVector};
use sage_core::{
    registry::{Entry, NoOptions},
    seed::Rng,
};

use super::instances::Pair;
use crate::{
    Agreement::Factor,
    Check, Mixed, Number, Report, Setup, Table, Tally, optimum,
    random::{log_uniform, normals},
    reward::{Concave, Curvature},
    root,
};

/// Numbers of experts, with the median slack of the max-bound and of the centre-bound inside of an independent
/// implementation.
const KNOWN: [(usize, f64, f64); 4] =
    [(2, 1.4e4, 433.0), (3, 5.1e3, 267.0), (4, 4.0e3, 237.0), (6, 6.3e3, 339.0)];
const TIGHT: f64 = 1e-9;
/// Sweeps over all pairs of weights, and the change at which they end.
const SWEEPS: usize = 40;
const SETTLED: f64 = 1e-9;

/// The claim T19.
pub struct ManyExperts;

impl Entry<dyn Check> for ManyExperts {
    const NAME: &'static str = "T19";
    const SUMMARY: &'static str = "k experts: coefficients, exact mixtures and bounds on the simplex";
    const SOURCE: &'static str = "this project, after SAGE (ICLR 2026)";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Check>, String> {
        Ok(Box::new(Self))
    }
}

/// Weights that sum to 1.
fn simplex(rng: &mut Rng, count: usize) -> DVector<f64> {
    let shares = DVector::from_fn(count, |_, _| -(1.0 - rng.unit()).ln());
    &shares / shares.sum()
}

/// Rows on the simplex, each with most of its weight on its own reward.
fn objectives(rng: &mut Rng, count: usize) -> DMatrix<f64> {
    let own = rng.uniform(0.3, 0.8);
    let rows: Vec<_> = (0..count)
        .map(|k| {
            let mut row = (1.0 - own) * simplex(rng, count);
            row[k] += own;
            row.transpose()
        })
        .collect();
    DMatrix::from_rows(&rows)
}

/// `c = B⁻ᵀ μ`; `None` if B cannot be inverted.
fn coefficients(
    objectives: &DMatrix<f64>,
    mu: &DVector<f64>,
    injected: Option<usize>,
) -> Option<DVector<f64>> {
    let of = if injected == Some(0) { objectives.clone() } else { objectives.transpose() };
    of.lu().solve(mu)
}

/// Constants of the experts' rewards: `B L` and `B m`.
fn of_experts(objectives: &DMatrix<f64>, base: &DVector<f64>, injected: Option<usize>) -> DVector<f64> {
    if injected == Some(1) { base.clone() } else { objectives * base }
}

/// Scalar curvatures: `θ(w)` is the optimum for `w_i = c_i L_i/Σ c L` iff c ≥ 0.
fn exact(instance: usize, rng: &mut Rng, tally: &mut Tally, injected: Option<usize>) {
    let (count, _, _) = KNOWN[instance % KNOWN.len()];
    let dimension = [count, 10, 40][instance / KNOWN.len() % 3];
    let objectives = objectives(rng, count);
    let optima: Vec<DVector<f64>> = (0..count).map(|_| normals(rng, dimension)).collect();
    let curvatures = DVector::from_fn(count, |_, _| log_uniform(rng, [-0.5, 0.5]));
    let best = |weights: &DVector<f64>| {
        let pull = weights.component_mul(&curvatures);
        let sum =
            optima.iter().zip(&pull).fold(DVector::zeros(dimension), |sum, (theta, p)| sum + *p * theta);
        sum / pull.sum()
    };
    let shares = simplex(rng, count);
    let mu = objectives.tr_mul(&shares);
    let Some(c) = coefficients(&objectives, &mu, injected) else { return tally.add_unsolved() };
    tally.equal(c.sum(), 1.0, 1e-12 * (1.0 + c.abs().sum()));
    let own = of_experts(&objectives, &curvatures, injected);
    let weights = c.component_mul(&own) / c.dot(&own);
    let mixed = objectives
        .row_iter()
        .zip(&weights)
        .fold(DVector::zeros(dimension), |sum, (row, weight)| sum + *weight * best(&row.transpose()));
    tally.equal((mixed - best(&mu)).norm(), 0.0, 1e-11 * (1.0 + optima[0].norm()));
}

/// Equal curvatures on a line, a preference beyond its first expert: the bound at that expert is its loss.
fn attained(instance: usize, rng: &mut Rng, tally: &mut Tally, injected: Option<usize>) {
    let (count, _, _) = KNOWN[instance % KNOWN.len()];
    let objectives = objectives(rng, count);
    let positions = &objectives * normals(rng, count);
    let first = positions.imin();
    // All of c but that of the first expert is positive; less of it until μ is a preference.
    let mut c = simplex(rng, count);
    let mut beyond = rng.uniform(0.05, 0.5);
    let mu = loop {
        let mut tried = (1.0 + beyond) * &c / (1.0 - c[first]);
        tried[first] = -beyond;
        let mu = objectives.tr_mul(&tried);
        if mu.min() >= 0.0 || beyond < 1e-6 {
            c = tried;
            break mu;
        }
        beyond *= 0.5;
    };
    let Some(found) = coefficients(&objectives, &mu, injected) else { return tally.add_unsolved() };
    let curvature = log_uniform(rng, [-1.0, 1.0]);
    let thetas: Vec<DVector<f64>> = positions.iter().map(|x| DVector::from_element(1, *x)).collect();
    let loss = |x: f64| 0.5 * curvature * (x - c.dot(&positions)).powi(2);
    let pulls = found.abs() * curvature;
    let bound = bound(&thetas, &pulls, &thetas[first], curvature, injected);
    let loss = loss(positions[first]);
    tally.equal(bound, loss, TIGHT * (1.0 + loss));
    // Inside, the pulls of the centre-bound vanish with L − m, as the loss does.
    let inside = simplex(rng, count);
    let optimum = inside.dot(&positions);
    let constants = DVector::from_element(count, curvature);
    let (weights, pulls) = centre(&inside, &constants, &constants);
    let theta = DVector::from_element(1, weights.dot(&positions));
    tally.equal(theta[0], optimum, TIGHT * (1.0 + optimum.abs()));
    tally.equal(pulls.norm(), 0.0, TIGHT);
    if loss > 1e-6 {
        tally.ratio(bound / loss);
    }
}

/// `(Σ pull_i ‖θ − θ_i‖)²/(2 m)`.
fn bound(
    thetas: &[DVector<f64>],
    pulls: &DVector<f64>,
    theta: &DVector<f64>,
    m: f64,
    injected: Option<usize>,
) -> f64 {
    let bracket: f64 = thetas.iter().zip(pulls).map(|(expert, pull)| pull * (theta - expert).norm()).sum();
    let half = if injected == Some(2) { 1.0 } else { 0.5 };
    half * bracket * bracket / m
}

/// Weights at which the experts' gradients cancel, and the pulls that are left there, for c ≥ 0.
fn centre(c: &DVector<f64>, l: &DVector<f64>, m: &DVector<f64>) -> (DVector<f64>, DVector<f64>) {
    let middle = 0.5 * (l + m);
    (c.component_mul(&middle) / c.dot(&middle), 0.5 * c.component_mul(&(l - m)))
}

/// Experts of random rewards.
struct Simplex<'r> {
    reward: Mixed<'r>,
    thetas: Vec<DVector<f64>>,
}

impl Simplex<'_> {
    fn at(&self, weights: &DVector<f64>) -> DVector<f64> {
        let zero = DVector::zeros(self.reward.dimension());
        self.thetas.iter().zip(weights).fold(zero, |sum, (theta, weight)| sum + *weight * theta)
    }

    /// The best mixture: weight is moved between two experts at a time.
    fn best(&self) -> DVector<f64> {
        let count = self.thetas.len();
        let mut weights = DVector::from_element(count, 1.0 / count as f64);
        for _ in 0..SWEEPS {
            let before = weights.clone();
            for i in 0..count {
                for j in 0..i {
                    let both = weights[i] + weights[j];
                    let way = &self.thetas[i] - &self.thetas[j];
                    let mut rest = weights.clone();
                    (rest[i], rest[j]) = (0.0, both);
                    let start = self.at(&rest);
                    let share = root(|share| self.reward.gradient(&(&start + share * both * &way)).dot(&way));
                    (weights[i], weights[j]) = (share * both, (1.0 - share) * both);
                }
            }
            if (&weights - before).amax() < SETTLED {
                break;
            }
        }
        weights
    }
}

fn bounds(instance: usize, rng: &mut Rng, tally: &mut Tally, injected: Option<usize>) {
    let (count, _, _) = KNOWN[instance % KNOWN.len()];
    let dimension = [count, 10, 40][instance / KNOWN.len() % 3];
    let scale = log_uniform(rng, [-1.0, 0.5]);
    let drawn: Vec<Pair> = (0..count)
        .map(|_| {
            let curvatures = [(); 2].map(|()| {
                let m = log_uniform(rng, [-1.0, 0.5]);
                Curvature { m, l: m * log_uniform(rng, [0.0, 1.5]) }
            });
            let number = rng.below(25);
            Pair::with(rng, Pair::families(number), curvatures, scale, dimension)
        })
        .collect();
    let base: Vec<&dyn Concave> = drawn.iter().map(|pair| pair.rewards()[0]).collect();
    let objectives = objectives(rng, count);
    let expert = |row: usize| {
        let weights = objectives.row(row).iter().copied().collect();
        optimum(&Mixed { of: base.clone(), weights }, DVector::zeros(dimension))
    };
    let Some(thetas) = (0..count).map(expert).collect::<Option<Vec<_>>>() else {
        return tally.add_unsolved();
    };
    let constants = |of: fn(&Curvature) -> f64| {
        let base = DVector::from_iterator(count, base.iter().map(|reward| of(&reward.curvature())));
        of_experts(&objectives, &base, injected)
    };
    let (l, m) = (constants(|c| c.l), constants(|c| c.m));
    // A preference inside, and any.
    for mu in [objectives.tr_mul(&simplex(rng, count)), simplex(rng, count)] {
        let Some(c) = coefficients(&objectives, &mu, injected) else { return tally.add_unsolved() };
        let reward = Mixed { of: base.clone(), weights: mu.iter().copied().collect() };
        let own = reward.curvature().m;
        // R_μ is the combination of the experts' rewards.
        let theta = normals(rng, dimension);
        let values = DVector::from_iterator(count, base.iter().map(|reward| reward.value(&theta)));
        let combined = c.dot(&(&objectives * &values));
        tally.equal(combined, reward.value(&theta), 1e-11 * (1.0 + c.abs().sum() * values.abs().sum()));
        let experts = Simplex { reward, thetas: thetas.clone() };
        let best = experts.best();
        let Some(hat) = optimum(&experts.reward, experts.at(&best)) else { return tally.add_unsolved() };
        let top = experts.reward.value(&hat);
        let rounding = 1e-11 * (1.0 + top.abs());
        let loss = |weights: &DVector<f64>| top - experts.reward.value(&experts.at(weights));
        let bound = |pulls: &DVector<f64>, weights: &DVector<f64>| {
            bound(&thetas, pulls, &experts.at(weights), own, injected)
        };
        let pulls = c.abs().component_mul(&l);
        // At any mixture.
        for weights in [simplex(rng, count), best.clone()] {
            tally.at_most(loss(&weights), bound(&pulls, &weights), rounding);
        }
        let corner = |k: usize| DVector::from_fn(count, |i, _| f64::from(u8::from(i == k)));
        let corners: Vec<f64> = (0..count).map(|k| bound(&pulls, &corner(k))).collect();
        let (largest, smallest) = (
            corners.iter().copied().fold(0.0, f64::max),
            corners.iter().copied().fold(f64::INFINITY, f64::min),
        );
        let gap = loss(&best);
        tally.at_most(gap, smallest, rounding);
        let is_inside = c.min() >= 0.0;
        if gap > 1e3 * rounding {
            tally.sample(format!("max {count}"), largest / gap);
        }
        if is_inside {
            let (weights, pulls) = centre(&c, &l, &m);
            let centre = bound(&pulls, &weights);
            tally.at_most(loss(&weights), centre, rounding);
            if gap > 1e3 * rounding {
                tally.sample(format!("centre {count}"), centre / gap);
            }
        }
    }
}

fn stored(tally: &mut Tally, injected: Option<usize>) {
    let objectives = DMatrix::from_element(3, 3, 0.1) + 0.7 * DMatrix::identity(3, 3);
    let curvatures = DVector::from_row_slice(&[1.0, 2.0, 5.0]);
    let optima = [[1.0, 0.0], [0.0, 1.0], [0.0, 0.0]];
    let own = of_experts(&objectives, &curvatures, injected);
    let known = [4.0 / 7.0, 2.0 / 7.0, 1.0 / 7.0];
    let mu = DVector::from_row_slice(&[0.5, 0.3, 0.2]);
    let Some(c) = coefficients(&objectives, &mu, None) else { return tally.add_unsolved() };
    c.iter().zip(known).for_each(|(found, known)| tally.compare_stored(*found, known, 1e-12));
    let weights = c.component_mul(&own) / c.dot(&own);
    for (found, known) in weights.iter().zip([0.408163265, 0.299319728, 0.292517007]) {
        tally.compare_stored(*found, known, 1e-9);
    }
    let pull = mu.component_mul(&curvatures);
    for (axis, known) in [0.238095238, 0.285714286].into_iter().enumerate() {
        let hat: f64 = optima.iter().zip(&pull).map(|(theta, pull)| theta[axis] * pull).sum();
        tally.compare_stored(hat / pull.sum(), known, 1e-9);
    }
    let outside = coefficients(&objectives, &DVector::from_row_slice(&[0.95, 0.05, 0.0]), None);
    let Some(outside) = outside else { return tally.add_unsolved() };
    for (found, known) in outside.iter().zip([1.214285714, -0.071428571, -0.142857143]) {
        tally.compare_stored(*found, known, 1e-9);
    }
}

impl Check for ManyExperts {
    fn formula(&self) -> &'static str {
        "R_μ = Σ c_i R_i^exp with c = B⁻ᵀ μ; gap(w) ≤ (Σ |c_i| L_i ‖θ(w) − θ_i‖)²/(2 m_μ), L = B L_base; inside with (L_i − m_i)/2 at w_i ∝ c_i (L_i + m_i); scalar curvatures: exact iff c ≥ 0, w_i ∝ c_i L_i"
    }

    fn experiment(&self) -> &'static str {
        "k in {2, 3, 4, 6}, dimensions k, 10 and 40, B with random rows on the simplex: 400 mixtures of scalar curvatures; 240 sets of random rewards (families and constants as in T5), two preferences each, best mixture by moving weight between pairs. Tight: 200 equal curvatures on a line with a preference beyond it"
    }

    fn caveat(&self) -> &'static str {
        "for two experts these are T2, T4 and T5; the bounds are as loose"
    }

    fn injected(&self) -> &'static [&'static str] {
        &["c = B⁻¹ μ", "L in place of B L", "without the factor ½"]
    }

    fn run(&self, setup: &Setup, injected: Option<usize>) -> Report {
        let mut tally = setup.each("T19", 400, |instance, rng, tally| exact(instance, rng, tally, injected));
        tally = tally
            .and(setup.whole().each("T19 tight", 200, |k, rng, tally| attained(k, rng, tally, injected)));
        tally = tally.and(setup.each("T19 bounds", 240, |k, rng, tally| bounds(k, rng, tally, injected)));
        stored(&mut tally, injected);
        let mut table = Table::new(
            "Bound over the gap of the best mixture, where the gap is above rounding: medians",
            &["experts", "largest corner", "centre, preferences inside"],
        );
        for (count, max, centre) in KNOWN {
            let median = |name: &str| Number::quantiles(tally.samples(&format!("{name} {count}")), [0.5])[0];
            let numbers =
                [median("max").beside(max, Factor(10.0)), median("centre").beside(centre, Factor(10.0))];
            table.row(format!("{count}"), numbers);
        }
        tally.report(vec![table], vec![])
    }
}
