//! T6: the appendix's bound, read with the theorem's preference, is not a bound.

use sage_core::registry::{Entry, NoOptions};

use super::unequal_curvature::Line;
use crate::{Bounds, Check, Number, Preference, Report, Setup, Table, Verdict, random::log_uniform};

/// Values of β, in turn; at 1 the threshold is infinite.
const BETAS: [f64; 4] = [0.51, 0.6, 0.75, 0.9];
/// Relative distance from the threshold below which rounding decides.
const NEAR: f64 = 1e-9;
/// β, a, b, μ, then gap, printed bound, max-bound and min-bound.
const FIXTURE: [(f64, f64, f64, f64, [f64; 4]); 6] = [
    (0.6, 1.0, 10.0, 1.0, [0.378072, 0.0850662, 0.439453, 0.378072]),
    (0.6, 10.0, 1.0, 0.0, [0.378072, 0.0850662, 0.439453, 0.378072]),
    (0.6, 1.0, 10.0, 0.95, [0.199628, 0.0748473, 0.254664, 0.199628]),
    (0.6, 1.0, 3.0, 1.0, [0.222222, 0.166667, 0.334711, 0.222222]),
    (0.9, 1.0, 1000.0, 1.0, [0.491120, 0.0397807, 0.499889, 0.491120]),
    (0.75, 1.0, 5.0, 1.0, [0.195312, 0.351562, 0.439453, 0.195312]),
];

/// The claim T6.
pub struct PrintedBound;

impl Entry<dyn Check> for PrintedBound {
    const NAME: &'static str = "T6";
    const SUMMARY: &'static str =
        "the appendix's bound, read with the preference of the theorem, bounds the gap";
    const SOURCE: &'static str = "SAGE (ICLR 2026), appendix; counterexamples of this project";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Check>, String> {
        Ok(Box::new(Self))
    }
}

/// The bound as printed: c_1 and c_2, and μ and 1 − μ in the curvature, are exchanged.
fn printed(line: &Line, at: Preference, injected: Option<usize>) -> f64 {
    let bounds = line.bounds(at);
    let [c1, c2] = bounds.coefficients;
    let coefficients = if injected == Some(1) { [c1, c2] } else { [c2, c1] };
    Bounds { coefficients, m: line.curvature(1.0 - at.mu), ..bounds }.max()
}

