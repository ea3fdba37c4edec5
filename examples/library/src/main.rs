//! Reads a scene, attacks it, drives it, searches it and draws it: cargo run -- ../crossing.pkl attacks.svg
use std::{env, fs, path::Path, sync::Arc};

use advsage::{
    Against, DriverInScene, Ego, Error, GeneratorSpec, OperatingPoints, Picture, Prepared, Recording,
    Registries, SearchOptions, SearchSpec, draw, drawn_path,
};

fn main() -> advsage::Result<()> {
    let Ok([_, file, svg]) = <[String; 3]>::try_from(env::args().collect::<Vec<_>>()) else {
        return Err(Error::Value("give two arguments: a scene file and a drawing".to_owned()));
    };
    let registries = Registries::shipped()?;
    let scene = Arc::new(Recording::read(Path::new(&file))?.scene);

    // Attacks on the recorded ego, from realistic to adversarial.
    let points = OperatingPoints::of_lambda([0.0, 0.5, 1.0]);
    let sage = GeneratorSpec { points, ..GeneratorSpec::default() }.build(&registries)?;
    let recorded = Prepared::recorded(&scene)?;
    let attacks = sage.attacks(&recorded.ctx, Against::Recording)?;

    // The strongest on a driver, who drives the scene first without it and then against it.
    let idm = Ego::named("idm", &registries)?;
    let driven = DriverInScene::of(&scene, &idm, 0)?;
    let attack = sage.attacks(&driven.ctx, Against::Driver(&driven.test))?.remove(2);
    let outcome = driven.drive(&attack)?;
    println!("attack on idm: {}; contacts: {}", outcome.verdict.attack, outcome.episode.contacts.len());

    // A search for plans that it fails at.
    let search = SearchSpec::default().build(&registries)?;
    let (_, found) = search.search(&driven, &SearchOptions::default(), 0)?;
    println!("failures of idm: {} in {} drives", found.failures.len(), found.driven.len());

    let drawn = attacks.iter().zip(&sage.points);
    let drawn =
        drawn.map(|(attack, point)| drawn_path(point.label(), &recorded.ctx, attack.trajectory().clone()));
    let picture = Picture { title: file, candidates: drawn.collect(), ..Picture::default() };
    fs::write(svg, draw(&scene, &picture))?;
    Ok(())
}
