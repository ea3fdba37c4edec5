//! What transfers say: for each method a matrix of the driver that plans are made against and the driver that is tested, how
//! much is lost from one to the other, and which driver stands in for which.

use sage_core::statistics::Estimate;

use crate::{
    estimate::{Samples, of_scenes},
    operating_point::OperatingPointSpec,
    rows::{Key, Results, Subject},
    table::Table,
};

/// Rates whose loss is shown.
const RATES: [&str; 4] = ["attack", "believable", "at fault", "failure"];
/// The rate of the matrices, and what stands beside it: shares of the attacks.
const RATE: &str = "attack";
const BESIDE: [&str; 2] = ["unavoidable", "unavoidable, R157"];
/// Rate by which drivers stand in for others.
const STAND_IN: &str = "believable";

/// A metric over methods and pairs of drivers: the scenes' values, by method, then by the driver that plans are made
/// against, then by the tested driver.
struct Cube<'r> {
    results: &'r Results,
    attacks: Vec<String>,
    drivers: Vec<String>,
    /// Number of the key, if there is one.
    keys: Vec<Option<usize>>,
}

impl<'r> Cube<'r> {
    fn new(results: &'r Results) -> Self {
        let methods = results.methods(Subject::Transfer);
        let mut drivers: Vec<String> = Vec::new();
        for k in &methods {
            if !drivers.contains(&results.keys[*k].made_against) {
                drivers.push(results.keys[*k].made_against.clone());
            }
        }
        let named: Vec<(String, Option<&String>)> =
            methods.iter().map(|k| attack_and_tested(&results.keys[*k], &drivers)).collect();
        let mut attacks: Vec<String> = Vec::new();
        for (attack, _) in &named {
            if !attacks.contains(attack) {
                attacks.push(attack.clone());
            }
        }
        let mut keys = Vec::new();
        for attack in &attacks {
            for made in &drivers {
                for tested in &drivers {
                    let place = named.iter().zip(&methods).position(|((of, driver), k)| {
                        of == attack && *driver == Some(tested) && results.keys[*k].made_against == *made
                    });
                    keys.push(place.map(|place| methods[place]));
                }
            }
        }
        Self { results, attacks, drivers, keys }
    }

    fn key(&self, attack: usize, made: usize, tested: usize) -> Option<usize> {
        let n = self.drivers.len();
        self.keys[(attack * n + made) * n + tested]
    }

    fn samples(&self, metric: &str) -> Option<Vec<Option<Samples>>> {
        let metric = self.results.metric(Subject::Transfer, metric)?;
        Some(self.keys.iter().map(|key| key.map(|key| self.results.samples(key, metric))).collect())
    }
}

/// The method of a key with its operating point and weights, and the driver that is tested. An arm is a driver, and
/// weights if there are several.
fn attack_and_tested<'d>(key: &Key, drivers: &'d [String]) -> (String, Option<&'d String>) {
    let rest = |driver: &String| {
        key.arm.strip_prefix(&**driver).filter(|rest| rest.is_empty() || rest.starts_with(", "))
    };
    let tested = drivers.iter().filter(|driver| rest(driver).is_some()).max_by_key(|driver| driver.len());
    let weights = tested.and_then(rest).map(|rest| rest.trim_start_matches(", ").to_owned());
    let words = [
        Some(key.attack.clone()),
        key.point.as_ref().map(OperatingPointSpec::label),
        weights.filter(|weights| !weights.is_empty()),
    ];
    (words.into_iter().flatten().collect::<Vec<_>>().join(" "), tested)
}

/// The tables; none without transfers.
pub(super) fn tables(results: &Results) -> Vec<Table> {
    if results.methods(Subject::Transfer).is_empty() {
        return Vec::new();
    }
    let cube = Cube::new(results);
    let mut all: Vec<Table> = (0..cube.attacks.len()).filter_map(|attack| matrix(&cube, attack)).collect();
    all.extend(loss(&cube));
    all.extend(stand_ins(&cube));
    all
}

/// One method: rows are made against, columns are tested.
fn matrix(cube: &Cube, attack: usize) -> Option<Table> {
    let results = cube.results;
    let metric = |name: &str| results.metric(Subject::Transfer, name);
    let rate = metric(RATE)?;
    let record = &results.metrics_of(Subject::Transfer)[rate];
    let cell = |made: usize, tested: usize| {
        let Some(key) = cube.key(attack, made, tested) else { return "-".to_owned() };
        let Some(e) = results.samples(key, rate).estimate(record.aggregate, RATE) else {
            return "-".to_owned();
        };
        let of = |name: &&str| {
            let share = metric(name).and_then(|metric| results.samples(key, metric).mean());
            share.map_or("-".to_owned(), |share| format!("{:.0}", 100.0 * share))
        };
        let beside: Vec<String> = BESIDE.iter().map(of).collect();
        format!(
            "{:.0} [{:.0}, {:.0}] ({})",
            100.0 * e.value,
            100.0 * e.low,
            100.0 * e.high,
            beside.join(", ")
        )
    };
    let n = cube.drivers.len();
    let row = |made: usize| {
        let cells = (0..n).map(|tested| cell(made, tested));
        std::iter::once(cube.drivers[made].clone()).chain(cells).collect()
    };
    let heads = std::iter::once("made against".to_owned()).chain(cube.drivers.iter().cloned());
    Some(Table {
        title: format!(
            "Attacks of `{}` in % of the scenes, by the driver that is tested (columns); in parentheses the % of them without an evasive manoeuvre, and without one within the limits of UN R157's driver:",
            cube.attacks[attack]
        ),
        heads: heads.collect(),
        rows: (0..n).map(row).collect(),
        names: 1,
    })
}

