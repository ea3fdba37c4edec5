//! Quantities of the curve of each method over its operating points.

use sage_core::{statistics::Estimate, text::table::Table};

use crate::{
    Result,
    context::{Context as _, require},
    curve::{Curve, Path, Point, VALUES, best_lambda, hypervolume, monotone, unevenness, within},
    rows::{Key, Results, Subject},
    study::{CurveQuantity, Study},
};

/// Methods that belong to one curve, in their order.
pub(super) struct Line {
    pub(super) name: String,
    pub(super) methods: Vec<usize>,
}

/// The curves of a subject: methods with the same arm and the same generator. Options that are numbers are points of
/// one curve, others are curves of their own.
pub(super) fn lines(results: &Results, subject: Subject) -> Vec<Line> {
    let mut all: Vec<Line> = Vec::new();
    let methods = results.methods(subject);
    let has_arms = methods.iter().any(|k| results.keys[*k].arm != results.keys[methods[0]].arm);
    let has_attacks =
        methods.iter().any(|k| generator(&results.keys[*k]) != generator(&results.keys[methods[0]]));
    for method in methods {
        let key = &results.keys[method];
        let parts = [(has_arms, key.arm.clone()), (has_attacks || !has_arms, generator(key))];
        let parts: Vec<String> = parts
            .into_iter()
            .filter(|(is_shown, text)| *is_shown && !text.is_empty())
            .map(|(_, text)| text)
            .collect();
        let name = parts.join(", ");
        match all.iter_mut().find(|line| line.name == name) {
            Some(line) => line.methods.push(method),
            None => all.push(Line { name, methods: vec![method] }),
        }
    }
    all
}

/// The generator with those of its options that are no numbers.
fn generator(key: &Key) -> String {
    let Some((name, _)) = key.attack.split_once('{') else { return key.attack.clone() };
    let options = serde_json::from_str(&key.attack[name.len()..]);
    let serde_json::Value::Object(options) = options.unwrap_or_default() else { return key.attack.clone() };
    let other: serde_json::Map<_, _> = options.into_iter().filter(|(_, value)| !value.is_number()).collect();
    if other.is_empty() { name.to_owned() } else { format!("{name}{}", serde_json::Value::Object(other)) }
}

impl Line {
    /// Its position at a point: λ or the aggression, whichever rises along the whole line; equal steps if neither does.
    fn positions(&self, results: &Results) -> Vec<f64> {
        let points = || self.methods.iter().map(|k| results.keys[*k].point.as_ref());
        let lambdas: Option<Vec<f64>> = points().map(|point| point?.lambda).collect();
        let aggressions: Option<Vec<f64>> = points().map(|point| point?.aggression).collect();
        let rises = |all: &Vec<f64>| all.windows(2).all(|pair| pair[0] < pair[1]);
        let steps = || (0..self.methods.len()).map(|k| k as f64).collect();
        aggressions.filter(rises).or_else(|| lambdas.filter(rises)).unwrap_or_else(steps)
    }

    /// The part of it that lies on a path between two experts, in the order of λ, with each λ. `None` without any.
    ///
    /// *Errors*: fewer than three λ, or one that occurs several times.
    fn over_lambda(&self, results: &Results) -> Result<Option<(Self, Vec<f64>)>> {
        let lambda = |k: usize| results.keys[k].point.as_ref()?.lambda;
        let mut all: Vec<(f64, usize)> =
            self.methods.iter().filter_map(|k| Some((lambda(*k)?, *k))).collect();
        if all.is_empty() {
            return Ok(None);
        }
        all.sort_by(|a, b| a.0.total_cmp(&b.0));
        let is_path = all.len() > 2 && all.windows(2).all(|pair| pair[0].0 < pair[1].0);
        require(is_path, || {
            format!(
                "`above-chord` and `best-lambda` need at least three lambda, each at one point; `{}` has {}",
                self.name,
                all.iter().map(|(lambda, _)| lambda.to_string()).collect::<Vec<_>>().join(", ")
            )
        })?;
        let (lambdas, methods) = all.into_iter().unzip();
        Ok(Some((Self { name: self.name.clone(), methods }, lambdas)))
    }
}

