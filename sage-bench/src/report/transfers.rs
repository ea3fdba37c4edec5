//! What transfers say: for each method a matrix of the driver that plans are made against and the driver that is tested, how
//! much is lost from one to the other, and which driver is the best to make attacks for another.

use advsage::operating_point::OperatingPointSpec;
use sage_core::{statistics::Estimate, text::table::Table};

use crate::{
    estimate::{Samples, of_scenes},
    rows::{Key, Results, Subject},
};

/// Rates whose loss is shown.
const RATES: [&str; 4] = ["attack", "believable", "at fault", "failure"];
/// Rates with a matrix for each method.
const ATTACK: &str = "attack";
const FAILURE: &str = "failure";
/// What stands beside the rate of attacks: shares of the attacks.
const BESIDE: [&str; 2] = ["unavoidable", "unavoidable, R157"];
/// Rate by which the best other driver is chosen.
const CHOSEN_BY: &str = "believable";
/// The method that searches with the driver in the loop: it is not averaged with the others.
const SEARCH: &str = "search";

/// The keys of all transfers.
struct Cube<'r> {
    results: &'r Results,
    /// Methods with their operating points.
    attacks: Vec<String>,
    drivers: Vec<String>,
    /// By method, then by the driver that plans are made against, then by the tested driver.
    keys: Vec<Option<usize>>,
}

/// A value of each scene; `None` where it was not measured.
type ByScene = Vec<Option<f64>>;

impl<'r> Cube<'r> {
    fn new(results: &'r Results) -> Self {
        let methods = results.methods(Subject::Transfer);
        let key = |k: &usize| &results.keys[*k];
        let drivers = distinct(methods.iter().map(|k| key(k).made_against.clone()));
        let attacks = distinct(methods.iter().map(|k| attack(key(k))));
        let mut keys = Vec::new();
        for of in &attacks {
            for made in &drivers {
                for tested in &drivers {
                    let is_it = |k: &&usize| {
                        attack(key(k)) == *of && key(k).made_against == *made && key(k).arm == *tested
                    };
                    keys.push(methods.iter().find(is_it).copied());
                }
            }
        }
        Self { results, attacks, drivers, keys }
    }

    fn key(&self, attack: usize, made: usize, tested: usize) -> Option<usize> {
        let n = self.drivers.len();
        self.keys[(attack * n + made) * n + tested]
    }

    /// Values of a metric, means over training seeds; `None` if it was measured in no scene.
    fn by_scene(&self, attack: usize, made: usize, tested: usize, metric: usize) -> Option<ByScene> {
        let samples = self.results.samples(self.key(attack, made, tested)?, metric);
        (samples.n() > 0).then(|| by_scene(&samples))
    }
}

fn distinct(all: impl Iterator<Item = String>) -> Vec<String> {
    let mut kept: Vec<String> = Vec::new();
    all.for_each(|one| {
        if !kept.contains(&one) {
            kept.push(one);
        }
    });
    kept
}

/// The method of a key with its operating point.
fn attack(key: &Key) -> String {
    let point = key.point.as_ref().map(OperatingPointSpec::label);
    [Some(key.attack.clone()), point].into_iter().flatten().collect::<Vec<_>>().join(" ")
}

/// The value of each scene, a mean over the seeds that measured it.
fn by_scene(samples: &Samples) -> ByScene {
    let scenes = samples.seeds.first().map_or(0, Vec::len);
    let value = |scene: usize| {
        let of_seed = |seed: &Vec<[f64; 2]>| {
            let [sum, weight] = seed[scene];
            (weight > 0.0).then(|| sum / weight)
        };
        mean(samples.seeds.iter().filter_map(of_seed))
    };
    (0..scenes).map(value).collect()
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    (count > 0.0).then(|| sum / count)
}

/// Numbers of the scenes in which all were measured.
fn common(all: &[&ByScene]) -> Vec<usize> {
    let scenes = all.iter().map(|values| values.len()).min().unwrap_or(0);
    (0..scenes).filter(|scene| all.iter().all(|values| values[*scene].is_some())).collect()
}

/// The mean of several values in some scenes, in which all were measured.
fn averaged(all: &[&ByScene], scenes: &[usize]) -> Vec<f64> {
    let of_scene = |scene: &usize| mean(all.iter().filter_map(|values| values[*scene])).unwrap_or(0.0);
    scenes.iter().map(of_scene).collect()
}