/// How much is lost from the driver that plans are made against to the others.
fn loss(cube: &Cube) -> Option<Table> {
    let n = cube.drivers.len();
    if n < 2 {
        return None;
    }
    let rates: Vec<(&str, Vec<Option<Samples>>)> =
        RATES.iter().filter_map(|name| Some((*name, cube.samples(name)?))).collect();
    let mut rows = Vec::new();
    for (attack, name) in cube.attacks.iter().enumerate() {
        for (rate, samples) in &rates {
            let of = |own: bool, drawn: &[usize]| {
                let pairs = (0..n * n).filter(|pair| (pair / n == pair % n) == own);
                mean(pairs.filter_map(|pair| rate_in(samples[attack * n * n + pair].as_ref()?, drawn)))
            };
            let stream = format!("transfer {name} {rate}");
            let estimate = |of: &(dyn Fn(&[usize]) -> f64 + Sync)| {
                of_scenes(cube.results.scenes.len(), &stream, of).map_or("-".to_owned(), |e| points(&e))
            };
            rows.push(vec![
                name.clone(),
                (*rate).to_owned(),
                estimate(&|drawn| of(true, drawn)),
                estimate(&|drawn| of(false, drawn)),
                estimate(&|drawn| of(true, drawn) - of(false, drawn)),
            ]);
        }
    }
    Some(Table {
        title: "What is lost when another driver is tested than the one that the plans are made against, % of the scenes, means over drivers:".to_owned(),
        heads: ["method", "rate", "itself", "another", "lost"].map(str::to_owned).to_vec(),
        rows,
        names: 2,
    })
}

/// Which driver stands in for which: the rate over all methods, and the best other driver for each tested one.
fn stand_ins(cube: &Cube) -> Option<Table> {
    let n = cube.drivers.len();
    let samples = cube.samples(STAND_IN).filter(|_| n > 2)?;
    let of = |made: usize, tested: usize, drawn: &[usize]| {
        let all = (0..cube.attacks.len())
            .filter_map(|attack| rate_in(samples[(attack * n + made) * n + tested].as_ref()?, drawn));
        mean(all)
    };
    let scenes: Vec<usize> = (0..cube.results.scenes.len()).collect();
    let others = |of_driver: usize| (0..n).filter(move |k| *k != of_driver);
    let best = |tested: usize| {
        others(tested).map(|made| (made, of(made, tested, &scenes))).max_by(|a, b| a.1.total_cmp(&b.1))
    };
    let row = |made: usize| {
        let cell = |tested: usize| {
            let mark = if best(tested).is_some_and(|(k, _)| k == made) { " *" } else { "" };
            format!("{:.0}{mark}", 100.0 * of(made, tested, &scenes))
        };
        let to_others = |drawn: &[usize]| mean(others(made).map(|tested| of(made, tested, drawn)));
        let mean = of_scenes(scenes.len(), &format!("stand-in {}", cube.drivers[made]), to_others);
        let cells = (0..n).map(cell).chain([mean.map_or("-".to_owned(), |e| points(&e))]);
        std::iter::once(cube.drivers[made].clone()).chain(cells).collect()
    };
    let heads = cube.drivers.iter().cloned();
    Some(Table {
        title: "Believable attacks in % of the scenes, mean over all methods, by the driver that is tested (columns); * marks the best other driver to make attacks for it:".to_owned(),
        heads: std::iter::once("made against".to_owned())
            .chain(heads)
            .chain(["mean of the others".to_owned()])
            .collect(),
        rows: (0..n).map(row).collect(),
        names: 1,
    })
}

/// Rate in some scenes; `None` if nothing was measured there.
fn rate_in(samples: &Samples, scenes: &[usize]) -> Option<f64> {
    let seed = samples.seeds.first()?;
    let [sum, weight] =
        scenes.iter().fold([0.0; 2], |[sum, weight], k| [sum + seed[*k][0], weight + seed[*k][1]]);
    (weight > 0.0).then(|| sum / weight)
}

fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0.0), |(sum, count), value| (sum + value, count + 1.0));
    if count > 0.0 { sum / count } else { 0.0 }
}

/// A share and its interval in percent.
fn points(e: &Estimate) -> String {
    format!("{:.1} [{:.1}, {:.1}]", 100.0 * e.value, 100.0 * e.low, 100.0 * e.high)
}
