//! The programs of a policy: started once for each worker, kept between drives.

use std::{
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
    time::{Duration, Instant},
};

use super::{
    super::planner::shortened,
    lines::{self, Greeting},
    log::{Log, Watched},
    messages,
    program::{FAREWELL, Failure, Program},
};
use crate::{Error, error::PlannerLog};

/// Most lines that a program may print before it says hello.
const MOST_BANNER: usize = 1000;

/// What all drives of a policy share: how its programs are started, and those that wait.
pub(super) struct Pool {
    pub(super) command: Vec<String>,
    /// For `hello`, `reset` and `step`.
    pub(super) limits: [Duration; 3],
    pub(super) radius: f64,
    pub(super) agents: usize,
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
pub(super) struct Planner {
    pub(super) program: Program,
    pub(super) log: Log,
    pub(super) greeting: Greeting,
}

impl Drop for Pool {
    /// Programs get the end of their input, then half a second all together to end by themselves.
    fn drop(&mut self) {
        let mut idle = std::mem::take(&mut self.state().idle);
        idle.iter_mut().for_each(|planner| planner.program.dismiss());
        let end = Instant::now() + FAREWELL;
        idle.iter().for_each(|planner| planner.program.wait_until_ended(end));
    }
}

impl Pool {
    /// A pool without programs.
    pub(super) fn new(command: Vec<String>, limits: [Duration; 3], radius: f64, agents: usize) -> Self {
        Self { command, limits, radius, agents, state: Mutex::default() }
    }

    /// A program waits for the next drive.
    pub(super) fn put_back(&self, planner: Planner) {
        self.state().idle.push(planner);
    }

    /// The log of a program that failed is for the next one.
    pub(super) fn keep_log(&self, log: Log) {
        self.state().logs.push(log);
    }

    /// Names the folder of logs.
    pub(super) fn write_logs_to(&self, folder: &Path) {
        self.state().folder = Some(folder.to_owned());
    }

    /// A lock that a panic elsewhere does not spoil: the lists hold whole entries at any time.
    fn state(&self) -> std::sync::MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A program without a drive, or a new one.
    pub(super) fn planner(&self, scene: &str) -> Result<Planner, Error> {
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
                self.keep_log(log);
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
