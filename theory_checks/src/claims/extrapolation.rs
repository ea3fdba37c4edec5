//! T13: extrapolation beyond the adversarial expert, at equal step lengths.

use nalgebra::DVector;
use sage_core::{
    registry::{Entry, NoOptions},
    seed::Rng,
};

use super::{instances::Pair, unequal_curvature::Line};
use crate::{
    Agreement::Factor,
    Check, Experts, Figure, Number, Preference, Report, Series, Setup, Table, Tally, Verdict,
    random::{normals, rotation},
    reward::{Concave, Curvature, Family, Separable, Shape},
};

const BETA: f64 = 0.9;
const DIMENSION: usize = 20;
/// Constants of the log-cosh and of the pseudo-Huber reward.
const CONSTANTS: [Curvature; 2] = [Curvature { m: 0.5, l: 2.0 }; 2];
/// Steps beyond converged experts, with median gains of R_adv of an independent implementation: directly, and along
/// the adversarial vector.
const STEPS: [(f64, [f64; 2]); 3] = [(0.05, [0.032, 0.018]), (0.3, [0.118, 0.033]), (1.0, [-0.30, -0.58])];
/// Training times of experts that are stopped, with median gains of R_1 likewise, and the step.
const TIMES: [(f64, [f64; 2]); 4] =
    [(0.1, [0.25, 0.41]), (1.0, [0.13, 0.22]), (3.0, [0.036, 0.067]), (10.0, [-0.008, -0.006])];
const STEP: f64 = 0.2;
/// Share of instances on which vector extrapolation must be better for under-trained experts.
const MOSTLY: f64 = 0.95;

/// The claim T13.
pub struct Extrapolation;

impl Entry<dyn Check> for Extrapolation {
    const NAME: &'static str = "T13";
    const SUMMARY: &'static str =
        "extrapolation along the adversarial vector is better than along the experts' line";
    const SOURCE: &'static str =
        "SAGE (ICLR 2026), preference vectors; compared at equal steps by this project";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Check>, String> {
        Ok(Box::new(Self))
    }
}

/// Both ways beyond the adversarial expert, as unit vectors: directly, and along the adversarial vector.
fn ways(adversarial: &DVector<f64>, realistic: &DVector<f64>, prior: &DVector<f64>) -> [DVector<f64>; 2] {
    [adversarial - realistic, adversarial - prior].map(|way| way.normalize())
}

/// Converged experts of log-cosh and pseudo-Huber rewards.
fn converged(rng: &mut Rng, tally: &mut Tally, injected: Option<usize>) {
    let families = [Shape::LogCosh, Shape::PseudoHuber].map(Family::Separable);
    let pair = Pair::with(rng, families, CONSTANTS, 1.0, DIMENSION);
    let Some(experts) = pair.experts(BETA) else { return tally.add_unsolved() };
    let prior = normals(rng, DIMENSION);
    let [adversarial, realistic] = &experts.thetas;
    // The identity: beyond the line is along both vectors.
    let phi = rng.uniform(0.0, 1.0);
    let sign = if injected == Some(1) { 1.0 } else { -1.0 };
    let along = adversarial + phi * (adversarial - &prior) + sign * phi * (realistic - &prior);
    let scale = 1.0 + adversarial.norm() + realistic.norm() + prior.norm();
    tally.equal((along - experts.at(1.0 + phi)).norm(), 0.0, 1e-12 * scale);
    // Vectors of one length: the direct step is the shorter one iff their angle is below 60°.
    let [one, other] = [(); 2].map(|()| normals(rng, 3).normalize());
    tally.holds(((&one - &other).norm() < 1.0) == (one.dot(&other) > 0.5));
    // At an optimum of R_1 both gradients are antiparallel, so every direction has one exchange rate.
    let [of_adversarial, of_realistic] = experts.rewards.map(|reward| reward.gradient(adversarial));
    let sum = BETA * &of_adversarial + (1.0 - BETA) * &of_realistic;
    tally.equal(sum.norm(), 0.0, 1e-8 * of_realistic.norm());
    let way = normals(rng, DIMENSION).normalize();
    let rates = [&experts.way.normalize(), &way].map(|way| {
        let difference = |reward: &dyn Concave| {
            let step = 1e-5;
            (reward.value(&(adversarial + step * way)) - reward.value(&(adversarial - step * way)))
                / (2.0 * step)
        };
        [difference(experts.rewards[0]), difference(experts.rewards[1])]
    });
    for [gain, cost] in rates {
        let size = of_realistic.norm();
        tally.equal(cost, -BETA / (1.0 - BETA) * gain, 1e-5 * (1.0 + size));
        tally.sample("gain", gain);
        tally.sample("cost", cost);
    }
    // Along the line R_adv rises and R_real falls.
    tally.holds(rates[0][0] > 0.0 && rates[0][1] < 0.0);
    let start = experts.rewards[0].value(adversarial);
    let own = experts.preferred(BETA);
    for (step, _) in STEPS {
        let gains = ways(adversarial, realistic, &prior).map(|way| {
            let theta = adversarial + step * way;
            // R_1 itself can only fall.
            tally.at_most(own.value(&theta), own.value(adversarial), 1e-11);
            experts.rewards[0].value(&theta) - start
        });
        for (name, gain) in ["direct", "vector"].into_iter().zip(gains) {
            tally.sample(format!("{name} {step}"), gain);
            tally.sample(format!("{name} {step} up"), f64::from(u8::from(gain > 0.0)));
        }
        tally.sample(format!("vector better {step}"), f64::from(u8::from(gains[1] > gains[0])));
    }
}

