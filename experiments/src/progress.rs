//! Progress on stderr: a line that renews itself on a terminal, silence elsewhere until the end.

use std::{
    io::{IsTerminal, Write},
    time::{Duration, Instant},
};

use crate::terminal;

/// Time between two renewals.
const PACE: Duration = Duration::from_millis(200);

/// Says a line on stderr. Nobody there to hear it is no reason to stop.
pub(crate) fn say(text: &str) {
    let _ = writeln!(std::io::stderr(), "{}", terminal::harmless(text));
}

/// Counts work done.
pub(crate) struct Progress {
    what: &'static str,
    total: usize,
    done: usize,
    start: Instant,
    shown: Option<Instant>,
    terminal: bool,
}

impl Progress {
    /// Progress of a number of things that are being `what` (converted, made, …).
    pub(crate) fn new(what: &'static str, total: usize) -> Self {
        let terminal = std::io::stderr().is_terminal();
        Self { what, total, done: 0, start: Instant::now(), shown: None, terminal }
    }

    /// One more is done.
    pub(crate) fn step(&mut self) {
        self.done += 1;
        if !self.terminal || self.shown.is_some_and(|shown| shown.elapsed() < PACE) {
            return;
        }
        let left = self.start.elapsed().as_secs_f64() / self.done as f64 * (self.total - self.done) as f64;
        let _ = write!(
            std::io::stderr(),
            "\r{} {} of {}, about {left:.0} s left   ",
            self.what,
            self.done,
            self.total
        );
        self.shown = Some(Instant::now());
    }

    /// Says something that stays.
    pub(crate) fn say(&mut self, text: &str) {
        self.clear();
        say(text);
    }

    /// Ends with a sum.
    pub(crate) fn finish(mut self, sum: &str) {
        self.clear();
        say(&format!("{sum} ({:.1} s)", self.start.elapsed().as_secs_f64()));
    }

    fn clear(&mut self) {
        if self.shown.take().is_some() {
            let _ = write!(std::io::stderr(), "\r{:60}\r", "");
        }
    }
}
