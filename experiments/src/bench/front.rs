//! Fronts of generators: attack rate and reward against realism, and who does better at equal realism.

use std::fmt::Write as _;

use anyhow::Result;
use sage_core::{
    seed::Rng,
    statistics::{self, Estimate},
};

use super::{
    line_chart::{Chart, Line},
    open_loop::{SceneRow, is_attack, is_believable},
    pareto::{Measure, Sweep, hypervolume},
};
use crate::{operating_point::RowKey, output::Folder};

/// Resamples of an interval.
const RESAMPLES: usize = 2000;

/// A generator with all its points: operating points, or weights that the user gave.
pub(crate) struct Front {
    pub(crate) name: String,
    points: Vec<Point>,
    /// Measures by scene and point.
    sweep: Sweep,
}

/// One point: what it is, and further values by scene.
struct Point {
    label: String,
    lane: Vec<f64>,
    nll: Vec<f64>,
}

/// Name of the front that a row belongs to: the generator, with those of its options that are no numbers.
pub(crate) fn name_of(key: &RowKey) -> String {
    let options: serde_json::Map<_, _> = key
        .options
        .iter()
        .filter(|(_, value)| !value.is_number())
        .map(|(k, v)| (k.clone(), v.clone()))
        .collect();
    if options.is_empty() {
        key.method.clone()
    } else {
        format!("{}{}", key.method, serde_json::Value::Object(options))
    }
}

/// Fronts of all rows, scene by scene; rows of all scenes have the same keys in the same order.
pub(crate) fn fronts(scenes: &[Vec<SceneRow>]) -> Vec<Front> {
    let Some(first) = scenes.first() else { return Vec::new() };
    let mut fronts: Vec<Front> = Vec::new();
    let mut of_row = Vec::with_capacity(first.len());
    for row in first {
        let (name, label) = (name_of(&row.key), row.key.label());
        let k = fronts.iter().position(|front| front.name == name).unwrap_or_else(|| {
            fronts.push(Front { name, points: Vec::new(), sweep: Sweep::default() });
            fronts.len() - 1
        });
        fronts[k].points.push(Point { label, lane: Vec::new(), nll: Vec::new() });
        of_row.push((k, fronts[k].points.len() - 1));
    }
    for rows in scenes {
        fronts.iter_mut().for_each(|front| front.sweep.scenes.push(Vec::new()));
        for (row, (k, point)) in rows.iter().zip(&of_row) {
            let front = &mut fronts[*k];
            if let Some(measures) = front.sweep.scenes.last_mut() {
                measures.push(measure(row));
            }
            let point = &mut front.points[*point];
            point.lane.push(row.natural.lane_distance);
            point.nll.extend(row.nll);
        }
    }
    fronts
}

/// Measures of the selected candidate of a scene.
pub(crate) fn measure(row: &SceneRow) -> Measure {
    let share = |is: bool| f64::from(u8::from(is));
    Measure {
        reward: row.paper.adversarial_reward,
        penalty: row.paper.kinematic_penalty + row.paper.behavior_penalty,
        attack: share(is_attack(row)),
        believable: share(is_believable(row)),
    }
}

/// The largest value on a front at no more than a penalty, straight between its points; that of the most realistic
/// point if all are less realistic, which happens in resamples.
fn within(front: &[Measure], penalty: f64, value: fn(&Measure) -> f64) -> f64 {
    let at = |m: &Measure| (m.penalty <= penalty).then(|| value(m));
    let crossing = |pair: &[Measure]| {
        let [a, b] = [&pair[0], &pair[1]];
        let share = (penalty - a.penalty) / (b.penalty - a.penalty);
        (0.0..=1.0).contains(&share).then(|| value(a) + share * (value(b) - value(a)))
    };
    let all = front.iter().filter_map(at).chain(front.windows(2).filter_map(crossing));
    all.reduce(f64::max).unwrap_or_else(|| {
        let most = front.iter().min_by(|a, b| a.penalty.total_cmp(&b.penalty));
        most.map_or(0.0, value)
    })
}

