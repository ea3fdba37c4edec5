//! Reports of tested drivers as Markdown and CSV.

use std::{collections::HashMap, fmt::Write as _};

use anyhow::Result;
use sage_core::{
    seed::Rng,
    statistics::{self, Estimate},
};
use sage_sim::policy::Privilege;

use super::{
    open_loop_report::field,
    tested_drivers::{Attacked, TestedDriver},
};
use crate::{operating_point::RowKey, terminal};

/// Resamples of an interval.
const RESAMPLES: usize = 2000;

/// A driver with its results in all scenes.
pub(crate) struct DriverRows {
    pub(crate) name: String,
    /// Name of its random streams.
    pub(crate) stream: String,
    pub(crate) knows: Privilege,
    pub(crate) scenes: Vec<TestedDriver>,
}

/// Runs over red, of the drives with a light ahead.
const OVER_RED: &str = "over red";

type OfDrive = fn(&TestedDriver) -> Option<bool>;
type OfAttack = fn(&Attacked) -> Option<bool>;

/// Shares of drives in the unchanged scenes.
const UNATTACKED: [(&str, OfDrive); 5] = [
    ("contact", |d| Some(!d.unattacked.contacts.is_empty())),
    ("at-fault contact", |d| Some(d.unattacked.is_at_fault())),
    ("off the road", |d| d.unattacked.is_off_road()),
    ("comfortable", |d| d.unattacked.is_comfortable),
    (OVER_RED, |d| d.unattacked.over_red.as_ref().map(|steps| !steps.is_empty())),
];

/// Shares of attacks.
const ATTACKED: [(&str, OfAttack); 4] = [
    ("attack", |a| Some(a.driven.verdict.attack)),
    ("at-fault attack", |a| Some(a.driven.verdict.at_fault)),
    // No attack, or whether it is avoidable where the search can say it.
    ("avoidable attack", |a| a.avoidable.as_ref().map_or(Some(false), |found| found.avoidable)),
    (OVER_RED, |a| a.over_red.as_ref().map(|steps| !steps.is_empty())),
];

/// All tables: unchanged scenes, attacks, and paired differences.
///
/// *Errors*: none that a caller can cause.
pub(crate) fn markdown(drivers: &[DriverRows], keys: &[RowKey], seed: u64) -> Result<String> {
    let mut out = String::new();
    unattacked(&mut out, drivers)?;
    if !keys.is_empty() {
        attacked(&mut out, drivers, keys)?;
    }
    pairs(&mut out, drivers, keys, seed)?;
    Ok(out)
}

fn unattacked(out: &mut String, drivers: &[DriverRows]) -> Result<()> {
    *out += "Drivers in unchanged scenes, all logged agents replayed.\n\n";
    let heads = UNATTACKED.map(|(name, _)| format!("{name} %"));
    writeln!(out, "| driver | knows | N | {} | median completion |", heads.join(" | "))?;
    writeln!(out, "| --- | --- | --- |{} --- |", " --- |".repeat(heads.len()))?;
    for DriverRows { name, knows, scenes, .. } in drivers {
        let shares = UNATTACKED.map(|(name, holds)| cell(name, scenes.iter().filter_map(holds)));
        let completions: Vec<f64> = scenes.iter().filter_map(|row| row.unattacked.completion).collect();
        let completion = statistics::median(&completions).map_or("-".to_owned(), |c| format!("{c:.2}"));
        writeln!(out, "| {name} | {knows} | {} | {} | {completion} |", scenes.len(), shares.join(" | "))?;
    }
    *out += "\nIntervals: 95 %, Wilson. An *at-fault contact* is one that nuPlan's rule gives to the ego; \
        only the first contact of a drive counts, and one on a map without lanes that its rule 5 would decide does not. *Off the road*: a road edge is touched, or a sidewalk entered, before any contact; one that is touched at the start counts once it was left. Scenes without road edges are left out. \
        *Comfortable*: up to its first contact the drive keeps nuPlan's bounds of acceleration, jerk and turning; `replay` shows how many recordings do. \
        *Over red*: of the drives with a traffic light ahead on the route, their number in the last brackets, those in which the front bumper crosses its stop point at more than 0.5 m/s while it is red, before any contact; flashing lights are not red. \
        *Completion* is progress along the logged route by that of the log, which may be below or above 1.\n";
    Ok(())
}