/// Experts of quadratics whose training by gradient flow was stopped.
fn stopped(rng: &mut Rng, tally: &mut Tally) {
    let prior = normals(rng, DIMENSION);
    let draw = |rng: &mut Rng| {
        let center = normals(rng, DIMENSION);
        let parameters = DVector::from_fn(DIMENSION, |_, _| rng.uniform(0.1, 1.0));
        let turn = rotation(rng, DIMENSION);
        Separable::new(Shape::Quadratic, Curvature { m: 0.1, l: 1.0 }, turn, center, parameters)
    };
    let rewards = [draw(rng), draw(rng)];
    let start = prior.clone();
    let Some(experts) = Experts::of([&rewards[0], &rewards[1]], BETA, &start) else {
        return tally.add_unsolved();
    };
    for (time, _) in TIMES {
        let stop = |weight: f64, optimum: &DVector<f64>| {
            let (hessian, offset) = (experts.preferred(weight).hessian(optimum), optimum - &prior);
            let eigen = hessian.symmetric_eigen();
            let inner = eigen.eigenvectors.tr_mul(&offset);
            let left = inner.zip_map(&eigen.eigenvalues, |x, h| (-h * time).exp() * x);
            optimum - &eigen.eigenvectors * left
        };
        let own = experts.preferred(BETA);
        let [adversarial, realistic] = [(BETA, &experts.thetas[0]), (1.0 - BETA, &experts.thetas[1])]
            .map(|(weight, optimum)| stop(weight, optimum));
        let [direct, vector] = ways(&adversarial, &realistic, &prior);
        let thetas = [direct, vector].map(|way| &adversarial + STEP * way);
        let gains = [0, 1].map(|k| own.value(&thetas[k]) - own.value(&adversarial));
        for (name, gain) in ["direct", "vector"].into_iter().zip(gains) {
            tally.sample(format!("{name} at {time}"), gain);
        }
        tally.sample(format!("better at {time}"), f64::from(u8::from(gains[1] > gains[0])));
    }
}

/// Under-trained experts of isotropic rewards: the adversarial vector points to the optimum of R_1, so no direction is
/// better at an equal step. With one φ for both, as in the paper, the longer step wins where the vectors oppose.
fn isotropic(rng: &mut Rng, tally: &mut Tally, injected: Option<usize>) {
    const PHI: f64 = 0.1;
    // Relative to the prior; half of the way to the optimum is trained.
    let adversarial = normals(rng, DIMENSION);
    let realistic = normals(rng, DIMENSION) - rng.uniform(-0.5, 1.0) * &adversarial;
    let optimum = 2.0 * &adversarial;
    let ways = ways(&adversarial, &realistic, &DVector::zeros(DIMENSION));
    let lengths = match injected {
        Some(0) => [PHI * (&adversarial - &realistic).norm(), PHI * adversarial.norm()],
        _ => [PHI * adversarial.norm(); 2],
    };
    let missed = [0, 1].map(|k| (&adversarial + lengths[k] * &ways[k] - &optimum).norm());
    tally.at_most(missed[1], missed[0], 1e-12 * optimum.norm());
}

