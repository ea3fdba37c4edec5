//! The tables of a rate: events by drivers, and differences between drivers.

use advsage::{
    rate::{Coverage, LEVELS},
    rows::rate::RateRow,
};
use sage_bench::estimate::{Difference, Samples};
use sage_core::{
    metric::Aggregate,
    statistics::{Estimate, wilson},
    text::table::Table,
};
use sage_sim::rate::{Event, Given};

/// Rates above which scenes are counted.
const ABOVE: [f64; 2] = [0.01, 0.1];

/// A table of the rates for each condition, one of how they spread over the scenes, and one of the paired differences if there are
/// several drivers. `rows` are those of each scene, driver by driver.
pub(super) fn tables(
    given: Given,
    labels: &[&str],
    events: &[Event],
    rows: &[Vec<Option<RateRow>>],
) -> Vec<Table> {
    let mut all: Vec<Table> =
        [given, given.other()].map(|given| of_given(given, labels, events, rows)).into();
    all.push(spread(given, labels, rows));
    if labels.len() > 1 {
        all.push(differences(given, labels, rows));
    }
    all.retain(|table| !table.rows.is_empty());
    all
}

/// How often recorded ends lie in the sets of the density that have a share of its probability; none if that is not known.
pub(super) fn reliability(coverage: &[Coverage]) -> Option<Table> {
    let sets = LEVELS.map(|level| format!("{:.0} % set", 100.0 * level));
    let mut heads = vec!["tracks"];
    heads.extend(sets.iter().map(|set| &**set));
    let title = "Is the density calibrated? Recorded ends in its sets, %:";
    let mut table = Table { names: 1, ..Table::new(title, &heads) };
    for of in coverage {
        let share = |[_, value, low, high]: &[f64; 4]| {
            format!("{:.0} [{:.0}, {:.0}]", 100.0 * value, 100.0 * low, 100.0 * high)
        };
        let fitted = if of.fitted { ", fitted" } else { "" };
        let name = format!("{} of {}{fitted}", of.role, of.scenes);
        table.row(name, of.sets.iter().map(share));
    }
    Some(table).filter(|table| !table.rows.is_empty())
}

/// The rates of a driver by scene.
fn samples(rows: &[Vec<Option<RateRow>>], ego: usize, of: impl Fn(&RateRow) -> Option<f64>) -> Samples {
    Samples::of(rows.iter().map(|scene| scene[ego].as_ref().and_then(&of)))
}

fn of_given(given: Given, labels: &[&str], events: &[Event], rows: &[Vec<Option<RateRow>>]) -> Table {
    let heads: Vec<String> = std::iter::once("driver".to_owned())
        .chain(events.iter().map(|event| format!("{} %", event.name())))
        .collect();
    let heads: Vec<&str> = heads.iter().map(|head| &**head).collect();
    let mut table = Table { names: 1, ..Table::new(format!("Given {}:", given.name()), &heads) };
    for (ego, label) in labels.iter().enumerate() {
        let rate = |event: &Event| {
            let values = samples(rows, ego, |row| Some(row.rate(given, event.name())?.rate));
            let name = format!("{label} {} {}", given.name(), event.name());
            percent(values.estimate(Aggregate::Mean, &name))
        };
        table.row(*label, events.iter().map(rate));
    }
    table
}

/// In how many scenes the drivers fail how often, and what no rate says.
fn spread(given: Given, labels: &[&str], rows: &[Vec<Option<RateRow>>]) -> Table {
    let [low, high] = ABOVE.map(|least| format!("above {} %", 100.0 * least));
    let title = format!("Scenes, given {}, by the rate of failure:", given.name());
    let heads = ["driver", "scenes", &low, &high, "not driven %", "contact without attack"];
    let mut table = Table { names: 1, ..Table::new(title, &heads) };
    for (ego, label) in labels.iter().enumerate() {
        let of_ego = || rows.iter().filter_map(|scene| scene[ego].as_ref());
        let rates: Vec<f64> =
            of_ego().filter_map(|row| row.rate(given, "failure")).map(|rate| rate.rate).collect();
        let above = ABOVE.map(|least| {
            let count = rates.iter().filter(|rate| **rate > least).count();
            let share = |e: Estimate| format!("{count} ({:.1} %)", 100.0 * e.value);
            wilson(count, rates.len()).map_or("-".to_owned(), share)
        });
        let undriven = samples(rows, ego, |row| row.undriven.get(&given).copied()).mean();
        let without = of_ego().filter(|row| row.unattacked_contact.is_some()).count();
        let [low, high] = above;
        let undriven = undriven.map_or("-".to_owned(), |share| format!("{:.1}", 100.0 * share));
        table.row(*label, [rates.len().to_string(), low, high, undriven, without.to_string()]);
    }
    table
}

/// Differences of failure rates, paired by scene, and in how many scenes each driver is worse.
fn differences(given: Given, labels: &[&str], rows: &[Vec<Option<RateRow>>]) -> Table {
    let title = format!("Failure given {}, A less B, paired by scene:", given.name());
    let mut table = Table::new(title, &["A", "B", "points", "scenes", "A is worse in", "B is worse in"]);
    table.names = 2;
    let of = |ego: usize| samples(rows, ego, |row| Some(row.rate(given, "failure")?.rate));
    for (k, a) in labels.iter().enumerate() {
        for (j, b) in labels.iter().enumerate().skip(k + 1) {
            let Some(Difference { estimate, larger, .. }) = of(k).less(&of(j), &format!("{a} {b}")) else {
                continue;
            };
            let [more, less] = larger.unwrap_or_default();
            let points = points(&estimate);
            table.row(
                *a,
                [(*b).to_owned(), points, estimate.n.to_string(), more.to_string(), less.to_string()],
            );
        }
    }
    table
}

fn percent(estimate: Option<Estimate>) -> String {
    estimate.map_or("-".to_owned(), |e| match e.n {
        // One scene says nothing about others.
        1 => format!("{:.2}", 100.0 * e.value),
        _ => format!("{:.2} [{:.2}, {:.2}]", 100.0 * e.value, 100.0 * e.low, 100.0 * e.high),
    })
}

fn points(e: &Estimate) -> String {
    format!("{:+.2} [{:.2}, {:.2}]", 100.0 * e.value, 100.0 * e.low, 100.0 * e.high)
}
