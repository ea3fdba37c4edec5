//! Tests of expected differences between arms: t tests over seeds and scenes (a bootstrap of scenes with one seed), corrected by
//! Holm's method within a family.

use sage_core::text::table::Table;

use crate::{
    Result,
    context::Context as _,
    estimate::{Difference, holm},
    published::{Published, orderings, published},
    rows::{Results, Subject},
    study::{Claim, Family, Study},
};

/// Level of the tests.
const LEVEL: f64 = 0.05;

/// The families of tests of a study. One whose tested arm was not measured is left out.
///
/// *Errors*: a metric that was not measured; no published numbers for a family without claims.
pub(super) fn tables(study: &Study, results: &Results) -> Result<Vec<Table>> {
    let published = match &study.report.published {
        Some(name) => published(name)?,
        None => Vec::new(),
    };
    let all = study.report.tests.iter().map(|family| table(family, &published, results));
    Ok(all.collect::<Result<Vec<_>>>()?.into_iter().flatten().collect())
}

/// A policy that collides less than `none` at less completion and speed than these brakes its way to safety.
const LESS_COMPLETION: f64 = 0.05;
const LESS_SPEED: f64 = 0.9;

/// Names trained policies that collide less than those trained without attacks because they drive less.
pub(super) fn braking(results: &Results) -> String {
    let value = |arm: &str, name: &str| {
        let (method, metric) = (method(results, arm, "")?, results.metric(Subject::Episode, name)?);
        results.samples(method, metric).mean()
    };
    let values = |arm: &str| Some([value(arm, "contact")?, value(arm, "completion")?, value(arm, "speed")?]);
    let Some([contact, completion, speed]) = values("none") else { return String::new() };
    let mut arms: Vec<&str> = Vec::new();
    for key in results.keys.iter().filter(|key| key.checkpoint.is_some() && key.arm != "none") {
        if !arms.contains(&&*key.arm) {
            arms.push(&key.arm);
        }
    }
    let brakes = |arm: &&&str| {
        values(arm).is_some_and(|[c, done, v]| {
            c < contact && done < completion - LESS_COMPLETION && v < LESS_SPEED * speed
        })
    };
    let said = arms.iter().filter(brakes).map(|arm| {
        format!("`{arm}` brakes its way to safety: fewer contacts than `none` in unchanged scenes, at less completion and speed. ")
    });
    said.collect()
}

/// The method of an arm under an attack.
fn method(results: &Results, arm: &str, attack: &str) -> Option<usize> {
    let methods = results.methods(Subject::Episode).into_iter();
    methods.into_iter().find(|k| results.keys[*k].arm == arm && results.keys[*k].attack == attack)
}

/// A difference that was expected, and what was found.
struct Tested {
    claim: Claim,
    /// The other arm.
    other: String,
    /// Verdict if it is found as expected.
    expected: String,
    difference: Difference,
}

fn table(family: &Family, published: &[Published], results: &Results) -> Result<Option<Table>> {
    let subject = Subject::Episode;
    let tested = &family.tested;
    let mut others: Vec<&str> = Vec::new();
    for k in results.methods(subject) {
        let key = &results.keys[k];
        let is_listed = family.against.is_empty() || family.against.contains(&key.arm);
        // Policies without training are no other runs.
        if key.arm != *tested && key.checkpoint.is_some() && is_listed && !others.contains(&&*key.arm) {
            others.push(&key.arm);
        }
    }
    others.sort_unstable();
    let mut rows: Vec<Tested> = Vec::new();
    for other in &others {
        let claims = match &family.claims {
            Some(claims) => claims.clone(),
            None => orderings(published, tested, other),
        };
        for claim in claims {
            let metric = |name: &str| {
                results
                    .metric(subject, name)
                    .with_context(|| format!("`tests` names `{name}`, which is not measured"))
            };
            let of = metric(&claim.metric)?;
            let methods = method(results, tested, &claim.attack).zip(method(results, other, &claim.attack));
            let Some((subject_of, against)) = methods else { continue };
            let less = |k: usize| {
                let stream = format!("{} {other} {k}", claim.attack);
                results.samples(subject_of, k).less(&results.samples(against, k), &stream)
            };
            let Some(difference) = less(of) else { continue };
            let is_bought = match &family.unless {
                Some(guard) => {
                    less(metric(&guard.metric)?).is_some_and(|d| d.estimate.value < -guard.lower_by)
                }
                None => false,
            };
            let expected = family.unless.as_ref().filter(|_| is_bought).map(|guard| guard.verdict.clone());
            let expected = expected.unwrap_or_else(|| family.verdicts[0].clone());
            rows.push(Tested { claim, other: (*other).to_owned(), expected, difference });
        }
    }
    if rows.is_empty() {
        return Ok(None);
    }
    // By what is claimed, then by arm.
    rows.sort_by(|a, b| (&a.claim.attack, &a.claim.metric).cmp(&(&b.claim.attack, &b.claim.metric)));
    let corrected = holm(&rows.iter().map(|row| row.difference.p).collect::<Vec<_>>());
    let row = |(Tested { claim, other, expected, difference: d }, p): (Tested, f64)| {
        let bound = family.bounded.get(&claim.metric);
        let is_bounded = bound.is_some_and(|bound| d.estimate.low.abs().max(d.estimate.high.abs()) <= *bound);
        let verdict = match (d.estimate.value > 0.0) == claim.larger {
            _ if p >= LEVEL && is_bounded => "bounded",
            _ if p >= LEVEL => "not resolved",
            true => &expected,
            false => &family.verdicts[1],
        };
        let scenes = if claim.attack.is_empty() { "unchanged" } else { &claim.attack };
        vec![
            format!("{} in {scenes} scenes, {tested} less {other}", claim.metric),
            if claim.larger { "above 0" } else { "below 0" }.to_owned(),
            format!("{:.3} [{:.3}, {:.3}]", d.estimate.value, d.estimate.low, d.estimate.high),
            format!("{p:.3}"),
            d.seeds_needed.map_or("-".to_owned(), |n| n.to_string()),
            verdict.to_owned(),
        ]
    };
    let heads =
        ["difference", "expected", "value", "p", "seeds needed", "verdict"].map(str::to_owned).to_vec();
    let bounds: Vec<String> =
        family.bounded.iter().map(|(metric, bound)| format!("{metric} {bound}")).collect();
    let bounded = match bounds.is_empty() {
        true => String::new(),
        false => format!(
            " Bounded: not resolved, but the whole interval is at most so far from 0: {}.",
            bounds.join(", ")
        ),
    };
    let title = format!(
        "{}. Differences are paired by scene, and by seed where both have the same; p is corrected by Holm's method over the {} rows.{bounded} Seeds: per method, for a power of 0.8:",
        family.title,
        rows.len()
    );
    Ok(Some(Table { title, heads, rows: rows.into_iter().zip(corrected).map(row).collect(), names: 1 }))
}