/// The curve of a line over the scenes in which all its points were measured.
fn curve(results: &Results, line: &Line, subject: Subject, scenes: &[usize]) -> Result<Curve> {
    let metric = |name: &str| {
        results
            .metric(subject, name)
            .with_context(|| format!("curves need the metric `{name}` of `{subject}`"))
    };
    let metrics = [metric("R_adv")?, metric("P_real")?, metric("attack")?, metric("believable")?];
    let samples: Vec<_> =
        line.methods.iter().map(|method| metrics.map(|k| results.samples(*method, k))).collect();
    let at = |scene: usize| {
        let value = |k: usize, of: usize| samples[of][k].seeds[0][scene][0];
        let point = |of: usize| Point {
            reward: value(0, of),
            penalty: value(1, of),
            attack: value(2, of),
            believable: value(3, of),
        };
        (0..samples.len()).map(point).collect()
    };
    Ok(Curve { scenes: scenes.iter().map(|scene| at(*scene)).collect() })
}

/// Scenes in which every method of a subject was measured.
fn common(results: &Results, subject: Subject) -> Vec<usize> {
    let methods = results.methods(subject);
    let is_whole = |scene: &usize| {
        let cells = &results.cells[*scene];
        methods.iter().all(|k| cells.iter().any(|cell| cell.key == *k && cell.error.is_empty()))
    };
    (0..results.scenes.len()).filter(is_whole).collect()
}

/// The tables of quantities.
///
/// *Errors*: R_adv, P_real, attack or believable was not measured; a line is no path over λ, where one is needed.
pub(super) fn tables(study: &Study, results: &Results) -> Result<Vec<Table>> {
    let wanted = &study.report.curves;
    let mut tables = Vec::new();
    for subject in [Subject::Trajectory, Subject::Policy] {
        // Without selection the prior is one policy, whatever λ is.
        let is_curve = |line: &Line| subject != Subject::Policy || line.name != "prior";
        let lines: Vec<Line> = lines(results, subject).into_iter().filter(is_curve).collect();
        if wanted.is_empty() || lines.is_empty() {
            continue;
        }
        let scenes = common(results, subject);
        let curves =
            lines.iter().map(|line| curve(results, line, subject, &scenes)).collect::<Result<Vec<_>>>()?;
        tables.extend(quantities(wanted, results, &lines, &curves, subject));
        if [CurveQuantity::AboveChord, CurveQuantity::BestLambda].iter().any(|of| wanted.contains(of)) {
            tables.extend(over_lambda(wanted, results, &lines, subject, &scenes)?);
        }
        if wanted.contains(&CurveQuantity::EqualRealism) && subject == Subject::Trajectory {
            tables.extend(equal_realism(results, &lines, &curves));
        }
    }
    Ok(tables)
}

fn shown(e: Option<Estimate>) -> String {
    e.map_or("-".to_owned(), |e| format!("{:.3} [{:.3}, {:.3}]", e.value, e.low, e.high))
}

/// One row for each curve; `None` without a quantity that is one number.
fn quantities(
    wanted: &[CurveQuantity],
    results: &Results,
    lines: &[Line],
    curves: &[Curve],
    subject: Subject,
) -> Option<Table> {
    let head = |quantity: &CurveQuantity| match quantity {
        CurveQuantity::Hypervolume => Some("hypervolume"),
        CurveQuantity::HypervolumeMinusFirst => Some("hypervolume minus the first"),
        CurveQuantity::Monotone => Some("R_adv monotone %"),
        CurveQuantity::Unevenness => Some("unevenness, points"),
        CurveQuantity::EqualRealism | CurveQuantity::AboveChord | CurveQuantity::BestLambda => None,
    };
    let wanted: Vec<CurveQuantity> =
        wanted.iter().copied().filter(|quantity| head(quantity).is_some()).collect();
    if wanted.is_empty() {
        return None;
    }
    let mut heads = vec!["curve".to_owned(), "points".to_owned(), "N".to_owned()];
    heads.extend(wanted.iter().filter_map(head).map(str::to_owned));
    let row = |(k, (line, curve)): (usize, (&Line, &Curve))| {
        let front = curve.front();
        let mut row = vec![line.name.clone(), line.methods.len().to_string(), curve.scenes.len().to_string()];
        row.extend(wanted.iter().map(|quantity| match quantity {
            CurveQuantity::Hypervolume => shown(curve.estimate(hypervolume)),
            CurveQuantity::HypervolumeMinusFirst if k == 0 => "-".to_owned(),
            CurveQuantity::HypervolumeMinusFirst => shown(curve.difference(&curves[0], hypervolume)),
            CurveQuantity::Monotone => format!("{:.0}", monotone(&front)),
            CurveQuantity::Unevenness => format!("{:.1}", unevenness(&line.positions(results), &front)),
            _ => String::new(),
        }));
        row
    };
    let title = match subject {
        Subject::Policy => "Curves without selection, expectations under the policy. ",
        _ => "Curves over the operating points. ",
    };
    let title = format!(
        "{title}Hypervolume: area in the plane of R_adv and P_real that the mean over scenes dominates at any point, up to R_adv 0 and P_real 6:"
    );
    Some(Table { title, heads, rows: lines.iter().zip(curves).enumerate().map(row).collect(), names: 1 })
}

