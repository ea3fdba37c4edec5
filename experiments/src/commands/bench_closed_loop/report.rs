//! The paper's tables of closed-loop training with our figures and its own, and a verdict on each ordering.

use std::fmt::Write as _;

use anyhow::{Result, bail};

use super::Method;
use crate::bench::{
    episode_columns::{
        AT_FAULT, COMPLETION, CONTACT, COST, Column, JERK, OFF_ROAD, REWARD, SPEED, csv_episode, csv_names,
    },
    seeds_and_scenes::{Difference, Measured, difference, holm, seed_mean},
};

/// Columns of a table: those of the paper, then ours.
const TABLE: [Column; 8] = [REWARD, COST, COMPLETION, CONTACT, SPEED, JERK, AT_FAULT, OFF_ROAD];
/// Level of the tests.
const LEVEL: f64 = 0.05;
/// A policy that collides less than `none` at less completion and speed than these brakes its way to safety.
const LESS_COMPLETION: f64 = 0.05;
const LESS_SPEED: f64 = 0.9;
/// A completion this far below the other's still counts as equal for the primary measure.
const SAME_COMPLETION: f64 = 0.02;

/// A row of the paper: kind of scenes, method, and its numbers in the order of [`TABLE`], mean and deviation.
type Published = (&'static str, &'static str, &'static [[f64; 2]]);

/// Results of the paper: reward, cost, completion, collision, speed, jerk.
const PAPER: [Published; 16] = [
    ("sage", "sage", &[[45.14, 3.27], [0.61, 0.04], [0.69, 0.03], [0.31, 0.02], [8.98, 0.02], [28.85, 0.68]]),
    ("sage", "cat", &[[37.70, 1.53], [0.70, 0.04], [0.58, 0.02], [0.37, 0.04], [6.85, 0.03], [31.83, 1.10]]),
    ("sage", "none", &[[41.32, 3.21], [0.68, 0.04], [0.62, 0.04], [0.44, 0.06], [8.77, 0.01], [30.42, 1.12]]),
    ("sage", "rule", &[[32.99, 4.89], [0.72, 0.03], [0.50, 0.04], [0.33, 0.02], [5.99, 0.04], [30.51, 0.99]]),
    (
        "unchanged",
        "sage",
        &[[51.99, 1.22], [0.48, 0.05], [0.77, 0.02], [0.16, 0.05], [9.27, 0.03], [24.97, 0.53]],
    ),
    (
        "unchanged",
        "cat",
        &[[46.81, 4.33], [0.50, 0.05], [0.67, 0.02], [0.18, 0.05], [7.21, 0.05], [28.15, 1.06]],
    ),
    (
        "unchanged",
        "none",
        &[[50.16, 5.32], [0.50, 0.07], [0.72, 0.04], [0.23, 0.02], [9.03, 0.03], [27.53, 0.98]],
    ),
    (
        "unchanged",
        "rule",
        &[[44.61, 3.88], [0.52, 0.05], [0.63, 0.04], [0.13, 0.00], [6.00, 0.10], [28.22, 1.44]],
    ),
    ("cat", "sage", &CROSS[0]),
    ("cat", "cat", &CROSS[1]),
    ("cat", "none", &CROSS[2]),
    ("cat", "rule", &CROSS[3]),
    ("rule", "sage", &CROSS[4]),
    ("rule", "cat", &CROSS[5]),
    ("rule", "none", &CROSS[6]),
    ("rule", "rule", &CROSS[7]),
];
/// Its cross-evaluation has completion and collision alone.
const CROSS: [[[f64; 2]; 4]; 8] = [
    [NONE, NONE, [0.678, 0.034], [0.307, 0.037]],
    [NONE, NONE, [0.660, 0.039], [0.298, 0.050]],
    [NONE, NONE, [0.665, 0.042], [0.454, 0.051]],
    [NONE, NONE, [0.569, 0.050], [0.348, 0.028]],
    [NONE, NONE, [0.655, 0.037], [0.334, 0.038]],
    [NONE, NONE, [0.633, 0.043], [0.389, 0.044]],
    [NONE, NONE, [0.642, 0.027], [0.461, 0.046]],
    [NONE, NONE, [0.556, 0.059], [0.293, 0.043]],
];
const NONE: [f64; 2] = [f64::NAN; 2];

/// What is expected of the tested run less another: kind of scenes, column, whether larger is better.
type Claim = (&'static str, Column, bool);

/// Differences that are tested together.
struct Family {
    title: &'static str,
    note: &'static str,
    claims: &'static [Claim],
    /// Verdict on a difference as expected, and on the opposite.
    verdicts: [&'static str; 2],
    /// Verdict on a difference as expected that the tested run owes to a completion more than [`SAME_COMPLETION`]
    /// below the other's.
    bought: Option<&'static str>,
}

/// The primary measure, chosen before the first training.
const PRIMARY: Family = Family {
    title: "Primary measure",
    note: " Fewer at-fault contacts count where completion in these scenes is at most 0.02 below the other's.",
    claims: &[("sage", AT_FAULT, false)],
    verdicts: ["lower", "higher"],
    bought: Some("lower at less completion"),
};

/// The orderings that the paper claims.
const ORDERINGS: Family = Family {
    title: "The paper's orderings",
    note: "",
    claims: &[
        ("sage", COMPLETION, true),
        ("sage", CONTACT, false),
        ("unchanged", COMPLETION, true),
        ("unchanged", CONTACT, false),
        ("cat", COMPLETION, true),
        ("rule", COMPLETION, true),
    ],
    verdicts: ["reproduced", "reversed"],
    bought: None,
};

/// The same differences for a run that the paper does not have.
const OTHER_MEASURES: Family = Family { title: "Other measures", verdicts: ["better", "worse"], ..ORDERINGS };
/// The run that the paper's orderings are about, and the others of the paper.
const OF_PAPER: (&str, [&str; 3]) = ("sage", ["cat", "none", "rule"]);

/// The run that is tested, and the runs against which it is.
pub(super) struct Tested<'a> {
    run: &'a str,
    others: Vec<&'a str>,
}

impl<'a> Tested<'a> {
    /// Tests `run`, by default `sage`, against all other runs.
    ///
    /// *Errors*: `run` is none of the runs.
    pub(super) fn of(run: Option<&'a str>, runs: impl Iterator<Item = &'a str>) -> Result<Self> {
        let (found, mut others): (Vec<_>, Vec<_>) = runs.partition(|name| *name == run.unwrap_or(OF_PAPER.0));
        others.sort_unstable();
        match (run, found.first()) {
            (Some(run), None) => {
                bail!("--tested names `{run}`, which is none of --runs: {}", others.join(", "))
            }
            _ => Ok(Self { run: run.unwrap_or(OF_PAPER.0), others }),
        }
    }
}

impl Method {
    /// A column of a kind of scenes: each seed's policies are averaged.
    fn measured(&self, kind: usize, column: &Column) -> Measured {
        let of_seed = |cells: &Vec<super::Cell>| {
            let scenes = cells.first().map_or(0, |cell| cell.kinds[kind].len());
            (0..scenes).map(|k| column.sums(cells.iter().map(|cell| &cell.kinds[kind][k]))).collect()
        };
        self.seeds.iter().map(of_seed).collect()
    }
}

/// Tables and verdicts.
pub(super) fn markdown(methods: &[Method], kinds: &[String], scenes: usize, tested: &Tested) -> String {
    let mut text = format!(
        "{scenes} scenes, each policy once in each. Mean ± deviation over seeds [95 % interval: bootstrap over seeds and scenes]; the policies of a seed are averaged first. Speed in m/s, jerk in m/s³; the others are sums or shares per episode.\n"
    );
    for (k, kind) in kinds.iter().enumerate() {
        let title =
            if k == 0 { "Unchanged scenes".to_owned() } else { format!("Scenes attacked by `{kind}`") };
        let _ = writeln!(text, "\n## {title}\n");
        text.push_str("| trained with | seeds |");
        for column in &TABLE {
            let _ = write!(text, " {} |", column.name.replace('_', " "));
        }
        let _ = writeln!(text, "\n| --- | ---: |{}", " ---: |".repeat(TABLE.len()));
        for method in methods {
            let _ = write!(text, "| {} | {} |", method.name, method.seeds.len());
            for column in &TABLE {
                let name = format!("{kind} {} {}", method.name, column.name);
                let measured = method.measured(k, column);
                if is_unmeasured(&measured) {
                    text.push_str(" – |");
                    continue;
                }
                match seed_mean(&measured, &name) {
                    Some(m) => {
                        let deviation = m.deviation.map_or(String::new(), |sd| format!(" ± {sd:.2}"));
                        let _ = write!(text, " {:.2}{deviation} [{:.2}, {:.2}] |", m.mean, m.low, m.high);
                    }
                    None => text.push_str(" |"),
                }
            }
            text.push('\n');
            published(&mut text, kind, &method.name);
        }
    }
    tests(&mut text, methods, kinds, &PRIMARY, tested);
    if tested.run == OF_PAPER.0 {
        let of_paper = |name: &&str| OF_PAPER.1.contains(name);
        let others = tested.others.iter().copied().filter(of_paper).collect();
        tests(&mut text, methods, kinds, &ORDERINGS, &Tested { run: tested.run, others });
    } else {
        tests(&mut text, methods, kinds, &OTHER_MEASURES, tested);
    }
    braking(&mut text, methods);
    text
}

/// Whether there are episodes, but none in which a column is measured.
fn is_unmeasured(measured: &Measured) -> bool {
    let mut all = measured.iter().flatten().peekable();
    all.peek().is_some() && all.all(|[_, weight]| *weight == 0.0)
}

/// The paper's row under ours.
fn published(text: &mut String, kind: &str, method: &str) {
    let Some((_, _, numbers)) = PAPER.iter().find(|(of, name, _)| *of == kind && *name == method) else {
        return;
    };
    text.push_str("| *paper* | |");
    for k in 0..TABLE.len() {
        match numbers.get(k).filter(|[mean, _]| mean.is_finite()) {
            Some([mean, deviation]) => text.push_str(&format!(" *{mean} ± {deviation}* |")),
            None => text.push_str(" |"),
        }
    }
    text.push('\n');
}

/// Tests a run against others.
fn tests(
    text: &mut String,
    methods: &[Method],
    kinds: &[String],
    family: &Family,
    Tested { run, others }: &Tested,
) {
    let find = |name: &str| methods.iter().find(|method| method.name == name);
    let Some(subject) = find(run) else { return };
    let mut rows: Vec<(String, [&str; 2], bool, Difference)> = Vec::new();
    for (kind, column, larger) in family.claims {
        let Some(k) = kinds.iter().position(|found| found == kind) else { continue };
        for other in others {
            let Some(method) = find(other) else { continue };
            let name = format!("{kind} {other} {}", column.name);
            let what = format!("{} in {kind} scenes, {run} less {other}", column.name.replace('_', " "));
            let less = |column| difference(&subject.measured(k, column), &method.measured(k, column), &name);
            let [expected, opposite] = family.verdicts;
            let is_bought = less(&COMPLETION).is_some_and(|d| d.value < -SAME_COMPLETION);
            let expected = family.bought.filter(|_| is_bought).unwrap_or(expected);
            rows.extend(less(column).map(|d| (what, [expected, opposite], *larger, d)));
        }
    }
    if rows.is_empty() {
        return;
    }
    let corrected = holm(&rows.iter().map(|(.., d)| d.p).collect::<Vec<_>>());
    let _ = writeln!(
        text,
        "\n## {}\n\nDifferences are paired by scene; p is corrected by Holm's method over the rows. Seeds: per method, for a power of 0.8.{}\n\n| difference | expected | value | p | seeds needed | verdict |\n| --- | --- | ---: | ---: | ---: | --- |",
        family.title, family.note
    );
    for ((what, [expected, opposite], larger, d), p) in rows.iter().zip(corrected) {
        let verdict = match (d.value > 0.0) == *larger {
            _ if p >= LEVEL => "not resolved",
            true => expected,
            false => opposite,
        };
        let claim = if *larger { "above 0" } else { "below 0" };
        let seeds = d.seeds_needed.map_or("–".to_owned(), |n| n.to_string());
        let _ = writeln!(
            text,
            "| {what} | {claim} | {:.3} [{:.3}, {:.3}] | {p:.3} | {seeds} | {verdict} |",
            d.value, d.low, d.high
        );
    }
}

/// Names policies that collide less because they drive less.
fn braking(text: &mut String, methods: &[Method]) {
    let value = |method: &Method, column: Column| {
        seed_mean(&method.measured(0, &column), "mean").map_or(f64::NAN, |m| m.mean)
    };
    let Some(base) = methods.iter().find(|method| method.name == "none") else { return };
    let [contact, completion, speed] = [CONTACT, COMPLETION, SPEED].map(|column| value(base, column));
    for method in methods.iter().filter(|method| method.name != base.name) {
        if value(method, CONTACT) < contact
            && value(method, COMPLETION) < completion - LESS_COMPLETION
            && value(method, SPEED) < LESS_SPEED * speed
        {
            let _ = writeln!(
                text,
                "\n`{}` brakes its way to safety: fewer contacts than `none` in unchanged scenes, at less completion and speed.",
                method.name
            );
        }
    }
}

/// A row per episode.
pub(super) fn episodes_csv(methods: &[Method], kinds: &[String], names: &[String]) -> String {
    let mut csv = format!("method,seed,policy,scenes,scene,steps{}\n", csv_names());
    for method in methods {
        for cell in method.seeds.iter().flatten() {
            let identity = &cell.identity[1];
            let (seed, policy) = (&identity["seed"], identity["policy"].to_string().replace('"', ""));
            for (kind, rows) in kinds.iter().zip(&cell.kinds) {
                for row in rows {
                    let _ = write!(csv, "{},{seed},\"{policy}\",{kind},", method.name);
                    csv.push_str(&csv_episode(row, names));
                }
            }
        }
    }
    csv
}
