//! `sage bench speed`: times of the main components.

use std::io::Write;

use advsage::{
    Registries,
    driver_spec::{DriverSpec, DriverSpecs},
    ego::Ego,
};
use anyhow::Result;
use sage_run::{Outcome, terminal};

use crate::{
    bench::speed::{self, Data, Timing},
    cli::SpeedArgs,
};

/// The scene in the binary, for a measurement without data.
const BUILT_IN: &[u8] = include_bytes!("../../crossing.pkl");

pub(crate) fn run(args: &SpeedArgs, registries: &Registries) -> Result<Outcome> {
    let data = match &args.data {
        Some(data) => Data::of(data)?,
        None => Data::one("crossing.pkl".into(), BUILT_IN.to_vec()),
    };
    let mut out = std::io::stdout().lock();
    if !args.json {
        writeln!(
            out,
            "{:<64} {:>5} {:>10} {:>10} {:>6}",
            "measurement", "n", "median ms", "target ms", "ratio"
        )?;
    }
    let report = |timing: Timing| {
        if args.json {
            terminal::json_line(&mut out, &timing)?;
        } else {
            let target = timing.target_ms.map_or("-".to_owned(), |t| format!("{t:.3}"));
            let ratio = timing.target_ms.map_or("-".to_owned(), |t| format!("{:.2}", timing.median_ms / t));
            writeln!(
                out,
                "{:<64} {:>5} {:>10.3} {target:>10} {ratio:>6}",
                timing.name, timing.n, timing.median_ms
            )?;
        }
        out.flush()?;
        Ok(())
    };
    if args.ego.is_empty() {
        speed::run(&data, args.repeat, report)?;
    } else {
        let parts: Vec<DriverSpec> = args.ego.iter().flat_map(|DriverSpecs(parts)| parts.clone()).collect();
        let egos = Ego::all(&parts, registries)?;
        speed::drivers(&data, &egos, report)?;
    }
    Ok(Outcome::Done)
}
