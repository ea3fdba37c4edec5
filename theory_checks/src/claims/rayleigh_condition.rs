//! T16: the Rayleigh condition for weight mixing.

use nalgebra::{DMatrix, DVector};
use sage_core::{
    registry::{Entry, NoOptions},
    seed::Rng,
};

use super::nets::{SIZES, problem};
use crate::{
    Agreement::Distance,
    Check, Number, Report, Setup, Table, Tally, Verdict,
    mixing::Problem,
    random::normal_matrix,
    tanh_net::{TanhNet, loss},
};

/// Sizes and inputs of the networks whose matrices are built whole.
const WHOLE: [usize; 3] = [3, 5, 2];
const INPUTS: usize = 40;
const ALPHA: f64 = 0.5;
/// Scales of δ with the share of right signs of an independent implementation.
const KNOWN: [(f64, f64); 3] = [(0.25, 0.991), (0.1, 0.999), (0.03, 1.0)];
const NETWORKS: usize = 1000;

/// The claim T16.
pub struct RayleighCondition;

impl Entry<dyn Check> for RayleighCondition {
    const NAME: &'static str = "T16";
    const SUMMARY: &'static str =
        "the curvature exceeds the Rayleigh quotient of the Fisher matrix, so weights mix better";
    const SOURCE: &'static str = "SAGE (ICLR 2026), Rayleigh condition; corrected by this project";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Check>, String> {
        Ok(Box::new(Self))
    }
}

/// All weights as a vector.
fn vector(net: &TanhNet) -> DVector<f64> {
    let all = net.inner.iter().chain(&net.offsets).chain(&net.outer);
    DVector::from_iterator(net.inner.len() + net.offsets.len() + net.outer.len(), all.copied())
}

/// J of one input, a row for each output.
fn jacobian(net: &TanhNet, input: &DVector<f64>) -> DMatrix<f64> {
    let h = (&net.inner * input + &net.offsets).map(f64::tanh);
    let rows = (0..net.outer.nrows()).map(|output| {
        let mut row = 0.0 * net;
        for unit in 0..h.len() {
            let slope = net.outer[(output, unit)] * (1.0 - h[unit] * h[unit]);
            row.offsets[unit] = slope;
            row.outer[(output, unit)] = h[unit];
            for (k, x) in input.iter().enumerate() {
                row.inner[(unit, k)] = slope * x;
            }
        }
        vector(&row).transpose()
    });
    DMatrix::from_rows(&rows.collect::<Vec<_>>())
}

/// The Fisher matrix for unit variance: `E[Jᵀ J]`.
fn fisher(net: &TanhNet, inputs: &DMatrix<f64>) -> DMatrix<f64> {
    let count = vector(net).len();
    let sum = inputs.column_iter().fold(DMatrix::zeros(count, count), |sum, input| {
        let j = jacobian(net, &input.into_owned());
        sum + j.tr_mul(&j)
    });
    sum / inputs.ncols() as f64
}

/// Second derivative of the loss along a direction, by differences of fourth order.
fn bend(problem: &Problem, net: &TanhNet, direction: &TanhNet) -> f64 {
    let step = 1e-2 / direction.norm_squared().sqrt();
    let at = |t: f64| loss(&net.plus(t * step, direction).outputs(&problem.inputs), &problem.targets);
    (16.0 * (at(1.0) + at(-1.0)) - at(2.0) - at(-2.0) - 30.0 * at(0.0)) / (12.0 * step * step)
}

/// `η − Rayleigh quotient = E[r f'']/‖δ‖²`, with all matrices built.
fn whole(rng: &mut Rng, tally: &mut Tally, injected: Option<usize>) {
    let mut problem = problem(rng, WHOLE, INPUTS, 0.5);
    problem.targets = normal_matrix(rng, WHOLE[2], INPUTS);
    let net = problem.first.plus(ALPHA, &problem.delta);
    let direction = vector(&problem.delta);
    let inputs =
        if injected == Some(1) { problem.inputs.columns(0, 1).into_owned() } else { problem.inputs.clone() };
    let length = direction.norm_squared();
    let rayleigh = direction.dot(&(fisher(&net, &inputs) * &direction)) / length;
    let eta = if injected == Some(0) {
        // The mean of the Hessian's diagonal.
        let trace: f64 = (0..direction.len())
            .map(|k| {
                let mut unit = vec![0.0; direction.len()];
                unit[k] = 1.0;
                bend(&problem, &net, &of_vector(&net, &unit))
            })
            .sum();
        trace / direction.len() as f64
    } else {
        bend(&problem, &net, &problem.delta) / length
    };
    let mixing = problem.at(ALPHA);
    tally.equal(eta - rayleigh, mixing.curvature / length, 1e-5 * (1.0 + rayleigh));
}

