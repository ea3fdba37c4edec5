//! `sage calibrate --nominal`: the temperature at which a prior is a calibrated density of where vehicles go.

use advsage::{
    Registries,
    rate::{
        Coverage, LEVELS, NOMINAL_FILE, NominalCard, RecordedEnd, fitted_temperature, hash, nominal_prior,
    },
    weights::NamedNetwork,
};
use anyhow::{Result, ensure};
use sage_bench::estimate::of_scenes;
use sage_core::{
    generator::Observation,
    motion::{HORIZON, NOW},
    scene::SceneData,
    statistics,
};
use sage_generators::goal_density;
use sage_run::{
    Outcome,
    output::{self, OutputFile},
    progress::{self, Progress},
    scenes::Scenes,
};

use crate::cli::CalibrateArgs;

/// Last frame that a network predicts.
const LAST: usize = NOW + HORIZON;

pub(super) fn run(args: &CalibrateArgs, registries: &Registries) -> Result<Outcome> {
    let out = OutputFile::claim(&args.out, args.force)?;
    let prior = nominal_prior(registries, &args.weights)?;
    let scenes = Scenes::of(&args.paths, &args.split.filter(), args.procedural, args.seed)?.attackable()?;
    let fitted = ends(&prior, &scenes)?;
    ensure!(!fitted.is_empty(), "no recorded ego or adversary is valid at the end of its scene");
    let temperature = fitted_temperature(&fitted.concat());
    let mut coverage = vec![covered(&fitted, temperature, scenes.describe(), true)];
    if !args.unseen.is_empty() {
        let unseen = Scenes::under(&args.unseen)?.attackable()?;
        coverage.push(covered(&ends(&prior, &unseen)?, temperature, unseen.describe(), false));
    }
    for coverage in &coverage {
        progress::say(&words(coverage, temperature));
    }
    let card = NominalCard { temperature, prior: hash(&prior)?, command: output::command(), coverage };
    out.write((serde_json::to_string_pretty(&card)? + "\n").as_bytes())?;
    progress::say(&format!(
        "the temperature is in `{}`; `sage rate` reads it as `{NOMINAL_FILE}` in the folder of the weights",
        args.out.display()
    ));
    Ok(scenes.outcome())
}

/// Where the ego and the adversary of each scene were recorded to end, in the density of a prior.
fn ends(prior: &NamedNetwork, scenes: &Scenes) -> Result<Vec<Vec<RecordedEnd>>> {
    let mut progress = Progress::new("read", scenes.len());
    let of_scene = |data: &SceneData| -> Result<Vec<RecordedEnd>> {
        let now = Observation::of(&data.scene, &data.index)?;
        let mut ends = Vec::new();
        for track in [data.scene.ego, data.scene.adversary_index()?] {
            let recorded = &data.scene.tracks[track];
            if recorded.valid.get(LAST) == Some(&true) {
                let density = goal_density(&*prior.network, &now, track)?;
                ends.extend(RecordedEnd::of(density, recorded.point(LAST)));
            }
        }
        Ok(ends)
    };
    let mut all = scenes.map(of_scene, || progress.step())?;
    all.retain(|ends| !ends.is_empty());
    progress.finish(&format!("{} scenes", all.len()));
    Ok(all)
}

/// How often the ends of scenes are in the sets of a density.
fn covered(ends: &[Vec<RecordedEnd>], temperature: f64, scenes: String, fitted: bool) -> Coverage {
    let all = ends.concat();
    let nll = |temperature: f64| {
        let values: Vec<f64> = all.iter().map(|end| end.nll(temperature)).collect();
        statistics::mean(&values).unwrap_or(f64::NAN)
    };
    let set = |level: f64| {
        let of = |drawn: &[usize]| {
            let of_drawn = || drawn.iter().flat_map(|scene| &ends[*scene]);
            let inside = of_drawn().filter(|end| end.is_in_set(temperature, level)).count();
            inside as f64 / of_drawn().count() as f64
        };
        let estimate = of_scenes(ends.len(), &format!("coverage {level}"), of);
        estimate.map(|e| [level, e.value, e.low, e.high])
    };
    Coverage {
        scenes,
        fitted,
        tracks: all.len(),
        nll: [nll(1.0), nll(temperature)],
        sets: LEVELS.into_iter().filter_map(set).collect(),
    }
}

fn words(coverage: &Coverage, temperature: f64) -> String {
    let set = |[level, share, low, high]: &[f64; 4]| {
        format!(
            "{:.0} % set: {:.0} % [{:.0}, {:.0}]",
            100.0 * level,
            100.0 * share,
            100.0 * low,
            100.0 * high
        )
    };
    let sets: Vec<String> = coverage.sets.iter().map(set).collect();
    let [before, after] = coverage.nll;
    format!(
        "{} tracks of {}{}: {}; negative log-likelihood {before:.2} nats at temperature 1, {after:.2} at {temperature:.2}",
        coverage.tracks,
        coverage.scenes,
        if coverage.fitted { ", fitted" } else { "" },
        sets.join(", "),
    )
}