/// A line over increasing λ.
struct LambdaPath {
    name: String,
    lambdas: Vec<f64>,
    curve: Curve,
}

/// The tables of quantities over λ.
fn over_lambda(
    wanted: &[CurveQuantity],
    results: &Results,
    lines: &[Line],
    subject: Subject,
    scenes: &[usize],
) -> Result<Vec<Table>> {
    let mut paths = Vec::new();
    for line in lines {
        if let Some((line, lambdas)) = line.over_lambda(results)? {
            let curve = curve(results, &line, subject, scenes)?;
            paths.push(LambdaPath { name: line.name, lambdas, curve });
        }
    }
    let mut tables = Vec::new();
    if wanted.contains(&CurveQuantity::AboveChord) {
        tables.push(above_chord(&paths));
    }
    if wanted.contains(&CurveQuantity::BestLambda) {
        tables.push(best_lambdas(&paths));
    }
    Ok(tables)
}

/// Heights of rewards above the chord of each path.
fn above_chord(paths: &[LambdaPath]) -> Table {
    let rows = paths.iter().flat_map(|path| {
        VALUES.iter().filter_map(|(name, value)| {
            let found = Path::of(&path.curve, &path.lambdas, *value)?;
            let cells = [found.least, found.mean, found.concave].map(|e| shown(Some(e)));
            Some([vec![path.name.clone(), (*name).to_owned()], cells.to_vec()].concat())
        })
    });
    let title = "Heights above the chord between the ends; the chord is what probability mixing attains, and a least height below 0 is a barrier:";
    let heads = ["curve", "value", "least height", "mean height", "concave at % of lambda"];
    Table {
        title: title.to_owned(),
        heads: heads.map(str::to_owned).to_vec(),
        rows: rows.collect(),
        names: 2,
    }
}

/// μ whose best λ is shown.
const PREFERENCES: [f64; 7] = [0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0];

/// Where on each path a weighted sum is largest.
fn best_lambdas(paths: &[LambdaPath]) -> Table {
    let rows = paths.iter().map(|path| {
        let best = |mu: f64| {
            let found = path.curve.estimate(|front| best_lambda(&path.lambdas, front, mu));
            found.map_or("-".to_owned(), |e| format!("{:.2} [{:.2}, {:.2}]", e.value, e.low, e.high))
        };
        std::iter::once(path.name.clone()).chain(PREFERENCES.map(best)).collect()
    });
    let heads = std::iter::once("curve".to_owned()).chain(PREFERENCES.map(|mu| format!("mu {mu}")));
    let title = "Lambda at which mu R_adv - (1 - mu) P_real is largest:".to_owned();
    Table { title, heads: heads.collect(), rows: rows.collect(), names: 1 }
}

/// The best of the first curve at no more P_real than each point of the others, straight between its points.
fn equal_realism(results: &Results, lines: &[Line], curves: &[Curve]) -> Option<Table> {
    let (first, own) = (lines.first()?, curves.first()?);
    let mut rows = Vec::new();
    for (line, curve) in lines.iter().zip(curves).skip(1) {
        for (k, (method, mean)) in line.methods.iter().zip(curve.front()).enumerate() {
            let is_reached = own.front().iter().any(|point| point.penalty <= mean.penalty);
            let less = |value: fn(&Point) -> f64, scale: f64| {
                let difference = is_reached.then(|| {
                    own.against(&curve.only(k), |own, other| {
                        scale * (within(own, other[0].penalty, value) - value(&other[0]))
                    })
                });
                let found = difference.flatten();
                found.map_or("-".to_owned(), |e| format!("{:+.1} [{:.1}, {:.1}]", e.value, e.low, e.high))
            };
            let label = results.keys[*method].attack_label();
            rows.push(vec![label, less(|p| p.attack, 100.0), less(|p| p.reward, 1.0)]);
        }
    }
    let title = format!(
        "`{}` at no more P_real than each other point, minus that point (- where none of its points is as realistic; the best of several points of a curve against one point favours the curve a little):",
        first.name
    );
    let heads = ["point", "attack, points", "R_adv"].map(str::to_owned).to_vec();
    (!rows.is_empty()).then_some(Table { title, heads, rows, names: 1 })
}