fn of_vector(like: &TanhNet, values: &[f64]) -> TanhNet {
    let (inner, rest) = values.split_at(like.inner.len());
    let (offsets, outer) = rest.split_at(like.offsets.len());
    TanhNet {
        inner: DMatrix::from_column_slice(like.inner.nrows(), like.inner.ncols(), inner),
        offsets: DVector::from_column_slice(offsets),
        outer: DMatrix::from_column_slice(like.outer.nrows(), like.outer.ncols(), outer),
    }
}

/// A model that is linear in its weights: η is the Rayleigh quotient, and both mixtures are one.
fn linear(rng: &mut Rng, tally: &mut Tally) {
    let [inputs, outputs, count] = [6, 3, 30];
    let features = normal_matrix(rng, inputs, count);
    let targets = normal_matrix(rng, outputs, count);
    let [first, second] = [(); 2].map(|()| normal_matrix(rng, outputs, inputs));
    let alpha = rng.unit();
    let mixed = (1.0 - alpha) * &first + alpha * &second;
    let weight = loss(&(&mixed * &features), &targets);
    let output = loss(&((1.0 - alpha) * (&first * &features) + alpha * (&second * &features)), &targets);
    tally.equal(weight, output, 1e-13 * (1.0 + weight));
    let delta = &second - &first;
    let rayleigh = (&delta * &features).norm_squared() / (count as f64 * delta.norm_squared());
    let at = |t: f64| loss(&((&mixed + t * &delta) * &features), &targets);
    let eta = (at(1.0) - 2.0 * at(0.0) + at(-1.0)) / delta.norm_squared();
    tally.equal(eta, rayleigh, 1e-11 * (1.0 + at(1.0)));
    // As printed, the curvature exceeds the quotient.
    tally.counterexample(eta <= rayleigh * (1.0 + 1e-9));
}

/// `f = θ x` on two inputs: η and the quotient are both 2.5.
fn stored(tally: &mut Tally) {
    let inputs = [1.0, 2.0];
    let targets = [0.5, -1.0];
    let loss =
        |theta: f64| -> f64 { inputs.iter().zip(targets).map(|(x, y)| 0.25 * (theta * x - y).powi(2)).sum() };
    let eta = loss(1.0) - 2.0 * loss(0.0) + loss(-1.0);
    let quotient = inputs.iter().map(|x| 0.5 * x * x).sum::<f64>();
    tally.compare_stored(eta, 2.5, 1e-12);
    tally.compare_stored(quotient, 2.5, 1e-12);
    tally.counterexample(eta <= quotient);
}

impl Check for RayleighCondition {
    fn formula(&self) -> &'static str {
        "η = δᵀ H δ/‖δ‖² > δᵀ F δ/‖δ‖², F = E[Jᵀ J], is E[r f''] > 0: with H = F + E[r ∇²f] nothing new, and a tie where outputs are linear in the weights"
    }

    fn experiment(&self) -> &'static str {
        "100 3-5-2 tanh networks with normal targets, F from all Jacobians and η from differences of the loss; 200 linear models; 1000 4-16-3 networks for each of three scales of δ"
    }

    fn caveat(&self) -> &'static str {
        "the strict inequality is never \"readily satisfied\" for a Gauss–Newton curvature: there both sides are equal. F is the Fisher matrix for unit output variance"
    }

    fn injected(&self) -> &'static [&'static str] {
        &["η from the mean of the Hessian's diagonal", "F of one input, without the expectation"]
    }

    fn expected(&self) -> Verdict {
        Verdict::FailsAsPrinted
    }

    fn run(&self, setup: &Setup, injected: Option<usize>) -> Report {
        let mut tally = setup.each("T16", 100, |_, rng, tally| whole(rng, tally, injected));
        tally = tally.and(setup.each("T16 linear", 200, |_, rng, tally| linear(rng, tally)));
        stored(&mut tally);
        let mut table = Table::new(
            "Share of networks where the sign of η minus the quotient is that of L_e − L_w",
            &["scale of δ", "share"],
        );
        for (scale, known) in KNOWN {
            let measured = setup.each(&format!("T16 {scale}"), NETWORKS, |_, rng, tally| {
                let mixing = problem(rng, SIZES, 128, scale).at(ALPHA);
                let is_right = (mixing.bend() > mixing.jacobian) == (mixing.difference() < 0.0);
                tally.sample("right", f64::from(u8::from(is_right)));
            });
            let share = Number::share(measured.samples("right"));
            table.row(format!("{scale}"), [share.beside(known, Distance(0.05))]);
        }
        tally.report(vec![table], vec![])
    }
}
