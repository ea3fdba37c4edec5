//! Somebody's own planner: a program in any language, which is asked over its standard input and output.
//!
//! `docs/testing-a-driver.md` describes the protocol: lines of JSON. The program is started once for each worker of a
//! run, and told the scene before each drive. A program that dies, hangs or answers nonsense fails its drive
//! ([`Error::Planner`]); the next drive gets a new one.
//!
//! It is another process because it may have another language, licence or version of its libraries, and may crash. Lines of
//! JSON cost 0.1 ms a step. Its state cannot be copied, so copying a drive may fail.

#[cfg(target_os = "linux")]
mod computing;
mod lines;
mod log;
mod messages;
mod program;

use std::{
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
    time::{Duration, Instant},
};

use sage_core::{geometry::Point, registry::Entry};
use serde::{Deserialize, Serialize};

use super::{
    Driver, EgoPolicy, OtherWay, Shown, Start, View,
    planner::{AGENTS, Answer, Asks, Follower, RADIUS, StepBefore, ToldScene, ToldStep, shortened},
};
use crate::{Error, error::PlannerLog, world::Control};
use lines::Greeting;
use log::{Log, Watched};
pub use program::kill_all as kill_programs;
use program::{FAREWELL, Failure, Program};

/// Longest time limit, s: a day.
const LONGEST: f64 = 86_400.0;
/// Largest radius of the map that is told, metres.
const FARTHEST_MAP: f64 = 10_000.0;
/// Most lines that a program may print before it says hello.
const MOST_BANNER: usize = 1000;
/// Most answers to a drive that come after its end.
const MOST_LATE: usize = 100;

/// Options of [`Process`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ProcessOptions {
    /// Program and arguments; no shell reads them.
    pub command: Vec<String>,
    /// Time to answer the first message of a program, that of a drive, and that of a step, s of computing; ten times as long in
    /// all.
    pub timeouts: [f64; 3],
    /// Distance from the route within which the map is told, metres.
    pub radius: f64,
    /// Most road users in a step: the nearest ones.
    pub agents: usize,
    /// How it follows its plans, of the ways that it offers; `None` for the first.
    pub follow: Option<String>,
}

impl Default for ProcessOptions {
    fn default() -> Self {
        Self {
            command: Vec::new(),
            timeouts: [60.0, 20.0, 5.0],
            radius: RADIUS,
            agents: AGENTS,
            follow: None,
        }
    }
}

/// The policy `process`.
pub struct Process {
    shared: Arc<Shared>,
    follow: Option<String>,
}

/// What all drives of a policy share.
struct Shared {
    command: Vec<String>,
    /// For `hello`, `reset` and `step`.
    limits: [Duration; 3],
    radius: f64,
    agents: usize,
    state: Mutex<State>,
}

/// Programs without a drive, and logs of programs that failed.
#[derive(Default)]
struct State {
    idle: Vec<Planner>,
    logs: Vec<Log>,
    folder: Option<PathBuf>,
}

/// A program that has said hello, and its log.
struct Planner {
    program: Program,
    log: Log,
    greeting: Greeting,
}

impl Entry<dyn EgoPolicy> for Process {
    const NAME: &'static str = "process";
    const SUMMARY: &'static str = "your own planner, a program in any language (cmd:COMMAND)";
    const SOURCE: &'static str = "this project";
    type Options = ProcessOptions;

    fn build(options: ProcessOptions) -> Result<Box<dyn EgoPolicy>, String> {
        let ProcessOptions { command, timeouts, radius, agents, follow } = options;
        if command.first().is_none_or(String::is_empty) {
            return Err(
                "`command` is empty; write cmd:COMMAND, such as 'cmd:python3 my_planner.py'".to_owned()
            );
        }
        if let Some(seconds) = timeouts.into_iter().find(|seconds| !(*seconds > 0.0 && *seconds <= LONGEST)) {
            return Err(format!("`timeouts` has {seconds}; expected seconds above 0 and up to {LONGEST}"));
        }
        if !(0.0..=FARTHEST_MAP).contains(&radius) {
            return Err(format!("`radius` is {radius}; expected metres from 0 to {FARTHEST_MAP}"));
        }
        let limits = timeouts.map(Duration::from_secs_f64);
        let shared = Shared { command, limits, radius, agents, state: Mutex::default() };
        Ok(Box::new(Self { shared: shared.into(), follow }))
    }
}

