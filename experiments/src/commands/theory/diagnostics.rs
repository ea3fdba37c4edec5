//! What the theory asks of trained experts: measured on scenes, as diagnostics.
//!
//! They are no claims: trained networks have no known constants, so measurements on them do not change the exit code.

mod mixtures;
mod models;
mod weight_and_output;

use advsage::Registries;
use anyhow::{Result, ensure};
use sage_backbones::training::{Measures, PreparedScene};
use sage_bench::curve::{Curve as Sweep, Point as Measure, VALUES, Value, best_lambda, heights};
use sage_core::{
    scene::SceneData,
    statistics::{self, Estimate},
    text::table::Table,
};
use sage_merging::{ADVERSARIAL, Geometry, REALISTIC};
use sage_run::{
    networks,
    progress::{self, Progress},
    scenes::Scenes,
};
use theory_checks::{Figure, Preference, Series};

use self::{
    models::{Measured, Points, models},
    weight_and_output::Comparison,
};
use crate::cli::TheoryArgs;

/// Weight of each expert's own reward in the shipped experts.
const BETA: f64 = 0.9;
/// μ whose best λ is compared with the sign rule.
const PREFERENCES: [f64; 9] = [0.0, 0.05, 0.1, 0.3, 0.5, 0.7, 0.9, 0.95, 1.0];
/// Scenes below which intervals say nothing.
const FEW: usize = 10;
/// Scenes in memory at a time.
const WINDOW: usize = 16;

/// A diagnostic of trained experts.
pub(super) struct Diagnostic {
    /// G1 to G6.
    pub(super) id: &'static str,
    /// What is asked.
    pub(super) question: &'static str,
    /// What was found, in one line.
    pub(super) finding: String,
    /// The claim behind it, and what the finding does not say.
    pub(super) caveat: &'static str,
    pub(super) tables: Vec<Table>,
    pub(super) figures: Vec<Figure>,
}

/// Measures of all scenes.
struct Found {
    path: Sweep,
    beyond: [Sweep; 2],
    mixing: Vec<[Comparison; 3]>,
    geometry: Geometry,
    points: Points,
}

/// All diagnostics of the realistic and the adversarial expert on scenes, what they were measured on, and how many
/// scenes failed.
///
/// *Errors*: experts or scenes cannot be read, or no scene can be attacked.
pub(super) fn run(args: &TheoryArgs, registries: &Registries) -> Result<(String, Vec<Diagnostic>, usize)> {
    let paths = args.data.as_deref().unwrap_or_default();
    let experts =
        networks::load_experts(&registries.backbones, &args.weights)?.only(&[REALISTIC, ADVERSARIAL])?;
    let geometry = Geometry::of(&experts)?;
    let points = Points::default();
    let models = models(&experts, &geometry, &points, args.seed)?;
    let scenes = Scenes::of(paths, &args.split.filter(), 0, args.seed)?.attackable()?;
    let measures = Measures::of(&[], &registries.rewards, &registries.feasibilities)?;
    let prior = &**experts.prior();
    let one = |data: &SceneData| -> Result<Option<Measured>> {
        let prepared = PreparedScene::new(prior, data, false, &measures)?;
        prepared.map(|prepared| models.measure(data, prior, &prepared)).transpose()
    };
    let mut progress = Progress::new("evaluated", scenes.len());
    let mut measured = Vec::new();
    for window in scenes.windows(WINDOW) {
        measured.extend(window.map_each(one, || progress.step())?.into_iter().flatten());
    }
    progress.finish(&format!("{} models on {} scenes", models.len(), measured.len()));
    let sweep = |of: fn(&Measured) -> &Vec<Measure>| Sweep {
        scenes: measured.iter().map(|measured| of(measured).clone()).collect(),
    };
    let found = Found {
        path: sweep(|m| &m.path),
        beyond: [sweep(|m| &m.beyond[0]), sweep(|m| &m.beyond[1])],
        mixing: measured.iter().filter_map(|measured| measured.mixing).collect(),
        geometry,
        points,
    };
    ensure!(!measured.is_empty(), "none of the scenes could be evaluated");
    let subject = format!("Experts `{}` on {}.", args.weights, progress::count(measured.len(), "scene"));
    let all = [
        found.path(),
        found.best(),
        Some(found.vectors()),
        found.extrapolation(),
        found.mixing(),
        found.surrogate(),
    ];
    if found.mixing.is_empty() {
        progress::say("G5 and G6 are left out: no scene records the adversary's whole future");
    }
    Ok((subject, all.into_iter().flatten().collect(), scenes.failure_count()))
}

