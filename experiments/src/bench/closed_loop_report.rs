//! Reports of attacks on drivers as Markdown and CSV.

use std::{collections::HashMap, fmt::Write as _};

use anyhow::Result;
use sage_core::{
    seed::Rng,
    statistics::{self, Estimate},
};
use sage_sim::policy::Privilege;

use super::{closed_loop::Driven, open_loop::SceneRow, open_loop_report::field, pairs};
use crate::{contact_row::ContactRow, operating_point::RowKey, terminal};

/// Resamples of an interval.
const RESAMPLES: usize = 2000;

/// All attacks of one generator at one operating point on one driver.
pub(crate) struct AttackedDriver<'a> {
    pub ego: &'a str,
    pub knows: Privilege,
    pub key: &'a RowKey,
    /// Result in each scene; an error if the generator or the driver failed there.
    pub scenes: Vec<(&'a str, Result<&'a SceneRow, &'a str>)>,
}

impl<'a> AttackedDriver<'a> {
    fn driven(&self) -> impl Iterator<Item = (&'a str, Option<&'a Driven>)> {
        self.scenes.iter().map(|(scene, row)| (*scene, row.ok().and_then(|row| row.driven.as_ref())))
    }

    /// Whether something holds in each scene; false where the scene failed.
    fn holds(&self, share: Share) -> impl Iterator<Item = (&'a str, bool)> {
        self.driven().map(move |(scene, driven)| (scene, driven.is_some_and(share)))
    }
}

type Share = fn(&Driven) -> bool;
type Mean = fn(&Driven) -> Option<f64>;

/// Shares of all scenes. A scene that failed counts as not attacked.
const SHARES: [(&str, Share); 4] = [
    ("attack", |d| d.verdict.attack),
    ("at-fault attack", |d| d.verdict.at_fault),
    ("solid attack", |d| d.verdict.solid),
    ("any vehicle", |d| d.verdict.any_vehicle),
];

/// Means over the scenes that did not fail.
const MEANS: [(&str, Mean); 4] = [
    ("progress", |d| d.completion.map(|c| c.min(1.0))),
    ("R_adv", |d| Some(d.reward)),
    ("R_adv, path cut", |d| Some(d.reward_cut)),
    ("impact m/s", |d| d.verdict.attack.then(|| d.contact.as_ref().map(|c| c.impact_speed)).flatten()),
];

/// The tables of attacks on drivers.
///
/// *Errors*: none that a caller can cause.
pub(crate) fn markdown(all: &[AttackedDriver]) -> Result<String> {
    let mut out = "Attacks on drivers. Each drives the unchanged scene, the attack is planned against that \
        drive, and it drives again, up to its first contact.\n\n"
        .to_owned();
    let heads = SHARES.map(|(name, _)| format!("{name} %")).into_iter().chain(MEANS.map(|m| m.0.to_owned()));
    let heads: Vec<String> = heads.collect();
    writeln!(out, "| ego | knows | generator | N | failed | {} |", heads.join(" | "))?;
    writeln!(out, "| --- | --- | --- | --- | --- |{}", " --- |".repeat(heads.len()))?;
    for row in all {
        let shares = SHARES.map(|(_, share)| {
            let count = row.holds(share).filter(|(_, holds)| *holds).count();
            statistics::wilson(count, row.scenes.len()).map_or("-".to_owned(), |e| {
                format!("{:.1} [{:.1}, {:.1}]", 100.0 * e.value, 100.0 * e.low, 100.0 * e.high)
            })
        });
        let means = MEANS.map(|(name, value)| {
            mean(row, name, value)
                .map_or("-".to_owned(), |e| format!("{:.2} [{:.2}, {:.2}]", e.value, e.low, e.high))
        });
        let failed = row.driven().filter(|(_, driven)| driven.is_none()).count();
        let cells = [shares, means].concat().join(" | ");
        let (ego, knows, label, n) = (row.ego, row.knows, row.key.label(), row.scenes.len());
        writeln!(out, "| {ego} | {knows} | {label} | {n} | {failed} | {cells} |")?;
    }
    out += "\n*Attack*: the ego's first contact is with the adversary after *now*, the plan is feasible, and without the \
        attack there was no contact by then, nor one with the adversary in the next 0.5 s. *At-fault*: nuPlan's rule gives this contact to the ego. *Solid*: the boxes \
        overlap by at least 0.5 m. *Any vehicle*: the published flag, the first contact is with any vehicle. *Progress*: \
        share of the logged route at the end, at most 1. *Impact*: mean over the attacks. Intervals: 95 %, Wilson for shares, \
        bootstrap for means. A scene that failed counts as not attacked.\n";
    between_drivers(&mut out, all)?;
    between_generators(&mut out, all)?;
    Ok(out)
}

