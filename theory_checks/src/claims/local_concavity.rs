//! T7: the bound with local constants is a bound if experts and optimum are in the region where they hold.

use sage_core::registry::{Entry, NoOptions};

use crate::{
    Bounds, Check, Number, Preference, Report, Setup, Table, Tally, Verdict, reward::Curvature, root,
};

/// Weight of the experts' own reward.
const BETA: f64 = 0.9;
/// Weight of the adversarial reward over the realistic one in the first instance.
const STRONG: f64 = 10.0;
/// Distance of the optima, then gap, max-bound and min-bound with the local m, and how many digits are known.
const FIXTURE: [(f64, [f64; 3]); 3] = [
    (5.0, [2.84346, 4.82383, 1.36610]),
    (10.0, [7.83463, 4.87693, 1.38114]),
    (20.0, [17.83463, 4.87693, 1.38114]),
];

/// The claim T7.
pub struct LocalConcavity;

impl Entry<dyn Check> for LocalConcavity {
    const NAME: &'static str = "T7";
    const SUMMARY: &'static str = "the bound with constants of a local region";
    const SOURCE: &'static str = "SAGE (ICLR 2026), appendix; counterexamples of this project";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Check>, String> {
        Ok(Box::new(Self))
    }
}

fn log_cosh(x: f64) -> f64 {
    x.abs() + (-2.0 * x.abs()).exp().ln_1p() - std::f64::consts::LN_2
}

/// Rewards `−10 log cosh(θ − T)` and `−log cosh θ` at μ = 0: strongly concave near their optima, flat far away.
struct Flat {
    distance: f64,
}

impl Flat {
    /// Optimum of `w R_adv + (1 − w) R_real`.
    fn optimum(&self, weight: f64) -> f64 {
        let slope =
            |theta: f64| -weight * STRONG * (theta - self.distance).tanh() - (1.0 - weight) * theta.tanh();
        self.distance * root(|share| slope(share * self.distance))
    }

    /// Gap, and bounds with the smallest curvature on the segments, or with that at the optimum.
    fn measured(&self, is_honest: bool) -> (f64, Bounds) {
        let (first, second) = (self.optimum(BETA), self.optimum(1.0 - BETA));
        // μ = 0: the optimum is 0, and the nearer expert is the best point of the segment.
        let bend = |theta: f64| theta.cosh().powi(-2);
        let m = if is_honest { bend(first) } else { 1.0 };
        let rewards = [Curvature { m: STRONG, l: STRONG }, Curvature { m, l: 1.0 }];
        let at = Preference { mu: 0.0, beta: BETA };
        (log_cosh(second), Bounds::of(at, rewards, first - second))
    }
}

/// Two hills: `g(θ) + 1.5 g(θ − 6)` and the same 0.1 further on, `g(t) = exp(−t²/2)`; both experts stay on the lower.
fn two_hills(tally: &mut Tally, is_honest: bool) -> [f64; 2] {
    let hills = |theta: f64| (-0.5 * theta * theta).exp() + 1.5 * (-0.5 * (theta - 6.0).powi(2)).exp();
    let slope = |theta: f64| {
        -theta * (-0.5 * theta * theta).exp() - 1.5 * (theta - 6.0) * (-0.5 * (theta - 6.0).powi(2)).exp()
    };
    let value = |weight: f64, theta: f64| weight * hills(theta) + (1.0 - weight) * hills(theta - 0.1);
    let top = |weight: f64, around: f64| {
        let bend = |x: f64| weight * slope(x) + (1.0 - weight) * slope(x - 0.1);
        around - 0.5 + root(|share| bend(around - 0.5 + share))
    };
    let (first, second) = (top(BETA, 0.05), top(1.0 - BETA, 0.05));
    // μ = 0.5: the best point of the segment is the top of the lower hill.
    let gap = value(0.5, top(0.5, 6.05)) - value(0.5, top(0.5, 0.05));
    // Curvature of R_μ at the top that the experts are near; honestly there is none between the hills.
    let bend = |x: f64| {
        let hill = |t: f64| (t * t - 1.0) * (-0.5 * t * t).exp();
        -(hill(x) + 1.5 * hill(x - 6.0))
    };
    let lower = top(0.5, 0.05);
    let local = 0.5 * bend(lower) + 0.5 * bend(lower - 0.1);
    tally.compare_stored(local, 0.99625, 1e-5);
    let m = if is_honest { 0.0 } else { local };
    let bounds = Bounds::of(Preference { mu: 0.5, beta: BETA }, [Curvature { m, l: 1.5 }; 2], second - first);
    tally.compare_stored(first, 0.009964, 1e-6);
    tally.compare_stored(second, 0.090036, 1e-6);
    tally.compare_stored(gap, 0.499375, 1e-6);
    if !is_honest {
        tally.compare_stored(bounds.max(), 0.00181, 5e-6);
    }
    [gap, bounds.max()]
}

