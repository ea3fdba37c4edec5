//! `sage calibrate --nominal`: the temperature at which a prior is a calibrated density of where vehicles go, and how they are timed.

mod meetings;

use advsage::{
    Registries,
    rate::{
        Coverage, Density, LEVELS, NOMINAL_FILE, NominalCard, PROFILES, RecordedEnd, RecordedTiming, Timing,
        TimingGain, fitted_spread, fitted_temperature, gains, hash,
    },
    search,
    weights::NamedNetwork,
};
use anyhow::{Result, ensure};
use sage_backbones::Backbone;
use sage_bench::estimate::Samples;
use sage_core::{
    generator::Observation,
    metric::Aggregate,
    motion::{HORIZON, NOW},
    scene::SceneData,
    statistics::{self, wilson},
};
use sage_generators::{TimedPath, goal_density, trajectory_to};
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
    let fit = Recorded::of(&*prior.network, &scenes)?;
    let adversaries = &fit.ends[Role::Adversary as usize];
    ensure!(!adversaries.is_empty(), "no recorded adversary is valid at the end of its scene");
    // The density is that of the adversary's plans.
    let temperature = fitted_temperature(adversaries);
    let timing = Timing::of(&fit.timings);
    let shifts = timing.as_ref().map_or(vec![0.0], |timing| timing.shifts(PROFILES));
    let spreads = [fitted_spread(&fit.timings, &[0.0]), fitted_spread(&fit.timings, &shifts)];
    let (weights, prior) = (prior.name, prior.network.into());
    let density = Density {
        weights,
        prior,
        temperature,
        shifts,
        is_aware: false,
        coverage: Vec::new(),
        notes: Vec::new(),
    };
    let rule = search::rule(registries, None)?;
    let (mut coverage, mut timing_gain, mut met) = (Vec::new(), Vec::new(), Vec::new());
    let mut report = |recorded: &Recorded, scenes: &Scenes, fitted: bool| -> Result<()> {
        for role in Role::ALL.into_iter().filter(|role| !recorded.ends[*role as usize].is_empty()) {
            let is_fitted = fitted && role == Role::Adversary;
            coverage.push(covered(&recorded.ends, role, temperature, scenes.describe(), is_fitted));
        }
        let gains = gains(&recorded.timings, &density.shifts, spreads);
        timing_gain.extend(gain(&gains, scenes.describe(), fitted));
        met.extend(meetings::meetings(&density, &rule, scenes)?);
        Ok(())
    };
    report(&fit, &scenes, true)?;
    if !args.unseen.is_empty() {
        let unseen = Scenes::under(&args.unseen)?.attackable()?;
        report(&Recorded::of(&*density.prior, &unseen)?, &unseen, false)?;
    }
    for coverage in &coverage {
        progress::say(&words(coverage, temperature));
    }
    for gain in &timing_gain {
        let [value, low, high] = gain.nats;
        progress::say(&format!(
            "{} timings of adversaries of {}{}: {PROFILES} are {value:.2} nats [{low:.2}, {high:.2}] likelier than one",
            gain.tracks,
            gain.scenes,
            if gain.fitted { ", fitted" } else { "" },
        ));
    }
    for met in &met {
        let share = |[value, low, high]: [f64; 3]| {
            format!("{:.1} % [{:.1}, {:.1}]", 100.0 * value, 100.0 * low, 100.0 * high)
        };
        progress::say(&format!(
            "{} adversaries of {}, {}: contact with the recorded ego {}, PET below 1 s {}",
            met.adversaries,
            met.scenes,
            met.whose,
            share(met.contact),
            share(met.near_miss),
        ));
    }
    let card = NominalCard {
        temperature,
        prior: hash(&*density.prior)?,
        command: output::command(),
        coverage,
        timing,
        timing_gain,
        meetings: met,
    };
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

/// What is recorded of the vehicles of scenes, in the density of a prior.
#[derive(Default)]
struct Recorded {
    /// Where adversaries and egos ended, by role.
    ends: [Vec<RecordedEnd>; 2],
    /// How adversaries were timed.
    timings: Vec<RecordedTiming>,
}

impl Recorded {
    fn of(prior: &dyn Backbone, scenes: &Scenes) -> Result<Self> {
        let mut progress = Progress::new("read", scenes.len());
        let of_scene = |data: &SceneData| -> Result<([Option<RecordedEnd>; 2], Option<RecordedTiming>)> {
            let now = Observation::of(&data.scene, &data.index)?;
            let end = |track: usize| -> Result<Option<RecordedEnd>> {
                let recorded = &data.scene.tracks[track];
                if recorded.valid.get(LAST) != Some(&true) {
                    return Ok(None);
                }
                Ok(RecordedEnd::of(goal_density(prior, &now, track)?, recorded.point(LAST)))
            };
            let adversary = data.scene.adversary_index()?;
            Ok(([end(adversary)?, end(data.scene.ego)?], timing(prior, &now, data, adversary)?))
        };
        let all = scenes.map(of_scene, || progress.step())?;
        progress.finish(&format!("{} scenes", all.len()));
        let mut recorded = Self::default();
        for (ends, timing) in all {
            for (of_role, end) in recorded.ends.iter_mut().zip(ends) {
                of_role.extend(end);
            }
            recorded.timings.extend(timing);
        }
        Ok(recorded)
    }
}

/// How an adversary was timed beside the trajectory of the goal nearest to its end; `None` if a frame of its future is missing.
fn timing(
    prior: &dyn Backbone,
    now: &Observation,
    data: &SceneData,
    adversary: usize,
) -> Result<Option<RecordedTiming>> {
    let recorded = &data.scene.tracks[adversary];
    if !(NOW..=LAST).all(|frame| recorded.valid.get(frame) == Some(&true)) {
        return Ok(None);
    }
    let Some(to_end) = trajectory_to(prior, now, adversary, recorded.point(LAST))? else {
        return Ok(None);
    };
    let path = TimedPath::new(recorded.point(NOW), &to_end);
    let steps = std::array::from_fn(|step| recorded.point(NOW + 1 + step));
    Ok(Some(RecordedTiming::of(&path, &steps)))
}

/// What several timings gain, with its interval over scenes; none without a track.
fn gain(gains: &[f64], scenes: String, fitted: bool) -> Option<TimingGain> {
    let samples = Samples::of(gains.iter().copied().map(Some));
    let mean = samples.estimate(Aggregate::Mean, "timing")?;
    let nats = [mean.value, mean.low, mean.high];
    Some(TimingGain { scenes, fitted, profiles: PROFILES, tracks: gains.len(), nats })
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