fn attacked(out: &mut String, drivers: &[DriverRows], keys: &[RowKey]) -> Result<()> {
    *out += "\nAttacks. Each is planned against the drive in the unchanged scene, and the driver drives again, up to its first contact.\n\n";
    let heads = ATTACKED.map(|(name, _)| format!("{name} %"));
    writeln!(
        out,
        "| generator | driver | N | {} | avoidable, share of attacks % | time to react, s | progress |",
        heads.join(" | ")
    )?;
    writeln!(out, "| --- | --- | --- |{} --- | --- | --- |", " --- |".repeat(heads.len()))?;
    for (k, key) in keys.iter().enumerate() {
        for DriverRows { name, stream, scenes, .. } in drivers {
            let all: Vec<&Attacked> = scenes.iter().filter_map(|scene| scene.attacks.get(k)).collect();
            let shares = ATTACKED.map(|(name, holds)| cell(name, all.iter().filter_map(|one| holds(one))));
            let searched = all.iter().filter_map(|one| one.avoidable.as_ref());
            let of_attacks = share(searched.clone().filter_map(|found| found.avoidable));
            let times: Vec<f64> = searched.filter_map(|found| found.time_to_react).collect();
            let completions: Vec<f64> =
                all.iter().filter_map(|one| one.driven.completion.map(|c| c.min(1.0))).collect();
            let label = key.label();
            let mean = |values: &[f64], what: &str| {
                let mut rng = Rng::new(0, &format!("{label} {stream}"), what);
                statistics::bootstrap_mean(values, RESAMPLES, &mut rng)
                    .map_or("-".to_owned(), |e| format!("{:.2} [{:.2}, {:.2}]", e.value, e.low, e.high))
            };
            writeln!(
                out,
                "| {label} | {name} | {} | {} | {of_attacks} | {} | {} |",
                all.len(),
                shares.join(" | "),
                mean(&times, "time to react"),
                mean(&completions, "progress"),
            )?;
        }
    }
    *out += "\n*Attack*: the ego's first contact is with the adversary after *now*, the plan is feasible, and without the \
        attack there was no contact by then, nor one with the adversary in the next 0.5 s. *At-fault*: nuPlan's rule gives \
        this contact to the ego. *Avoidable*: a search over braking and steering found a way on, from the driver's own path up to then, on which at most a replayed \
        follower touches it from behind; *time to react*: how long before the contact the last one starts, mean over the attacks with one. *Over red*: as in the unchanged scenes, in the attacked drive. *Progress*: share of the logged route at the \
        end, at most 1, mean. Intervals: 95 %, Wilson for shares, bootstrap for means.\n";
    Ok(())
}

/// A share as a cell of a column. Few drives have a light ahead, so that column says how many.
fn cell(column: &str, holds: impl Iterator<Item = bool> + Clone) -> String {
    let text = share(holds.clone());
    if column == OVER_RED { format!("{text} ({})", holds.count()) } else { text }
}

/// A share in percent with its interval.
fn share(holds: impl Iterator<Item = bool>) -> String {
    let (mut count, mut all) = (0, 0);
    holds.for_each(|holds| (count, all) = (count + usize::from(holds), all + 1));
    statistics::wilson(count, all).map_or("-".to_owned(), |e| {
        format!("{:.1} [{:.1}, {:.1}]", 100.0 * e.value, 100.0 * e.low, 100.0 * e.high)
    })
}

/// Differences of all pairs of drivers, over the common scenes.
fn pairs(out: &mut String, drivers: &[DriverRows], keys: &[RowKey], seed: u64) -> Result<()> {
    if drivers.len() < 2 {
        return Ok(());
    }
    let without = UNATTACKED.map(|(name, holds)| {
        let value: Holds = Box::new(holds);
        (name, value)
    });
    table(out, "without attack", drivers, &without, seed)?;
    for (k, key) in keys.iter().enumerate() {
        let under = ATTACKED.map(|(name, holds)| {
            let value: Holds = Box::new(move |driver| driver.attacks.get(k).and_then(holds));
            (name, value)
        });
        table(out, &key.label(), drivers, &under, seed)?;
    }
    *out += "\nIntervals: 95 %, bootstrap over scenes.\n";
    Ok(())
}

