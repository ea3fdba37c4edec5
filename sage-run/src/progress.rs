//! Progress on stderr. On a terminal it is a line that is updated; otherwise a line every two minutes, and the summary at
//! the end.

use std::{
    collections::BTreeSet,
    io::{IsTerminal, Write},
    sync::{Mutex, PoisonError},
    time::{Duration, Instant},
};

pub use sage_core::text::count;
use sage_core::text::wrap::wrapped;

use crate::terminal;

/// Minimum time between two updates.
const INTERVAL: Duration = Duration::from_millis(200);

/// The same where a line that is updated cannot be shown.
const LOG_INTERVAL: Duration = Duration::from_secs(120);

/// Most characters of a message: a text may quote what a stranger wrote.
const LONGEST_LINE: usize = 2000;

/// Prints a line on stderr. A text may be a stranger's, so a new line in it is escaped, and a very long one is
/// shortened. A closed stderr is ignored.
pub fn say(text: &str) {
    let text = terminal::escaped_name(text);
    let count = text.chars().count();
    if count <= LONGEST_LINE {
        let text = if std::io::stderr().is_terminal() { wrapped(&text, 2) } else { text };
        let _ = writeln!(std::io::stderr(), "{text}");
        return;
    }
    // What is wrong stands at the start, the cause at the end.
    let half = LONGEST_LINE / 2;
    let start: String = text.chars().take(half).collect();
    let end: String = text.chars().skip(count - half).collect();
    let _ = writeln!(std::io::stderr(), "{start} … ({} characters) … {end}", count - 2 * half);
}

/// Prints several lines of this program on stderr.
pub fn say_lines(text: &str) {
    text.lines().for_each(say);
}

/// As [`say`], but a text that was said before in this process is not repeated.
pub fn say_once(text: &str) {
    static SAID: Mutex<BTreeSet<String>> = Mutex::new(BTreeSet::new());
    if SAID.lock().unwrap_or_else(PoisonError::into_inner).insert(text.to_owned()) {
        say(text);
    }
}

/// Shows a line that the next one replaces, on a terminal only.
pub fn show(text: &str) {
    if std::io::stderr().is_terminal() {
        let _ = write!(std::io::stderr(), "\r{}   ", terminal::escaped(text));
    }
}

/// Counts finished items.
pub struct Progress {
    verb: &'static str,
    /// Number of items; `None` if it is not known.
    total: Option<usize>,
    done: usize,
    /// Number of items that earlier runs finished.
    found: usize,
    start: Instant,
    shown: Option<Instant>,
    terminal: bool,
}

impl Progress {
    /// Progress of `total` items, which may be unknown; `verb` is a participle, such as `converted`.
    pub fn new(verb: &'static str, total: impl Into<Option<usize>>) -> Self {
        let terminal = std::io::stderr().is_terminal();
        Self { verb, total: total.into(), done: 0, found: 0, start: Instant::now(), shown: None, terminal }
    }

    /// Counts an item that this run finished.
    pub fn step(&mut self) {
        self.done += 1;
        self.show();
    }

    /// Counts an item that an earlier run finished.
    pub fn step_found(&mut self) {
        self.done += 1;
        self.found += 1;
        self.show();
    }

    /// Number of finished items.
    pub fn done(&self) -> usize {
        self.done
    }

    /// Number of items that earlier runs finished.
    pub fn found_count(&self) -> usize {
        self.found
    }

    fn show(&mut self) {
        let interval = if self.terminal { INTERVAL } else { LOG_INTERVAL };
        let last = if self.terminal { self.shown } else { Some(self.shown.unwrap_or(self.start)) };
        if last.is_some_and(|last| last.elapsed() < interval) {
            return;
        }
        let Self { verb, done, .. } = self;
        let text = match self.total {
            Some(total) => {
                // The first items of all threads end nearly together, so each alone would say too much.
                let worked = *done - self.found;
                let seconds = self.start.elapsed().as_secs_f64() / worked.max(1) as f64;
                let left = match worked > rayon::current_num_threads() {
                    true => format!(", about {:.0} s left", seconds * total.saturating_sub(*done) as f64),
                    false => String::new(),
                };
                format!("{verb} {done} of {total}{left}")
            }
            None => format!("{verb} {done}"),
        };
        if self.terminal {
            let _ = write!(std::io::stderr(), "\r{text}   ");
        } else {
            say(&text);
        }
        self.shown = Some(Instant::now());
    }

    /// Prints a permanent line.
    pub fn say(&mut self, text: &str) {
        self.clear();
        say(text);
    }

    /// Prints a summary with the elapsed time.
    pub fn finish(mut self, summary: &str) {
        self.clear();
        say(&format!("{summary} ({:.1} s)", self.start.elapsed().as_secs_f64()));
    }

    /// Removes the progress line from the terminal, so that other text can be printed. The next step prints
    /// it again.
    pub fn clear(&mut self) {
        if self.terminal && self.shown.take().is_some() {
            let _ = write!(std::io::stderr(), "\r{:60}\r", "");
        }
    }
}
