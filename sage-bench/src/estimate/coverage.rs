//! How often intervals with several training seeds hold the true value: tables that are made with known components.

use super::*;

/// What a table is made of; standard deviations.
#[derive(Clone, Copy)]
struct Made {
    /// Of seeds, scenes and what is left.
    parts: [f64; 3],
    /// Of the scenes of the difference, for a second method.
    gap: Option<f64>,
    /// Whether both methods have the same training seeds, with half of the variance of seeds in common.
    has_same_seeds: bool,
    kind: Kind,
}

#[derive(Clone, Copy, PartialEq)]
enum Kind {
    /// Normal values.
    Normal,
    /// Outcomes 0 and 1: in this share of the scenes the probability is 0.9, in the others 0.05.
    Outcomes(f64),
    /// Normal values of scenes with weights, of which a fifth is 0.
    Weighted,
}

const MEAN: Made = Made { parts: [0.06, 0.3, 0.35], gap: None, has_same_seeds: false, kind: Kind::Normal };
const OUTCOMES: Made = Made { parts: [0.04, 0.0, 0.0], kind: Kind::Outcomes(0.3), ..MEAN };
const RARE: Made = Made { parts: [0.02, 0.0, 0.0], kind: Kind::Outcomes(0.02), ..MEAN };
const WEIGHTED: Made = Made { kind: Kind::Weighted, ..MEAN };
const BY_SCENE: Made = Made { gap: Some(0.2), ..MEAN };
const BY_SEED: Made = Made { has_same_seeds: true, ..BY_SCENE };
const OUTCOMES_GAP: Made = Made { gap: Some(0.0), ..OUTCOMES };
/// The noise of cells is all, or seeds do not differ.
const NOISE: Made = Made { parts: [0.0, 0.0, 0.35], ..MEAN };
const SAME_SEEDS: Made = Made { parts: [0.0, 0.3, 0.35], ..MEAN };

/// A table of one method or two, with the true mean, or the true difference, 0.
fn made(of: Made, [seeds, scenes]: [usize; 2], rng: &mut Rng) -> (f64, Vec<Samples>) {
    let normal = |rng: &mut Rng, size: f64| size * rng.normal();
    let polar = |rng: &mut Rng, share: f64| if rng.unit() < share { 0.9 } else { 0.05 };
    let truth = match of.kind {
        Kind::Outcomes(share) => 0.05 + 0.85 * share,
        _ => 0.5,
    };
    let base: Vec<f64> = match of.kind {
        Kind::Outcomes(share) => (0..scenes).map(|_| polar(rng, share)).collect(),
        _ => (0..scenes).map(|_| truth + normal(rng, of.parts[1])).collect(),
    };
    let in_common: Vec<f64> = (0..seeds).map(|_| rng.normal()).collect();
    let method = |rng: &mut Rng| {
        let scene = |x: &f64| x + normal(rng, of.gap.unwrap_or(0.0) * 0.5f64.sqrt());
        let middle: Vec<f64> = base.iter().map(scene).collect();
        let seed = |common: &f64| {
            let own = rng.normal();
            let shift = if of.has_same_seeds { (common + own) * 0.5f64.sqrt() } else { own };
            // Probabilities stay within [0, 1].
            let shift = if matches!(of.kind, Kind::Outcomes(_)) { shift.clamp(-1.2, 1.2) } else { shift };
            let cell = |middle: &f64| {
                let x = middle + of.parts[0] * shift;
                match of.kind {
                    Kind::Normal => [x + normal(rng, of.parts[2]), 1.0],
                    Kind::Outcomes(_) => [f64::from(u8::from(rng.unit() < x)), 1.0],
                    Kind::Weighted => {
                        let weight = if rng.unit() < 0.2 { 0.0 } else { rng.uniform(5.0, 50.0) };
                        [weight * (x + normal(rng, of.parts[2])), weight]
                    }
                }
            };
            middle.iter().map(cell).collect()
        };
        let cells = in_common.iter().map(seed).collect();
        let names = if of.has_same_seeds { (0..seeds as u64).collect() } else { Vec::new() };
        Samples { seeds: cells, training_seeds: names, ..Samples::default() }
    };
    let methods = (0..if of.gap.is_some() { 2 } else { 1 }).map(|_| method(rng)).collect();
    (if of.gap.is_some() { 0.0 } else { truth }, methods)
}

fn aggregate(of: Made) -> Aggregate {
    if matches!(of.kind, Kind::Outcomes(_)) { Aggregate::Share } else { Aggregate::Mean }
}

fn mended(of: Made, methods: &[Samples]) -> Estimate {
    match methods {
        [a, b] => a.less(b, "x").unwrap().estimate,
        all => all[0].estimate(aggregate(of), "x").unwrap(),
    }
}

/// The bootstrap that draws seeds and scenes, which these intervals replace.
fn bootstrapped(methods: &[Samples], name: &str) -> Estimate {
    let drawn = match methods {
        [a, b] => a.resampled_gaps(b, &a.measured(), name),
        all => all[0].resampled_means(&mut Rng::new(0, name, "bootstrap")),
    };
    interval(0.0, 0, &drawn).unwrap()
}