/// The mean over scenes with its interval; `name` seeds the bootstrap, so differences are paired.
fn estimate(values: &[f64], name: &str) -> Option<Estimate> {
    of_scenes(values.len(), name, |drawn| mean(drawn.iter().map(|k| values[*k])).unwrap_or(0.0))
}

fn less(a: &[f64], b: &[f64]) -> Vec<f64> {
    a.iter().zip(b).map(|(a, b)| a - b).collect()
}

/// The tables; none without transfers.
pub(super) fn tables(results: &Results) -> Vec<Table> {
    if results.methods(Subject::Transfer).is_empty() {
        return Vec::new();
    }
    let cube = Cube::new(results);
    let of_attack = |attack: usize| [matrix(&cube, attack, ATTACK), matrix(&cube, attack, FAILURE)];
    let mut all: Vec<Table> = (0..cube.attacks.len()).flat_map(of_attack).flatten().collect();
    all.extend(loss(&cube));
    all.extend(best_others(&cube));
    all
}

/// One method: rows are made against, columns are tested.
fn matrix(cube: &Cube, attack: usize, rate: &str) -> Option<Table> {
    let results = cube.results;
    let metric = |name: &str| results.metric(Subject::Transfer, name);
    let number = metric(rate)?;
    let record = &results.metrics_of(Subject::Transfer)[number];
    let cell = |made: usize, tested: usize| -> Option<String> {
        let key = cube.key(attack, made, tested)?;
        let e = results.samples(key, number).estimate(record.aggregate, rate)?;
        let of = |name: &&str| {
            let share = metric(name).and_then(|metric| results.samples(key, metric).mean());
            share.map_or("-".to_owned(), |share| format!("{:.0}", 100.0 * share))
        };
        let beside: Vec<String> = BESIDE.iter().filter(|_| rate == ATTACK).map(of).collect();
        let beside = if beside.is_empty() { String::new() } else { format!(" ({})", beside.join(", ")) };
        Some(format!("{:.0} [{:.0}, {:.0}]{beside}", 100.0 * e.value, 100.0 * e.low, 100.0 * e.high))
    };
    let n = cube.drivers.len();
    let row = |made: usize| {
        let cells = (0..n).map(|tested| cell(made, tested).unwrap_or("-".to_owned()));
        std::iter::once(cube.drivers[made].clone()).chain(cells).collect()
    };
    let name = &cube.attacks[attack];
    let title = match rate {
        ATTACK => format!(
            "Attacks of `{name}` in % of the scenes, by the driver that is tested (columns); in parentheses the % of them for which no evasive manoeuvre was found, and none within the limits of UN R157's driver:"
        ),
        _ => format!(
            "Failures by plans of `{name}` in % of the scenes, by the driver that is tested (columns):"
        ),
    };
    let heads = std::iter::once("made against".to_owned()).chain(cube.drivers.iter().cloned());
    Some(Table { title, heads: heads.collect(), rows: (0..n).map(row).collect(), names: 1 })
}

/// How much is lost from the driver that plans are made against to the others.
fn loss(cube: &Cube) -> Option<Table> {
    if cube.drivers.len() < 2 {
        return None;
    }
    let mut rows = Vec::new();
    for (attack, name) in cube.attacks.iter().enumerate() {
        for rate in RATES {
            let Some(metric) = cube.results.metric(Subject::Transfer, rate) else { continue };
            let mut row = vec![name.clone(), rate.to_owned()];
            match own_and_others(cube, attack, metric) {
                None => row.extend(["0", "-", "-", "-"].map(str::to_owned)),
                Some((own, others)) => {
                    let stream = format!("transfer {name} {rate}");
                    row.push(own.len().to_string());
                    for values in [&own, &others, &less(&own, &others)] {
                        row.push(points(estimate(values, &stream)));
                    }
                }
            }
            rows.push(row);
        }
    }
    Some(Table {
        title: "What is lost when another driver is tested than the one that the plans are made against, % of the scenes, means over drivers; N: scenes in which every pair of drivers was measured:".to_owned(),
        heads: ["method", "rate", "N", "itself", "another", "lost"].map(str::to_owned).to_vec(),
        rows,
        names: 2,
    })
}

