//! Differences between methods, paired by scene.

use rayon::prelude::*;
use sage_core::text::table::Table;

use super::{name_columns, named};
use crate::{
    Result,
    context::Context as _,
    rows::{Key, Results},
    study::{PairSpec, Study},
};

/// All pairs of arms under the same attack.
const ARMS: &str = "arms";
/// The first arm under the same attack.
const FIRST: &str = "first";
/// The first operating point of the same arm and generator.
const FIRST_POINT: &str = "first-point";
/// What `with` may be besides a generator.
pub(crate) const KINDS: [&str; 3] = [ARMS, FIRST, FIRST_POINT];

/// The comparisons of a study.
///
/// *Errors*: a metric that was not measured.
pub(super) fn tables(study: &Study, results: &Results) -> Result<Vec<Table>> {
    let measured = |spec: &&PairSpec| !results.methods(spec.of).is_empty();
    let all = study.report.pairs.iter().filter(measured).map(|spec| table(spec, results));
    Ok(all.collect::<Result<Vec<_>>>()?.into_iter().flatten().collect())
}

/// Pairs of methods: the first less the second.
fn pairs(spec: &PairSpec, results: &Results) -> Vec<[usize; 2]> {
    let methods = results.methods(spec.of);
    let key = |k: usize| &results.keys[k];
    let has_same_attack = |a: usize, b: usize| key(a).attack == key(b).attack && key(a).point == key(b).point;
    let all = methods.iter().enumerate().flat_map(|(k, a)| methods[k + 1..].iter().map(move |b| [*a, *b]));
    match &*spec.with {
        ARMS => all.filter(|[a, b]| key(*a).arm != key(*b).arm && has_same_attack(*a, *b)).collect(),
        FIRST => {
            let first = methods.first().map_or("", |k| &*key(*k).arm);
            all.filter(|[a, b]| key(*a).arm == first && key(*b).arm != first && has_same_attack(*a, *b))
                .map(|[a, b]| [b, a])
                .collect()
        }
        FIRST_POINT => {
            let is_same = |a: usize, b: usize| (&key(a).arm, &key(a).attack) == (&key(b).arm, &key(b).attack);
            let is_first = |a: &usize| methods.iter().find(|k| is_same(**k, *a)) == Some(a);
            all.filter(|[a, b]| is_first(a) && is_same(*a, *b)).map(|[a, b]| [b, a]).collect()
        }
        baseline => {
            let others = methods.iter().filter(|k| key(**k).attack != baseline);
            // Variants of the baseline are compared with itself.
            let itself = |k: usize| {
                let is_there = |b: &&usize| {
                    let has_same_point = (&key(k).arm, &key(k).point) == (&key(**b).arm, &key(**b).point);
                    key(**b).attack == baseline && has_same_point
                };
                methods.iter().find(is_there).copied()
            };
            let base = |k: usize| match generator(key(k)) == baseline {
                true => itself(k),
                false => base_of(k, baseline, &methods, results),
            };
            others.filter_map(|k| Some([*k, base(*k)?])).collect()
        }
    }
}

/// Name of the generator without its options.
fn generator(key: &Key) -> &str {
    key.attack.split('{').next().unwrap_or_default()
}

/// The method of a baseline that another one is compared with: it has the same operating point and options, or the same
/// operating point, or the largest μ.
fn base_of(of: usize, baseline: &str, methods: &[usize], results: &Results) -> Option<usize> {
    let key = |k: usize| &results.keys[k];
    let options = |k: usize| key(k).attack.split_once('{').map(|(_, options)| options);
    let is_base = |k: &&usize| generator(key(**k)) == baseline && key(**k).arm == key(of).arm;
    let bases: Vec<usize> = methods.iter().filter(is_base).copied().collect();
    let same = || bases.iter().filter(|k| key(**k).point == key(of).point);
    let mu = |k: usize| key(k).point.as_ref().map_or(0.0, |point| point.mu);
    let largest = bases.iter().max_by(|a, b| mu(**a).total_cmp(&mu(**b)));
    same().find(|k| options(**k) == options(of)).or_else(|| same().next()).or(largest).copied()
}

fn table(spec: &PairSpec, results: &Results) -> Result<Option<Table>> {
    let metric = |name: &String| {
        let known = || format!("`pairs` names `{name}`, which is no metric of `{}` in this study", spec.of);
        results.metric(spec.of, name).with_context(known)
    };
    let metrics = spec.metrics.iter().map(metric).collect::<Result<Vec<_>>>()?;
    let pairs = pairs(spec, results);
    if pairs.is_empty() {
        return Ok(None);
    }
    let all: Vec<usize> = pairs.iter().flatten().copied().collect();
    let has = name_columns(results, &all);
    let label = |k: usize| named(results, k, has).join(", ");
    let mut heads = ["A", "B", "N"].map(str::to_owned).to_vec();
    for name in &spec.metrics {
        heads.extend([format!("{name}: larger in A"), "in B".to_string(), format!("{name}: A − B")]);
    }
    let row = |[a, b]: &[usize; 2]| {
        let mut row = vec![label(*a), label(*b), String::new()];
        let mut most = 0;
        for (k, name) in metrics.iter().zip(&spec.metrics) {
            let stream = format!("{} {} {name}", results.keys[*a].stream(), results.keys[*b].stream());
            let found = results.samples(*a, *k).less(&results.samples(*b, *k), &stream);
            let scale = if results.metrics_of(spec.of)[*k].head().ends_with('%') { 100.0 } else { 1.0 };
            let Some(found) = found else {
                row.extend(["-", "-", "-"].map(str::to_owned));
                continue;
            };
            let larger =
                found.larger.map_or(["-".to_owned(), "-".to_owned()], |larger| larger.map(|n| n.to_string()));
            row.extend(larger);
            let e = found.estimate;
            most = most.max(e.n);
            let digits = if scale == 1.0 { 3 } else { 1 };
            let text = |x: f64, plus: bool| {
                if plus { format!("{:+.digits$}", scale * x) } else { format!("{:.digits$}", scale * x) }
            };
            row.push(format!("{} [{}, {}]", text(e.value, true), text(e.low, false), text(e.high, false)));
        }
        row[2] = most.to_string();
        row
    };
    let title = match &*spec.with {
        ARMS => "Pairs of arms".to_owned(),
        FIRST => "Arms A less the first arm B".to_owned(),
        FIRST_POINT => "Points A less the first point B".to_owned(),
        baseline => format!("Generators A less `{baseline}` B"),
    };
    let title =
        format!("{title}, {}, paired by scene; scenes in which A or B is larger; shares in points:", spec.of);
    Ok(Some(Table { title, heads, rows: pairs.par_iter().map(row).collect(), names: 2 }))
}
