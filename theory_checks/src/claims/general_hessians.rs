//! T3: with general Hessians the optima leave the segment; the best λ and the gap are known.

use nalgebra::{DMatrix, DVector};
use sage_core::registry::{Entry, NoOptions};

use super::{instances::preference, quadratics::Quadratics};
use crate::{
    Agreement::{Factor, ThreeStandardErrors},
    Check, Number, Preference, Report, Setup, Table, Tally,
    reward::Curvature,
};

/// Dimensions and condition numbers of the identity, in turn.
const DIMENSIONS: [usize; 4] = [2, 3, 10, 40];
const CONDITIONS: [f64; 3] = [1.5, 10.0, 100.0];
const TOLERANCE: f64 = 1e-9;
/// β and μ of the table.
const BETA: f64 = 0.9;
const PREFERENCES: [f64; 3] = [0.3, 0.5, 0.7];
/// Quantities of the table.
const QUANTITIES: [&str; 5] = [
    "distance of the optimum from the line / D",
    "gap / gap of the better expert",
    "max-bound / gap",
    "min-bound / gap",
    "best bound / gap",
];
/// Condition number, dimension, instances, and of an independent implementation the medians and the largest of the
/// first two quantities.
type Known = (f64, usize, usize, [f64; 5], [f64; 2]);
const MEDIANS: [Known; 6] = [
    (1.5, 2, 100, [0.028, 0.008, 1.0e3, 243.0, 10.5], [0.081, 0.055]),
    (1.5, 100, 20, [0.027, 0.009, 1.5e3, 197.0, 11.4], [0.038, 0.013]),
    (10.0, 2, 100, [0.16, 0.24, 400.0, 81.0, 27.0], [0.56, 0.65]),
    (10.0, 100, 20, [0.14, 0.20, 808.0, 116.0, 48.0], [0.20, 0.26]),
    (100.0, 2, 100, [0.30, 0.48, 1.7e3, 389.0, 157.0], [1.85, 0.81]),
    (100.0, 100, 20, [0.24, 0.33, 9.7e3, 1.4e3, 713.0], [0.34, 0.43]),
];
/// μ, then λ before clipping, gap, max-bound, min-bound and best bound.
const FIXTURE: [(f64, [f64; 5]); 4] = [
    (0.0, [-0.63125, 0.14578296089, 43.50487637, 0.53709724, 0.53709724]),
    (0.3, [0.5372340426, 0.0036015005707, 19.33550061, 2.14838896, 0.97885972]),
    (0.5, [0.7769230769, 0.0042569511138, 8.59355583, 8.59355583, 1.74019505]),
    (1.0, [1.0329545455, 0.0036549467126, 43.50487637, 0.53709724, 0.53709724]),
];

/// The claim T3.
pub struct GeneralHessians;

impl Entry<dyn Check> for GeneralHessians {
    const NAME: &'static str = "T3";
    const SUMMARY: &'static str =
        "general Hessians: the best λ and the gap of the segment, which misses the optimum";
    const SOURCE: &'static str = "this project, after SAGE (ICLR 2026)";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn Check>, String> {
        Ok(Box::new(Self))
    }
}

fn identity(instance: usize, rng: &mut sage_core::seed::Rng, tally: &mut Tally, injected: Option<usize>) {
    let dimension = DIMENSIONS[instance % DIMENSIONS.len()];
    let at = preference(rng, instance);
    let quadratics = Quadratics::draw(rng, dimension, CONDITIONS[instance % CONDITIONS.len()]);
    match quadratics.segment(at, injected) {
        Some(segment) => {
            let ([lambda, gap], [best, direct]) = (segment.formula, segment.direct);
            tally.equal(lambda, best, TOLERANCE);
            tally.equal(gap, direct, TOLERANCE * (1.0 + direct));
        }
        None => tally.add_unsolved(),
    }
}

