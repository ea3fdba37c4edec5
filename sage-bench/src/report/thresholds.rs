//! What thresholds say of drivers: the point at which half of the scenes fail, and whether the area orders drivers as their
//! faults do.

use sage_core::{
    statistics::{Estimate, kendall_tau},
    text::table::Table,
};

use crate::{
    estimate::of_scenes,
    rows::{Results, Subject},
};

/// Names of the metrics of the curve, without their numbers.
const UP_TO: &str = "threshold up to";
/// What the area is compared with.
const FAULTS: [&str; 2] = ["at-fault attack", "at-fault contact"];
/// Seeds the bootstrap.
const STREAM: &str = "thresholds";
/// Fewest drivers whose order is compared.
const FEWEST: usize = 4;

/// The tables; none without thresholds.
pub(super) fn tables(results: &Results) -> Vec<Table> {
    let methods = results.methods(Subject::Threshold);
    if methods.is_empty() {
        return Vec::new();
    }
    half(results, &methods).into_iter().chain(order(results, &methods)).collect()
}

/// λ at which the share of scenes with a threshold reaches one half.
fn half(results: &Results, methods: &[usize]) -> Option<Table> {
    let number = |name: &str| name.strip_prefix(UP_TO)?.trim().parse::<f64>().ok();
    let metrics = results.metrics_of(Subject::Threshold).iter().enumerate();
    let mut steps: Vec<(f64, usize)> = metrics.filter_map(|(k, m)| Some((number(&m.name)?, k))).collect();
    steps.sort_by(|a, b| a.0.total_cmp(&b.0));
    if steps.is_empty() {
        return None;
    }
    let row = |method: &usize| {
        let share = |k: usize| results.samples(*method, k).mean().unwrap_or(0.0);
        let reached = steps.iter().find(|(_, k)| share(*k) >= 0.5);
        let last = steps.last().map_or(0.0, |(_, k)| share(*k));
        vec![
            results.keys[*method].arm.clone(),
            reached.map_or("not reached".to_owned(), |(lambda, _)| lambda.to_string()),
            format!("{:.1}", 100.0 * last),
        ]
    };
    Some(Table {
        title: "Smallest lambda at which at least half of the scenes have a threshold:".to_owned(),
        heads: ["driver", "50 % point", "share at lambda 1, %"].map(str::to_owned).to_vec(),
        rows: methods.iter().map(row).collect(),
        names: 1,
    })
}

/// Kendall's τ over drivers between the area and the rates of fault.
fn order(results: &Results, methods: &[usize]) -> Option<Table> {
    if methods.len() < FEWEST {
        return None;
    }
    let values = |name: &str| -> Option<Vec<Vec<Option<f64>>>> {
        let metric = results.metric(Subject::Threshold, name)?;
        let of = |method: &usize| {
            let samples = results.samples(*method, metric);
            samples.seeds.first().map(|seed| {
                seed.iter().map(|[sum, weight]| (*weight > 0.0).then(|| sum / weight)).collect::<Vec<_>>()
            })
        };
        methods.iter().map(of).collect()
    };
    let areas = values("area")?;
    let tau = |name: &str| -> Option<Estimate> {
        let faults = values(name)?;
        let is_measured =
            |k: &usize| areas.iter().chain(&faults).all(|scenes| scenes.get(*k).is_some_and(Option::is_some));
        let scenes: Vec<usize> = (0..results.scenes.len()).filter(is_measured).collect();
        let mean = |of: &[Option<f64>], drawn: &[usize]| {
            drawn.iter().filter_map(|k| of[scenes[*k]]).sum::<f64>() / drawn.len().max(1) as f64
        };
        of_scenes(scenes.len(), STREAM, |drawn| {
            let [a, b] =
                [&areas, &faults].map(|all| all.iter().map(|of| mean(of, drawn)).collect::<Vec<_>>());
            kendall_tau(&a, &b)
        })
    };
    let row = |name: &&str| {
        let tau = tau(name)?;
        Some(vec![(*name).to_owned(), format!("{:.2} [{:.2}, {:.2}]", tau.value, tau.low, tau.high)])
    };
    let rows: Vec<Vec<String>> = FAULTS.iter().filter_map(row).collect();
    (!rows.is_empty()).then(|| Table {
        title: format!("Kendall's tau over {} drivers between the area and:", methods.len()),
        heads: ["rate", "tau"].map(str::to_owned).to_vec(),
        rows,
        names: 1,
    })
}
