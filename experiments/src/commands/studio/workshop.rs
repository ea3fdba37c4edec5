//! What the page chooses among, and what comes of a choice. Nothing here knows of requests.

use std::{
    borrow::Cow,
    collections::{HashMap, VecDeque},
    sync::{Arc, Mutex, PoisonError},
};

use advsage::{
    Registries,
    ego::Ego,
    generators::{Against, Generators},
    named_generator::{GeneratorSpec, NamedGenerator},
    operating_point::{OperatingPoints, Values},
    part::Part,
    planned_attack::PlannedAttack,
    prepared,
    rows::drive::{DriveRow, RowHead},
    selection::Selection,
};
use anyhow::{Context as _, Result, ensure};
use sage_core::{
    generator::Attack,
    geometry::{Point, distance},
    motion::NOW,
    objective::{Context, ObjectiveSpec},
    scene::{Scene, SceneIndex, Track, TrackKind},
};
use sage_data::Format;
use sage_run::{networks, scenes::Scenes};
use sage_sim::{SimScene, attack_test::AttackTest, traffic::Plan};
use sage_view::{
    player::{self, Panel},
    studio::{DriveData, SceneData},
};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

use super::command_line;
use crate::cli::StudioArgs;

/// Places of the slider, from 0 to 1.
pub(super) const STEPS: usize = 21;
/// Most drives side by side.
const MOST_DRIVERS: usize = 2;
/// Drivers in scenes that are kept ready, the newest first: each holds a scene, a drive and the attacks on it.
const KEPT: usize = 12;

/// What the slider holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Dial {
    Lambda,
    Aggression,
}

impl Dial {
    fn option(self) -> &'static str {
        match self {
            Self::Lambda => "--lambda",
            Self::Aggression => "--aggression",
        }
    }
}

/// Value of a place of the slider, as a user would type it.
fn value(step: usize) -> f64 {
    (step as f64 * 100.0 / (STEPS - 1) as f64).round() / 100.0
}

/// A generator with its dials.
pub(super) struct Method {
    part: Part,
    weights: Option<String>,
    /// Its attacks at all places of each dial; one without places if it depends on none.
    dials: Vec<(Option<Dial>, NamedGenerator)>,
}

impl Method {
    /// Builds a generator.
    ///
    /// *Errors*: the name or the options are wrong; weights cannot be used.
    pub(super) fn of(part: &Part, weights: Option<&str>, seed: u64, registries: &Registries) -> Result<Self> {
        let places = || Some(Values((0..STEPS).map(value).collect()));
        let spec = |points| GeneratorSpec {
            method: Some(part.clone()),
            weights: weights.map(str::to_owned),
            points,
            seed,
            ..GeneratorSpec::default()
        };
        let lambda = OperatingPoints { lambda: places(), ..OperatingPoints::default() };
        let first = spec(lambda).checked(registries)?.build(networks::announce_experts)?;
        let uses_point = first.built.facts.uses_operating_point();
        let mut dials = vec![(uses_point.then_some(Dial::Lambda), first)];
        if uses_point {
            let aggression = OperatingPoints { aggression: places(), ..OperatingPoints::default() };
            // Weights without a dial have no aggression.
            if let Ok(built) = spec(aggression).build(registries) {
                dials.push((Some(Dial::Aggression), built));
            }
        }
        Ok(Self { part: part.clone(), weights: weights.map(str::to_owned), dials })
    }

    fn offered(&self) -> Value {
        let dials: Vec<Dial> = self.dials.iter().filter_map(|(dial, _)| *dial).collect();
        // A goal is a selection, on which some generators do not depend.
        let aims = self.dials[0].1.built.facts.depends_on_mu;
        json!({"name": self.part.to_string(), "dials": dials, "aims": aims})
    }

    fn at(&self, dial: Dial) -> Option<(usize, &NamedGenerator)> {
        let is_it = |known: Option<Dial>| known.is_none_or(|known| known == dial);
        let found = self.dials.iter().enumerate().find(|(_, (known, _))| is_it(*known));
        found.map(|(number, (_, generator))| (number, generator))
    }
}

/// A choice: numbers of what was offered, and road users of the scene.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Wanted {
    scene: usize,
    generator: usize,
    dial: Dial,
    step: usize,
    drivers: Vec<usize>,
    adversary: Option<String>,
    without: Vec<String>,
    goal: Option<Point>,
}

