//! The table of generators against a replayed ego: the paper's columns and further measures.

use std::{sync::Arc, time::Instant};

use anyhow::Result;
use sage_backbones::{
    Backbone, MotionModel,
    backbone::finite,
    features::Frame,
    training::{Expectation, Measures, PreparedScene},
};
use sage_core::{
    generator::{Attack, Note},
    geometry::distance,
    motion::{HORIZON, NOW, Trajectory},
    objective::{
        CollisionType, Context, ContextOptions, Convention, FurtherMeasures, Naturalness, Scorer, Scores,
        Situation, violation::MEDIAN,
    },
    scene::SceneData,
    seed::Rng,
    statistics::{self, Estimate},
};
use sage_generators::logged_future;
use sage_sim::{
    attack_test::AttackTest,
    avoidable::{Avoidable, Avoidance, AvoidanceOptions},
};
use serde::{Deserialize, Serialize};

use super::closed_loop::Driven;
use crate::{generators::BuiltGenerator, operating_point::RowKey};

/// Resamples of an interval.
const RESAMPLES: usize = 2000;

/// Result of one generator in one scene.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SceneRow {
    /// Name of the scene.
    pub scene: String,
    /// The generator and its operating point.
    pub key: RowKey,
    /// Scores in the `paper` convention.
    pub paper: Scores,
    /// Scores in the `release` convention.
    pub release: Scores,
    /// Naturalness of the selected trajectory.
    pub natural: Naturalness,
    /// Naturalness of the log, if the adversary is valid throughout: interpolated gaps are not driving.
    pub natural_log: Option<Naturalness>,
    /// −log p under the prior of the goal nearest to the trajectory's end.
    pub nll: Option<f64>,
    /// The same of the log, if the adversary is valid at its end.
    pub nll_log: Option<f64>,
    /// Type of the collision.
    pub collision_type: Option<CollisionType>,
    /// The selected trajectory, metres, world frame.
    pub trajectory: Trajectory,
    /// Seconds per operating point: the time of all operating points of the generator, divided equally.
    pub seconds: f64,
    /// Note of the generator on its selection.
    pub note: Option<Note>,
    /// Whether a driver could have avoided the attack; `None` unless it was asked for.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub avoidable: Option<Avoidable>,
    /// What happens when a driver meets the attack; `None` without a simulation.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub driven: Option<Driven>,
}

/// A column of the table.
pub struct Column {
    /// Name of the column.
    pub name: &'static str,
    /// How it takes its value from a row.
    pub value: Value,
    /// True if the value of each scene is 0 or 1.
    pub is_share: bool,
}

/// How a column takes its value from a row.
#[derive(Clone, Copy)]
pub enum Value {
    /// A built-in measure.
    Of(fn(&SceneRow) -> Option<f64>),
    /// The further reward with the column's name.
    Reward,
    /// 1 if the further rule with the column's name is satisfied.
    Rule,
}

impl Column {
    /// Value of a scene; `None` if it was not measured.
    pub fn of(&self, row: &SceneRow) -> Option<f64> {
        match self.value {
            Value::Of(value) => value(row),
            Value::Reward => row.paper.rewards.get(self.name).copied().flatten(),
            Value::Rule => row.paper.rules.get(self.name).and_then(|violations| yes(violations.is_empty())),
        }
    }
}

/// Columns of a table: the built-in ones, those of the search for ways out if it was made, a mean for each further
/// reward, a share for each further rule.
pub(crate) fn columns(further: &FurtherMeasures, with_avoidable: bool) -> Vec<Column> {
    let searched = if with_avoidable { AVOIDABLE } else { &[] };
    let own = COLUMNS.iter().chain(searched);
    let own = own.map(|c| Column { name: c.name, value: c.value, is_share: c.is_share });
    let rewards = further.rewards().filter(|name| !SHOWN.contains(name));
    let rewards = rewards.map(|name| Column { name, value: Value::Reward, is_share: false });
    let rules = further.rules().map(|name| Column { name, value: Value::Rule, is_share: true });
    own.chain(rewards).chain(rules).collect()
}

/// Rewards that built-in columns already show in another form.
const SHOWN: [&str; 1] = ["lane-distance"];

const fn share(name: &'static str, value: fn(&SceneRow) -> Option<f64>) -> Column {
    Column { name, value: Value::Of(value), is_share: true }
}

const fn mean_of(name: &'static str, value: fn(&SceneRow) -> Option<f64>) -> Column {
    Column { name, value: Value::Of(value), is_share: false }
}

