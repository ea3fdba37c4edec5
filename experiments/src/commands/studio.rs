//! `sage studio`: a local page on which attacks are tried by hand.

mod command_line;
mod server;
mod workshop;

use std::net::{Ipv4Addr, TcpListener};

use advsage::{Registries, driver_spec::DriverSpecs, ego::Ego, part::Part};
use anyhow::{Context as _, Result, ensure};
use sage_run::{Outcome, scenes::Scenes};

use crate::cli::StudioArgs;
use workshop::{Method, Workshop};

pub(crate) fn run(args: &StudioArgs, registries: &Registries) -> Result<Outcome> {
    let scenes = match args.scenes.is_empty() {
        true => Scenes::procedural(args.procedural, args.seed),
        false => Scenes::under(&args.scenes)?,
    };
    ensure!(!scenes.is_empty(), "there is no scene to try");
    let specs = args.ego.iter().flat_map(|DriverSpecs(parts)| parts);
    let specs: Vec<_> = specs.map(|spec| args.planner.applied(spec)).collect();
    let drivers = Ego::all(&specs, registries)?;
    let of = |part: &Part| Method::of(part, args.weights.as_deref(), args.seed, registries);
    let methods = args.method.iter().map(of).collect::<Result<Vec<_>>>()?;
    let workshop = Workshop::new(scenes, args, &drivers, methods, registries);

    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, args.port))
        .with_context(|| format!("cannot listen on port {}; choose another with --port", args.port))?;
    server::serve(listener, &workshop)?;
    Ok(Outcome::Done)
}
