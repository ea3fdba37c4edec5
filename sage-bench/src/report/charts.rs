//! The charts of a study: means of two metrics over the operating points, triangles of mixtures, or planes.

use advsage::operating_point::OperatingPointSpec;

use super::{curves::lines, sweeps::sweeps};
use crate::{
    Error, Result,
    chart::{
        heat_map::{self, Grid},
        line::{Chart, Legend, Line},
        triangle::{self, Triangle, mixtures},
    },
    context::{Context as _, require},
    published::{Published, published},
    rows::{Results, Subject},
    study::{ChartSpec, PlaneAxis, Study},
};

/// Axes that are no metrics.
const LAMBDA: &str = "lambda";
const AGGRESSION: &str = "aggression";
const TRIANGLE: &str = "triangle";
const OPERATING_POINT: &str = "operating-point";
const PLANE: &str = "plane";
const SERIES: &str = "series";
/// Ratio of the ends of a series from which its axis is logarithmic.
const LOG_FROM: f64 = 16.0;

/// All charts as file names and contents.
///
/// *Errors*: a chart names a metric that was not measured.
pub(super) fn draw(study: &Study, results: &Results) -> Result<Vec<(String, String)>> {
    let measured = |chart: &&ChartSpec| !results.methods(chart.of).is_empty();
    let one = |chart: &ChartSpec| -> Result<(String, String)> {
        let svg = match &*chart.x {
            TRIANGLE => triangles(study, results, chart),
            OPERATING_POINT => sweeps_of(results, chart),
            PLANE => plane(study, results, chart),
            SERIES => series(results, chart),
            _ => lines_of(study, results, chart),
        };
        Ok((chart.file.clone(), svg.with_context(|| format!("chart `{}`", chart.file))?))
    };
    study.report.charts.iter().filter(measured).map(one).collect()
}

/// Mean of a metric of a method, as the axis shows it; `None` if it was not measured.
fn mean(results: &Results, chart: &ChartSpec, method: usize, name: &str) -> Result<Option<f64>> {
    let point = results.keys[method].point.as_ref();
    match name {
        LAMBDA => return Ok(point.and_then(|point| point.lambda)),
        AGGRESSION => return Ok(point.and_then(|point| point.aggression)),
        _ => {}
    }
    let k = results.metric(chart.of, name);
    let k = k.with_context(|| format!("`{name}` is no metric of `{}` in this study", chart.of))?;
    let metric = &results.metrics_of(chart.of)[k];
    let samples = results.samples(method, k);
    let scale = if is_share(chart, &metric.head(), name) { 100.0 } else { 1.0 };
    Ok(samples.mean().map(|mean| scale * mean))
}

/// Whether an axis is in percent: shares, and probabilities of policies.
fn is_share(chart: &ChartSpec, head: &str, name: &str) -> bool {
    head.ends_with('%')
        || (chart.of == Subject::Policy && ["attack", "believable", "feasible"].contains(&name))
}

fn axis(results: &Results, chart: &ChartSpec, name: &str) -> String {
    let metric = results.metric(chart.of, name).map(|k| &results.metrics_of(chart.of)[k]);
    let Some(metric) = metric else { return name.to_owned() };
    let head = metric.head();
    let head = if is_share(chart, &head, name) && !head.ends_with('%') { format!("{head} %") } else { head };
    match &*metric.better {
        "less" => format!("{head} (smaller is better)"),
        _ => head,
    }
}

