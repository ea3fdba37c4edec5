//! The results of a study: one value for each metric of each result in each scene.

mod key;

use std::{
    collections::{BTreeMap, HashMap},
    fmt,
    sync::OnceLock,
};

use sage_core::{
    metric::{Aggregate, Better, MetricInfo, TwoSamples},
    text,
};
use serde::{Deserialize, Serialize};

pub use key::{Key, Subject};

use crate::estimate::Samples;

/// Values of one result in one scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cell {
    /// Number of its key.
    pub key: usize,
    /// The agent, where a scene has several.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub agent: String,
    /// Values of the metrics of its subject, `None` where not measured; empty if it failed.
    pub values: Vec<Option<f64>>,
    /// Words about values, by the number of the metric.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub notes: Vec<(usize, String)>,
    /// Why there are no values.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub error: String,
}

impl Cell {
    /// A result that could not be measured.
    pub fn failed(key: usize, error: impl fmt::Display) -> Self {
        Self { key, agent: String::new(), values: Vec::new(), notes: Vec::new(), error: error.to_string() }
    }
}

/// A metric as a study's record describes it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MetricRecord {
    /// Name.
    pub name: String,
    /// Unit; may be empty.
    pub unit: String,
    /// Description.
    pub summary: String,
    /// How scenes are averaged.
    pub aggregate: Aggregate,
    /// `more`, `less` or `neither` is better.
    pub better: String,
    /// Metric that weighs the scenes.
    pub weight: Option<String>,
}

impl From<&MetricInfo> for MetricRecord {
    fn from(info: &MetricInfo) -> Self {
        Self {
            name: info.name.to_string(),
            unit: info.unit.to_string(),
            summary: info.summary.to_string(),
            aggregate: info.aggregate,
            better: match info.better {
                Better::More => "more",
                Better::Less => "less",
                Better::Neither => "neither",
            }
            .to_owned(),
            weight: info.weight.as_ref().map(ToString::to_string),
        }
    }
}

impl MetricRecord {
    /// Head of its column.
    pub fn head(&self) -> String {
        match (self.aggregate, &*self.unit) {
            (Aggregate::Share, "") => format!("{} %", self.name),
            (_, "") => self.name.clone(),
            (_, unit) => format!("{}, {unit}", self.name),
        }
    }
}

/// The results of a study.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Results {
    /// Name of the study.
    pub study: String,
    /// Keys of all results.
    pub keys: Vec<Key>,
    /// Metrics by what they are of.
    pub metrics: BTreeMap<Subject, Vec<MetricRecord>>,
    /// Names of the scenes.
    pub scenes: Vec<String>,
    /// Cells of each scene.
    pub cells: Vec<Vec<Cell>>,
    /// The first key of the method of each key, once it was asked for.
    pub methods: MethodOfKeys,
}

/// Numbers of methods by key. They follow from the keys, so results do not differ by them.
#[derive(Clone, Debug, Default)]
pub struct MethodOfKeys(OnceLock<Vec<usize>>);

impl PartialEq for MethodOfKeys {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

/// Heads of the columns of `rows.csv`.
pub const HEADS: [&str; 20] = [
    "study",
    "subject",
    "arm",
    "training_seed",
    "checkpoint",
    "attack",
    "lambda",
    "mu",
    "aggression",
    "mixture",
    "target",
    "seed",
    "scene",
    "agent",
    "metric",
    "unit",
    "value",
    "note",
    "error",
    "key",
];

impl Results {
    /// The metrics of a subject.
    pub fn metrics_of(&self, subject: Subject) -> &[MetricRecord] {
        self.metrics.get(&subject).map_or(&[], |all| all)
    }

    /// Number of a metric of a subject.
    pub fn metric(&self, subject: Subject, name: &str) -> Option<usize> {
        self.metrics_of(subject).iter().position(|metric| metric.name == name)
    }

    /// The first key of each method with a subject, in their order.
    pub fn methods(&self, subject: Subject) -> Vec<usize> {
        let first = |k: &usize| self.keys[*k].subject == subject && self.method_of(*k) == *k;
        (0..self.keys.len()).filter(first).collect()
    }