/// Attacks by the numbers of their generator, dial and place.
type Attacks = HashMap<(usize, usize, usize), Attack>;

/// A driver in a scene, after its drive without an attack, with the attacks on it.
struct Ready<'w> {
    key: ReadyKey,
    scene: Arc<Scene>,
    test: AttackTest<'w>,
    ctx: Context,
    attacks: Mutex<Attacks>,
}

#[derive(Clone, Debug, PartialEq, Eq)]
struct ReadyKey {
    scene: usize,
    driver: usize,
    adversary: Option<String>,
    without: Vec<String>,
}

/// Everything that is offered.
pub(super) struct Workshop<'w> {
    scenes: Scenes,
    names: Vec<String>,
    /// Names as the page shows them: without the folder of all.
    labels: Vec<String>,
    /// Seed of procedural scenes; `None` for scenes of files.
    procedural: Option<u64>,
    seed: u64,
    drivers: &'w [Ego],
    methods: Vec<Method>,
    registries: &'w Registries,
    ready: Mutex<VecDeque<Arc<Ready<'w>>>>,
}

/// Paths without the folder in which all of them lie.
fn labels(paths: &[String]) -> Vec<String> {
    let folder = |path: &str| path.rfind('/').map_or(0, |slash| slash + 1);
    let mut shared = paths.first().map_or("", |path| &path[..folder(path)]);
    while let Some(other) = paths.iter().find(|path| !path.starts_with(shared)) {
        let common = shared.bytes().zip(other.bytes()).take_while(|(a, b)| a == b).count();
        shared = &shared[..folder(&shared[..shared.floor_char_boundary(common)])];
    }
    paths.iter().map(|path| path[shared.len()..].to_owned()).collect()
}

/// What is said of a drive.
#[derive(Serialize)]
struct Words {
    driver: String,
    text: String,
    attack: bool,
}

impl<'w> Workshop<'w> {
    /// All that a command line names.
    pub(super) fn new(
        scenes: Scenes,
        args: &StudioArgs,
        drivers: &'w [Ego],
        methods: Vec<Method>,
        registries: &'w Registries,
    ) -> Self {
        let names = scenes.names();
        let labels = labels(&names);
        let procedural = args.scenes.is_empty().then_some(args.seed);
        let seed = args.seed;
        Self {
            scenes,
            names,
            labels,
            procedural,
            seed,
            drivers,
            methods,
            registries,
            ready: Mutex::default(),
        }
    }

    /// What the page chooses among.
    pub(super) fn offered(&self) -> Value {
        let drivers: Vec<&str> = self.drivers.iter().map(|driver| &*driver.label).collect();
        let generators: Vec<Value> = self.methods.iter().map(Method::offered).collect();
        json!({"scenes": self.labels, "generators": generators, "drivers": drivers, "steps": STEPS})
    }

    fn scene(&self, number: usize) -> Result<Arc<sage_core::scene::SceneData>> {
        ensure!(number < self.names.len(), "there is no scene {number}");
        self.scenes.load(number)?.with_context(|| format!("there is no scene `{}`", self.names[number]))
    }

    /// A scene without drives.
    ///
    /// *Errors*: it cannot be read.
    pub(super) fn describe(&self, number: usize) -> Result<Value> {
        let data = self.scene(number)?;
        let scene = &data.scene;
        let can_attack = |id: &str| (**scene).clone().with_roles(None, Some(id)).is_ok();
        // The nearest first.
        let gap = |track: &Track| distance(track.point(NOW), scene.ego().point(NOW));
        let is_shown = |(k, track): &(usize, &Track)| *k != scene.ego && track.is_valid(NOW);
        let mut users: Vec<&Track> =
            scene.tracks.iter().enumerate().filter(is_shown).map(|(_, track)| track).collect();
        users.sort_by(|a, b| gap(a).total_cmp(&gap(b)));
        let users = users.into_iter().map(|track| {
            let is_vehicle = track.kind == TrackKind::Vehicle;
            json!({
                "id": track.id,
                "kind": track.kind.name().to_lowercase(),
                "canAttack": is_vehicle && can_attack(&track.id),
            })
        });
        Ok(json!({
            "data": SceneData::of(scene, &self.labels[number]),
            "users": users.collect::<Vec<_>>(),
            "adversary": scene.adversary.map(|k| &scene.tracks[k].id),
        }))
    }

