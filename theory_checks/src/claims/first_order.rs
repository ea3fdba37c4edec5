//! T12: a preference vector is the gradient at the prior, to first order only.

use nalgebra::DVector;
use sage_core::{
    registry::{Entry, NoOptions},
    seed::Rng,
};

use crate::{
    Agreement::{Distance, ThreeStandardErrors},
    Check, Number, Report, Setup, Table, Tally, Verdict,
    random::{log_uniform, normals, spectrum},
};

/// Times of the gradient flow, as multiples of 1/L.
const TIMES: [f64; 5] = [0.01, 0.1, 1.0, 10.0, 100.0];
const DIMENSION: usize = 200;
const SEEDS: usize = 20;
/// Condition numbers with median cosines of an independent implementation, and length ratios at 100.
const COSINES: [(f64, [f64; 5]); 3] = [
    (1.0, [1.0, 1.0, 1.0, 1.0, 1.0]),
    (10.0, [1.0, 0.9999, 0.994, 0.885, 0.841]),
    (100.0, [1.0, 0.9999, 0.994, 0.861, 0.675]),
];
const LENGTHS: [f64; 5] = [0.996, 0.965, 0.722, 0.190, 0.028];
/// Digits of a printed cosine.
const PRINTED: f64 = 1e-3;
/// Steps of gradient descent.
const STEPS: usize = 100;
/// Cosine that still counts as the same direction.
const SAME: f64 = 0.99;

/// The claim T12.
pub struct FirstOrder;

impl Entry<dyn Check> for FirstOrder {
    const NAME: &'static str = "T12";
    const SUMMARY: &'static str = "a preference vector points along the reward's gradient at the prior";
    const SOURCE: &'static str = "SAGE (ICLR 2026), preference vectors; bound of this project";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Check>, String> {
        Ok(Box::new(Self))
    }
}

/// Gradient flow of a quadratic for a time, in the axes of its Hessian.
struct Flow {
    spectrum: DVector<f64>,
    /// Optimum minus prior.
    offset: DVector<f64>,
}

impl Flow {
    /// `(I − e^{−Ht}) (θ* − θ_ref)`.
    fn vector(&self, time: f64) -> DVector<f64> {
        self.offset.zip_map(&self.spectrum, |x, h| -(-h * time).exp_m1() * x)
    }

    /// Gradient after a time.
    fn gradient(&self, time: f64) -> DVector<f64> {
        self.offset.zip_map(&self.spectrum, |x, h| h * (-h * time).exp() * x)
    }

    /// The flow by Runge and Kutta's method, without the closed form.
    fn integrated(&self, time: f64) -> DVector<f64> {
        let slope = |v: &DVector<f64>| (&self.offset - v).component_mul(&self.spectrum);
        let step = time / STEPS as f64;
        (0..STEPS).fold(DVector::zeros(self.offset.len()), |v, _| {
            let a = slope(&v);
            let b = slope(&(&v + 0.5 * step * &a));
            let c = slope(&(&v + 0.5 * step * &b));
            let d = slope(&(&v + step * &c));
            v + step / 6.0 * (a + 2.0 * b + 2.0 * c + d)
        })
    }
}

fn cosine(a: &DVector<f64>, b: &DVector<f64>) -> f64 {
    a.dot(b) / (a.norm() * b.norm())
}

/// Least cosine of vectors whose components differ by factors between a and 1 (Kantorovich), for L = 1.
fn least_cosine(time: f64) -> f64 {
    let a = -(-time).exp_m1() / time;
    2.0 * a.sqrt() / (1.0 + a)
}

fn flow(rng: &mut Rng, tally: &mut Tally, injected: Option<usize>) {
    let dimension = 2 + rng.below(20);
    let low = log_uniform(rng, [-2.0, 0.0]);
    let flow = Flow { spectrum: spectrum(rng, dimension, [low, 1.0]), offset: normals(rng, dimension) };
    let size = flow.offset.norm();
    // Gradient descent adds up the gradients that it meets.
    let rate = 0.05;
    let mut summed = DVector::zeros(dimension);
    for _ in 0..STEPS {
        summed += rate * (&flow.offset - &summed).component_mul(&flow.spectrum);
    }
    let descent = flow.offset.zip_map(&flow.spectrum, |x, h| (1.0 - (1.0 - rate * h).powi(STEPS as i32)) * x);
    tally.equal((summed - descent).norm(), 0.0, 1e-12 * size);
    for time in [0.01, 0.1, 1.0] {
        let vector = flow.vector(time);
        tally.equal((&vector - flow.integrated(time)).norm(), 0.0, 1e-8 * size);
        let gradient = if injected == Some(0) { flow.gradient(time) } else { flow.gradient(0.0) };
        tally.at_most(least_cosine(time), cosine(&vector, &gradient), 1e-12);
        // The next order: Δ/t = g − t/2 H g + at most t²/6 H² g.
        let next = &gradient - 0.5 * time * gradient.component_mul(&flow.spectrum);
        let most = time * time / 6.0 * flow.gradient(0.0).norm();
        tally.at_most((vector / time - next).norm(), most, 1e-12 * size);
    }
    // Far on, the direction is another one.
    let far = cosine(&flow.vector(100.0), &flow.gradient(0.0));
    tally.exception(far < SAME);
}