    /// The first key of the same method as a key.
    fn method_of(&self, key: usize) -> usize {
        let methods = self.methods.0.get_or_init(|| {
            let mut firsts: HashMap<_, Vec<usize>> = HashMap::new();
            let mut methods = Vec::with_capacity(self.keys.len());
            for (k, key) in self.keys.iter().enumerate() {
                let point = key.point.as_ref().map(|point| format!("{point:?}"));
                let alike = firsts.entry((key.subject, &*key.arm, &*key.attack, point)).or_default();
                let first = alike.iter().find(|first| self.keys[**first].is_same_method(key)).copied();
                if first.is_none() {
                    alike.push(k);
                }
                methods.push(first.unwrap_or(k));
            }
            methods
        });
        methods[key]
    }

    /// The values of a metric for the method of a key: scenes in their order, seeds apart, the checkpoints of a seed
    /// and the agents of a scene together.
    pub fn samples(&self, method: usize, metric: usize) -> Samples {
        let of = &self.keys[method];
        let weight = self.metrics_of(of.subject)[metric].weight.as_deref();
        let weight = weight.and_then(|name| self.metric(of.subject, name));
        let mut seeds: Vec<Option<u64>> = Vec::new();
        // Number of the seed of each key that belongs to the method.
        let of_key: Vec<Option<usize>> = (self.keys.iter().enumerate())
            .map(|(k, key)| {
                (self.method_of(k) == self.method_of(method)).then(|| {
                    seeds.iter().position(|known| *known == key.training_seed).unwrap_or_else(|| {
                        seeds.push(key.training_seed);
                        seeds.len() - 1
                    })
                })
            })
            .collect();
        let mut sums = vec![vec![[0.0; 2]; self.scenes.len()]; seeds.len()];
        let mut values = vec![Vec::new(); self.scenes.len()];
        let is_pooled = self.metrics_of(of.subject)[metric].aggregate == Aggregate::Pooled;
        let pools = if is_pooled { seeds.len() } else { 0 };
        let mut pools = vec![vec![TwoSamples::default(); self.scenes.len()]; pools];
        for (scene, cells) in self.cells.iter().enumerate() {
            for cell in cells {
                let Some(seed) = of_key[cell.key] else { continue };
                let Some(Some(value)) = cell.values.get(metric) else { continue };
                if let Some(pool) = pools.get_mut(seed) {
                    let note = cell.notes.iter().find(|(of, _)| *of == metric);
                    let Some(samples) = note.and_then(|(_, text)| TwoSamples::parse(text)) else { continue };
                    pool[scene].append(samples);
                }
                let weight = weight.map_or(1.0, |k| cell.values[k].unwrap_or(0.0));
                let sum = &mut sums[seed][scene];
                *sum = [sum[0] + weight * value, sum[1] + weight];
                values[scene].push(*value);
            }
        }
        let has_agents = self.cells.iter().flatten().any(|cell| cell.key == method && !cell.agent.is_empty());
        let agents = has_agents.then(|| values.iter().map(Vec::len).sum());
        let training_seeds = seeds.into_iter().flatten().collect();
        Samples { seeds: sums, training_seeds, values, agents, ..Samples::default() }.with_pools(&pools)
    }

    /// Number of scenes in which the method of a key failed.
    pub fn failure_count(&self, method: usize) -> usize {
        let is_of = |cell: &Cell| self.method_of(cell.key) == self.method_of(method);
        let failed = |cells: &&Vec<Cell>| cells.iter().any(|cell| is_of(cell) && !cell.error.is_empty());
        self.cells.iter().filter(failed).count()
    }

    /// Heads of the columns of [`Results::rows`]: [`HEADS`], and the driver that plans were made against, where there is one.
    pub fn heads(&self) -> Vec<String> {
        let made_against = self.is_transfer().then_some("made_against");
        HEADS.into_iter().chain(made_against).map(str::to_owned).collect()
    }

    fn is_transfer(&self) -> bool {
        self.keys.iter().any(|key| !key.made_against.is_empty())
    }

    /// All rows: the columns of [`Results::heads`].
    pub fn rows(&self) -> impl Iterator<Item = Vec<String>> {
        let of_scene = move |(scene, cells): (&'_ String, &'_ Vec<Cell>)| {
            cells.iter().flat_map(|cell| self.rows_of(scene, cell)).collect::<Vec<_>>()
        };
        self.scenes.iter().zip(&self.cells).flat_map(of_scene)
    }