/// The built-in columns, the paper's first.
pub const COLUMNS: &[Column] = &[
    share("attack", |r| yes(is_attack(r))),
    share("believable", |r| yes(is_believable(r))),
    mean_of("R_adv", |r| Some(r.paper.adversarial_reward)),
    mean_of("P_beh", |r| Some(r.paper.behavior_penalty)),
    mean_of("P_kin", |r| Some(r.paper.kinematic_penalty)),
    mean_of("cross-line", |r| r.paper.cross_line),
    mean_of("crash-object", |r| Some(r.paper.crash_object)),
    mean_of("WD speed", |r| r.paper.distances.wd_speed),
    mean_of("WD acceleration", |r| r.paper.distances.wd_acceleration),
    mean_of("WD yaw rate", |r| r.paper.distances.wd_yaw_rate),
    share("attack, feasible or not", |r| yes(r.paper.collision?)),
    share("attacks on a median", |r| if is_attack(r) { yes(touches_median(r)) } else { None }),
    share("feasible by `drivable`", |r| yes(r.paper.feasible_drivable)),
    mean_of("impact m/s", |r| r.paper.criticality.impact_speed),
    mean_of("lane m − log", |r| Some(r.natural.lane_distance - r.natural_log?.lane_distance)),
    mean_of("heading ° − log", |r| Some(r.natural.heading_error? - r.natural_log?.heading_error?)),
    mean_of("against − log", |r| Some(r.natural.against_lane - r.natural_log?.against_lane)),
    mean_of("speeding − log", |r| Some(r.natural.speeding - r.natural_log?.speeding)),
    mean_of("nll − log", |r| Some(r.nll? - r.nll_log?)),
    share("release: attack", |r| yes(r.release.collision?)),
    mean_of("release: R_adv", |r| Some(r.release.adversarial_reward)),
    mean_of("release: P_beh", |r| Some(r.release.behavior_penalty)),
    mean_of("release: P_kin", |r| Some(r.release.kinematic_penalty)),
    mean_of("release: cross-line", |r| r.release.cross_line),
    mean_of("release: crash-object", |r| Some(r.release.crash_object)),
];

/// Columns of the search for ways out, over the attacks alone. Times are of attacks for which one was found.
const AVOIDABLE: &[Column] = &[
    share("avoidable", |r| avoidable(r).and_then(|a| yes(a.avoidable?))),
    share("avoidable, nobody behind", |r| avoidable(r).and_then(|a| yes(a.avoidable_unhit?))),
    share("recovers", |r| avoidable(r).and_then(|a| yes(a.recovers?))),
    mean_of("react s", |r| avoidable(r)?.time_to_react),
    mean_of("brake s", |r| avoidable(r)?.time_to_brake),
    mean_of("steer s", |r| avoidable(r)?.time_to_steer),
];

/// True if a feasible trajectory hits the ego.
pub fn is_attack(row: &SceneRow) -> bool {
    row.paper.collision == Some(true) && row.paper.feasible
}

/// True if a person would believe the attack.
pub fn is_believable(row: &SceneRow) -> bool {
    row.paper.believable == Some(true)
}

/// Whether an attack is avoidable; `None` if it is no attack.
fn avoidable(row: &SceneRow) -> Option<&Avoidable> {
    row.avoidable.as_ref().filter(|_| is_attack(row))
}

fn touches_median(row: &SceneRow) -> bool {
    row.paper.unbelievable.iter().any(|reason| reason.reason == MEDIAN)
}

fn yes(is: bool) -> Option<f64> {
    Some(f64::from(u8::from(is)))
}

/// Mean of a column over rows with its 95 % interval over scenes: Wilson's for shares of scenes, a
/// bootstrap for the rest.
pub fn estimate(column: &Column, rows: &[SceneRow]) -> Option<Estimate> {
    let values: Vec<f64> = rows.iter().filter_map(|row| column.of(row)).collect();
    if values.iter().all(|v| *v == 0.0 || *v == 1.0) && column.is_share {
        return statistics::wilson(values.iter().filter(|v| **v == 1.0).count(), values.len());
    }
    // This random stream keeps its old name, so that intervals keep their bits.
    let stream = if column.name == "nll − log" { "surprise − log" } else { column.name };
    statistics::bootstrap_mean(&values, RESAMPLES, &mut Rng::new(0, stream, "open loop"))
}

/// A scene prepared for the rows of all generators.
pub(crate) struct MeasuredScene<'d> {
    data: &'d SceneData,
    ctx: Context,
    release: Context,
    further: &'d FurtherMeasures,
    natural_log: Naturalness,
    likelihood: Option<PriorOfAdversary>,
    nll_log: Option<f64>,
    avoidance: Option<Avoidance>,
}

impl<'d> MeasuredScene<'d> {
    /// Prepares contexts in both conventions, measures of the log, and the prior's goal probabilities.
    ///
    /// *Errors*: the scene cannot be attacked; those of the prior.
    pub(crate) fn new(
        data: &'d SceneData,
        prior: &dyn Backbone,
        further: &'d FurtherMeasures,
    ) -> Result<Self> {
        let context = |convention| {
            let options = ContextOptions { convention, ..ContextOptions::default() };
            Context::new(&data.scene, &data.index, &options)
        };
        let (ctx, release) = (context(Convention::Paper)?, context(Convention::Release)?);
        let log = logged_future(&data.scene)?;
        let natural_log = Naturalness::of(&ctx.candidate(log.clone()), &ctx);
        let likelihood = PriorOfAdversary::of(data, prior)?;
        let nll_log = likelihood.as_ref().and_then(|prior| prior.nll(&log));
        Ok(Self { data, ctx, release, further, natural_log, likelihood, nll_log, avoidance: None })
    }