impl Check for LocalConcavity {
    fn formula(&self) -> &'static str {
        "gap ≤ max(|c₁| L₁, |c₂| L₂)² D²/(2 m_μ) with m the curvature at the optima"
    }

    fn experiment(&self) -> &'static str {
        "40 pairs of −10 log cosh(θ − T) and −log cosh θ with T in [1, 30] at μ = 0, β = 0.9, with the curvature at the optimum and with the smallest on the segments; two hills of which both experts climb the lower"
    }

    fn caveat(&self) -> &'static str {
        "the experts and the optimum must lie in the region where m holds: with the curvature at the optima alone it is no bound. A softmax has flat directions, so m = 0 there: for a trained network the constants are a diagnostic"
    }

    fn injected(&self) -> &'static [&'static str] {
        &["the smallest curvature on the segments in place of the local one"]
    }

    fn expected(&self) -> Verdict {
        Verdict::HoldsIf
    }

    fn run(&self, setup: &Setup, injected: Option<usize>) -> Report {
        let is_honest = injected == Some(0);
        let mut tally = setup.each("T7", 40, |_, rng, tally| {
            let flat = Flat { distance: rng.uniform(1.0, 30.0) };
            let (gap, honest) = flat.measured(true);
            tally.at_most(gap, honest.max(), 1e-9);
            tally.at_most(gap, honest.min(), 1e-9);
            let (gap, bounds) = flat.measured(is_honest);
            tally.exception(gap > bounds.max());
        });
        let columns =
            ["instance", "gap", "max-bound, local m", "min-bound, local m", "max-bound, smallest m"];
        let mut table = Table::new(
            "Stored counterexamples: the bounds with the local curvature are below the gap",
            &columns,
        );
        for (distance, [gap, max, min]) in FIXTURE {
            let flat = Flat { distance };
            if distance == 10.0 {
                let (first, second) = (flat.optimum(BETA), flat.optimum(1.0 - BETA));
                tally.compare_stored(first, 9.98889, 1e-5);
                tally.compare_stored(second, 8.52778, 1e-5);
                tally.compare_stored(first - second, 1.46111, 1e-5);
                tally.compare_stored(first.cosh().powi(-2), 8.4e-9, 5e-11);
            }
            let ((found, bounds), (_, honest)) = (flat.measured(false), flat.measured(true));
            for (found, known) in [(found, gap), (bounds.max(), max), (bounds.min(), min)] {
                tally.compare_stored(found, known, 1e-5);
            }
            if !is_honest {
                tally.exception(found > bounds.min());
            }
            let numbers = [found, bounds.max(), bounds.min(), honest.max()].map(Number::new);
            table.row(format!("log cosh, T = {distance}"), numbers);
        }
        let [gap, max] = two_hills(&mut tally, is_honest);
        tally.exception(gap > max);
        table.row("two hills", [gap, max, max, f64::INFINITY].map(Number::new));
        tally.report(vec![table], vec![])
    }
}