    /// The drives of a choice. `check` is asked between the stages whether anybody still waits.
    ///
    /// *Errors*: a choice of what was not offered; a scene that cannot be driven or attacked so; those of `check`.
    pub(super) fn drive(&self, wanted: &Wanted, check: &dyn Fn() -> Result<()>) -> Result<Value> {
        ensure!(
            !wanted.drivers.is_empty() && wanted.drivers.len() <= MOST_DRIVERS,
            "choose one or two drivers"
        );
        ensure!(wanted.step < STEPS, "there is no place {} of the slider", wanted.step);
        let mut drives = Vec::new();
        for &driver in &wanted.drivers {
            check()?;
            let ready = self.ready(wanted, driver)?;
            check()?;
            drives.push(self.driven(wanted, driver, ready)?);
        }
        let panels: Vec<Panel> = drives.iter().map(Driven::panel).collect();
        let words = drives.iter().map(|driven| Words {
            driver: self.drivers[driven.driver].label.clone(),
            text: format!("{}. {}", driven.row.ending(), driven.row.note()),
            attack: driven.row.verdict().is_some_and(|verdict| verdict.is_attack),
        });
        let scene = &drives[0].ready.scene;
        Ok(json!({
            "drives": DriveData::of(scene, &panels, &[]),
            "words": words.collect::<Vec<_>>(),
            "adversary": scene.adversary()?.id,
            "command": self.command(wanted),
        }))
    }