    /// The same, with the search for ways out of attacks.
    ///
    /// *Errors*: options out of range.
    pub(crate) fn with_avoidance(self, options: Option<AvoidanceOptions>) -> Result<Self> {
        let avoidance = options.map(|options| Avoidance::new(&self.ctx, options)).transpose()?;
        Ok(Self { avoidance, ..self })
    }

    /// Runs a generator at all its operating points; a row for each.
    ///
    /// *Errors*: those of the generator.
    pub(crate) fn rows(&self, built: &BuiltGenerator, seed: u64) -> Result<Vec<SceneRow>> {
        let clock = Instant::now();
        let attacks = built.generator.attacks(&self.ctx, &built.points, seed)?;
        let seconds = clock.elapsed().as_secs_f64() / attacks.len() as f64;
        let rows = built.keys.iter().zip(attacks);
        rows.map(|(key, attack)| self.row(key.clone(), attack, seconds)).collect()
    }

    fn row(&self, key: RowKey, attack: Attack, seconds: f64) -> Result<SceneRow> {
        let Self { data, ctx, release, natural_log, .. } = self;
        attack.check(&data.scene)?;
        let trajectory = attack.trajectory();
        let adversary = ctx.adversary();
        let candidate = ctx.candidate(trajectory.clone());
        let paper = Scorer::with(ctx, self.further).scores(&candidate);
        let situation = Situation::new(&candidate, ctx.ego(), ctx);
        Ok(SceneRow {
            scene: data.name.clone(),
            key,
            collision_type: CollisionType::of(&situation, &paper.criticality),
            paper,
            release: Scorer::new(release).scores(&release.candidate(trajectory.clone())),
            natural: Naturalness::of(&candidate, ctx),
            natural_log: (adversary.count_valid(NOW + 1..NOW + 1 + HORIZON) == HORIZON)
                .then_some(*natural_log),
            nll: self.likelihood.as_ref().and_then(|prior| prior.nll(trajectory)),
            nll_log: self.nll_log.filter(|_| adversary.is_valid(NOW + HORIZON)),
            trajectory: trajectory.clone(),
            seconds,
            note: attack.note,
            avoidable: self.avoidance.as_ref().map(|avoidance| avoidance.of(&candidate)),
            driven: None,
        })
    }

    /// Drives again against the attack of each row.
    ///
    /// *Errors*: as [`AttackTest::attack`].
    pub(crate) fn drive(&self, rows: &mut [SceneRow], test: &AttackTest) -> Result<()> {
        for row in rows {
            row.driven = Some(Driven::of(&test.attack(&row.trajectory, row.paper.feasible)?, &self.ctx));
        }
        Ok(())
    }
}

/// Log-probabilities of the adversary's goals under the prior.
struct PriorOfAdversary {
    frame: Frame,
    ends: Vec<[f32; 2]>,
    log_probs: Vec<f64>,
}

impl PriorOfAdversary {
    /// `None` if the adversary is not valid *now*.
    fn of(data: &SceneData, prior: &dyn Backbone) -> Result<Option<Self>> {
        let adversary = data.scene.adversary_index()?;
        if !data.scene.tracks[adversary].is_valid(NOW) {
            return Ok(None);
        }
        let features = prior.features(&data.observe()?, adversary, None)?;
        let encoding = prior.encode(features.into())?;
        let log_probs: Vec<f64> = finite(&prior.log_probs(&encoding)?)?;
        let ends = prior.mode_ends(&encoding)?;
        Ok(Some(Self { frame: encoding.features().frame, ends, log_probs }))
    }

    /// −log p of the goal nearest to the end of a trajectory.
    fn nll(&self, trajectory: &Trajectory) -> Option<f64> {
        let end = self.frame.to_local(trajectory.points()[HORIZON - 1]);
        let gap = |k: &usize| distance(self.ends[*k].map(f64::from), end);
        (0..self.ends.len()).min_by(|a, b| gap(a).total_cmp(&gap(b))).map(|k| -self.log_probs[k])
    }
}

/// Expectations under policies of one prior, without selection; `None` if the scene cannot be attacked.
///
/// *Errors*: those of the networks.
pub fn expectations(
    data: &SceneData,
    prior: &dyn Backbone,
    policies: &[Arc<dyn MotionModel>],
    measures: &Measures,
) -> Result<Option<Vec<Expectation>>> {
    let Some(prepared) = PreparedScene::new(prior, data, false, measures)? else { return Ok(None) };
    Ok(Some(policies.iter().map(|policy| prepared.expectation(&**policy)).collect::<Result<_, _>>()?))
}

/// Mean and interval of one value over expectations.
pub fn mean(all: &[Expectation], value: fn(&Expectation) -> f64) -> Option<Estimate> {
    let values: Vec<f64> = all.iter().map(value).collect();
    statistics::bootstrap_mean(&values, RESAMPLES, &mut Rng::new(0, "expectation", "open loop"))
}