/// Share of tables whose interval holds the true value, and the mean half-width.
fn coverage(
    tables: u64,
    of: Made,
    size: [usize; 2],
    interval: impl Fn(Made, &[Samples], &str) -> Estimate + Sync,
) -> [f64; 2] {
    let one = |k: u64| {
        let (truth, methods) = made(of, size, &mut Rng::new(k, "tables", "test"));
        let e = interval(of, &methods, &k.to_string());
        [f64::from(u8::from((e.low..=e.high).contains(&truth))), 0.5 * (e.high - e.low)]
    };
    let all: Vec<[f64; 2]> = (0..tables).into_par_iter().map(one).collect();
    [0, 1].map(|k| all.iter().map(|x| x[k]).sum::<f64>() / tables as f64)
}

const SIZES: [[usize; 2]; 3] = [[5, 60], [8, 60], [20, 60]];
const SETTINGS: [(&str, Made); 6] = [
    ("mean", MEAN),
    ("share", OUTCOMES),
    ("mean with weights", WEIGHTED),
    ("difference, paired by scene", BY_SCENE),
    ("difference, paired by scene and seed", BY_SEED),
    ("difference of shares, paired by scene", OUTCOMES_GAP),
];
/// Where coverage need not be exact: few seeds, rare outcomes, components that are 0.
const EDGES: [(&str, Made, [usize; 2]); 8] = [
    ("mean, 3 seeds", MEAN, [3, 60]),
    ("mean, 2 seeds", MEAN, [2, 60]),
    ("rare share", RARE, [5, 60]),
    ("rare share", RARE, [20, 60]),
    ("noise alone", NOISE, [5, 60]),
    ("noise alone", NOISE, [20, 60]),
    ("equal seeds", SAME_SEEDS, [5, 60]),
    ("difference, by seed, 3 seeds", BY_SEED, [3, 60]),
];

#[test]
fn intervals_of_seeds_cover_at_their_level() {
    // Three points are more than three standard errors with 600 tables.
    for (name, of) in SETTINGS {
        let [held, _] = coverage(600, of, [8, 60], |of, methods, _| mended(of, methods));
        assert!((0.92..=0.98).contains(&held), "{name}: {held}");
    }
}

/// Before and after. The standard error of a coverage is 0.005 with 2000 tables, for the bootstrap, and 0.0015 with 20 000:
/// 2000 are too few to tell 0.95 from 0.96 in each of 18 settings.
#[test]
#[ignore = "two minutes"]
fn intervals_of_seeds_cover_exactly() {
    const TABLES: u64 = 20_000;
    let mut missed = Vec::new();
    let settings = SETTINGS.iter().flat_map(|(name, of)| SIZES.map(|size| (*name, *of, size, true)));
    let edges = EDGES.iter().map(|(name, of, size)| (*name, *of, *size, false));
    for (name, of, size, is_exact) in settings.chain(edges) {
        let before = coverage(TABLES / 10, of, size, |_, methods, name| bootstrapped(methods, name));
        let after = coverage(TABLES, of, size, |of, methods, _| mended(of, methods));
        println!("{name}, {size:?}: bootstrap {before:.4?}, components {after:.4?}");
        if is_exact && !(0.94..=0.96).contains(&after[0]) {
            missed.push((name, size, after[0]));
        }
    }
    assert!(missed.is_empty(), "{missed:?}");
}

/// Tables to which seeds are added until the interval is narrow: coverage, and the mean number of seeds.
fn coverage_when_stopped(tables: u64, of: Made, scenes: usize, least: usize) -> [f64; 2] {
    let one = |k: u64| {
        let (truth, methods) = made(of, [MOST_SEEDS, scenes], &mut Rng::new(k, "tables", "stopping"));
        let first = |n: usize| -> Vec<Samples> {
            let cut = |all: &Samples| Samples {
                seeds: all.seeds[..n].to_vec(),
                training_seeds: all.training_seeds.iter().copied().take(n).collect(),
                ..Samples::default()
            };
            methods.iter().map(cut).collect()
        };
        let mut n = least;
        let mut e = mended(of, &first(n));
        while adds_a_seed(n, &e) {
            n += 1;
            e = mended(of, &first(n));
        }
        [f64::from(u8::from((e.low..=e.high).contains(&truth))), n as f64]
    };
    let all: Vec<[f64; 2]> = (0..tables).into_par_iter().map(one).collect();
    [0, 1].map(|k| all.iter().map(|x| x[k]).sum::<f64>() / tables as f64)
}

#[test]
#[ignore = "a minute"]
fn stopping_at_a_half_width_keeps_the_coverage() {
    let settings = [
        ("seeds differ most", Made { parts: [0.03, 0.0, 0.1], ..MEAN }),
        ("seeds and scenes differ", Made { parts: [0.03, 0.08, 0.35], ..MEAN }),
        ("difference, by seed", Made { parts: [0.02, 0.0, 0.25], gap: Some(0.06), ..BY_SEED }),
    ];
    for (name, of) in settings {
        for least in [LEAST_SEEDS, 10] {
            let [held, seeds] = coverage_when_stopped(4000, of, 200, least);
            println!("{name}, from {least} seeds on: {held:.4} with {seeds:.1} seeds");
            // Stopping favours tables whose seeds seem to differ little, which costs two points.
            assert!((0.92..=0.96).contains(&held), "{name}: {held}");
        }
    }
}
