//! The policy of a planner of Python: drives that ask it.

use std::{
    collections::{BTreeMap, VecDeque},
    sync::{Arc, Mutex, PoisonError},
    thread::ThreadId,
};

use pyo3::prelude::*;
use sage_sim::{
    Error,
    policy::{
        Driver, EgoPolicy, OtherWay, Shown, Start, View,
        planner::{AGENTS, Answer, Asks, Follower, StepBefore, ToldScene, ToldStep},
    },
    world::Control,
};

use crate::{
    observation::HISTORY,
    planner::{Asked, Planner},
    together::Questions,
};

/// Objects that drive, with their threads. An object keeps what its drive needs, so two threads would drive with a mixture.
static DRIVING: Mutex<BTreeMap<usize, (ThreadId, usize)>> = Mutex::new(BTreeMap::new());

/// An object that drives in this thread.
struct Busy(usize);

impl Busy {
    /// Takes an object for this thread.
    ///
    /// *Errors*: another thread drives with it.
    fn of(address: usize) -> Result<Self, String> {
        let thread = std::thread::current().id();
        let mut all = DRIVING.lock().unwrap_or_else(PoisonError::into_inner);
        let (owner, drives) = all.entry(address).or_insert((thread, 0));
        if *owner != thread {
            return Err(
                "it drives in another thread at the same time; give each thread a planner of its own"
                    .to_owned(),
            );
        }
        *drives += 1;
        Ok(Self(address))
    }
}

impl Drop for Busy {
    fn drop(&mut self) {
        let mut all = DRIVING.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((_, drives)) = all.get_mut(&self.0) {
            *drives -= 1;
            if *drives == 0 {
                all.remove(&self.0);
            }
        }
    }
}

/// How the drives of a policy reach their planner.
#[derive(Clone)]
pub(crate) enum Way {
    /// By a call: the drive is on the caller's thread.
    Call(Arc<Planner>),
    /// By a question to the caller's thread.
    Question(Arc<Planner>, Questions),
}

impl Way {
    fn planner(&self) -> &Planner {
        match self {
            Self::Call(planner) | Self::Question(planner, _) => planner,
        }
    }
}

/// The policy of a planner, which follows its plans by one of the ways that it offers.
pub(crate) struct PlannerPolicy {
    way: Way,
    asks: Asks,
}

impl PlannerPolicy {
    pub(crate) fn new(way: Way) -> Self {
        let planner = way.planner();
        let asks =
            Asks { goal: planner.wants_goal, follow: planner.follows.first().cloned(), ..Asks::default() };
        Self { way, asks }
    }
}

impl EgoPolicy for PlannerPolicy {
    fn other_ways(&self) -> Result<Vec<OtherWay>, Error> {
        let follows = self.way.planner().follows.iter();
        let others = follows.filter(|follow| self.asks.follow.as_ref() != Some(*follow));
        let other = |follow: &String| {
            let asks = Asks { follow: Some(follow.clone()), ..self.asks.clone() };
            OtherWay { name: follow.clone(), policy: Box::new(Self { way: self.way.clone(), asks }) }
        };
        Ok(others.map(other).collect())
    }

    fn start(&self, start: &Start) -> Result<Box<dyn Driver>, Error> {
        Ok(Box::new(PlannerDriver {
            way: self.way.clone(),
            asks: self.asks.clone(),
            before: StepBefore::default(),
            scene_id: start.scene_id().to_owned(),
            seed: start.seed(),
            told: None,
            scene: None,
            busy: None,
            follower: Follower::default(),
            frames: VecDeque::with_capacity(HISTORY),
            shown: None,
        }))
    }
}

/// A drive of a planner.
struct PlannerDriver {
    way: Way,
    asks: Asks,
    before: StepBefore,
    scene_id: String,
    seed: u64,
    told: Option<Arc<ToldScene>>,
    /// The scene as the planner got it, if it is called here.
    scene: Option<Py<PyAny>>,
    /// Keeps other threads from driving with the same object meanwhile.
    busy: Option<Busy>,
    follower: Follower,
    /// The last frames, with whether it was asked then.
    frames: VecDeque<(Arc<ToldStep>, bool)>,
    shown: Option<Shown>,
}

impl Driver for PlannerDriver {
    fn control(&mut self, view: &View) -> Result<Control, Error> {
        let control = self.next(view).map_err(|problem| Error::Planner {
            scene: self.scene_id.clone(),
            step: Some(view.step()),
            is_late: false,
            problem: format!("the planner `{}` failed: {problem}", self.way.planner().name),
            log: sage_sim::PlannerLog::default(),
            drive: None,
        })?;
        self.before = StepBefore::of(view, &control);
        Ok(control)
    }

    fn shown(&mut self) -> Option<Shown> {
        self.shown.take()
    }

    fn boxed_clone(&self) -> Result<Box<dyn Driver>, Error> {
        let name = &self.way.planner().name;
        Err(Error::Clone {
            problem: format!("the planner `{name}` is an object of Python, whose state is not copied"),
        })
    }
}

impl PlannerDriver {
    /// The control of the next step.
    fn next(&mut self, view: &View) -> Result<Control, String> {
        if let Some(control) = self.follower.kept(view)? {
            self.remember(view, false);
            return Ok(control);
        }
        let answer = self.answer(view)?;
        let (control, plan) = self.follower.follow(view, answer)?;
        self.shown = (!plan.is_empty()).then(|| Shown { step: view.step(), plan, log: String::new() });
        Ok(control)
    }

    /// Keeps what is seen in a frame.
    fn remember(&mut self, view: &View, is_asked: bool) {
        if self.frames.len() == HISTORY {
            self.frames.pop_front();
        }
        self.frames.push_back((Arc::new(ToldStep::new(view, AGENTS, &self.before)), is_asked));
    }

    /// What the planner answers to a step.
    fn answer(&mut self, view: &View) -> Result<Answer, String> {
        if self.way.planner().is_stopped() {
            return Err("it was interrupted".to_owned());
        }
        let is_first = self.told.is_none();
        let asks = &self.asks;
        let told = self.told.get_or_insert_with(|| Arc::new(ToldScene::new(view, self.seed, asks.clone())));
        let told = told.clone();
        self.remember(view, true);
        let asked = Asked {
            told,
            frames: self.frames.iter().cloned().collect(),
            observation: view.later_observation(),
            car: *view.car(),
        };
        match &self.way {
            Way::Question(_, questions) => questions.ask(asked, is_first),
            Way::Call(planner) => Python::attach(|py| {
                let scene = match &self.scene {
                    Some(scene) => scene,
                    None => {
                        self.busy = Some(Busy::of(planner.address())?);
                        self.scene.insert(planner.reset(py, &asked.told, 0)?)
                    }
                };
                planner.act(py, scene, asked)
            }),
        }
    }
}
