//! Sweeps of operating points: how evenly rates rise along the aggression dial and along λ = μ, and the shares of λ and
//! of μ in the whole change.

use advsage::operating_point::OperatingPointSpec;
use sage_core::{statistics::rank_correlation, text::table::Table};

use crate::{
    Result,
    context::Context as _,
    curve::{Linearity, shapley_of_lambda},
    rows::{Results, Subject},
};

/// What the tables are of.
const SUBJECT: Subject = Subject::Trajectory;
/// Rates, and the reward.
const RATES: [&str; 2] = ["attack", "believable"];
const REWARD: &str = "R_adv";

/// A sweep from 0 to 1: its name, and the position and the method of each point.
pub(super) struct Sweep {
    pub(super) name: &'static str,
    pub(super) points: Vec<(f64, usize)>,
}

/// Position of an operating point on a sweep.
type Place = fn(&OperatingPointSpec) -> Option<f64>;

/// The sweeps that the results hold: aggression, and λ = μ.
pub(super) fn sweeps(results: &Results) -> Vec<Sweep> {
    let all: [(&'static str, Place); 2] = [
        ("aggression", |point| point.aggression),
        ("lambda = mu", |point| {
            point.lambda.filter(|lambda| point.aggression.is_none() && *lambda == point.mu)
        }),
    ];
    let methods = results.methods(SUBJECT);
    let sweep = |(name, place): (&'static str, Place)| {
        let point = |k: &usize| Some((place(results.keys[*k].point.as_ref()?)?, *k));
        let mut points: Vec<(f64, usize)> = methods.iter().filter_map(point).collect();
        points.sort_by(|a, b| a.0.total_cmp(&b.0));
        // Points of the grid lie between the steps of the sweep.
        let step = points.get(1).map_or(0.0, |point| point.0 - points[0].0);
        let first = points.first().map_or(0.0, |point| point.0);
        let is_on_step =
            |x: f64| step > 0.0 && ((x - first) / step - ((x - first) / step).round()).abs() < 1e-6;
        points.retain(|(x, _)| is_on_step(*x));
        Sweep { name, points }
    };
    all.into_iter().map(sweep).filter(|sweep| sweep.points.len() > 2).collect()
}

fn mean(results: &Results, method: usize, name: &str) -> Result<f64> {
    let metric = results.metric(SUBJECT, name).with_context(|| format!("sweeps need the metric `{name}`"))?;
    Ok(results.samples(method, metric).mean().unwrap_or(f64::NAN))
}

/// The tables.
///
/// *Errors*: attack, believable or R_adv was not measured.
pub(super) fn tables(results: &Results) -> Result<Vec<Table>> {
    let mut tables = Vec::new();
    let sweeps = sweeps(results);
    if !sweeps.is_empty() {
        tables.push(evenness(results, &sweeps)?);
    }
    tables.extend(grid(results)?);
    Ok(tables)
}

fn evenness(results: &Results, sweeps: &[Sweep]) -> Result<Table> {
    let mut rows = Vec::new();
    for sweep in sweeps {
        let at: Vec<f64> = sweep.points.iter().map(|(x, _)| *x).collect();
        let means = |name: &str| {
            sweep.points.iter().map(|(_, k)| mean(results, *k, name)).collect::<Result<Vec<_>>>()
        };
        let reward = means(REWARD)?;
        for rate in RATES {
            let rates = means(rate)?;
            let found = Linearity::of(&at, &rates);
            rows.push(vec![
                sweep.name.to_owned(),
                rate.to_owned(),
                format!("{:.1}", 100.0 * found.rms),
                format!("{:.1}", 100.0 * found.worst),
                format!("{:.0}", found.largest_drop * results.scenes.len() as f64),
                format!("{:.1}", 100.0 * found.span),
                format!("{:.3}", rank_correlation(&at, &rates)),
                format!("{:.3}", rank_correlation(&at, &reward)),
            ]);
        }
    }
    let heads = [
        "sweep",
        "rate",
        "deviation from a straight line, RMS points",
        "largest, points",
        "largest drop, scenes",
        "span, points",
        "rank correlation",
        "with R_adv",
    ];
    let title = "How evenly the rates rise along each sweep:".to_owned();
    Ok(Table { title, heads: heads.map(str::to_owned).to_vec(), rows, names: 2 })
}

/// Rates over λ and μ, and the Shapley share of λ, where every λ was measured at every μ.
fn grid(results: &Results) -> Result<Vec<Table>> {
    let point = |k: usize| {
        let point = results.keys[k].point.as_ref().filter(|point| point.aggression.is_none())?;
        Some((point.lambda?, point.mu))
    };
    let points: Vec<((f64, f64), usize)> =
        results.methods(SUBJECT).into_iter().filter_map(|k| Some((point(k)?, k))).collect();
    let find = |lambda: f64, mu: f64| points.iter().find(|(at, _)| *at == (lambda, mu)).map(|(_, k)| *k);
    let mut values: [Vec<f64>; 2] =
        [points.iter().map(|(at, _)| at.0).collect(), points.iter().map(|(at, _)| at.1).collect()];
    values.iter_mut().for_each(|all| {
        all.sort_by(f64::total_cmp);
        all.dedup();
    });
    let [mut lambdas, mut mus] = values;
    // The grid is what has both ends of the other coordinate.
    let (first, last) = (mus.first().copied(), mus.last().copied());
    lambdas.retain(|lambda| [first, last].into_iter().flatten().all(|mu| find(*lambda, mu).is_some()));
    mus.retain(|mu| lambdas.iter().all(|lambda| find(*lambda, *mu).is_some()));
    if lambdas.len() < 2 || mus.len() < 2 {
        return Ok(Vec::new());
    }
    let mut tables = Vec::new();
    let mut shares = Vec::new();
    for name in [RATES[0], RATES[1], REWARD] {
        let at = |lambda: f64, mu: f64| find(lambda, mu).map_or(Ok(f64::NAN), |k| mean(results, k, name));
        let heads =
            std::iter::once("lambda".to_owned()).chain(mus.iter().map(|mu| format!("mu {mu}"))).collect();
        let mut table = Table {
            title: format!("Mean of {name} over lambda and mu:"),
            heads,
            names: 1,
            ..Table::default()
        };
        for lambda in &lambdas {
            let cells =
                mus.iter().map(|mu| Ok(format!("{:.2}", at(*lambda, *mu)?))).collect::<Result<Vec<_>>>()?;
            table.rows.push([vec![lambda.to_string()], cells].concat());
        }
        tables.push(table);
        let ends = [lambdas[0], lambdas[lambdas.len() - 1]];
        let [low, high] = [mus[0], mus[mus.len() - 1]];
        let corners = [at(ends[0], low)?, at(ends[1], low)?, at(ends[0], high)?, at(ends[1], high)?];
        let share = shapley_of_lambda(corners).map_or("-".to_owned(), |share| format!("{share:.2}"));
        shares.push(vec![name.to_owned(), share]);
    }
    let title =
        "Shapley share of lambda in the whole span; the rest is due to the selection (mu):".to_owned();
    let heads = ["metric", "share of lambda"].map(str::to_owned).to_vec();
    tables.push(Table { title, heads, rows: shares, names: 1 });
    Ok(tables)
}