    fn rows_of(&self, scene: &str, cell: &Cell) -> Vec<Vec<String>> {
        let key = &self.keys[cell.key];
        let number = |x: Option<f64>| x.map_or(String::new(), |x| x.to_string());
        let whole = |x: Option<u64>| x.map_or(String::new(), |x| x.to_string());
        let plain = |text: &str| text::escaped_name(text);
        let point = key.point.as_ref();
        let mixture = point.map(|p| p.mix.iter().map(|(name, w)| format!("{name}={w}")).collect::<Vec<_>>());
        let head = [
            plain(&self.study),
            key.subject.name().to_owned(),
            plain(&key.arm),
            whole(key.training_seed),
            whole(key.checkpoint),
            plain(&key.attack),
            number(point.and_then(|p| p.lambda)),
            number(point.map(|p| p.mu)),
            number(point.and_then(|p| p.aggression)),
            mixture.unwrap_or_default().join(","),
            number(key.target),
            key.seed.to_string(),
            plain(scene),
            plain(&cell.agent),
        ];
        let made_against = self.is_transfer().then(|| plain(&key.made_against));
        let row = |metric: &str, unit: &str, value: &str, note: &str, error: &str| {
            let tail = [metric, unit, value, note, error].map(str::to_owned);
            let last = std::iter::once(cell.key.to_string()).chain(made_against.clone());
            head.iter().cloned().chain(tail).chain(last).collect::<Vec<_>>()
        };
        if !cell.error.is_empty() {
            return vec![row("", "", "", "", &plain(&cell.error))];
        }
        let metrics = self.metrics_of(key.subject).iter().zip(&cell.values).enumerate();
        let rows = metrics.map(|(k, (metric, value))| {
            let note = cell.notes.iter().find(|(of, _)| *of == k).map_or("", |(_, note)| note);
            row(&metric.name, &metric.unit, &number(*value), &plain(note), "")
        });
        rows.collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(name: &str, aggregate: Aggregate, weight: Option<&str>) -> MetricRecord {
        MetricRecord {
            name: name.to_owned(),
            unit: String::new(),
            summary: String::new(),
            aggregate,
            better: "more".to_owned(),
            weight: weight.map(str::to_owned),
        }
    }

    /// Two seeds with two checkpoints each, in two scenes; speed weighs by steps.
    fn results() -> Results {
        let key = |seed, checkpoint| Key {
            training_seed: Some(seed),
            checkpoint: Some(checkpoint),
            ..Key::new(Subject::Episode, "td3", 0)
        };
        let cell = |key, values: [f64; 2]| Cell {
            key,
            agent: String::new(),
            values: values.map(Some).to_vec(),
            notes: vec![(0, "a, \"b\"".to_owned())],
            error: String::new(),
        };
        Results {
            methods: MethodOfKeys::default(),
            study: "example".to_owned(),
            keys: vec![key(1, 10), key(1, 20), key(2, 10), key(2, 20)],
            metrics: BTreeMap::from([(
                Subject::Episode,
                vec![record("speed", Aggregate::Mean, Some("steps")), record("steps", Aggregate::Mean, None)],
            )]),
            scenes: vec!["a".to_owned(), "b".to_owned()],
            cells: vec![
                vec![
                    cell(0, [2.0, 10.0]),
                    cell(1, [4.0, 30.0]),
                    cell(2, [1.0, 1.0]),
                    Cell::failed(3, "no road"),
                ],
                vec![cell(0, [6.0, 20.0]), cell(2, [1.0, 1.0])],
            ],
        }
    }

    #[test]
    fn checkpoints_of_a_seed_are_one_sample_of_it() {
        let results = results();
        assert_eq!(results.methods(Subject::Episode), [0]);
        let samples = results.samples(0, 0);
        // Scene a, seed 1: 2 · 10 + 4 · 30 over 40 steps.
        assert_eq!(samples.seeds, [[[140.0, 40.0], [120.0, 20.0]], [[1.0, 1.0], [1.0, 1.0]]]);
        assert_eq!(samples.training_seeds, [1, 2]);
        assert_eq!(results.failure_count(0), 1);
    }

    #[test]
    fn rows_hold_every_value_and_every_failure() {
        let rows: Vec<Vec<String>> = results().rows().collect();
        assert_eq!(rows.len(), 11);
        assert!(rows.iter().all(|row| row.len() == HEADS.len()));
        let at = |row: &[String], head: &str| row[HEADS.iter().position(|h| *h == head).unwrap()].clone();
        assert_eq!(
            ["scene", "metric", "value", "note"].map(|h| at(&rows[0], h)),
            ["a", "speed", "2", "a, \"b\""]
        );
        assert_eq!(["scene", "metric", "value", "error"].map(|h| at(&rows[6], h)), ["a", "", "", "no road"]);
    }
}
