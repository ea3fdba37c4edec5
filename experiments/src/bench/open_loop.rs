//! The table of generators against a replayed ego: the paper's columns and what they hide.

use std::time::Instant;

use anyhow::Result;
use sage_backbones::{
    Backbone,
    backbone::finite,
    training::{Expectation, SceneData, TunedScene},
};
use sage_core::{
    generator::Generator,
    geometry::distance,
    motion::{HORIZON, NOW, Trajectory},
    objective::{CollisionKind, Context, ContextOptions, Convention, Naturalness, Scorer, Scores},
    seed::Rng,
    statistics::{self, Estimate},
};
use sage_generators::logged_future;
use serde::{Deserialize, Serialize};

/// Resamples of an interval.
const RESAMPLES: usize = 2000;

/// What one method did in one scene.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SceneRow {
    /// Scene.
    pub scene: String,
    /// Method with its lambda.
    pub method: String,
    /// Scores in the `paper` convention.
    pub paper: Scores,
    /// Scores in the `release` convention.
    pub release: Scores,
    /// How the chosen way lies to the lanes.
    pub natural: Naturalness,
    /// The same of the log, if the adversary was seen throughout: a filled gap is no driving.
    pub natural_log: Option<Naturalness>,
    /// −log p under the prior of the goal nearest to its end.
    pub surprise: Option<f64>,
    /// The same of the log, if its end was seen.
    pub surprise_log: Option<f64>,
    /// What sort of accident it is.
    pub kind: Option<CollisionKind>,
    /// The chosen way, metres, world frame.
    pub trajectory: Trajectory,
    /// Seconds to generate it.
    pub seconds: f64,
    /// What the generator has to say of its choice.
    pub note: Option<String>,
}

/// One column of the table: a name and what it takes from a row; none where it was not measured.
pub struct Column {
    /// Its name.
    pub name: &'static str,
    /// Its value in a scene.
    pub value: fn(&SceneRow) -> Option<f64>,
    /// Whether it says of each scene yes or no.
    pub is_share: bool,
}

const fn share(name: &'static str, value: fn(&SceneRow) -> Option<f64>) -> Column {
    Column { name, value, is_share: true }
}

const fn mean_of(name: &'static str, value: fn(&SceneRow) -> Option<f64>) -> Column {
    Column { name, value, is_share: false }
}

/// The columns, the paper's first.
pub const COLUMNS: &[Column] = &[
    share("attack", |r| yes(is_attack(r))),
    mean_of("R_adv", |r| Some(r.paper.adversarial_reward)),
    mean_of("P_beh", |r| Some(r.paper.behavior_penalty)),
    mean_of("P_kin", |r| Some(r.paper.kinematic_penalty)),
    mean_of("cross-line", |r| Some(r.paper.cross_line)),
    mean_of("crash-object", |r| Some(r.paper.crash_object)),
    mean_of("WD speed", |r| r.paper.distances.wd_speed),
    mean_of("WD acceleration", |r| r.paper.distances.wd_acceleration),
    mean_of("WD yaw rate", |r| r.paper.distances.wd_yaw_rate),
    share("attack, feasible or not", |r| yes(r.paper.collision)),
    share("strictly feasible", |r| yes(r.paper.feasible_strict)),
    mean_of("impact m/s", |r| r.paper.criticality.impact_speed),
    mean_of("lane m − log", |r| Some(r.natural.lane_distance - r.natural_log?.lane_distance)),
    mean_of("heading ° − log", |r| Some(r.natural.heading_error? - r.natural_log?.heading_error?)),
    mean_of("against − log", |r| Some(r.natural.against_lane - r.natural_log?.against_lane)),
    mean_of("speeding − log", |r| Some(r.natural.speeding - r.natural_log?.speeding)),
    mean_of("surprise − log", |r| Some(r.surprise? - r.surprise_log?)),
    share("release: attack", |r| yes(r.release.collision)),
    mean_of("release: R_adv", |r| Some(r.release.adversarial_reward)),
    mean_of("release: P_beh", |r| Some(r.release.behavior_penalty)),
    mean_of("release: P_kin", |r| Some(r.release.kinematic_penalty)),
    mean_of("release: cross-line", |r| Some(r.release.cross_line)),
    mean_of("release: crash-object", |r| Some(r.release.crash_object)),
];

/// Whether a feasible way hits the ego.
pub fn is_attack(row: &SceneRow) -> bool {
    row.paper.collision && row.paper.feasible
}