/// What interpolation gains over the better expert, and how loose the bounds are.
fn table(setup: &Setup, injected: Option<usize>) -> (Tally, Table) {
    let mut all = Tally::default();
    let mut columns = vec!["κ; d"];
    columns.extend(QUANTITIES);
    columns.extend(["largest distance / D", "largest gap / gap"]);
    let mut table = Table::new(
        "Medians over seeds and μ in {0.3, 0.5, 0.7}, β = 0.9; spectra log-uniform in [1, κ] with both ends, random rotations, normal optima",
        &columns,
    );
    for (condition, dimension, count, medians, most) in MEDIANS {
        let purpose = format!("T3 table {condition} {dimension}");
        let tally = setup.each(&purpose, count, |_, rng, tally| {
            let quadratics = Quadratics::draw(rng, dimension, condition);
            for mu in PREFERENCES {
                let at = Preference { mu, beta: BETA };
                let Some(segment) = quadratics.segment(at, injected) else {
                    tally.add_unsolved();
                    continue;
                };
                let [_, gap] = segment.direct;
                let bounds = quadratics.bounds(at, segment.distance);
                tally.at_most(gap, bounds.best(), TOLERANCE * gap);
                let values = [
                    segment.off_line / segment.distance,
                    gap / segment.expert_gap,
                    bounds.max() / gap,
                    bounds.min() / gap,
                    bounds.best() / gap,
                ];
                QUANTITIES.iter().zip(values).for_each(|(name, value)| tally.sample(*name, value));
            }
        });
        let numbers = QUANTITIES.iter().zip(medians).map(|(name, known)| {
            // The three μ of a seed share their rewards.
            Number::median(tally.samples(name), setup.scaled(count)).beside(known, ThreeStandardErrors)
        });
        let largest = QUANTITIES.iter().zip(most).map(|(name, known)| {
            let largest = tally.samples(name).iter().copied().fold(0.0, f64::max);
            Number::new(largest).beside(known, Factor(2.5))
        });
        table.row(format!("{condition}; {dimension}"), numbers.chain(largest));
        all = all.and(tally);
    }
    (all, table)
}

fn stored(tally: &mut Tally, injected: Option<usize>) {
    let quadratics = Quadratics {
        hessians: [
            DMatrix::from_row_slice(2, 2, &[1.0, 0.0, 0.0, 10.0]),
            DMatrix::from_row_slice(2, 2, &[5.5, 4.5, 4.5, 5.5]),
        ],
        optima: [DVector::from_row_slice(&[1.0, 0.0]), DVector::from_row_slice(&[0.0, 1.0])],
        curvatures: [Curvature { m: 1.0, l: 10.0 }; 2],
    };
    let thetas = [(BETA, [0.926713081715, 0.013924514474]), (1.0 - BETA, [0.340417735434, 0.600219860755])];
    for (weight, known) in thetas {
        let Some(theta) = quadratics.optimum(weight) else { return tally.add_unsolved() };
        theta.iter().zip(known).for_each(|(found, known)| tally.compare_stored(*found, known, 1e-11));
    }
    for (mu, [free, gap, max, min, best]) in FIXTURE {
        let at = Preference { mu, beta: BETA };
        let Some(segment) = quadratics.segment(at, injected) else { return tally.add_unsolved() };
        let bounds = quadratics.bounds(at, segment.distance);
        tally.compare_stored(segment.distance, 0.8291468303, 1e-10);
        tally.compare_stored(segment.free, free, 1e-9);
        tally.compare_stored(segment.formula[1], gap, 1e-11);
        tally.compare_stored(bounds.max(), max, 1e-7);
        tally.compare_stored(bounds.min(), min, 1e-7);
        tally.compare_stored(bounds.best(), best, 1e-7);
    }
}

impl Check for GeneralHessians {
    fn formula(&self) -> &'static str {
        "best λ = c₁ h₁/(c₁ h₁ + c₂ h₂) clipped to [0, 1], h_i = dᵀ H_i d; gap = ½ gᵀ H_μ⁻¹ g, g = [c₁ (1 − λ) H₁ − c₂ λ H₂] d"
    }

    fn experiment(&self) -> &'static str {
        "1000 instances in dimensions 2, 3, 10 and 40, condition numbers 1.5, 10 and 100, β in {0.51, 0.6, 0.75, 0.9, 1}; best λ by bisection. The table has 100 seeds, 20 at d = 100"
    }

    fn caveat(&self) -> &'static str {
        "\"exactly optimal inside [1 − β, β]\" is a property of scalar curvature: at condition number 100 interpolation removes only half to two thirds of what the better expert alone misses"
    }

    fn injected(&self) -> &'static [&'static str] {
        &["h₁ and h₂ exchanged", "λ = c₁"]
    }

    fn run(&self, setup: &Setup, injected: Option<usize>) -> Report {
        let found = setup.each("T3", 1000, |instance, rng, tally| identity(instance, rng, tally, injected));
        let (measured, table) = table(setup, injected);
        let mut tally = found.and(measured);
        stored(&mut tally, injected);
        tally.report(vec![table], vec![])
    }
}