impl Found {
    /// Rewards along the path: heights above the chord in units of λ(1 − λ) D²/2, and barriers.
    fn path(&self) -> Option<Diagnostic> {
        let squared = self.geometry.norm(&[-1.0, 1.0]).powi(2);
        let last = (self.points.lambdas.len() - 1) as f64;
        let curvatures = |front: &[Measure], value: Value| -> Vec<f64> {
            let heights = heights(&self.points.lambdas, &front.iter().map(value).collect::<Vec<_>>())
                .into_iter()
                .enumerate();
            heights
                .map(|(k, height)| {
                    let lambda = (k + 1) as f64 / last;
                    2.0 * height / (lambda * (1.0 - lambda) * squared)
                })
                .collect()
        };
        let mut path = Table::new(
            "q(λ) = 2 (R − chord)/(λ (1 − λ) D²) over the inner λ: a strongly concave reward keeps it above 0",
            &["reward", "least q", "mean q", "largest q"],
        );
        let mut barriers = Table::new(
            "Barrier of the loss −R: its largest height over the chord at the inner λ, below 0 for a concave reward; and over the mean of both ends",
            &["reward", "over the chord", "over the mean"],
        );
        let mut refuted = Vec::new();
        let front = self.path.front();
        let mut curves = Vec::new();
        for (name, value) in VALUES {
            let of = |fold: fn(&[f64]) -> f64| self.path.estimate(|front| fold(&curvatures(front, value)));
            let least = of(|q| q.iter().copied().fold(f64::INFINITY, f64::min))?;
            let mean = of(|q| statistics::mean(q).unwrap_or(f64::NAN))?;
            let largest = of(|q| q.iter().copied().fold(f64::NEG_INFINITY, f64::max))?;
            // The least of many noisy values is below 0 by chance; their mean is not.
            if mean.high < 0.0 {
                refuted.push(name);
            }
            path.row(name, [least, mean, largest].map(|e| cell(&e, 4)));
            let over_chord = self.path.estimate(|front| {
                heights(&self.points.lambdas, &front.iter().map(value).collect::<Vec<_>>())
                    .into_iter()
                    .map(|height| -height)
                    .fold(f64::NEG_INFINITY, f64::max)
            })?;
            let over_mean = self.path.estimate(|front| {
                let ends = [front.first(), front.last()].map(|end| end.map_or(0.0, value));
                let heights = front.iter().map(|m| 0.5 * (ends[0] + ends[1]) - value(m));
                heights.skip(1).take(front.len().saturating_sub(2)).fold(f64::NEG_INFINITY, f64::max)
            })?;
            barriers.row(name, [over_chord, over_mean].map(|e| cell(&e, 3)));
            let points = self.points.lambdas[1..].iter().zip(curvatures(&front, value));
            curves.push(Series::line(name, points.map(|(lambda, q)| [*lambda, q]).collect()));
        }
        let with_chord = |(name, value): (&str, Value)| {
            let points = self.points.lambdas.iter().zip(&front).map(|(lambda, m)| [*lambda, value(m)]);
            let points: Vec<[f64; 2]> = points.collect();
            let chord = [points.first(), points.last()].into_iter().flatten().copied().collect();
            let title = format!("{name} along the experts' path, and its chord");
            Figure::new(&title, ["λ", name], vec![Series::line(name, points), Series::line("chord", chord)])
        };
        let mut figures: Vec<Figure> = VALUES[..2].iter().copied().map(with_chord).collect();
        figures.push(Figure::new("q along the path", ["λ", "q"], curves));
        let finding = if refuted.is_empty() {
            "the interval of no mean q is below 0".to_owned()
        } else {
            format!(
                "the interval of the mean q is below 0, so these are not concave along the path: {}",
                refuted.join("; ")
            )
        };
        Some(Diagnostic {
            id: "G1",
            question: "Are the rewards concave along the path, and is there a barrier (T10)?",
            finding: unless_few(self.path.scenes.len(), finding),
            caveat: "A q above 0 would not imply concavity. Noise draws the least and the largest of 19 values outwards, and so the barrier, but not their mean.",
            tables: vec![path, barriers],
            figures,
        })
    }