fn lines_of(study: &Study, results: &Results, chart: &ChartSpec) -> Result<String> {
    let (mut drawn, mut dots, mut marks, mut texts): (Vec<Line>, Vec<Line>, Vec<_>, Vec<_>) =
        Default::default();
    for line in lines(results, chart.of) {
        let (mut points, mut labels) = (Vec::new(), Vec::new());
        for method in &line.methods {
            let [x, y] = [mean(results, chart, *method, &chart.x)?, mean(results, chart, *method, &chart.y)?];
            points.extend(x.zip(y).map(|(x, y)| [x, y]));
            let point = results.keys[*method].point.as_ref();
            labels.extend(x.and(y).map(|_| point.map(OperatingPointSpec::long_label).unwrap_or_default()));
        }
        // Mixtures of named experts have no order that a line could follow.
        let is_mixture =
            |method: &usize| results.keys[*method].point.as_ref().is_some_and(|p| !p.mix.is_empty());
        if points.len() > 1 && line.methods.iter().any(is_mixture) {
            dots.push((line.name, points));
            continue;
        }
        // Where the operating point is no axis, the ends of a line say theirs.
        if points.len() > 1 && ![LAMBDA, AGGRESSION].contains(&&*chart.x) {
            let ends = [0, points.len() - 1];
            texts.extend(ends.map(|k| (labels[k].clone(), points[k])));
        }
        // A method with one point is a mark.
        match &points[..] {
            [] => {}
            [point] => marks.push((line.name, *point)),
            _ => drawn.push((line.name, points)),
        }
    }
    marks.extend(published_points(study, results, chart)?);
    let axes = [axis(results, chart, &chart.x), axis(results, chart, &chart.y)];
    Chart { axes: [&axes[0], &axes[1]], lines: drawn, dots, marks, texts, ..Chart::default() }.draw()
}

/// The paper's points of the methods that are drawn, where it has both metrics. It has none without selection.
fn published_points(study: &Study, results: &Results, chart: &ChartSpec) -> Result<Vec<(String, [f64; 2])>> {
    let Some(name) = study.report.published.as_ref().filter(|_| chart.of == Subject::Trajectory) else {
        return Ok(Vec::new());
    };
    let is_drawn = |attack: &str| results.keys.iter().any(|key| key.attack_label() == attack);
    let value = |row: &Published, name: &str| {
        let metric = results.metric(chart.of, name).map(|k| results.metrics_of(chart.of)[k].head());
        let scale = if is_share(chart, &metric?, name) { 100.0 } else { 1.0 };
        Some(scale * row.values.get(name)?.first()?)
    };
    let point = |row: Published| {
        let at = [value(&row, &chart.x)?, value(&row, &chart.y)?];
        let drawn = row.attack.iter().find(|attack| is_drawn(attack))?;
        Some((format!("paper: {drawn}"), at))
    };
    Ok(published(name)?.into_iter().filter_map(point).collect())
}

/// Rates over the operating point, and a straight line between the ends of the first sweep.
fn sweeps_of(results: &Results, chart: &ChartSpec) -> Result<String> {
    let mut lines: Vec<Line> = Vec::new();
    for sweep in sweeps(results) {
        let mut points = Vec::new();
        for (x, method) in sweep.points {
            points.extend(mean(results, chart, method, &chart.y)?.map(|y| [x, y]));
        }
        lines.push((sweep.name.to_owned(), points));
    }
    let ends = lines.first().map(|(_, points)| &points[..]);
    let dashed = ends.and_then(|points| Some([*points.first()?, *points.last()?]));
    let shown = axis(results, chart, &chart.y);
    let ranges = Some([0.0..1.0, 0.0..100.0]);
    Chart { axes: ["aggression, or lambda = mu", &shown], lines, ranges, dashed, ..Chart::default() }.draw()
}