/// Wrong versions of the min-bound outside [1 − β, β], where the right one is the gap: name, the wrong bound, and the
/// shares of cases in which it is below the gap in an independent implementation.
type Wrong = (&'static str, fn(&Bounds, Preference, &Line) -> f64, f64);
const WRONG: [Wrong; 8] = [
    ("half the bound", |b, _, _| 0.5 * b.min(), 1.0),
    (
        "2β in place of 2β − 1 in c₁ and c₂",
        |b, at, _| {
            let share = (2.0 * at.beta - 1.0) / (2.0 * at.beta);
            Bounds { coefficients: b.coefficients.map(|c| c * share), ..*b }.min()
        },
        1.0,
    ),
    (
        "μ and 1 − μ exchanged in m_μ",
        |b, at, line| Bounds { m: line.curvature(1.0 - at.mu), ..*b }.min(),
        0.5,
    ),
    ("L₁ and L₂ exchanged", |b, _, _| nearer(&Bounds { experts: [b.experts[1], b.experts[0]], ..*b }), 0.5),
    (
        "as printed in the appendix, largest f",
        |b, at, line| {
            let [c1, c2] = b.coefficients;
            Bounds { coefficients: [c2, c1], m: line.curvature(1.0 - at.mu), ..*b }.max()
        },
        0.18,
    ),
    ("half the max-bound", |b, _, _| 0.5 * b.max(), 0.24),
    ("twice the bound", |b, _, _| 2.0 * b.min(), 0.0),
    (
        "μ − β + 1 in c₁",
        |b, at, _| {
            let c1 = (at.mu - at.beta + 1.0) / (2.0 * at.beta - 1.0);
            nearer(&Bounds { coefficients: [c1, b.coefficients[1]], ..*b })
        },
        0.0,
    ),
];

/// The bound at the nearer expert: λ = 0 for a negative c_1, else λ = 1.
fn nearer(bounds: &Bounds) -> f64 {
    let [first, second] = [0.0, 1.0].map(|lambda| bounds.at_lambda(lambda));
    if bounds.coefficients[1] > 0.0 { first } else { second }
}

/// How often a one-sided test and a test of equality notice a wrong bound.
fn power(setup: &Setup) -> Table {
    let mut table = Table::new(
        "Why inequalities need instances where they are attained: isotropic quadratics with μ outside, where the min-bound is the gap; share of cases in which a wrong bound is noticed",
        &["wrong bound", "by gap ≤ bound", "by gap = bound"],
    );
    let measured = setup.each("T6 power", 16_700, |instance, rng, tally| {
        let line = Line { a: log_uniform(rng, [-1.0, 1.0]), b: log_uniform(rng, [-1.0, 1.0]) };
        let beta = rng.uniform(0.55, 0.99);
        let outside = rng.unit() * (1.0 - beta);
        let at = Preference { mu: if instance.is_multiple_of(2) { outside } else { 1.0 - outside }, beta };
        let ([_, gap], bounds) = (line.direct(at), line.bounds(at));
        for (name, wrong, _) in WRONG {
            let bound = wrong(&bounds, at, &line);
            tally.sample(format!("{name} below"), f64::from(u8::from(bound < gap * (1.0 - NEAR))));
            tally.sample(format!("{name} other"), f64::from(u8::from((bound - gap).abs() > NEAR * gap)));
        }
    });
    for (name, _, known) in WRONG {
        let share = |of: &str| Number::new(Number::share(measured.samples(&format!("{name} {of}"))).value);
        table.row(name, [share("below").beside_another(known), share("other")]);
    }
    table
}

impl Check for PrintedBound {
    fn formula(&self) -> &'static str {
        "printed: max(|c₂| L₁, |c₁| L₂)² D² / (2 [(1 − μ) m_adv + μ m_real]); at μ = 1 below the gap iff b/a > (β/(1 − β))²"
    }

    fn experiment(&self) -> &'static str {
        "5000 quadratics with scalar curvatures a in 10^[-1, 1] and b/a in 10^[-1, 3] at μ = 1, β in {0.51, 0.6, 0.75, 0.9}; six stored cases; 16 700 isotropic quadratics with μ outside for the power of the tests"
    }

    fn caveat(&self) -> &'static str {
        "the appendix is coherent alone: it uses the reversed preference (1 − μ) R_adv + μ R_real; with equal curvatures both readings coincide"
    }

    fn injected(&self) -> &'static [&'static str] {
        &["equal curvatures", "c₁ and c₂ in the theorem's order"]
    }

    fn expected(&self) -> Verdict {
        Verdict::FailsAsPrinted
    }

    fn run(&self, setup: &Setup, injected: Option<usize>) -> Report {
        let mut tally = setup.each("T6", 5000, |instance, rng, tally| {
            let beta = BETAS[instance % BETAS.len()];
            let a = log_uniform(rng, [-1.0, 1.0]);
            let ratio = log_uniform(rng, [-1.0, 3.0]);
            let line = Line { a, b: if injected == Some(0) { a } else { a * ratio } };
            let at = Preference { mu: 1.0, beta };
            let ([_, gap], bounds) = (line.direct(at), line.bounds(at));
            // The bounds of the theorem's convention hold.
            tally.at_most(gap, bounds.min(), NEAR * gap);
            tally.at_most(bounds.min(), bounds.max(), NEAR * gap);
            let threshold = (beta / (1.0 - beta)).powi(2);
            let is_below = printed(&line, at, injected) < gap;
            if (line.b / line.a / threshold - 1.0).abs() > NEAR {
                tally.holds(is_below == (line.b / line.a > threshold));
            }
            tally.counterexample(is_below);
        });
        let columns = ["β; a; b; μ", "gap", "printed", "max-bound", "min-bound"];
        let mut table =
            Table::new("Stored counterexamples, and the last one where the printed bound holds", &columns);
        for (beta, a, b, mu, known) in FIXTURE {
            let line = Line { a, b: if injected == Some(0) { a } else { b } };
            let at = Preference { mu, beta };
            let bounds = line.bounds(at);
            let found = [line.direct(at)[1], printed(&line, at, injected), bounds.max(), bounds.min()];
            found.iter().zip(known).for_each(|(found, known)| tally.compare_stored(*found, known, 1e-6));
            tally.counterexample(found[1] < found[0] * (1.0 - NEAR));
            table.row(format!("{beta}; {a}; {b}; {mu}"), found.map(Number::new));
        }
        tally.report(vec![table, power(setup)], vec![])
    }
}