/// Whether something holds for a driver in a scene; `None` if it was not measured.
type Holds = Box<dyn Fn(&TestedDriver) -> Option<bool>>;
type Property = (&'static str, Holds);

fn table(
    out: &mut String,
    title: &str,
    drivers: &[DriverRows],
    properties: &[Property],
    seed: u64,
) -> Result<()> {
    let heads: Vec<String> = properties.iter().map(|(name, _)| format!("{name}, points")).collect();
    writeln!(
        out,
        "\nPaired by scene, {title}, first driver minus second:\n\n| drivers | {} |",
        heads.join(" | ")
    )?;
    writeln!(out, "| --- |{}", " --- |".repeat(heads.len()))?;
    for (k, first) in drivers.iter().enumerate() {
        for second in &drivers[k + 1..] {
            let cell = |(name, holds): &Property| {
                let theirs: HashMap<&str, bool> =
                    second.scenes.iter().filter_map(|row| Some((&*row.scene, holds(row)?))).collect();
                let value = |holds: bool| f64::from(u8::from(holds));
                let differences: Vec<f64> = (first.scenes.iter())
                    .filter_map(|row| Some(100.0 * (value(holds(row)?) - value(*theirs.get(&*row.scene)?))))
                    .collect();
                let mut rng = Rng::new(seed, &format!("{} {}", first.stream, second.stream), name);
                statistics::bootstrap_mean(&differences, RESAMPLES, &mut rng)
                    .as_ref()
                    .map_or("-".to_owned(), points)
            };
            let cells: Vec<String> = properties.iter().map(cell).collect();
            writeln!(out, "| {} − {} | {} |", first.name, second.name, cells.join(" | "))?;
        }
    }
    Ok(())
}

fn points(e: &Estimate) -> String {
    format!("{:+.1} [{:+.1}, {:+.1}]", e.value, e.low, e.high)
}

/// `scenes.csv`: one row per driver and scene, without attack.
///
/// *Errors*: none that a caller can cause.
pub(crate) fn unattacked_csv(drivers: &[DriverRows]) -> Result<String> {
    let mut out =
        "policy,scene,steps,contacts,at_fault,off_road_step,completion,comfortable,off_road,over_red,over_red_step\n"
            .to_owned();
    for driver in drivers {
        for row in &driver.scenes {
            let drive = &row.unattacked;
            let contacts = drive.contacts.iter().map(|(step, track, class)| {
                let class = serde_json::to_value(class).unwrap_or_default();
                format!("{step}:{track}:{}", class.as_str().unwrap_or("?"))
            });
            writeln!(
                out,
                "{},{},{},{},{},{},{},{},{},{},{}",
                field(&driver.name),
                field(&terminal::escaped_name(&row.scene)),
                drive.steps,
                field(&contacts.collect::<Vec<_>>().join(" ")),
                drive.is_at_fault(),
                text(drive.off_road.step()),
                text(drive.completion),
                text(drive.is_comfortable),
                text(drive.is_off_road()),
                text(drive.over_red.as_ref().map(Vec::len)),
                text(drive.over_red.as_ref().and_then(|steps| steps.first())),
            )?;
        }
    }
    Ok(out)
}

/// `attacks.csv`: one row per driver, generator and scene.
///
/// *Errors*: none that a caller can cause.
pub(crate) fn attacks_csv(drivers: &[DriverRows], keys: &[RowKey]) -> Result<String> {
    let mut out =
        "policy,generator,scene,attack,at_fault_attack,contact_step,at_fault,impact_speed,avoidable,\
        avoidable_reason,avoidable_unhit,hit_from_behind,hit_by_reactive_follower,time_to_react,time_to_brake,time_to_steer,progress,over_red,over_red_step\n"
            .to_owned();
    for driver in drivers {
        for (k, key) in keys.iter().enumerate() {
            for (row, one) in driver.scenes.iter().filter_map(|row| Some((row, row.attacks.get(k)?))) {
                let (verdict, contact) = (&one.driven.verdict, one.driven.contact.as_ref());
                let found = one.avoidable.as_ref();
                writeln!(
                    out,
                    "{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{},{}",
                    field(&driver.name),
                    field(&key.label()),
                    field(&terminal::escaped_name(&row.scene)),
                    verdict.attack,
                    verdict.at_fault,
                    text(contact.map(|contact| contact.step)),
                    text(contact.and_then(|contact| contact.at_fault)),
                    text(contact.map(|contact| contact.impact_speed)),
                    text(found.and_then(|found| found.avoidable)),
                    field(found.and_then(|found| found.avoidable_reason.as_deref()).unwrap_or_default()),
                    text(found.and_then(|found| found.avoidable_unhit)),
                    text(found.and_then(|found| found.hit_from_behind)),
                    text(found.and_then(|found| found.hit_by_reactive_follower)),
                    text(found.and_then(|found| found.time_to_react)),
                    text(found.and_then(|found| found.time_to_brake)),
                    text(found.and_then(|found| found.time_to_steer)),
                    text(one.driven.completion),
                    text(one.over_red.as_ref().map(Vec::len)),
                    text(one.over_red.as_ref().and_then(|steps| steps.first())),
                )?;
            }
        }
    }
    Ok(out)
}

fn text<T: ToString>(value: Option<T>) -> String {
    value.map_or(String::new(), |value| value.to_string())
}