/// Means of the metrics whose names differ in a number, over that number: a line for each method.
fn series(results: &Results, chart: &ChartSpec) -> Result<String> {
    let number = |name: &str| name.strip_prefix(&chart.y)?.trim().parse::<f64>().ok();
    let numbered = results.metrics_of(chart.of).iter().filter_map(|m| Some((number(&m.name)?, &*m.name)));
    let mut names: Vec<(f64, &str)> = numbered.collect();
    names.sort_by(|a, b| a.0.total_cmp(&b.0));
    require(!names.is_empty(), || {
        format!("no metric of `{}` in this study is named `{} NUMBER`", chart.of, chart.y)
    })?;
    let methods = results.methods(chart.of);
    let has_attacks = methods.iter().any(|k| results.keys[*k].attack != results.keys[methods[0]].attack);
    let mut lines: Vec<Line> = Vec::new();
    for method in methods {
        let key = &results.keys[method];
        let attack = Some(key.attack_label()).filter(|label| has_attacks && !label.is_empty());
        let name = std::iter::once(key.arm.clone()).chain(attack).collect::<Vec<_>>().join(", ");
        let mut points = Vec::new();
        for (x, metric) in &names {
            points.extend(mean(results, chart, method, metric)?.map(|y| [*x, y]));
        }
        lines.push((name, points));
    }
    let y = format!("{} ... %", chart.y);
    let axes = [chart.axis.as_deref().unwrap_or("number"), &y];
    let drawn = || lines.iter().flat_map(|(_, points)| points.iter().map(|[x, _]| *x));
    let (first, last) = (drawn().fold(f64::INFINITY, f64::min), drawn().fold(0.0, f64::max));
    let is_log = first > 0.0 && last >= LOG_FROM * first;
    let x = if is_log { first.log10()..last.log10() } else { first..last.max(first + 1e-9) };
    // Shares that rise leave the upper left free.
    let legend = Legend::UpperLeft;
    let ranges = first.is_finite().then_some([x, 0.0..100.0]);
    Chart { axes, lines, is_log: [is_log, false], ranges, legend, ..Chart::default() }.draw()
}

/// The method that was measured at a mixture.
///
/// *Errors*: there is none, or there are several, which one picture cannot show.
fn method_at(results: &Results, chart: &ChartSpec, mix: &[(String, f64)]) -> Result<usize> {
    let is_here = |k: &usize| results.keys[*k].point.as_ref().is_some_and(|point| point.mix == mix);
    let found: Vec<usize> = results.methods(chart.of).into_iter().filter(is_here).collect();
    match found[..] {
        [method] => Ok(method),
        [] => Err(Error::Value("a mixture of the picture was not measured".to_owned())),
        _ => Err(Error::Value(format!(
            "the picture shows one merger, weights and generator; the study has {}",
            found.len()
        ))),
    }
}

fn triangles(study: &Study, results: &Results, chart: &ChartSpec) -> Result<String> {
    let Some(axis) = &study.triangle else {
        return Err(Error::Value("the study has no `triangle`".to_owned()));
    };
    let named = |weights: [f64; 3]| axis.experts.iter().cloned().zip(weights).collect::<Vec<_>>();
    let methods = mixtures(axis.steps).into_iter().map(|weights| method_at(results, chart, &named(weights)));
    let methods: Vec<usize> = methods.collect::<Result<_>>()?;
    let metrics: Vec<&String> = std::iter::once(&chart.y).chain(&chart.more).collect();
    let mut all = Vec::new();
    for name in metrics {
        let values =
            methods.iter().map(|method| Ok(mean(results, chart, *method, name)?.unwrap_or(f64::NAN)));
        all.push((self::axis(results, chart, name), values.collect::<Result<Vec<f64>>>()?));
    }
    let pictures: Vec<Triangle> =
        all.iter().map(|(title, values)| Triangle { title, values: values.clone() }).collect();
    let [a, b, c] = &axis.experts;
    triangle::draw([a, b, c], axis.steps, &pictures)
}

fn plane(study: &Study, results: &Results, chart: &ChartSpec) -> Result<String> {
    let Some(PlaneAxis { experts: [a, b], shares }) = &study.plane else {
        return Err(Error::Value("the study has no `plane`".to_owned()));
    };
    let value = |y: &f64, x: &f64| -> Result<f64> {
        let method = method_at(results, chart, &[(a.clone(), *x), (b.clone(), *y)])?;
        Ok(mean(results, chart, method, &chart.y)?.unwrap_or(f64::NAN))
    };
    let values = shares.iter().flat_map(|y| shares.iter().map(move |x| value(y, x)));
    let axes = [format!("share of the {a} vector"), format!("share of the {b} vector")];
    heat_map::draw(&Grid {
        title: &axis(results, chart, &chart.y),
        axes: [&axes[0], &axes[1]],
        at: shares,
        values: values.collect::<Result<_>>()?,
        marks: &[("prior", [0.0, 0.0]), (a, [1.0, 0.0]), (b, [0.0, 1.0])],
    })
}