    /// The best λ for each μ against the sign rule.
    fn best(&self) -> Option<Diagnostic> {
        let mut table = Table::new(
            "λ at which μ R_adv − (1 − μ) P_real is largest, of 21",
            &["μ", "best λ", "rule for β = 0.9"],
        );
        let mut points = Vec::new();
        let mut against = Vec::new();
        for mu in PREFERENCES {
            let best = self.path.estimate(|front| best_lambda(&self.points.lambdas, front, mu))?;
            let at = Preference { mu, beta: BETA };
            let (rule, [low, high]) = match at.coefficients() {
                [c1, _] if c1 <= 1e-9 => ("0", [0.0, 0.0]),
                [_, c2] if c2 <= 1e-9 => ("1", [1.0, 1.0]),
                // An inner λ: the nearest points of the path.
                _ => ("between", [0.05, 0.95]),
            };
            if best.high < low || best.low > high {
                against.push(format!("{mu}"));
            }
            table.row(format!("{mu}"), [cell(&best, 2), rule.to_owned()]);
            points.push([mu, best.value]);
        }
        let rises = points.windows(2).all(|pair| pair[1][1] >= pair[0][1]);
        let finding = format!(
            "the best λ {} with μ; {}",
            if rises { "never falls" } else { "falls somewhere" },
            if against.is_empty() {
                "no interval is against the sign rule".to_owned()
            } else {
                format!("the interval is not where the sign rule asks for it at μ = {}", against.join(", "))
            }
        );
        Some(Diagnostic {
            id: "G2",
            question: "Does the best λ follow the sign rule (T5s)?",
            finding: unless_few(self.path.scenes.len(), finding),
            caveat: "Not following it means rewards that are not concave, experts that are not at their optimum, noise, or a best λ nearer to an end than the grid shows. The rule is for experts tuned with β = 0.9, as the shipped ones.",
            tables: vec![table],
            figures: vec![Figure::new(
                "The best λ for each μ",
                ["μ", "best λ"],
                vec![Series::line("trained experts", points)],
            )],
        })
    }