/// The tables: hypervolumes, then all points with the first front at equal realism.
///
/// *Errors*: none that a caller can cause.
pub(crate) fn markdown(fronts: &[Front]) -> Result<String> {
    let Some(first) = fronts.first() else { return Ok(String::new()) };
    let name = &first.name;
    let mut out = format!(
        "Fronts of generators: each generator at all its points.\n\n\
         | generator | points | N | hypervolume | `{name}` minus it |\n| --- | --- | --- | --- | --- |\n"
    );
    let cell = |e: Option<Estimate>| {
        e.map_or("-".to_owned(), |e| format!("{:.2} [{:.2}, {:.2}]", e.value, e.low, e.high))
    };
    for front in fronts {
        let is_first = std::ptr::eq(front, first);
        let minus =
            if is_first { "-".to_owned() } else { cell(first.sweep.difference(&front.sweep, hypervolume)) };
        writeln!(
            out,
            "| {} | {} | {} | {} | {minus} |",
            front.name,
            front.points.len(),
            front.sweep.scenes.len(),
            cell(front.sweep.estimate(hypervolume)),
        )?;
    }
    writeln!(
        out,
        "\n| point | attack % | believable % | R_adv | P_real | lane distance, m | nll | `{name}` at equal P_real minus it: attack, points | R_adv |\n\
         | --- | --- | --- | --- | --- | --- | --- | --- | --- |"
    )?;
    for front in fronts {
        let means = front.sweep.front();
        for (k, (point, mean)) in front.points.iter().zip(&means).enumerate() {
            let single = front.sweep.only(k);
            let is_reached = first.sweep.front().iter().any(|own| own.penalty <= mean.penalty);
            let less = |value: fn(&Measure) -> f64, scale: f64| {
                if std::ptr::eq(front, first) || !is_reached {
                    return "-".to_owned();
                }
                let difference = first.sweep.against(&single, |own, other| {
                    scale * (within(own, other[0].penalty, value) - value(&other[0]))
                });
                difference
                    .map_or("-".to_owned(), |e| format!("{:+.1} [{:+.1}, {:+.1}]", e.value, e.low, e.high))
            };
            writeln!(
                out,
                "| {} | {:.1} | {:.1} | {:.2} | {:.2} | {} | {} | {} | {} |",
                point.label,
                100.0 * mean.attack,
                100.0 * mean.believable,
                mean.reward,
                mean.penalty,
                mean_of(&point.lane, "lane"),
                mean_of(&point.nll, "nll"),
                less(|m| m.attack, 100.0),
                less(|m| m.reward, 1.0),
            )?;
        }
    }
    out += "\n*Hypervolume*: area in the plane of R_adv and P_real that the mean over scenes dominates at any point, up to R_adv 0 \
        and P_real 6. *Equal P_real*: the best of the first generator's front, straight between its points, that is at least as \
        realistic (- where none is); the best of several points of a front against one point, which favours the front a little. *nll*: negative log-likelihood under the prior. Intervals: 95 %, bootstrap over scenes; \
        differences are paired.\n";
    Ok(out)
}

fn mean_of(values: &[f64], what: &str) -> String {
    statistics::bootstrap_mean(values, RESAMPLES, &mut Rng::new(0, what, "front"))
        .map_or("-".to_owned(), |e| format!("{:.2} [{:.2}, {:.2}]", e.value, e.low, e.high))
}

/// `points.csv`: means of every point.
///
/// *Errors*: none that a caller can cause.
pub(crate) fn csv(fronts: &[Front]) -> Result<String> {
    let mut out = "generator,point,attack,believable,reward,penalty,lane_distance,nll\n".to_owned();
    let quoted = |text: &str| format!("\"{}\"", text.replace('"', "\"\""));
    let text = |values: &[f64]| statistics::mean(values).map_or(String::new(), |mean| mean.to_string());
    for front in fronts {
        for (point, m) in front.points.iter().zip(front.sweep.front()) {
            let (name, label) = (quoted(&front.name), quoted(&point.label));
            let (lane, nll) = (text(&point.lane), text(&point.nll));
            writeln!(
                out,
                "{name},{label},{},{},{},{},{lane},{nll}",
                m.attack, m.believable, m.reward, m.penalty
            )?;
        }
    }
    Ok(out)
}

/// Writes the charts.
///
/// *Errors*: a file cannot be written.
pub(crate) fn charts(out: &Folder, fronts: &[Front]) -> Result<()> {
    let lines = |point: &dyn Fn(&Measure, &Point) -> Option<[f64; 2]>| -> Vec<Line> {
        let line = |front: &Front| {
            let means = front.sweep.front();
            let points = means.iter().zip(&front.points).filter_map(|(m, p)| point(m, p));
            (front.name.clone(), points.collect())
        };
        fronts.iter().map(line).collect()
    };
    let attack = "feasible hits, %";
    let realism = "P_real (smaller is better)";
    let of = |values: &[f64], m: &Measure| Some([statistics::mean(values)?, 100.0 * m.attack]);
    for (file, axes, lines) in [
        ("attack-realism.svg", [realism, attack], lines(&|m, _| Some([m.penalty, 100.0 * m.attack]))),
        ("attack-lane.svg", ["lane distance, m", attack], lines(&|m, p| of(&p.lane, m))),
        ("attack-nll.svg", ["negative log-likelihood, nats", attack], lines(&|m, p| of(&p.nll, m))),
        ("reward-realism.svg", [realism, "R_adv"], lines(&|m, _| Some([m.penalty, m.reward]))),
    ] {
        // A generator with one point is a mark.
        let (single, lines): (Vec<Line>, Vec<Line>) =
            lines.into_iter().partition(|(_, points)| points.len() == 1);
        let marks = single.into_iter().map(|(name, points)| (name, points[0])).collect();
        out.write(file, Chart { axes, lines, marks, ..Chart::default() }.draw()?.as_bytes())?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_front_is_read_straight_between_its_points() {
        let at = |attack: f64, penalty: f64| Measure { attack, penalty, ..Measure::default() };
        let front = [at(0.1, 2.0), at(0.5, 2.4), at(0.9, 3.0)];
        let attack = |penalty| within(&front, penalty, |m| m.attack);
        assert!((attack(2.2) - 0.3).abs() < 1e-12);
        assert!((attack(2.7) - 0.7).abs() < 1e-12);
        assert_eq!((attack(4.0), attack(1.0)), (0.9, 0.1));
    }
}
