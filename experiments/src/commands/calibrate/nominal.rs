//! `sage calibrate --nominal`: the temperature at which a prior is a calibrated density of where vehicles go.

use advsage::{
    Registries,
    rate::{Coverage, LEVELS, NOMINAL_FILE, NominalCard, RecordedEnd, fitted_temperature, hash},
    weights::NamedNetwork,
};
use anyhow::{Result, ensure};
use sage_core::{
    generator::Observation,
    motion::{HORIZON, NOW},
    scene::SceneData,
    statistics::{self, wilson},
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
    let prior = NamedNetwork::load(&registries.backbones, &args.weights)?;
    let scenes = Scenes::of(&args.paths, &args.split.filter(), args.procedural, args.seed)?.attackable()?;
    let ends_of = ends(&prior, &scenes)?;
    let adversaries = &ends_of[Role::Adversary as usize];
    ensure!(!adversaries.is_empty(), "no recorded adversary is valid at the end of its scene");
    // The density is that of the adversary's plans.
    let temperature = fitted_temperature(adversaries);
    let mut coverage: Vec<Coverage> = Role::ALL
        .map(|role| covered(&ends_of, role, temperature, scenes.describe(), role == Role::Adversary))
        .into();
    if !args.unseen.is_empty() {
        let unseen = Scenes::under(&args.unseen)?.attackable()?;
        let ends_of = ends(&prior, &unseen)?;
        coverage.extend(Role::ALL.map(|role| covered(&ends_of, role, temperature, unseen.describe(), false)));
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

/// Whose ends are looked at.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Role {
    Adversary,
    Ego,
}

impl Role {
    const ALL: [Self; 2] = [Self::Adversary, Self::Ego];

    fn name(self) -> &'static str {
        match self {
            Self::Adversary => "adversary",
            Self::Ego => "ego",
        }
    }
}

/// Where the adversary and the ego of each scene were recorded to end, by role, in the density of a prior.
fn ends(prior: &NamedNetwork, scenes: &Scenes) -> Result<[Vec<RecordedEnd>; 2]> {
    let mut progress = Progress::new("read", scenes.len());
    let of_scene = |data: &SceneData| -> Result<[Option<RecordedEnd>; 2]> {
        let now = Observation::of(&data.scene, &data.index)?;
        let end = |track: usize| -> Result<Option<RecordedEnd>> {
            let recorded = &data.scene.tracks[track];
            if recorded.valid.get(LAST) != Some(&true) {
                return Ok(None);
            }
            Ok(RecordedEnd::of(goal_density(&*prior.network, &now, track)?, recorded.point(LAST)))
        };
        Ok([end(data.scene.adversary_index()?)?, end(data.scene.ego)?])
    };
    let all = scenes.map(of_scene, || progress.step())?;
    progress.finish(&format!("{} scenes", all.len()));
    let [mut adversaries, mut egos] = [Vec::new(), Vec::new()];
    for [adversary, ego] in all {
        adversaries.extend(adversary);
        egos.extend(ego);
    }
    Ok([adversaries, egos])
}

/// How often the ends of a role are in the sets of a density.
fn covered(
    ends: &[Vec<RecordedEnd>; 2],
    role: Role,
    temperature: f64,
    scenes: String,
    fitted: bool,
) -> Coverage {
    let ends = &ends[role as usize];
    let nll = |temperature: f64| {
        let values: Vec<f64> = ends.iter().map(|end| end.nll(temperature)).collect();
        statistics::mean(&values).unwrap_or(f64::NAN)
    };
    let set = |level: f64| {
        let inside = ends.iter().filter(|end| end.is_in_set(temperature, level)).count();
        wilson(inside, ends.len()).map(|e| [level, e.value, e.low, e.high])
    };
    Coverage {
        scenes,
        role: role.name().to_owned(),
        fitted,
        tracks: ends.len(),
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
        "{} as {} of {}{}: {}; negative log-likelihood {before:.2} nats at temperature 1, {after:.2} at {temperature:.2}",
        coverage.tracks,
        coverage.role,
        coverage.scenes,
        if coverage.fitted { ", fitted" } else { "" },
        sets.join(", "),
    )
}
