//! Progress on stderr: one line that is updated on a terminal; elsewhere only the sum at the end.

use std::{
    io::{IsTerminal, Write},
    time::{Duration, Instant},
};

use crate::terminal;

/// Least time between two updates.
const INTERVAL: Duration = Duration::from_millis(200);

/// Prints a line on stderr. A closed stderr is no error.
pub(crate) fn say(text: &str) {
    let _ = writeln!(std::io::stderr(), "{}", terminal::escaped(text));
}

/// Counts work done.
pub(crate) struct Progress {
    what: &'static str,
    total: usize,
    done: usize,
    /// Of those done, how many took no work.
    found: usize,
    start: Instant,
    shown: Option<Instant>,
    terminal: bool,
}

impl Progress {
    /// Progress of `total` items; `what` is the verb, such as `converted`.
    pub(crate) fn new(what: &'static str, total: usize) -> Self {
        let terminal = std::io::stderr().is_terminal();
        Self { what, total, done: 0, found: 0, start: Instant::now(), shown: None, terminal }
    }

    /// One more is done.
    pub(crate) fn step(&mut self) {
        self.done += 1;
        self.show();
    }

    /// One more was done before this run.
    pub(crate) fn step_found(&mut self) {
        self.done += 1;
        self.found += 1;
        self.show();
    }

    /// Number done so far.
    pub(crate) fn done(&self) -> usize {
        self.done
    }

    /// Number done before this run.
    pub(crate) fn found(&self) -> usize {
        self.found
    }

    fn show(&mut self) {
        if !self.terminal || self.shown.is_some_and(|shown| shown.elapsed() < INTERVAL) {
            return;
        }
        let worked = (self.done - self.found).max(1) as f64;
        let left = self.start.elapsed().as_secs_f64() / worked * (self.total - self.done) as f64;
        let _ = write!(
            std::io::stderr(),
            "\r{} {} of {}, about {left:.0} s left   ",
            self.what,
            self.done,
            self.total
        );
        self.shown = Some(Instant::now());
    }

    /// Prints a line that stays.
    pub(crate) fn say(&mut self, text: &str) {
        self.clear();
        say(text);
    }

    /// Ends with a sum.
    pub(crate) fn finish(mut self, sum: &str) {
        self.clear();
        say(&format!("{sum} ({:.1} s)", self.start.elapsed().as_secs_f64()));
    }

    /// Removes the line from the terminal, so that something else can be printed; the next step shows it again.
    pub(crate) fn clear(&mut self) {
        if self.shown.take().is_some() {
            let _ = write!(std::io::stderr(), "\r{:60}\r", "");
        }
    }
}