fn yes(is: bool) -> Option<f64> {
    Some(f64::from(u8::from(is)))
}

/// Mean of a column over rows with its 95 % interval over scenes: Wilson's for shares of scenes, a
/// bootstrap for the rest.
pub fn estimate(column: &Column, rows: &[SceneRow]) -> Option<Estimate> {
    let values: Vec<f64> = rows.iter().filter_map(column.value).collect();
    if values.iter().all(|v| *v == 0.0 || *v == 1.0) && column.is_share {
        return statistics::wilson(values.iter().filter(|v| **v == 1.0).count(), values.len());
    }
    statistics::bootstrap_mean(&values, RESAMPLES, &mut Rng::new(0, column.name, "open loop"))
}

/// Runs one generator on one scene.
///
/// *Errors*: those of the generator.
pub fn run(data: &SceneData, generator: &dyn Generator, prior: &dyn Backbone, seed: u64) -> Result<SceneRow> {
    let context = |convention| {
        let options = ContextOptions { convention, ..ContextOptions::default() };
        Context::new(&data.scene, &data.index, &options)
    };
    let (ctx, release) = (context(Convention::Paper)?, context(Convention::Release)?);
    let clock = Instant::now();
    let attack = generator.generate(&ctx, seed)?;
    let seconds = clock.elapsed().as_secs_f64();
    attack.check(&data.scene)?;
    let chosen = attack.trajectory();
    let log = logged_future(&data.scene)?;
    let adversary = ctx.adversary();
    let [natural, natural_log] =
        [chosen, &log].map(|path| Naturalness::of(&ctx.candidate(path.clone()), &ctx));
    let candidate = ctx.candidate(chosen.clone());
    let paper = Scorer::new(&ctx).scores(&candidate);
    let [surprise, surprise_log] = surprises(data, prior, [chosen, &log])?;
    Ok(SceneRow {
        scene: data.name.clone(),
        method: generator.name(),
        kind: CollisionKind::of(&candidate, &ctx, paper.collision_step, &paper.criticality),
        paper,
        release: Scorer::new(&release).scores(&release.candidate(chosen.clone())),
        natural,
        natural_log: (adversary.count_valid(NOW + 1..NOW + 1 + HORIZON) == HORIZON).then_some(natural_log),
        surprise,
        surprise_log: surprise_log.filter(|_| adversary.is_valid(NOW + HORIZON)),
        trajectory: chosen.clone(),
        seconds,
        note: attack.note,
    })
}

/// −log p of the goals nearest to the ends of two paths; none if the adversary is not there *now*.
fn surprises(data: &SceneData, prior: &dyn Backbone, paths: [&Trajectory; 2]) -> Result<[Option<f64>; 2]> {
    let adversary = data.scene.adversary_index()?;
    if !data.scene.tracks[adversary].is_valid(NOW) {
        return Ok([None; 2]);
    }
    let features = prior.features(&data.scene, &data.index, adversary)?;
    let encoding = prior.encode(features.into())?;
    let log_probs: Vec<f64> = finite(&prior.log_probs(&encoding)?)?;
    let ends = prior.mode_ends(&encoding)?;
    let surprise = |path: &Trajectory| {
        let end = encoding.features().frame.to_local(path.points()[HORIZON - 1]);
        let gap = |k: &usize| distance(ends[*k].map(f64::from), end);
        (0..ends.len()).min_by(|a, b| gap(a).total_cmp(&gap(b))).map(|k| -log_probs[k])
    };
    Ok(paths.map(surprise))
}

/// Expectations under policies of one prior, without any choice; `None` if the scene cannot be attacked.
///
/// *Errors*: those of the networks.
pub fn expectations<'n>(
    data: &SceneData,
    prior: &dyn Backbone,
    policies: impl Iterator<Item = &'n dyn Backbone>,
) -> Result<Option<Vec<Expectation>>> {
    let Some(prepared) = TunedScene::new(prior, data, false)? else { return Ok(None) };
    Ok(Some(policies.map(|policy| prepared.expectation(policy)).collect::<Result<_, _>>()?))
}

/// Mean and interval of one number of expectations.
pub fn mean(all: &[Expectation], value: fn(&Expectation) -> f64) -> Option<Estimate> {
    let values: Vec<f64> = all.iter().map(value).collect();
    statistics::bootstrap_mean(&values, RESAMPLES, &mut Rng::new(0, "expectation", "open loop"))
}
