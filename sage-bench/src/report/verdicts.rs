//! Verdicts on published numbers: the study's own less the paper's, and the paper's orderings of methods.

use anyhow::Result;
use sage_core::{
    metric::Aggregate,
    statistics::{Estimate, wilson},
};

use super::{Estimates, cell, named, shown};
use crate::{
    published::{Published, published},
    rows::{Key, Results, Subject},
    study::{Study, VerdictSpec},
    table::Table,
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
    /// Of a difference from a published number: an interval that is wider than `within` to either side tells nothing unless
    /// it is apart from 0.
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

    fn words(self, because: Option<&String>) -> String {
        match (self, because) {
            (Self::Reproduced, _) => "reproduced".to_owned(),
            (Self::Reversed, _) => "reversed".to_owned(),
            (Self::CannotBeTold, _) => "cannot be told".to_owned(),
            (Self::Differs, None) => "differs".to_owned(),
            (Self::Differs, Some(reason)) => format!("differs: {reason}"),
        }
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
    let n = scenes.map_or(f64::INFINITY, |n| n as f64);
    let error = |half: f64| match share_times {
        Some(times) => {
            let share = (theirs / times).clamp(0.0, 1.0);
            Z * times * (share * (1.0 - share) / n).sqrt()
        }
        None => half * (own.n as f64 / n).sqrt(),
    };
    let own = &widened(own, share_times);
    let [below, above] = [own.value - own.low, own.high - own.value];
    let value = own.value - theirs;
    Estimate {
        value,
        low: value - below.hypot(error(below)),
        high: value + above.hypot(error(above)),
        n: own.n,
    }
}

/// A share whose bootstrap has no width, because all scenes are alike, has Wilson's interval.
fn widened(own: &Estimate, share_times: Option<f64>) -> Estimate {
    let found = share_times.filter(|_| own.low == own.high).and_then(|times| {
        let e = wilson((own.value / times * own.n as f64).round() as usize, own.n)?;
        Some(Estimate { value: own.value, low: times * e.low, high: times * e.high, n: own.n })
    });
    found.unwrap_or(*own)
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
    let has = shown(results, methods.get(..1).map(|_| &methods[..])?);
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
            row.push(cell(metric, Some(own), None));
            row.push(theirs.cell(&metric.name, if is_share { 100.0 } else { 1.0 }));
            row.push(cell(metric, Some(difference), None));
            row.push(verdict.words(reason(spec, &results.keys[method], &metric.name)));
            rows.push(row);
        }
    }
    if rows.is_empty() {
        return None;
    }
    let names = has.iter().filter(|has| **has).count();
    let heads = ["arm", "generator"].into_iter().zip(has).filter(|(_, has)| *has).map(|(name, _)| name);
    let heads = heads.chain(["metric", "ours", "paper", "difference", "verdict"]);
    let title = "Ours less the paper's. *Reproduced*: the interval of the difference, with the paper's own error, holds 0 and is narrow; *cannot be told*: it holds 0 and is wide:";
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
    let is_reference = |method: usize| results.keys[method].generator_label() == *reference;
    let mut rows = Vec::new();
    let methods: Vec<usize> = compared.iter().map(|(method, _)| *method).collect();
    let has = shown(results, methods.get(..1).map(|_| &methods[..])?);
    for (method, theirs) in compared.iter().filter(|(method, _)| !is_reference(*method)) {
        let own = &results.keys[*method];
        // Against the reference of the same driver and of plans against the same path.
        let is_base = |(k, _): &&(usize, &Published)| {
            let key = &results.keys[*k];
            is_reference(*k) && (&key.arm, &key.made_against) == (&own.arm, &own.made_against)
        };
        let Some((base, of_base)) = compared.iter().find(is_base) else { continue };
        if std::ptr::eq(*theirs, *of_base) {
            continue;
        }
        for name in &spec.ordered {
            let Some(k) = results.metric(subject, name) else { continue };
            let value = |row: &Published| row.values.get(name).and_then(|v| v.first().copied());
            let (Some(a), Some(b)) = (value(theirs), value(of_base)) else { continue };
            let stream = format!("{} less {} {name}", own.stream(), results.keys[*base].stream());
            let Some(found) = results.samples(*method, k).less(&results.samples(*base, k), &stream) else {
                continue;
            };
            let metric = &results.metrics_of(subject)[k];
            let scale = if metric.aggregate == Aggregate::Share { 100.0 } else { 1.0 };
            let mut row = named(results, *method, has);
            row.push(metric.head());
            row.push(cell(metric, Some(found.estimate), None));
            row.push(format!("*{:+}*", (1e4 * scale * (a - b)).round() / 1e4));
            row.push(Verdict::of_ordering(a - b, &found.estimate).words(None));
            rows.push(row);
        }
    }
    if rows.is_empty() {
        return None;
    }
    let names = has.iter().filter(|has| **has).count();
    let heads = ["arm", "generator"].into_iter().zip(has).filter(|(_, has)| *has).map(|(name, _)| name);
    let heads = heads.chain(["metric", "ours", "paper", "verdict"]).map(str::to_owned).collect();
    let title = format!("The paper's orderings: each method less `{reference}`, paired by scene:");
    Some(Table { title, heads, rows, names })
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
        // 76.15 % of 369 scenes: a standard error of 2.22 points.
        let d = less(&estimate(0.78, 0.74, 0.82), 0.7615, Some(369), Some(1.0));
        assert!((d.value - 0.0185).abs() < 1e-12);
        assert!((d.low - (0.0185 - 0.04f64.hypot(0.043_487))).abs() < 1e-4, "{d:?}");
        // Means: our half-width, with the scenes of the paper.
        let d = less(&estimate(4.0, 3.6, 4.2), 4.0, Some(240), None);
        assert!((d.low + 0.4f64.hypot(0.2)).abs() < 1e-12 && (d.high - 0.2f64.hypot(0.1)).abs() < 1e-12);
        assert!((less(&estimate(4.0, 3.6, 4.2), 4.0, None, None).low + 0.4).abs() < 1e-12);
        // No contact in 60 scenes: up to 6.0 % of them, 10 each; of the paper's 369 scenes 25 have one.
        let d = less(&estimate(0.0, 0.0, 0.0), 0.677, Some(369), Some(10.0));
        assert!(
            (d.low + 0.933).abs() < 2e-3 && (d.high + 0.677 - 0.602f64.hypot(0.256)).abs() < 2e-3,
            "{d:?}"
        );
    }
}
