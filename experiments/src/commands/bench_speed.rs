//! `sage bench speed`.

use std::io::Write;

use anyhow::{Context, Result};
use sage_data::folder;

use crate::{Outcome, bench::speed, cli::SpeedArgs};

/// A scene that ships with the binary, for a measurement without any data.
const BUILT_IN: &[u8] = include_bytes!("../../../examples/crossing.pkl");

pub(crate) fn run(args: &SpeedArgs) -> Result<Outcome> {
    let mut temporary = None;
    let files = match &args.data {
        Some(data) => folder::scene_files(data)?,
        None => {
            let path = std::env::temp_dir().join(format!("sage-bench-{}.pkl", std::process::id()));
            std::fs::write(&path, BUILT_IN).with_context(|| format!("cannot write `{}`", path.display()))?;
            temporary = Some(path.clone());
            vec![path]
        }
    };
    let mut out = std::io::stdout().lock();
    if !args.json {
        writeln!(
            out,
            "{:<64} {:>5} {:>10} {:>10} {:>10} {:>10} {:>6}",
            "what", "n", "median ms", "min ms", "p90 ms", "target ms", "ratio"
        )?;
    }
    let outcome = speed::run(&files, args.repeat, |timing| {
        if args.json {
            serde_json::to_writer(&mut out, &timing)?;
            writeln!(out)?;
        } else {
            let target = timing.target_ms.map_or("-".to_owned(), |t| format!("{t:.3}"));
            let ratio = timing.target_ms.map_or("-".to_owned(), |t| format!("{:.2}", timing.median_ms / t));
            writeln!(
                out,
                "{:<64} {:>5} {:>10.3} {:>10.3} {:>10.3} {target:>10} {ratio:>6}",
                timing.name, timing.n, timing.median_ms, timing.min_ms, timing.p90_ms
            )?;
        }
        out.flush()?;
        Ok(())
    });
    if let Some(path) = temporary {
        // Nobody waits for the file; a failure to remove it is no failure to measure.
        let _ = std::fs::remove_file(path);
    }
    outcome.map(|()| Outcome::Done)
}
