//! Verdicts on published numbers: the study's own less the paper's, and the paper's orderings of methods.

use sage_core::{
    metric::Aggregate,
    statistics::{Estimate, wilson},
    text::table::Table,
};

use super::{Estimates, cell, name_columns, named};
use crate::{
    Result,
    published::{Published, published},
    rows::{Key, Results, Subject},
    study::{Study, VerdictSpec},
};

/// Half-width of a 95 % interval in standard deviations.
const Z: f64 = 1.959_964;

/// What a comparison shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Verdict {
    Reproduced,
    Reversed,
    Differs,
    CannotBeTold,
}

impl Verdict {
    /// Of a difference from a published number: an interval whose half-width exceeds `within` tells nothing unless it is apart
    /// from 0.
    fn of_difference(difference: &Estimate, within: f64) -> Self {
        let Estimate { low, high, .. } = *difference;
        match low <= 0.0 && high >= 0.0 {
            false => Self::Differs,
            true if (high - low) / 2.0 <= within => Self::Reproduced,
            true => Self::CannotBeTold,
        }
    }

    /// Of an ordering whose difference is published with a sign.
    fn of_ordering(published: f64, own: &Estimate) -> Self {
        match (own.low <= 0.0 && own.high >= 0.0, (own.value > 0.0) == (published > 0.0)) {
            (true, _) => Self::CannotBeTold,
            (false, true) => Self::Reproduced,
            (false, false) => Self::Reversed,
        }
    }

    fn words(self) -> String {
        let words = match self {
            Self::Reproduced => "reproduced",
            Self::Reversed => "reversed",
            Self::CannotBeTold => "cannot be told",
            Self::Differs => "differs",
        };
        words.to_owned()
    }
}

/// The tables of verdicts; none unless the study asks for them.
///
/// *Errors*: no published numbers of this name.
pub(super) fn tables(study: &Study, results: &Results, all: &Estimates) -> Result<Vec<Table>> {
    let (Some(name), Some(spec)) = (&study.report.published, &study.report.verdicts) else {
        return Ok(Vec::new());
    };
    let published = published(name)?;
    let of = |subject| {
        let differences = differences(spec, results, subject, &published, all);
        [differences, orderings(spec, results, subject, &published)]
    };
    Ok(Subject::ALL.into_iter().flat_map(of).flatten().collect())
}

/// Published methods of a subject, each with its row, in the order of the results.
fn compared<'p>(
    results: &Results,
    subject: Subject,
    published: &'p [Published],
) -> Vec<(usize, &'p Published)> {
    let row = |method: usize| published.iter().find(|row| row.is_of(&results.keys[method]));
    results.methods(subject).into_iter().filter_map(|method| Some((method, row(method)?))).collect()
}

/// Own estimate less a published value. The error of the published value is that of a share of its scenes, times a number;
/// of other quantities it is ours, scaled to the number of its scenes.
fn less(own: &Estimate, theirs: f64, scenes: Option<usize>, share_times: Option<f64>) -> Estimate {
    let own = &widened(own, share_times);
    let [below, above] = [own.value - own.low, own.high - own.value];
    let [their_below, their_above] = match (scenes, share_times) {
        (None, _) => [0.0; 2],
        (Some(n), Some(times)) => share_error(theirs, n, times),
        (Some(n), None) => [below, above].map(|half| half * (own.n as f64 / n as f64).sqrt()),
    };
    let value = own.value - theirs;
    // The difference is smallest where the published value is largest.
    let (low, high) = (value - below.hypot(their_above), value + above.hypot(their_below));
    Estimate { value, low, high, n: own.n }
}

/// Wilson's interval of a number that is `times` a share of `n` scenes: how far it goes below and above.
fn share_error(value: f64, n: usize, times: f64) -> [f64; 2] {
    let held = (value / times * n as f64).round().clamp(0.0, n as f64) as usize;
    let error = wilson(held, n).map(|e| [e.value - e.low, e.high - e.value]);
    error.unwrap_or_default().map(|half| times * half)
}

/// An estimate of a multiple of a share has at least Wilson's interval: a bootstrap of few cases is too narrow, and
/// without any it has no width.
fn widened(own: &Estimate, share_times: Option<f64>) -> Estimate {
    let Some(times) = share_times else { return *own };
    let [below, above] = share_error(own.value, own.n, times);
    Estimate { low: own.low.min(own.value - below), high: own.high.max(own.value + above), ..*own }
}