/// For each scene with all values: the mean over drivers of the rate on the driver that plans are made against, and of the mean
/// rate on the others. Drivers without either are left out; `None` if none remains.
fn own_and_others(cube: &Cube, attack: usize, metric: usize) -> Option<(Vec<f64>, Vec<f64>)> {
    let n = cube.drivers.len();
    let of_driver = |made: usize| -> Option<(ByScene, Vec<ByScene>)> {
        let own = cube.by_scene(attack, made, made, metric)?;
        let others = (0..n).filter(|tested| *tested != made);
        let others: Vec<ByScene> =
            others.filter_map(|tested| cube.by_scene(attack, made, tested, metric)).collect();
        (!others.is_empty()).then_some((own, others))
    };
    let drivers: Vec<(ByScene, Vec<ByScene>)> = (0..n).filter_map(of_driver).collect();
    let all: Vec<&ByScene> =
        drivers.iter().flat_map(|(own, others)| std::iter::once(own).chain(others)).collect();
    let scenes = common(&all);
    if scenes.is_empty() {
        return None;
    }
    let own: Vec<&ByScene> = drivers.iter().map(|(own, _)| own).collect();
    let of_others: Vec<ByScene> = (drivers.iter())
        .map(|(_, others)| {
            let others: Vec<&ByScene> = others.iter().collect();
            let mut values = vec![None; others[0].len()];
            let means = averaged(&others, &scenes);
            scenes.iter().zip(means).for_each(|(scene, mean)| values[*scene] = Some(mean));
            values
        })
        .collect();
    Some((averaged(&own, &scenes), averaged(&of_others.iter().collect::<Vec<_>>(), &scenes)))
}

/// For each tested driver the best other driver to make attacks for it.
fn best_others(cube: &Cube) -> Option<Table> {
    let metric = cube.results.metric(Subject::Transfer, CHOSEN_BY).filter(|_| cube.drivers.len() > 2)?;
    let (searches, others): (Vec<usize>, Vec<usize>) =
        (0..cube.attacks.len()).partition(|attack| cube.attacks[*attack].starts_with(SEARCH));
    let groups = [("search", searches), ("other methods, mean", others)];
    let mut rows = Vec::new();
    for (name, attacks) in groups.iter().filter(|(_, attacks)| !attacks.is_empty()) {
        for (tested, driver) in cube.drivers.iter().enumerate() {
            rows.extend(
                best_other(cube, attacks, tested, metric)
                    .map(|cells| [vec![(*name).to_owned(), driver.clone()], cells].concat()),
            );
        }
    }
    Some(Table {
        title: "Believable attacks in % of the scenes, made against the tested driver itself, and against the best other driver, which is chosen on the same scenes, so that the difference is rather too small:".to_owned(),
        heads: ["method", "tested", "N", "itself", "best other", "its rate", "itself − best other"]
            .map(str::to_owned)
            .to_vec(),
        rows,
        names: 2,
    })
}

/// Cells of a tested driver: N, own rate, best other driver, its rate, difference.
fn best_other(cube: &Cube, attacks: &[usize], tested: usize, metric: usize) -> Option<Vec<String>> {
    // Values of all methods of the plans made against a driver; `None` if one was not measured.
    let of_driver = |made: usize| -> Option<Vec<ByScene>> {
        attacks.iter().map(|attack| cube.by_scene(*attack, made, tested, metric)).collect()
    };
    let made: Vec<(usize, Vec<ByScene>)> =
        (0..cube.drivers.len()).filter_map(|made| Some((made, of_driver(made)?))).collect();
    let all: Vec<&ByScene> = made.iter().flat_map(|(_, values)| values).collect();
    let scenes = common(&all);
    let rates: Vec<(usize, Vec<f64>)> = (made.iter())
        .map(|(made, values)| (*made, averaged(&values.iter().collect::<Vec<_>>(), &scenes)))
        .collect();
    let own = &rates.iter().find(|(made, _)| *made == tested)?.1;
    let rate = |values: &[f64]| mean(values.iter().copied());
    let others = rates.iter().filter(|(made, values)| *made != tested && !values.is_empty());
    let (best, values) = others.reduce(|a, b| if rate(&b.1) > rate(&a.1) { b } else { a })?;
    let stream = format!("best other {}", cube.drivers[tested]);
    let [own_rate, best_rate, gap] =
        [own, values, &less(own, values)].map(|values| points(estimate(values, &stream)));
    Some(vec![own.len().to_string(), own_rate, cube.drivers[*best].clone(), best_rate, gap])
}