fn tables(tally: &Tally) -> [Table; 2] {
    let median = |name: String| Number::quantiles(tally.samples(&name), [0.5])[0];
    let share = |name: String| Number::new(Number::share(tally.samples(&name)).value);
    let mut far = Table::new(
        "Beyond converged experts (log-cosh and pseudo-Huber, m = 0.5, L = 2, normal optima): median change of R_adv",
        &["step", "direct", "rises", "vector", "rises", "vector better"],
    );
    for (step, [direct, vector]) in STEPS {
        far.row(
            format!("{step}"),
            [
                median(format!("direct {step}")).beside(direct, Factor(3.0)),
                share(format!("direct {step} up")),
                median(format!("vector {step}")).beside(vector, Factor(3.0)),
                share(format!("vector {step} up")),
                share(format!("vector better {step}")),
            ],
        );
    }
    let mut early = Table::new(
        "Beyond experts stopped at a time of gradient flow (quadratics in [0.1, 1]), step 0.2: median change of R_1",
        &["time", "direct", "vector", "vector better"],
    );
    for (time, [direct, vector]) in TIMES {
        early.row(
            format!("{time}"),
            [
                median(format!("direct at {time}")).beside(direct, Factor(3.0)),
                median(format!("vector at {time}")).beside(vector, Factor(3.0)),
                share(format!("better at {time}")),
            ],
        );
    }
    [far, early]
}

impl Check for Extrapolation {
    fn formula(&self) -> &'static str {
        "θ(1 + φ) = θ_adv + φ (Δ_adv − Δ_real); at the optimum of R_1 every direction exchanges dR_real = −β/(1 − β) dR_adv"
    }

    fn experiment(&self) -> &'static str {
        "200 converged pairs of log-cosh and pseudo-Huber rewards, 100 pairs of quadratics and 200 of isotropic rewards whose experts stop early, 20 dimensions, normal prior, β = 0.9; both extrapolations at the same ‖θ − θ_adv‖"
    }

    fn caveat(&self) -> &'static str {
        "only for under-trained experts, where it continues the training; the paper compares unequal steps. For equal curvature direct extrapolation is exact up to λ = 1.125 at β = 0.9"
    }

    fn injected(&self) -> &'static [&'static str] {
        &["one φ for both in place of equal steps", "(φ, +φ) in place of (φ, −φ)"]
    }

    fn expected(&self) -> Verdict {
        Verdict::HoldsIf
    }

    fn run(&self, setup: &Setup, injected: Option<usize>) -> Report {
        let far = setup.each("T13", 200, |_, rng, tally| converged(rng, tally, injected));
        let early = setup.each("T13 stopped", 100, |_, rng, tally| stopped(rng, tally));
        let round = setup.each("T13 isotropic", 200, |_, rng, tally| isotropic(rng, tally, injected));
        let mut tally = far.and(early).and(round);
        for (time, _) in &TIMES[..2] {
            tally.holds(Number::share(tally.samples(&format!("better at {time}"))).value >= MOSTLY);
        }
        for step in [0.05, 0.3] {
            let share = Number::share(tally.samples(&format!("vector better {step}"))).value;
            tally.exception(share < 0.5);
        }
        // Equal curvature: the line serves μ = 0 and 1 beyond the experts.
        let line = Line { a: 1.0, b: 1.0 };
        let (first, second) = (line.optimum(BETA), line.optimum(1.0 - BETA));
        for (lambda, mu) in [(-0.125, 0.0), (1.125, 1.0)] {
            tally.compare_stored(second + lambda * (first - second), line.optimum(mu), 1e-12);
            tally.compare_stored(Preference { mu, beta: BETA }.coefficients()[0], lambda, 1e-12);
        }
        let rates = ["gain", "cost"].map(|name| tally.samples(name).to_vec());
        let points = rates[0].iter().zip(&rates[1]).map(|(gain, cost)| [*gain, *cost]).collect();
        let most = rates[0].iter().copied().fold(0.0, f64::max);
        let line = vec![[-most, most * BETA / (1.0 - BETA)], [most, -most * BETA / (1.0 - BETA)]];
        let figure = Figure::new(
            "Slopes of both rewards at the adversarial expert, along the experts' line and along random directions",
            ["slope of R_adv", "slope of R_real"],
            vec![Series::points("directions", points), Series::line("−β/(1 − β)", line)],
        );
        tally.report(tables(&tally).into(), vec![figure])
    }
}