/// Whether the paper orders two of its values: their difference exceeds its own error, where that is known.
fn is_ordered(a: f64, b: f64, scenes: [Option<usize>; 2], share_times: Option<f64>) -> bool {
    let variance = |value: f64, n: Option<usize>| {
        let times = share_times?;
        let share = (value / times).clamp(0.0, 1.0);
        Some(times * times * share * (1.0 - share) / n? as f64)
    };
    let error = variance(a, scenes[0]).zip(variance(b, scenes[1])).map_or(0.0, |(a, b)| Z * (a + b).sqrt());
    a != b && (a - b).abs() >= error
}

/// Why a metric of a method may differ from the paper's.
fn reason<'s>(spec: &'s VerdictSpec, key: &Key, metric: &str) -> Option<&'s String> {
    let generator = key.attack.split('{').next().unwrap_or_default();
    let names = [format!("{generator} {metric}"), generator.to_owned(), metric.to_owned()];
    names.iter().find_map(|name| spec.because.get(name))
}

fn differences(
    spec: &VerdictSpec,
    results: &Results,
    subject: Subject,
    published: &[Published],
    all: &Estimates,
) -> Option<Table> {
    let compared = compared(results, subject, published);
    let methods: Vec<usize> = compared.iter().map(|(method, _)| *method).collect();
    if methods.is_empty() {
        return None;
    }
    let has = name_columns(results, &methods);
    let mut rows = Vec::new();
    for (method, theirs) in compared {
        for (k, metric) in results.metrics_of(subject).iter().enumerate() {
            let Some([value, ..]) = theirs.values.get(&metric.name).map(|v| &v[..]) else { continue };
            let (_, Some(own)) = all.get(method, k) else { continue };
            let is_share = metric.aggregate == Aggregate::Share;
            let share_times = spec.share_times.get(&metric.name).copied().or(is_share.then_some(1.0));
            let difference = less(&own, *value, theirs.n, share_times);
            let within = spec.within.get(&metric.name).copied().unwrap_or(f64::INFINITY);
            let verdict = Verdict::of_difference(&difference, within);
            let mut row = named(results, method, has);
            row.push(metric.head());
            // Before the values, because a terminal may have no room for all columns.
            row.push(verdict.words());
            row.push(cell(metric, Some(own), None));
            row.push(theirs.cell(&metric.name, if is_share { 100.0 } else { 1.0 }));
            row.push(cell(metric, Some(difference), None));
            let possibly = reason(spec, &results.keys[method], &metric.name);
            row.push(possibly.filter(|_| verdict == Verdict::Differs).cloned().unwrap_or_default());
            rows.push(row);
        }
    }
    if rows.is_empty() {
        return None;
    }
    let heads = has.of("arm", "generator");
    let names = heads.len();
    let heads =
        heads.into_iter().chain(["metric", "verdict", "ours", "paper", "difference", "possibly because"]);
    let title = "Ours less the paper's. *Reproduced*: the interval of the difference, with the paper's own error, holds 0 and its half-width is at most that of the study; *cannot be told*: it holds 0 and is wider:";
    Some(Table { title: title.to_owned(), heads: heads.map(str::to_owned).collect(), rows, names })
}

fn orderings(
    spec: &VerdictSpec,
    results: &Results,
    subject: Subject,
    published: &[Published],
) -> Option<Table> {
    let reference = spec.reference.as_ref()?;
    let compared = compared(results, subject, published);
    let methods: Vec<usize> = compared.iter().map(|(method, _)| *method).collect();
    if methods.is_empty() {
        return None;
    }
    let has = name_columns(results, &methods);
    let row_of_reference = published.iter().find(|row| row.attack.contains(reference))?;
    let mut rows = Vec::new();
    for (method, theirs) in compared.iter().filter(|(_, row)| !std::ptr::eq(*row, row_of_reference)) {
        let own = &results.keys[*method];
        let Some(base) = base_of(own, reference, row_of_reference, results, &methods) else { continue };
        for name in &spec.ordered {
            let Some(k) = results.metric(subject, name) else { continue };
            let metric = &results.metrics_of(subject)[k];
            let is_share = metric.aggregate == Aggregate::Share;
            let share_times = spec.share_times.get(name).copied().or(is_share.then_some(1.0));
            let value = |row: &Published| row.values.get(name).and_then(|v| v.first().copied());
            let (Some(a), Some(b)) = (value(theirs), value(row_of_reference)) else { continue };
            if !is_ordered(a, b, [theirs.n, row_of_reference.n], share_times) {
                continue;
            }
            let stream = format!("{} less {} {name}", own.stream(), results.keys[base].stream());
            let Some(found) = results.samples(*method, k).less(&results.samples(base, k), &stream) else {
                continue;
            };
            let scale = if is_share { 100.0 } else { 1.0 };
            let mut row = named(results, *method, has);
            row.push(named(results, base, has).pop().unwrap_or_default());
            row.push(metric.head());
            row.push(Verdict::of_ordering(a - b, &found.estimate).words());
            row.push(cell(metric, Some(found.estimate), None));
            row.push(format!("*{:+}*", (1e4 * scale * (a - b)).round() / 1e4));
            rows.push(row);
        }
    }
    if rows.is_empty() {
        return None;
    }
    let heads = has.of("arm", "generator");
    let names = heads.len();
    let heads =
        heads.into_iter().chain(["less", "metric", "verdict", "ours", "paper"]).map(str::to_owned).collect();
    let title = "The paper's orderings, where its difference exceeds its own error; ours paired by scene:";
    Some(Table { title: title.to_owned(), heads, rows, names })
}