/// Two components for which the least cosine is attained.
fn attained(rng: &mut Rng, tally: &mut Tally) {
    let time = log_uniform(rng, [-2.0, 1.0]);
    let a = -(-time).exp_m1() / time;
    let slow = 1e-12;
    let gradient = DVector::from_row_slice(&[1.0, a.sqrt()]);
    let flow = Flow {
        spectrum: DVector::from_row_slice(&[1.0, slow]),
        offset: DVector::from_row_slice(&[gradient[0], gradient[1] / slow]),
    };
    tally.equal(cosine(&flow.vector(time), &flow.gradient(0.0)), least_cosine(time), 1e-9);
}

/// A prior as far from the optimum in the curved as in the flat direction: after long training the vector is diagonal,
/// the gradient at the prior is not.
fn stored(tally: &mut Tally) {
    let flow = Flow {
        spectrum: DVector::from_row_slice(&[1.0, 0.01]),
        offset: DVector::from_row_slice(&[1.0, 1.0]),
    };
    let far = cosine(&flow.vector(1e4), &flow.gradient(0.0));
    tally.compare_stored(far, 1.01 / (2.0f64 * 1.0001).sqrt(), 1e-12);
    tally.exception(far < SAME);
}

impl Check for FirstOrder {
    fn formula(&self) -> &'static str {
        "gradient flow of a quadratic: Δ = (I − e^{−Ht}) (θ* − θ_ref); cos(Δ, ∇R(θ_ref)) ≥ 2√a/(1 + a), a = (1 − e^{−tL})/(tL)"
    }

    fn experiment(&self) -> &'static str {
        "500 quadratics in 2 to 21 dimensions, L = 1 and m in 10^[-2, 0], against Runge and Kutta's method and summed gradients; 100 two-dimensional ones where the cosine is the least. The table: 20 seeds, 200 dimensions, Hessian log-uniform in [1/κ, 1], normal offsets"
    }

    fn caveat(&self) -> &'static str {
        "only for short training; an optimiser of Adam's kind starts with the sign of the gradient, at a cosine of √(2/π) = 0.798 to a normal gradient"
    }

    fn injected(&self) -> &'static [&'static str] {
        &["the gradient at the expert in place of that at the prior"]
    }

    fn expected(&self) -> Verdict {
        Verdict::HoldsIf
    }

    fn run(&self, setup: &Setup, injected: Option<usize>) -> Report {
        let random = setup.each("T12", 500, |_, rng, tally| flow(rng, tally, injected));
        let mut tally = random.and(setup.each("T12 tight", 100, |_, rng, tally| attained(rng, tally)));
        stored(&mut tally);
        let mut columns = vec!["".to_owned()];
        columns.extend(TIMES.map(|time| format!("t L = {time}")));
        let mut table = Table::new(
            "Median cosine of Δ and the gradient at the prior, and of the length of Δ over t ‖∇R‖",
            &[],
        );
        table.columns = columns;
        for (condition, known) in COSINES {
            let measured = setup.each(&format!("T12 {condition}"), SEEDS, |_, rng, tally| {
                let spectrum = spectrum(rng, DIMENSION, [1.0 / condition, 1.0]);
                let flow = Flow { spectrum, offset: normals(rng, DIMENSION) };
                let gradient = flow.gradient(0.0);
                for time in TIMES {
                    let vector = flow.vector(time);
                    tally.sample(format!("cosine {time}"), cosine(&vector, &gradient));
                    tally.sample(format!("length {time}"), vector.norm() / (time * gradient.norm()));
                }
                tally.sample("sign", cosine(&gradient.map(f64::signum), &gradient));
                let normal = normals(rng, DIMENSION);
                tally.sample("adam", cosine(&normal.map(f64::signum), &normal));
            });
            let of = |name: &str, time: f64, known: f64| {
                let number = Number::median(measured.samples(&format!("{name} {time}")), setup.scaled(SEEDS));
                if number.standard_error.is_some_and(|error| error < PRINTED) {
                    return number.beside(known, Distance(PRINTED));
                }
                number.beside(known, ThreeStandardErrors)
            };
            let cosines = TIMES.iter().zip(known).map(|(time, known)| of("cosine", *time, known));
            table.row(format!("cosine, κ = {condition}"), cosines);
            if condition == 100.0 {
                let lengths = TIMES.iter().zip(LENGTHS).map(|(time, known)| {
                    let values = measured.samples(&format!("length {time}"));
                    // Beside a single instance, so within three times the spread.
                    Number::median(values, 1).beside(known, ThreeStandardErrors)
                });
                table.row("length, κ = 100 (± spread of one instance)", lengths);
                let adam = Number::median(measured.samples("adam"), setup.scaled(SEEDS));
                let first = adam.beside(0.798, ThreeStandardErrors);
                table.row("first step of Adam, normal gradient", [first]);
            }
            tally = tally.and(measured);
        }
        tally.report(vec![table], vec![])
    }
}
