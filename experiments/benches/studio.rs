//! How long the page of `sage studio` takes from a step of the slider to the drawn drive, in Chromium: eleven values in ten invented
//! scenes, for each driver.
//!
//! ```sh
//! cargo bench -p experiments --bench studio
//! ```

#![allow(clippy::print_stdout, clippy::unwrap_used)] // It prints a table; a benchmark that fails says where.

#[path = "../tests/studio/browser.rs"]
mod browser;
#[path = "../tests/studio/mod.rs"]
mod studio;

use browser::Browser;
use studio::Studio;

const DRIVERS: [&str; 3] = ["idm", "expert", "pdm"];
const SCENES: usize = 10;

/// Milliseconds of each step in the scene that is open.
const STEPS: &str = "
  const done = arguments[arguments.length - 1], taken = [];
  const shown = () => new Promise((drawn) => {
    const before = document.body.dataset.drawn;
    // Between frames: a drive is drawn within one.
    const look = () => (document.body.dataset.drawn !== before && !waiting ? drawn() : setTimeout(look, 1));
    look();
  });
  (async () => {
    for (let k = 0; k <= 10; k++) {
      const start = performance.now();
      const drawn = shown();
      element('dial').value = 2 * k;
      element('dial').dispatchEvent(new Event('input'));
      await drawn;
      taken.push(performance.now() - start);
    }
    done(taken);
  })();";

fn main() {
    let folder = tempfile::tempdir().unwrap();
    let Some(browser) = Browser::start(1280, 800) else { return };
    println!("| driver | steps | median, ms | 95th percentile, ms | largest, ms |\n|---|--:|--:|--:|--:|");
    for driver in DRIVERS {
        let studio = Studio::start(
            &["--procedural", "10", "--seed", "5", "--ego", driver, "--threads", "1"],
            folder.path(),
        );
        browser.open("about:blank");
        browser.open(&studio.link());
        browser.wait("document.body.dataset.drawn");
        let mut all: Vec<f64> = Vec::new();
        for scene in 0..SCENES {
            browser.run(&format!("openScene({scene})"));
            browser.wait(&format!("wanted.scene === {scene} && scene && !pending && panels.length"));
            all.extend(serde_json::from_value::<Vec<f64>>(browser.run_async(STEPS)).unwrap());
        }
        all.sort_by(f64::total_cmp);
        let at = |share: f64| all[((all.len() - 1) as f64 * share).round() as usize];
        println!("| `{driver}` | {} | {:.0} | {:.0} | {:.0} |", all.len(), at(0.5), at(0.95), at(1.0));
    }
}