    /// Norm and cosine of the preference vector along the path.
    fn vectors(&self) -> Diagnostic {
        let norm = |at: [f64; 2]| self.geometry.norm(&at);
        let (real, adversarial) = (norm([1.0, 0.0]), norm([0.0, 1.0]));
        let cosine = self.geometry.cosine(&[1.0, 0.0], &[0.0, 1.0]);
        let ratio = adversarial.max(real) / adversarial.min(real);
        let mut table = Table::new("Geometry of both preference vectors", &["quantity", "value"]);
        for (name, value) in [
            ("norm, realistic", format!("{real:.3}")),
            ("norm, adversarial", format!("{adversarial:.3}")),
            ("angle ψ", format!("{:.2}°", cosine.acos().to_degrees())),
            ("ratio of the norms", format!("{ratio:.3}")),
            ("1/cos ψ", format!("{:.3}", 1.0 / cosine)),
        ] {
            table.row(name, [value]);
        }
        let is_monotone = cosine > 0.0 && ratio >= 1.0 / cosine;
        let line = |name: &str, value: &dyn Fn([f64; 2]) -> f64| {
            let points = self.points.lambdas.iter().map(|lambda| [*lambda, value([1.0 - lambda, *lambda])]);
            Series::line(name, points.collect())
        };
        let curves = vec![
            line("norm / norm of the adversarial vector", &|at| norm(at) / adversarial),
            line("cosine to the adversarial vector", &|at| self.geometry.cosine(&at, &[0.0, 1.0])),
        ];
        Diagnostic {
            id: "G3",
            question: "Do norm and cosine of the preference vector change monotonically (T9)?",
            finding: format!(
                "the cosine rises, as it must; the norm {}",
                if is_monotone {
                    "is monotone: the ratio of the norms is above 1/cos ψ"
                } else {
                    "dips between the experts"
                }
            ),
            caveat: "A monotone cosine is geometry, no evidence about training.",
            tables: vec![table],
            figures: vec![Figure::new("Norm and cosine along the path", ["λ", "value"], curves)],
        }
    }

    /// Both extrapolations at equal steps.
    fn extrapolation(&self) -> Option<Diagnostic> {
        let [vector, direct] = &self.beyond;
        let mut table = Table::new(
            "Beyond the adversarial expert; steps as shares of the distance between the experts",
            &[
                "step",
                "along its vector: R_adv",
                "along the line: R_adv",
                "difference: R_adv",
                "difference: P_real",
            ],
        );
        let (mut better, mut worse) = (Vec::new(), Vec::new());
        for (k, step) in self.points.steps.iter().enumerate().skip(1) {
            let reward = |front: &[Measure]| front[k].reward;
            let difference = vector.difference(direct, reward)?;
            if difference.low > 0.0 {
                better.push(format!("{step}"));
            }
            if difference.high < 0.0 {
                worse.push(format!("{step}"));
            }
            let cells = [
                vector.estimate(reward)?,
                direct.estimate(reward)?,
                difference,
                vector.difference(direct, |front| front[k].penalty)?,
            ];
            table.row(format!("{step}"), cells.map(|e| cell(&e, 2)));
        }
        let line = |(name, sweep): (&str, &Sweep)| {
            let points = self.points.steps.iter().zip(sweep.front()).map(|(step, m)| [*step, m.reward]);
            Series::line(name, points.collect())
        };
        let list =
            |steps: Vec<String>| if steps.is_empty() { "no step".to_owned() } else { steps.join(", ") };
        Some(Diagnostic {
            id: "G4",
            question: "Is extrapolation along the adversarial vector better than along the experts' line (T13)?",
            finding: unless_few(
                vector.scenes.len(),
                format!(
                    "the interval of the vector's advantage in R_adv is above 0 at {}, below 0 at {}",
                    list(better),
                    list(worse)
                ),
            ),
            caveat: "At equal lengths of the step; twelve intervals are not corrected for their number. At a converged expert neither has an advantage to first order.",
            tables: vec![table],
            figures: vec![Figure::new(
                "R_adv beyond the adversarial expert",
                ["step / distance between the experts", "R_adv"],
                [("along its vector", vector), ("along the line", direct)].map(line).to_vec(),
            )],
        })
    }
}

/// What was found, unless there are too few scenes to say it.
fn unless_few(scenes: usize, found: String) -> String {
    if scenes < FEW { format!("too few scenes for a finding ({scenes})") } else { found }
}

fn cell(e: &Estimate, digits: usize) -> String {
    // Adding 0 after rounding takes the sign from a negative 0.
    let scale = 10f64.powi(i32::try_from(digits).unwrap_or(0));
    let [value, low, high] = [e.value, e.low, e.high].map(|x| (x * scale).round() / scale + 0.0);
    format!("{value:.digits$} [{low:.digits$}, {high:.digits$}]")
}
