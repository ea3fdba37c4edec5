//! What the page chooses among, and what comes of a choice. Nothing here knows of requests.

use std::{
    collections::{HashMap, VecDeque},
    sync::{Arc, Mutex},
};

use advsage::{
    Registries,
    ego::Ego,
    generators::{BuiltGenerator, Generators},
    named_generator::NamedGenerator,
    named_search::NamedSearch,
    prepared::DriverInScene,
    rows::failure::FailureRow,
    selection::Selection,
};
use anyhow::{Context as _, Result, ensure};
use sage_core::{
    generator::{Attack, PreparedProposer, Proposal},
    geometry::{Point, distance},
    motion::NOW,
    objective::ObjectiveSpec,
    scene::{Scene, SceneData, SceneIndex, Track, TrackKind},
};
use sage_run::scenes::Scenes;
use sage_sim::SimScene;
use sage_view::studio::{ShownScene, thumbnail};
use serde_json::{Value, json};

use super::{
    choice::Choice,
    keeper::Keeper,
    locked::locked,
    method::{Dial, Method, STEPS},
};

/// Drivers in scenes that are kept ready, the last used first: each holds a scene, a drive and the attacks on it.
const KEPT: usize = 12;

/// A driver in a scene, after its drive without an attack.
pub(super) struct Ready<'w> {
    key: ReadyKey,
    pub(super) driver: DriverInScene<'w>,
    /// What the attacks of each generator share: the scene is encoded once.
    prepared: Mutex<HashMap<usize, Option<Arc<dyn PreparedProposer>>>>,
    attacks: Mutex<HashMap<AttackKey, PlannedOnce>>,
    /// The attack that was asked for last.
    last: Mutex<Option<AttackKey>>,
    /// What the newest search found.
    pub(super) found: Mutex<FoundFailures>,
}

/// What a search found.
#[derive(Default)]
pub(super) struct FoundFailures {
    /// Number of the search.
    pub(super) search: usize,
    pub(super) rows: Vec<FailureRow>,
}

impl Ready<'_> {
    pub(super) fn scene(&self) -> &Arc<Scene> {
        self.driver.test.scene()
    }

    /// Number of the driver.
    pub(super) fn number(&self) -> usize {
        self.key.driver
    }
}

/// Numbers of a generator, its dial and a place of it.
type AttackKey = (usize, Dial, usize);

/// An attack once it is planned: who asks for it meanwhile waits.
type PlannedOnce = Arc<Mutex<Option<Attack>>>;

/// What tells drivers in scenes apart.
#[derive(Clone, Debug, PartialEq, Eq)]
struct ReadyKey {
    scene: usize,
    driver: usize,
    adversary: Option<String>,
    without: Vec<String>,
}

/// Everything that is offered.
pub(super) struct Workshop<'w> {
    pub(super) scenes: Scenes,
    pub(super) names: Vec<String>,
    /// Names as the page shows them: without the folder of all.
    pub(super) labels: Vec<String>,
    /// Seed of procedural scenes; `None` for scenes of files.
    pub(super) procedural: Option<u64>,
    pub(super) seed: u64,
    /// Drives of a search.
    pub(super) budget: usize,
    pub(super) drivers: &'w [Ego],
    pub(super) methods: Vec<Method>,
    /// A search for each of the weights.
    pub(super) searches: Vec<NamedSearch>,
    /// Where failures are kept; `None` if nothing is written.
    pub(super) keeper: Option<Keeper>,
    pub(super) registries: &'w Registries,
    pub(super) ready: Mutex<VecDeque<Arc<Ready<'w>>>>,
}

/// An attack without the candidates that were not selected.
fn selected(mut attack: Attack) -> Attack {
    attack.candidates = vec![attack.candidates.swap_remove(attack.chosen)];
    attack.chosen = 0;
    attack
}