/// Differences of the attack rates of each pair of drivers, by generator.
fn between_drivers(out: &mut String, all: &[AttackedDriver]) -> Result<()> {
    let mut is_first = true;
    for (k, first) in all.iter().enumerate() {
        for second in all[k + 1..].iter().filter(|second| second.key == first.key) {
            if std::mem::take(&mut is_first) {
                writeln!(
                    out,
                    "\nDrivers paired by scene, same generator:\n\n| generator | drivers | attack: only the first | only the second | difference |\n| --- | --- | --- | --- | --- |"
                )?;
            }
            let (label, cells) = (first.key.label(), pairs::cell(&pairing(first, second)));
            writeln!(out, "| {label} | {} − {} | {cells} |", first.ego, second.ego)?;
        }
    }
    Ok(())
}

/// Differences of the attack rates of generators from the baselines, by driver.
fn between_generators(out: &mut String, all: &[AttackedDriver]) -> Result<()> {
    for baseline in pairs::BASELINES {
        let mut is_first = true;
        for row in all.iter().filter(|row| row.key.method != baseline) {
            let others = || all.iter().filter(|o| o.ego == row.ego && o.key.method == baseline);
            let same = others().find(|other| other.key.point == row.key.point);
            let mu = |other: &AttackedDriver| other.key.point.as_ref().map_or(0.0, |point| point.mu);
            let Some(other) = same.or_else(|| others().max_by(|a, b| mu(a).total_cmp(&mu(b)))) else {
                continue;
            };
            if std::mem::take(&mut is_first) {
                writeln!(
                    out,
                    "\nPaired by scene with `{baseline}`, same driver:\n\n| ego | generator | against | attack: only this | only the other | difference |\n| --- | --- | --- | --- | --- | --- |"
                )?;
            }
            let [label, against] = [row, other].map(|row| row.key.label());
            writeln!(out, "| {} | {label} | {against} | {} |", row.ego, pairs::cell(&pairing(row, other)))?;
        }
    }
    Ok(())
}

fn pairing(first: &AttackedDriver, second: &AttackedDriver) -> pairs::Pairing {
    let (name, attack) = SHARES[0];
    let other: HashMap<&str, bool> = second.holds(attack).collect();
    let value = |holds: bool| f64::from(u8::from(holds));
    let pairs =
        first.holds(attack).filter_map(|(scene, holds)| Some(value(holds) - value(*other.get(scene)?)));
    pairs::compare(&pairs.collect::<Vec<_>>(), name)
}

fn mean(row: &AttackedDriver, name: &str, value: Mean) -> Option<Estimate> {
    let values: Vec<f64> = row.driven().filter_map(|(_, driven)| value(driven?)).collect();
    statistics::bootstrap_mean(&values, RESAMPLES, &mut Rng::new(0, name, "closed loop"))
}

/// `drivers.csv`: one row per scene, driver and generator.
///
/// *Errors*: none that a caller can cause.
pub(crate) fn csv(all: &[AttackedDriver]) -> Result<String> {
    let mut out = "scene,ego,generator,attack,at_fault_attack,solid_attack,any_vehicle,contact_step,contact_with,overlap,\
        impact_speed,side_hit,at_fault,rule,progress,reward,reward_cut,error\n"
        .to_owned();
    for row in all {
        for (scene, result) in &row.scenes {
            let name = field(&terminal::escaped_name(scene));
            write!(out, "{name},{},{}", field(row.ego), field(&row.key.label()))?;
            match result {
                Ok(SceneRow { driven: Some(driven), .. }) => writeln!(out, "{},", cells(driven))?,
                Ok(_) => writeln!(out, "{}", ",".repeat(15))?,
                Err(error) => writeln!(out, "{}{}", ",".repeat(15), field(error))?,
            }
        }
    }
    Ok(out)
}

fn cells(driven: &Driven) -> String {
    let Driven { verdict: v, contact, completion, reward, reward_cut } = driven;
    let contact = match contact {
        None => ",,,,,,".to_owned(),
        Some(ContactRow { step, with, overlap, impact_speed, side_hit, at_fault, rule, .. }) => format!(
            "{step},{},{overlap},{impact_speed},{},{},{rule}",
            field(&terminal::escaped_name(with)),
            side_hit.name(),
            at_fault.map_or(String::new(), |is| is.to_string())
        ),
    };
    let completion = completion.map_or(String::new(), |c| c.to_string());
    let flags = format!("{},{},{},{}", v.attack, v.at_fault, v.solid, v.any_vehicle);
    format!(",{flags},{contact},{completion},{reward},{reward_cut}")
}
