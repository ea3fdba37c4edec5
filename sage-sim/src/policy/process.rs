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
mod drive;
mod lines;
mod log;
mod messages;
mod pool;
mod program;

use std::{path::Path, sync::Arc, time::Duration};

use sage_core::registry::Entry;
use serde::{Deserialize, Serialize};

use super::{
    Driver, EgoPolicy, OtherWay, Start,
    planner::{AGENTS, Asks, RADIUS},
};
use crate::Error;
use drive::ProcessDriver;
use pool::Pool;
pub use program::kill_all as kill_programs;

/// Longest time limit, s: a day.
const LONGEST: f64 = 86_400.0;
/// Largest radius of the map that is told, metres.
const FARTHEST_MAP: f64 = 10_000.0;

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
    shared: Arc<Pool>,
    follow: Option<String>,
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
        Ok(Box::new(Self { shared: Pool::new(command, limits, radius, agents).into(), follow }))
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
            self.shared.put_back(planner);
            return Err(start.error(problem));
        }
        let asks = Asks {
            radius: self.shared.radius,
            goal: planner.greeting.wants_goal,
            follow: self.follow.as_ref().or(follows.first()).cloned(),
        };
        Ok(Box::new(ProcessDriver::new(self.shared.clone(), planner, asks, start)))
    }

    fn other_ways(&self) -> Result<Vec<OtherWay>, Error> {
        let planner = self.shared.planner("")?;
        let follows = planner.greeting.follows.clone();
        self.shared.put_back(planner);
        let own = self.follow.as_ref().or(follows.first());
        let others = follows.iter().filter(|follow| Some(*follow) != own);
        let way = |follow: &String| OtherWay {
            name: follow.clone(),
            policy: Box::new(Self { shared: self.shared.clone(), follow: Some(follow.clone()) }),
        };
        Ok(others.map(way).collect())
    }

    fn write_logs_to(&self, folder: &Path) {
        self.shared.write_logs_to(folder);
    }
}
