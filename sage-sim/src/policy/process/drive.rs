//! A drive of a planner that is a program.

use std::{sync::Arc, time::Duration};

use sage_core::geometry::Point;

use super::{
    super::{
        Driver, Shown, Start, View,
        planner::{Answer, Asks, Follower, StepBefore, ToldScene, ToldStep, shortened},
    },
    lines,
    log::Watched,
    messages,
    pool::{Planner, Pool},
    program::Program,
};
use crate::{Error, error::PlannerLog, world::Control};

/// Most answers to a drive that come after its end.
const MOST_LATE: usize = 100;

/// What a program answers to a message within a time, while its log stays within its size.
fn asked<T>(
    program: &mut Program,
    message: &[u8],
    limit: Duration,
    log: Watched,
    understood: impl Fn(&[u8]) -> Result<T, String>,
) -> Result<T, String> {
    let line = program.ask(message, limit, log).map_err(|failure| failure.to_string())?;
    let answer = understood(&line)?;
    program.no_more().map_err(|failure| failure.to_string())?;
    Ok(answer)
}

/// Waits until a program is ready for a drive. Answers to steps of the drive before, which say so, are passed over.
fn asked_to_reset(
    program: &mut Program,
    message: &[u8],
    limit: Duration,
    log: Watched,
) -> Result<(), String> {
    let mut line = program.ask(message, limit, log).map_err(|failure| failure.to_string())?;
    for _ in 0..MOST_LATE {
        if !lines::is_late(&line) {
            break;
        }
        line = program.ask(&[], limit, log).map_err(|failure| failure.to_string())?;
    }
    lines::ready(&line)?;
    program.no_more().map_err(|failure| failure.to_string())
}

/// A drive of a planner.
pub(super) struct ProcessDriver {
    shared: Arc<Pool>,
    asks: Asks,
    before: StepBefore,
    /// Taken when it fails.
    planner: Option<Planner>,
    /// Length of the log at the start of the drive, bytes.
    first_byte: u64,
    seed: u64,
    is_reset: bool,
    /// Whether an answer did not say which step it is of, so that answers have to be counted.
    counts: bool,
    follower: Follower,
    /// Length of the log after the step before, bytes.
    logged: u64,
    shown: Option<Shown>,
}

impl Driver for ProcessDriver {
    fn control(&mut self, view: &View) -> Result<Control, Error> {
        let control = self.next(view).map_err(|problem| self.failed(view, problem))?;
        self.before = StepBefore::of(view, &control);
        Ok(control)
    }

    fn shown(&mut self) -> Option<Shown> {
        self.shown.take()
    }

    fn end(&mut self, view: &View) -> Result<(), Error> {
        self.count(view).map_err(|problem| self.failed(view, problem))
    }

    fn boxed_clone(&self) -> Result<Box<dyn Driver>, Error> {
        Err(Error::Clone {
            problem: format!(
                "the planner `{}` is a program, whose state cannot be copied",
                self.shared.command.join(" ")
            ),
        })
    }
}

impl ProcessDriver {
    /// A drive in a scene of a program that waits.
    pub(super) fn new(shared: Arc<Pool>, planner: Planner, asks: Asks, start: &Start) -> Self {
        planner.log.note(format!("sage: a drive in scene {}", start.scene_id()).as_bytes());
        let (first_byte, seed) = (planner.log.length(), start.seed());
        Self {
            shared,
            asks,
            before: StepBefore::default(),
            first_byte,
            planner: Some(planner),
            seed,
            is_reset: false,
            counts: false,
            follower: Follower::default(),
            logged: first_byte,
            shown: None,
        }
    }

    /// The control of the next step.
    fn next(&mut self, view: &View) -> Result<Control, String> {
        if let Some(control) = self.follower.kept(view)? {
            return Ok(control);
        }
        let answer = self.answer(view)?;
        let (control, positions) = self.follower.follow(view, answer)?;
        self.show(view.step(), positions);
        Ok(control)
    }

    /// What the planner answers to the next step.
    fn answer(&mut self, view: &View) -> Result<Answer, String> {
        let [_, reset, step] = self.shared.limits;
        let planner = self.planner.as_mut().ok_or("it failed before")?;
        if !self.is_reset {
            let told = ToldScene::new(view, self.seed, self.asks.clone());
            let log = Watched { log: &planner.log, since: self.first_byte };
            asked_to_reset(&mut planner.program, &messages::line("reset", &told), reset, log)?;
            self.is_reset = true;
        }
        let observation = match (planner.greeting.wants_observation, view.observation()) {
            (true, Some(numbers)) => Some(numbers),
            (true, None) => {
                return Err("it asks for the observation, which an adversary does not have".to_owned());
            }
            (false, _) => None,
        };
        let told = ToldStep::new(view, self.shared.agents, &self.before);
        let message = messages::line("step", &told.message(view.scene().scene(), observation));
        let log = Watched { log: &planner.log, since: self.first_byte };
        let understood = |line: &[u8]| lines::step(line, told.t, view.car());
        let (answer, is_numbered) = asked(&mut planner.program, &message, step, log, understood)?;
        self.counts |= !is_numbered;
        Ok(answer)
    }

    /// Looks for answers beyond those that were asked for: the first line after a further `reset` is `ready`, or there are more
    /// answers than steps, and each may have been taken for the next.
    fn count(&mut self, view: &View) -> Result<(), String> {
        let Some(planner) = self.planner.as_mut().filter(|_| self.is_reset && self.counts) else {
            return Ok(());
        };
        let told = ToldScene::new(view, self.seed, self.asks.clone());
        let log = Watched { log: &planner.log, since: self.first_byte };
        let limit = self.shared.limits[1];
        asked(&mut planner.program, &messages::line("reset", &told), limit, log, |line| {
            lines::ready(line).map_err(|_| {
                format!("it printed more answers than it got messages, the last `{}`", shortened(line))
            })
        })
    }

    /// Keeps what is shown of a step: a plan, and what was written to the log since the step before.
    fn show(&mut self, step: usize, plan: Vec<Point>) {
        let Some(planner) = &self.planner else { return };
        let length = planner.log.length();
        let log =
            if length > self.logged { planner.log.last_lines(self.logged).join("\n") } else { String::new() };
        self.logged = length;
        self.shown = (!plan.is_empty() || !log.is_empty()).then_some(Shown { step, plan, log });
    }

    /// The error of a failed planner, which is killed.
    fn failed(&mut self, view: &View, problem: String) -> Error {
        let (mut log, mut is_late) = (PlannerLog::default(), false);
        if let Some(Planner { program, log: own, .. }) = self.planner.take() {
            is_late = program.is_late();
            drop(program);
            log = PlannerLog::of(own.path(), own.last_lines(self.first_byte));
            if is_late {
                own.note(b"sage: no answer in time; the program is ended");
            }
            own.limit();
            self.shared.keep_log(own);
        }
        Error::Planner {
            scene: view.scene().scene().id.clone(),
            step: Some(view.step()),
            is_late,
            problem: format!("the planner `{}` failed: {problem}", self.shared.command.join(" ")),
            log,
            drive: None,
        }
    }
}

impl Drop for ProcessDriver {
    /// A planner that did not fail waits for the next drive.
    fn drop(&mut self) {
        if let Some(planner) = self.planner.take() {
            self.shared.put_back(planner);
        }
    }
}