impl EgoPolicy for Process {
    fn start(&self, start: &Start) -> Result<Box<dyn Driver>, Error> {
        let planner = self.shared.planner(start.scene_id())?;
        let follows = &planner.greeting.follows;
        let unknown = self.follow.as_ref().filter(|follow| !follows.contains(follow));
        if let Some(unknown) = unknown {
            let offered = if follows.is_empty() { "none".to_owned() } else { follows.join(", ") };
            let command = self.shared.command.join(" ");
            let problem = format!(
                "the planner `{command}` does not offer to follow by `{unknown}`; it offers {offered}"
            );
            self.shared.state().idle.push(planner);
            return Err(start.error(problem));
        }
        let asks = Asks {
            radius: self.shared.radius,
            goal: planner.greeting.wants_goal,
            follow: self.follow.as_ref().or(follows.first()).cloned(),
        };
        let first_byte = planner.log.length();
        Ok(Box::new(ProcessDriver {
            shared: self.shared.clone(),
            asks,
            before: StepBefore::default(),
            first_byte,
            planner: Some(planner),
            seed: start.seed(),
            is_reset: false,
            counts: false,
            follower: Follower::default(),
            logged: first_byte,
            shown: None,
        }))
    }

    fn other_ways(&self) -> Result<Vec<OtherWay>, Error> {
        let planner = self.shared.planner("")?;
        let follows = planner.greeting.follows.clone();
        self.shared.state().idle.push(planner);
        let own = self.follow.as_ref().or(follows.first());
        let others = follows.iter().filter(|follow| Some(*follow) != own);
        let way = |follow: &String| OtherWay {
            name: follow.clone(),
            policy: Box::new(Self { shared: self.shared.clone(), follow: Some(follow.clone()) }),
        };
        Ok(others.map(way).collect())
    }

    fn write_logs_to(&self, folder: &Path) {
        self.shared.state().folder = Some(folder.to_owned());
    }
}

impl Drop for Shared {
    /// Programs get the end of their input, then half a second all together to end by themselves.
    fn drop(&mut self) {
        let mut idle = std::mem::take(&mut self.state().idle);
        idle.iter_mut().for_each(|planner| planner.program.dismiss());
        let end = Instant::now() + FAREWELL;
        idle.iter().for_each(|planner| planner.program.wait_until_ended(end));
    }
}

impl Shared {
    /// A lock that a panic elsewhere does not spoil: the lists hold whole entries at any time.
    fn state(&self) -> std::sync::MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A program without a drive, or a new one.
    fn planner(&self, scene: &str) -> Result<Planner, Error> {
        let idle = self.state().idle.pop();
        if let Some(planner) = idle {
            planner.log.limit();
            return Ok(planner);
        }
        let fail = |problem: String, log: PlannerLog| Error::Planner {
            scene: scene.to_owned(),
            step: None,
            is_late: false,
            problem: format!("the planner `{}` {problem}", self.command.join(" ")),
            log,
            drive: None,
        };
        let (log, folder) = {
            let mut state = self.state();
            (state.logs.pop(), state.folder.clone())
        };
        let log = match log {
            Some(log) => log,
            None => Log::create(folder.as_deref())
                .map_err(|error| fail(format!("gets no log: {error}"), PlannerLog::default()))?,
        };
        log.limit();
        let since = log.length();
        match self.started(&log) {
            Ok((program, greeting)) => Ok(Planner { program, log, greeting }),
            Err(problem) => {
                let error = fail(problem, PlannerLog::of(log.path(), log.last_lines(since)));
                log.limit();
                self.state().logs.push(log);
                Err(error)
            }
        }
    }

    /// Starts the program and greets it.
    fn started(&self, log: &Log) -> Result<(Program, Greeting), String> {
        let mut program = Program::start(&self.command, log.file()).map_err(|error| {
            let hint = match error.kind() {
                std::io::ErrorKind::NotFound => format!(
                    "; there is no program `{}`, and no shell reads the command: cmd:sh -c '…' asks one",
                    self.command[0]
                ),
                _ => String::new(),
            };
            format!("does not start: {error}{hint}")
        })?;
        let greeting = greeted(&mut program, log, self.limits[0])
            .map_err(|problem| format!("failed at its start: {problem}"))?;
        Ok((program, greeting))
    }
}

/// What a program says of itself. Libraries print when they are loaded, before a planner can keep its output for answers: lines
/// that are no JSON object go to the log until it says hello.
fn greeted(program: &mut Program, log: &Log, limit: Duration) -> Result<Greeting, String> {
    let start = Instant::now();
    let watched = Watched { log, since: log.length() };
    let mut line = program.ask(&messages::hello(), limit, watched).map_err(|failure| failure.to_string())?;
    for _ in 0..MOST_BANNER {
        if lines::is_object(&line) {
            break;
        }
        log.note(&line);
        let left = limit.saturating_sub(start.elapsed());
        let said = line;
        line = program.ask(&[], left, watched).map_err(|failure| match failure {
            Failure::Late(_) => format!(
                "it printed `{}`, which is no answer to `hello`, and then nothing; {}",
                shortened(&said),
                Failure::Late(limit)
            ),
            failure => failure.to_string(),
        })?;
    }
    let greeting = lines::greeting(&line)?;
    program.no_more().map_err(|failure| failure.to_string())?;
    Ok(greeting)
}

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
struct ProcessDriver {
    shared: Arc<Shared>,
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
            self.shared.state().logs.push(own);
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
            self.shared.state().idle.push(planner);
        }
    }
}