/// A share and its interval in percent.
fn points(e: Option<Estimate>) -> String {
    e.map_or("-".to_owned(), |e| {
        format!("{:.1} [{:.1}, {:.1}]", 100.0 * e.value, 100.0 * e.low, 100.0 * e.high)
    })
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use sage_core::metric::Aggregate;

    use super::*;
    use crate::rows::{Cell, MetricRecord};

    /// Three drivers, one method; `rate` gives the value of each scene for made against and tested, `None` if not measured.
    fn results(scenes: usize, rate: impl Fn(usize, usize, usize) -> Option<f64>) -> Results {
        let drivers = ["a", "b", "c"];
        let metric = |name: &str| MetricRecord {
            name: name.to_owned(),
            unit: String::new(),
            summary: String::new(),
            aggregate: Aggregate::Share,
            better: "more".to_owned(),
            weight: None,
        };
        let mut keys = Vec::new();
        let mut cells = vec![Vec::new(); scenes];
        for made in 0..3 {
            for tested in 0..3 {
                for (scene, cells) in cells.iter_mut().enumerate() {
                    let Some(value) = rate(made, tested, scene) else { continue };
                    cells.push(Cell {
                        key: keys.len(),
                        agent: String::new(),
                        values: vec![Some(value); 2],
                        notes: Vec::new(),
                        error: String::new(),
                    });
                }
                keys.push(Key {
                    attack: "sage".to_owned(),
                    made_against: drivers[made].to_owned(),
                    ..Key::new(Subject::Transfer, drivers[tested], 0)
                });
            }
        }
        Results {
            keys,
            metrics: BTreeMap::from([(Subject::Transfer, vec![metric("attack"), metric("believable")])]),
            scenes: (0..scenes).map(|k| k.to_string()).collect(),
            cells,
            ..Results::default()
        }
    }

    fn table(results: &Results, title: &str) -> Table {
        tables(results).into_iter().find(|table| table.title.starts_with(title)).unwrap()
    }

    #[test]
    fn what_is_lost_is_a_mean_over_drivers() {
        // A driver meets its own plans always; those of `a` also hit `b`.
        let results = results(4, |made, tested, _| {
            Some(f64::from(u8::from(made == tested || (made, tested) == (0, 1))))
        });
        let lost = table(&results, "What is lost");
        // Another: a gives (1 + 0)/2, b and c give 0: 1/6.
        assert_eq!(
            lost.rows[0],
            ["sage", "attack", "4", "100.0 [100.0, 100.0]", "16.7 [16.7, 16.7]", "83.3 [83.3, 83.3]"]
        );
        let best = table(&results, "Believable attacks");
        assert_eq!(
            best.rows[1][3..],
            ["100.0 [100.0, 100.0]", "a", "100.0 [100.0, 100.0]", "0.0 [0.0, 0.0]"]
        );
        assert_eq!(best.rows[0][4], "b", "the first of equals");
        assert_eq!(
            table(&results, "Attacks of `sage`").rows[0][1..3],
            ["100 [51, 100] (-, -)", "100 [51, 100] (-, -)"]
        );
    }

    #[test]
    fn a_driver_that_was_not_measured_is_no_zero() {
        // Nothing is made against `c`, and `c` is tested in the first scene alone.
        let rate = |made: usize, tested: usize, scene: usize| {
            let is_measured = made != 2 && (tested != 2 || scene == 0);
            is_measured.then(|| f64::from(u8::from(made == tested)))
        };
        let results = results(3, rate);
        let lost = table(&results, "What is lost");
        assert_eq!(
            lost.rows[0][2..],
            ["1", "100.0 [100.0, 100.0]", "0.0 [0.0, 0.0]", "100.0 [100.0, 100.0]"]
        );
        let best = table(&results, "Believable attacks");
        // Only `a` and `b` have plans of their own.
        let tested: Vec<&str> = best.rows.iter().map(|row| &*row[1]).collect();
        assert_eq!((tested, &*best.rows[0][4], &*best.rows[0][2]), (vec!["a", "b"], "b", "3"));
        assert_eq!(table(&results, "Attacks of `sage`").rows[2][1..], ["-", "-", "-"]);
    }

    #[test]
    fn several_seeds_are_averaged() {
        let samples = Samples {
            seeds: vec![vec![[1.0, 1.0], [0.0, 0.0]], vec![[0.0, 1.0], [1.0, 1.0]]],
            ..Samples::default()
        };
        assert_eq!(by_scene(&samples), [Some(0.5), Some(1.0)]);
    }
}
