//! How long a search takes, said after the first drive.

use std::{
    sync::{
        OnceLock,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

use sage_run::progress::{self, count};

/// Shortest search whose time is said.
const LEAST: Duration = Duration::from_secs(60);

/// The time that a search takes by that of its first drive.
#[derive(Default)]
pub(super) struct Estimate {
    scenes: OnceLock<usize>,
    is_told: AtomicBool,
}

impl Estimate {
    /// The number of scenes to search.
    pub(super) fn set_scenes(&self, scenes: usize) {
        let _ = self.scenes.set(scenes);
    }

    /// Says once, of a search that may take minutes, what a drive costs and how many there may be. `drive` is the time of
    /// an unattacked drive; references drive as well where the driver fails, so it may take longer.
    pub(super) fn tell(&self, driver: &str, budget: usize, drive: Duration) {
        let scenes = self.scenes.get().copied().unwrap_or(1);
        let threads = rayon::current_num_threads().min(scenes);
        let all = drive.mul_f64((scenes * (budget + 1)) as f64 / threads as f64);
        if all < LEAST || self.is_told.swap(true, Ordering::Relaxed) {
            return;
        }
        progress::say(&format!(
            "note: a drive of `{driver}` takes {:.2} s; up to {} in each of {} on {} take about {:.0} min, and more where it \
             fails; Ctrl-C stops, the same command continues, and a smaller --budget keeps what is done",
            drive.as_secs_f64(),
            count(budget, "attacked drive"),
            count(scenes, "scene"),
            count(threads, "thread"),
            all.as_secs_f64() / 60.0
        ));
    }
}