/// Paths without the folder in which all of them lie.
pub(super) fn labels(paths: &[String]) -> Vec<String> {
    let folder = |path: &str| path.rfind('/').map_or(0, |slash| slash + 1);
    let mut shared = paths.first().map_or("", |path| &path[..folder(path)]);
    while let Some(other) = paths.iter().find(|path| !path.starts_with(shared)) {
        let common = shared.bytes().zip(other.bytes()).take_while(|(a, b)| a == b).count();
        shared = &shared[..folder(&shared[..shared.floor_char_boundary(common)])];
    }
    paths.iter().map(|path| path[shared.len()..].to_owned()).collect()
}

impl<'w> Workshop<'w> {
    /// What the page chooses among.
    pub(super) fn offered(&self) -> Value {
        let driver = |driver: &Ego| json!({"name": driver.label, "isProgram": driver.is_program});
        let drivers: Vec<Value> = self.drivers.iter().map(driver).collect();
        let generators: Vec<Value> = self.methods.iter().map(Method::offered).collect();
        json!({
            "scenes": self.labels,
            "generators": generators,
            "drivers": drivers,
            "steps": STEPS,
            "budget": self.budget,
            "keeps": self.keeper.is_some(),
        })
    }

    fn scene(&self, number: usize) -> Result<Arc<SceneData>> {
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
            "data": ShownScene::of(scene, &self.labels[number]),
            "users": users.collect::<Vec<_>>(),
            "adversary": scene.adversary.map(|k| &scene.tracks[k].id),
        }))
    }

    /// The picture of a scene in the list, as SVG.
    ///
    /// *Errors*: it cannot be read.
    pub(super) fn thumbnail(&self, number: usize) -> Result<Value> {
        Ok(json!({"svg": thumbnail(&self.scene(number)?.scene)}))
    }

    /// A driver in the scene of a choice, ready to be attacked.
    ///
    /// *Errors*: a choice of what was not offered; a scene in which it cannot drive, or that cannot be attacked so.
    pub(super) fn ready(&self, choice: &Choice, driver: usize) -> Result<Arc<Ready<'w>>> {
        let key = ReadyKey {
            scene: choice.scene,
            driver,
            adversary: choice.adversary.clone(),
            without: choice.sorted_without(),
        };
        let mut all = locked(&self.ready);
        if let Some(place) = all.iter().position(|ready| ready.key == key)
            && let Some(ready) = all.remove(place)
        {
            all.push_front(ready.clone());
            return Ok(ready);
        }
        drop(all);
        let ego = self.drivers.get(driver).with_context(|| format!("there is no driver {driver}"))?;
        let scene = (*self.scene(choice.scene)?.scene).clone();
        let scene = Arc::new(scene.without(&key.without)?.with_roles(None, key.adversary.as_deref())?);
        let simulated = SimScene::new(scene.clone(), SceneIndex::new(scene.map.clone()))?;
        let failed = || format!("the policy `{}` cannot drive here", ego.label);
        let driver = DriverInScene::new(&simulated, |scene| {
            ego.test(scene, self.seed).map_err(|error| advsage::Error::from(error).within(failed()))
        })?;
        let ready = Arc::new(Ready {
            key,
            driver,
            prepared: Mutex::default(),
            attacks: Mutex::default(),
            last: Mutex::default(),
            found: Mutex::default(),
        });
        let mut all = locked(&self.ready);
        all.push_front(ready.clone());
        all.truncate(KEPT);
        Ok(ready)
    }

    /// The generator of a choice with all its dials.
    ///
    /// *Errors*: there is no such generator.
    pub(super) fn method(&self, choice: &Choice) -> Result<&Method> {
        let method = self.methods.get(choice.generator);
        method.with_context(|| format!("there is no generator {}", choice.generator))
    }

    /// The search with the weights of a choice.
    ///
    /// *Errors*: as [`Workshop::method`].
    pub(super) fn search_of(&self, choice: &Choice) -> Result<&NamedSearch> {
        Ok(&self.searches[self.method(choice)?.search])
    }

    /// The generator of a choice at the places of its dial, and the number of the chosen one.
    ///
    /// *Errors*: there is no such generator, or it has no such dial.
    pub(super) fn generator(&self, choice: &Choice) -> Result<(&NamedGenerator, usize)> {
        let method = self.method(choice)?;
        let generator = method.at(choice.dial).context("this generator has no such dial")?;
        Ok((generator, if method.has_dial() { choice.step } else { 0 }))
    }

    /// The attack of a choice, as `sage simulate` plans it.
    ///
    /// *Errors*: a choice of what was not offered; those of the generator.
    pub(super) fn attack(&self, choice: &Choice, ready: &Ready) -> Result<Attack> {
        if let Some(found) = &choice.found {
            let FailureRow { head, trajectory, .. } = self.found(choice, found)?;
            let own = &ready.scene().adversary()?.id;
            ensure!(head.adversary == *own, "that failure is of the adversary `{}`", head.adversary);
            return Ok(Attack::of(vec![Proposal::of(trajectory)], 0, None));
        }
        let (generator, number) = self.generator(choice)?;
        let (driver, seed) = (&ready.driver, generator.spec.seed);
        let prepared = self.prepared(choice.generator, generator, ready)?;
        if let Some(goal) = choice.goal {
            let built = self.aimed(generator, goal, number)?;
            return Ok(built.planned_at(&driver.ctx, &driver.test, prepared.as_deref(), 0, seed)?);
        }
        let key = (choice.generator, choice.dial, number);
        let planned = locked(&ready.attacks).entry(key).or_default().clone();
        let mut planned = locked(&planned);
        if planned.is_none() {
            let prepared = prepared.as_deref();
            let attack = generator.built.planned_at(&driver.ctx, &driver.test, prepared, number, seed)?;
            *planned = Some(selected(attack));
        }
        planned.clone().context("the attack was planned")
    }

    /// Plans the attacks of the place to which a slider goes on from a choice, while its drives are drawn.
    pub(super) fn plan_ahead(&self, choice: &Choice, check: &dyn Fn() -> Result<()>) -> Result<()> {
        // A program is asked only for what a person asks.
        let is_own = |driver: &&usize| self.drivers.get(**driver).is_some_and(|driver| !driver.is_program);
        for &driver in choice.drivers.iter().filter(is_own) {
            let ready = self.ready(choice, driver)?;
            let key = (choice.generator, choice.dial, choice.step);
            let before = locked(&ready.last).replace(key);
            let Some((_, _, last)) = before.filter(|before| (before.0, before.1) == (key.0, key.1)) else {
                continue;
            };
            let step =
                (2 * choice.step).checked_sub(last).filter(|step| *step < STEPS && *step != choice.step);
            if let Some(step) = step.filter(|_| choice.found.is_none() && choice.goal.is_none()) {
                check()?;
                self.attack(&Choice { step, ..choice.clone() }, &ready)?;
            }
        }
        Ok(())
    }

    /// What the attacks of a generator in a scene share.
    fn prepared(
        &self,
        number: usize,
        generator: &NamedGenerator,
        ready: &Ready,
    ) -> Result<Option<Arc<dyn PreparedProposer>>> {
        if let Some(known) = locked(&ready.prepared).get(&number) {
            return Ok(known.clone());
        }
        let prepared = generator.built.prepare(&ready.driver.ctx)?.map(Arc::from);
        locked(&ready.prepared).insert(number, prepared.clone());
        Ok(prepared)
    }

    /// A generator that selects the plan that ends nearest to a goal, at one of its places.
    fn aimed(&self, generator: &NamedGenerator, goal: Point, number: usize) -> Result<BuiltGenerator> {
        let selection = serde_json::to_string(&ObjectiveSpec::ends_near(goal))?;
        let selection = Selection::of(self.registries, &selection, None)?;
        let spec = &generator.spec;
        let generators = Generators::new(self.registries, &spec.merger, &selection, spec.seed)?;
        let generators = match &generator.weights {
            Some(weights) => generators.with_experts(&weights.experts),
            None => generators,
        };
        Ok(generators.build(&generator.method, &generator.points[number..=number])?)
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
