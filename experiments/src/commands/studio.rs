//! `sage studio`: a local page on which attacks are tried by hand.

mod choice;
mod command_line;
mod driving;
mod finding;
mod keeper;
mod keeping;
mod locked;
mod method;
mod server;
mod sessions;
mod workshop;

use std::{
    io::{IsTerminal as _, stderr},
    net::{Ipv4Addr, TcpListener},
    sync::Mutex,
};

use advsage::{
    Registries, driver_spec::DriverSpecs, ego::Ego, named_generator::GeneratorSpec, named_search::SearchSpec,
};
use anyhow::{Context as _, Result, ensure};
use sage_run::{Outcome, scenes::Scenes};

use crate::cli::StudioArgs;
use keeper::Keeper;
use method::Method;
use workshop::{Workshop, labels};

pub(crate) fn run(args: &StudioArgs, registries: &Registries) -> Result<Outcome> {
    let scenes = match args.scenes.is_empty() {
        true => Scenes::procedural(args.procedural, args.seed),
        false => Scenes::under(&args.scenes)?,
    };
    ensure!(!scenes.is_empty(), "there is no scene to try");
    let specs = args.ego.iter().flat_map(|DriverSpecs(parts)| parts);
    let specs: Vec<_> = specs.map(|spec| args.planner.applied(spec)).collect();
    let drivers = Ego::all(&specs, registries)?;
    let weights: Vec<Option<&str>> = match args.weights.is_empty() {
        true => vec![None],
        false => args.weights.iter().map(|name| Some(&**name)).collect(),
    };
    let (mut methods, mut searches) = (Vec::new(), Vec::new());
    for weights in weights {
        for part in &args.method {
            methods.push(Method::of(part, weights, searches.len(), args.seed, registries)?);
        }
        let weights = weights.map(str::to_owned);
        let spec = GeneratorSpec { weights, seed: args.seed, ..GeneratorSpec::default() };
        searches.push(SearchSpec { generator: spec, ..SearchSpec::default() }.build(registries)?);
    }
    let keeper = |out| Keeper::new(out, searches[0].rule.objective.spec().feasibility.clone());
    let keeper = args.out.as_deref().map(keeper).transpose()?;
    let names = scenes.names();
    let workshop = Workshop {
        labels: labels(&names),
        scenes,
        names,
        procedural: args.scenes.is_empty().then_some(args.seed),
        seed: args.seed,
        budget: args.budget,
        drivers: &drivers,
        methods,
        searches,
        keeper,
        registries,
        ready: Mutex::default(),
    };
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, args.port))
        .with_context(|| format!("cannot listen on port {}; choose another with --port", args.port))?;
    server::serve(listener, &workshop, has_desktop() && !args.no_browser)?;
    Ok(Outcome::Done)
}

/// Whether a person sits before this machine: a terminal, and a desktop that is not far away.
fn has_desktop() -> bool {
    let is_set = |name: &str| std::env::var_os(name).is_some_and(|value| !value.is_empty());
    let has_windows =
        cfg!(any(windows, target_os = "macos")) || is_set("DISPLAY") || is_set("WAYLAND_DISPLAY");
    stderr().is_terminal() && has_windows && !is_set("SSH_CONNECTION")
}