    /// A driver in a scene, ready to be attacked.
    fn ready(&self, wanted: &Wanted, driver: usize) -> Result<Arc<Ready<'w>>> {
        let mut without = wanted.without.clone();
        without.sort();
        without.dedup();
        let key = ReadyKey { scene: wanted.scene, driver, adversary: wanted.adversary.clone(), without };
        let lock = || self.ready.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(found) = lock().iter().find(|ready| ready.key == key) {
            return Ok(found.clone());
        }
        let ego = self.drivers.get(driver).with_context(|| format!("there is no driver {driver}"))?;
        let scene = (*self.scene(wanted.scene)?.scene).clone();
        let scene = Arc::new(scene.without(&key.without)?.with_roles(None, key.adversary.as_deref())?);
        let simulated = SimScene::new(scene.clone(), SceneIndex::new(scene.map.clone()))?;
        let test = AttackTest::new(&*ego.policy, &simulated, self.seed);
        let test = test.with_context(|| format!("the policy `{}` cannot drive here", ego.label))?;
        let ctx = prepared::drive(&test)?;
        let ready = Arc::new(Ready { key, scene, test, ctx, attacks: Mutex::default() });
        let mut all = lock();
        all.push_front(ready.clone());
        all.truncate(KEPT);
        Ok(ready)
    }

    /// The attack of a choice, as `sage simulate` plans it.
    fn attack(&self, wanted: &Wanted, ready: &Ready) -> Result<Attack> {
        let method = self.methods.get(wanted.generator);
        let method = method.with_context(|| format!("there is no generator {}", wanted.generator))?;
        let (dial, generator) = method.at(wanted.dial).context("this generator has no such dial")?;
        let against = Against::Driver(&ready.test);
        let number = if generator.built.facts.uses_operating_point() { wanted.step } else { 0 };
        if let Some(goal) = wanted.goal {
            let selection = serde_json::to_string(&ObjectiveSpec::ends_near(goal))?;
            let selection = Selection::of(self.registries, &selection, None)?;
            let spec = &generator.spec;
            let generators = Generators::new(self.registries, &spec.merger, &selection, spec.seed)?;
            let generators = match &generator.weights {
                Some(weights) => generators.with_experts(&weights.experts),
                None => generators,
            };
            let built = generators.build(&generator.method, &generator.points[number..=number])?;
            let attacks = built.planned(&ready.ctx, against, spec.seed)?;
            return attacks.into_iter().next().context("the generator gave no attack");
        }
        let key = (wanted.generator, dial, number);
        let lock = || ready.attacks.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(known) = lock().get(&key) {
            return Ok(known.clone());
        }
        let (built, point) = (&generator.built, &generator.built.points[number..=number]);
        let attacks = built.planned_at(&ready.ctx, against, point, generator.spec.seed)?;
        let attack = attacks.into_iter().next().context("the generator gave no attack")?;
        lock().insert(key, attack.clone());
        Ok(attack)
    }

    fn driven(&self, wanted: &Wanted, driver: usize, ready: Arc<Ready<'w>>) -> Result<Driven<'w>> {
        let attack = self.attack(wanted, &ready)?;
        attack.check(ready.ctx.scene())?;
        let planned = PlannedAttack::of(&ready.ctx, ready.test.path_of(&attack)?).extended(attack.extension);
        let outcome = ready.test.attack_along(planned.path.clone(), planned.feasible)?;
        let plan = Plan::of_adversary(&ready.scene, &planned.path.trajectory)?;
        let row = planned.row(outcome.verdict, &outcome.episode, ready.test.unattacked())?;
        let head = RowHead {
            run_hash: "",
            scene: &self.labels[wanted.scene],
            ego: &self.drivers[driver].label,
            generated: None,
            source_hash: "",
            seed: self.seed,
        };
        let row = DriveRow::new(head, &outcome.episode, &ready.scene, Some(row));
        Ok(Driven {
            driver,
            ready,
            plan,
            episode: outcome.episode,
            row,
            label: self.drivers[driver].label.clone(),
        })
    }

    /// The command that makes the same drives.
    fn command(&self, wanted: &Wanted) -> String {
        let name = &*self.names[wanted.scene];
        let file = match self.procedural {
            None => Cow::Borrowed(name),
            Some(_) => Cow::Owned(format!("invented/{name}.{}", Format::Native.ending())),
        };
        let mut words: Vec<Cow<str>> = vec!["sage".into(), "simulate".into(), file];
        let mut add = |option: &'static str, value: String| words.extend([option.into(), value.into()]);
        for driver in &wanted.drivers {
            add("--ego", self.drivers[*driver].label.clone());
        }
        let method = &self.methods[wanted.generator];
        add("--method", method.part.to_string());
        if let Some(weights) = &method.weights {
            add("--weights", weights.clone());
        }
        if method.dials[0].0.is_some() {
            add(wanted.dial.option(), value(wanted.step).to_string());
        }
        if let Some(adversary) = &wanted.adversary {
            add("--adversary", adversary.clone());
        }
        if !wanted.without.is_empty() {
            add("--without", wanted.without.join(","));
        }
        if let Some([x, y]) = wanted.goal {
            add("--goal", format!("{x},{y}"));
        }
        if self.seed != 0 {
            add("--seed", self.seed.to_string());
        }
        add("--out", "drives".to_owned());
        let command = command_line::quoted(words);
        match self.procedural {
            None => command,
            Some(seed) => {
                let count = wanted.scene + 1;
                format!("sage scenes --count {count} --seed {seed} --out invented --force\n{command}")
            }
        }
    }
}

/// One drive of a choice.
struct Driven<'w> {
    driver: usize,
    label: String,
    ready: Arc<Ready<'w>>,
    plan: Plan,
    episode: sage_sim::episode::Episode,
    row: DriveRow,
}

impl Driven<'_> {
    fn panel(&self) -> Panel<'_> {
        let unattacked = player::shown_part(self.ready.test.unattacked());
        self.row.panel(self.label.clone(), &self.episode, Some(&self.plan.motion), Some(unattacked))
    }
}

#[cfg(test)]
mod tests {
    use super::labels;

    #[test]
    fn scenes_are_shown_without_the_folder_that_they_share() {
        let of = |paths: &[&str]| labels(&paths.iter().map(|path| (*path).to_owned()).collect::<Vec<_>>());
        assert_eq!(of(&["/a/b/1.pkl", "/a/b/2.pkl"]), ["1.pkl", "2.pkl"]);
        assert_eq!(of(&["/a/bc/1.pkl", "/a/bd/x/2.pkl"]), ["bc/1.pkl", "bd/x/2.pkl"]);
        assert_eq!(of(&["/é/1.pkl", "/è/2.pkl"]), ["é/1.pkl", "è/2.pkl"]);
        assert_eq!(of(&["x.pkl", "/a/y.pkl"]), ["x.pkl", "/a/y.pkl"]);
        assert_eq!(of(&["four-way-1-0"]), ["four-way-1-0"]);
        assert!(of(&[]).is_empty());
    }
}