/// The method that another one is ordered against: of the reference's row, the same driver and plans against the same path; by
/// the same generator if it is in that row, else the reference itself.
fn base_of(
    own: &Key,
    reference: &str,
    row_of_reference: &Published,
    results: &Results,
    methods: &[usize],
) -> Option<usize> {
    let bases = || {
        methods.iter().copied().filter(|k| {
            let key = &results.keys[*k];
            row_of_reference.is_of(key) && (&key.arm, &key.made_against) == (&own.arm, &own.made_against)
        })
    };
    let by_same = bases().find(|k| results.keys[*k].attack == own.attack);
    by_same.or_else(|| bases().find(|k| results.keys[*k].generator_label() == reference))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn estimate(value: f64, low: f64, high: f64) -> Estimate {
        Estimate { value, low, high, n: 60 }
    }

    #[test]
    fn a_verdict_follows_from_the_interval() {
        let of = |low, high| Verdict::of_difference(&estimate(0.0, low, high), 0.08);
        assert_eq!(of(-0.07, 0.08), Verdict::Reproduced);
        assert_eq!(of(-0.02, 0.15), Verdict::CannotBeTold);
        assert_eq!(of(0.01, 0.15), Verdict::Differs);
        let of = |value, low, high| Verdict::of_ordering(2.0, &estimate(value, low, high));
        assert_eq!(of(1.0, 0.5, 1.5), Verdict::Reproduced);
        assert_eq!(of(-1.0, -1.5, -0.5), Verdict::Reversed);
        assert_eq!(of(1.0, -0.5, 1.5), Verdict::CannotBeTold);
    }

    #[test]
    fn the_papers_own_error_widens_the_interval() {
        // Wilson's interval of 281 of 369 scenes goes 4.6 points below and 4.1 above.
        let d = less(&estimate(0.78, 0.62, 0.90), 0.7615, Some(369), Some(1.0));
        assert!((d.value - 0.0185).abs() < 1e-12);
        assert!((d.low - (0.0185 - 0.16f64.hypot(0.0408))).abs() < 1e-3, "{d:?}");
        assert!((d.high - (0.0185 + 0.12f64.hypot(0.0459))).abs() < 1e-3, "{d:?}");
        // Means: our half-width, with the scenes of the paper.
        let d = less(&estimate(4.0, 3.6, 4.2), 4.0, Some(240), None);
        assert!((d.low + 0.4f64.hypot(0.1)).abs() < 1e-12 && (d.high - 0.2f64.hypot(0.2)).abs() < 1e-12);
        assert!((less(&estimate(4.0, 3.6, 4.2), 4.0, None, None).low + 0.4).abs() < 1e-12);
        // No contact in 60 scenes: up to 6.0 % of them, 10 each; of the paper's 369 scenes 25 have one.
        let d = less(&estimate(0.0, 0.0, 0.0), 0.677, Some(369), Some(10.0));
        assert!(d.low < -0.9 && (-0.1..0.1).contains(&d.high), "{d:?}");
    }

    #[test]
    fn a_difference_within_the_papers_error_is_no_ordering() {
        let orders = |a: f64, b: f64| is_ordered(a / 369.0, b / 369.0, [Some(369); 2], Some(1.0));
        assert!(orders(281.0, 186.0) && !orders(8.0, 7.0) && !orders(9.0, 9.0));
        assert!(is_ordered(1.4, 0.3, [None; 2], None));
    }
}
