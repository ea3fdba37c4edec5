//! Metrics of a trajectory of the adversary against one path of the ego.

use std::sync::{Arc, OnceLock};

use super::{Metric, Metrics};
use crate::{
    Error,
    generator::{Extension, Note},
    motion::{HORIZON, NOW},
    objective::{
        Candidate, CollisionType, Context, LoggedProfile, Naturalness, Scorer, Scores, Situation,
        violation::MEDIAN,
    },
};

/// Measures of the recorded future, from which those of a trajectory are subtracted.
#[derive(Clone, Copy, Debug, Default)]
pub struct LogMeasures {
    /// Naturalness, if the adversary is valid throughout: interpolated gaps are not driving.
    pub natural: Option<Naturalness>,
    /// −log p under the prior of the goal nearest to its end, if the adversary is valid there.
    pub nll: Option<f64>,
}

/// A trajectory with its measures. Those that few studies show are made when a metric asks for them.
pub struct MeasuredTrajectory {
    /// The scene, in the `paper` convention.
    pub ctx: Arc<Context>,
    /// The same in the `release` convention.
    pub release_ctx: Arc<Context>,
    /// The trajectory.
    pub candidate: Candidate,
    /// Scores in the `paper` convention.
    pub paper: Scores,
    /// −log p under the prior of the goal nearest to the trajectory's end.
    pub nll: Option<f64>,
    /// The same of the log, and its naturalness.
    pub log: LogMeasures,
    /// Note of the generator on its selection.
    pub note: Option<Note>,
    /// What the generator adds to the attack.
    pub extension: Option<Extension>,
    /// Seconds per operating point: the time of all operating points of the generator, divided equally.
    pub seconds: f64,
    /// Measures on demand.
    pub later: Later,
}

/// Measures of a trajectory that are made once, on demand.
#[derive(Default)]
pub struct Later {
    release: OnceLock<Scores>,
    natural: OnceLock<Naturalness>,
    collision_type: OnceLock<Option<CollisionType>>,
}

impl MeasuredTrajectory {
    /// Scores in the `release` convention.
    pub fn release(&self) -> &Scores {
        let ctx = &self.release_ctx;
        let scores = || Scorer::new(ctx).scores(&ctx.candidate(self.candidate.trajectory().clone()));
        self.later.release.get_or_init(scores)
    }

    /// Naturalness.
    pub fn natural(&self) -> &Naturalness {
        self.later.natural.get_or_init(|| Naturalness::of(&self.candidate, &self.ctx))
    }

    /// Type of the collision with the ego's path, if there is one.
    pub fn collision_type(&self) -> Option<CollisionType> {
        *self.later.collision_type.get_or_init(|| {
            let situation = Situation::new(&self.candidate, self.ctx.ego(), &self.ctx);
            CollisionType::of(&situation)
        })
    }

    /// Measures of the log that may be compared with: those of valid frames.
    pub fn log_measures(ctx: &Context, natural: Naturalness, nll: Option<f64>) -> LogMeasures {
        let adversary = ctx.adversary();
        let is_whole = adversary.count_valid(NOW + 1..NOW + 1 + HORIZON) == HORIZON;
        let is_valid_at_end = adversary.is_valid(NOW + HORIZON);
        LogMeasures { natural: is_whole.then_some(natural), nll: nll.filter(|_| is_valid_at_end) }
    }

    /// True if a feasible trajectory hits the ego.
    pub fn is_attack(&self) -> bool {
        feasible_hit(&self.paper)
    }
}

/// True if a feasible trajectory hits the ego.
pub fn feasible_hit(scores: &Scores) -> bool {
    scores.collision == Some(true) && scores.feasible
}

/// The metrics of this crate, the paper's first, and those of what generators add to their attacks.
///
/// *Errors*: two have the same name.
pub fn trajectory_metrics(
    extensions: impl IntoIterator<Item = Metric<MeasuredTrajectory>>,
) -> Result<Metrics<MeasuredTrajectory>, Error> {
    type T = MeasuredTrajectory;
    let natural = |of: fn(&Naturalness) -> Option<f64>| {
        move |t: &T| Some(of(t.natural())? - of(t.log.natural.as_ref()?)?)
    };
    Metrics::default()
        .with_all([
            Metric::share("attack", |t: &T| Some(t.is_attack()))
                .about("a feasible trajectory hits the ego")
                .with_note(|t| t.note.as_ref().map(Note::to_string))
                .more_is_better(),
            Metric::share("believable", |t: &T| Some(t.paper.believable == Some(true)))
                .about("an attack within measurable limits of what cars and drivers do")
                .more_is_better(),
            Metric::mean("R_adv", |t: &T| Some(t.paper.adversarial_reward))
                .about("adversarial reward: early contact, else closeness")
                .more_is_better(),
            Metric::mean("P_beh", |t: &T| Some(t.paper.behavior_penalty))
                .about("behaviour penalty")
                .less_is_better(),
            Metric::mean("P_kin", |t: &T| Some(t.paper.kinematic_penalty))
                .about("kinematic penalty")
                .less_is_better(),
            Metric::mean("P_real", |t: &T| Some(t.paper.kinematic_penalty + t.paper.behavior_penalty))
                .about("realism penalty: P_kin + P_beh")
                .less_is_better(),
            Metric::mean("cross-line", |t: &T| t.paper.cross_line)
                .about("50 if a road boundary is touched, else 0")
                .less_is_better(),
            Metric::mean("crash-object", |t: &T| Some(t.paper.crash_object))
                .about("10 if another road user is touched, else 0")
                .less_is_better(),
            Metric::mean("WD speed", |t: &T| t.paper.distances.wd_speed)
                .unit("m/s")
                .about("Wasserstein distance of the speeds from those of the log")
                .less_is_better(),
            Metric::mean("WD acceleration", |t: &T| t.paper.distances.wd_acceleration)
                .unit("m/s²")
                .about("Wasserstein distance of the accelerations from those of the log")
                .less_is_better(),
            Metric::mean("WD yaw rate", |t: &T| t.paper.distances.wd_yaw_rate)
                .unit("rad/s")
                .about("Wasserstein distance of the yaw rates from those of the log")
                .less_is_better(),
            Metric::share("attack, feasible or not", |t: &T| t.paper.collision)
                .about("the trajectory hits the ego"),
            Metric::share("attacks on a median", |t: &T| {
                t.is_attack().then(|| t.paper.unbelievable.iter().any(|reason| reason.reason == MEDIAN))
            })
            .about("of the attacks, those that touch a median")
            .less_is_better(),
            Metric::share("feasible", |t: &T| Some(t.paper.feasible))
                .about("no rule is violated")
                .more_is_better(),
            Metric::share("feasible by `drivable`", |t: &T| Some(t.paper.feasible_drivable))
                .about("nor a rule of `drivable`")
                .more_is_better(),
            Metric::mean("impact", |t: &T| t.paper.criticality.impact_speed)
                .unit("m/s")
                .about("relative speed at the contact"),
            Metric::mean("lane distance − log", natural(|n| Some(n.lane_distance)))
                .unit("m")
                .about("mean distance to the nearest lane in the direction of motion, minus that of the log")
                .less_is_better(),
            Metric::mean("heading error − log", natural(|n| n.heading_error))
                .unit("°")
                .about("mean angle to that lane, minus that of the log")
                .less_is_better(),
            Metric::mean("against − log", natural(|n| Some(n.against_lane)))
                .about("share of the time against the traffic, minus that of the log")
                .less_is_better(),
            Metric::mean("speeding − log", natural(|n| Some(n.speeding)))
                .about("share of the time above the speed limit, minus that of the log")
                .less_is_better(),
            Metric::mean("nll − log", |t: &T| Some(t.nll? - t.log.nll?))
                .unit("nats")
                .about("negative log-likelihood of its end under the prior, minus that of the log")
                .less_is_better(),
            Metric::mean("lane distance", |t: &T| Some(t.natural().lane_distance))
                .unit("m")
                .about("without subtraction"),
            Metric::mean("nll", |t: &T| t.nll).unit("nats").about("without subtraction").less_is_better(),
            Metric::share("release: attack", |t: &T| t.release().collision)
                .about("as the published code counts it"),
            Metric::mean("release: R_adv", |t: &T| Some(t.release().adversarial_reward)),
            Metric::mean("release: P_beh", |t: &T| Some(t.release().behavior_penalty)),
            Metric::mean("release: P_kin", |t: &T| Some(t.release().kinematic_penalty)),
            Metric::mean("release: cross-line", |t: &T| t.release().cross_line),
            Metric::mean("release: crash-object", |t: &T| Some(t.release().crash_object)),
            Metric::mean("horizon", |t: &T| Some(t.paper.horizon as f64))
                .unit("steps")
                .about("steps that are evaluated"),
            Metric::mean("collision step", |t: &T| t.paper.collision_step.map(|step| step as f64))
                .unit("steps")
                .about("first step with contact"),
        ])?
        .with_all(extensions)?
        .with_all([Metric::median("generation", |t: &T| Some(1e3 * t.seconds))
            .unit("ms")
            .about("time of one operating point; it differs from run to run")
            .varying()
            .less_is_better()])?
        .with_all(pooled_distances())?
        .with_all(CollisionType::ALL.map(|kind| {
            Metric::share(format!("type: {}", kind.name()), move |t: &T| {
                Some(t.is_attack() && t.collision_type() == Some(kind))
            })
            .about("an attack with a collision of this type")
        }))
}

/// Distances of speeds, accelerations and yaw rates from those of the log, pooled over scenes: with a right mask, and as the
/// published evaluation takes them.
fn pooled_distances() -> [Metric<MeasuredTrajectory>; 6] {
    type T = MeasuredTrajectory;
    let right = |of: fn([&Vec<f64>; 3]) -> &Vec<f64>| {
        move |t: &T| {
            let own = t.candidate.profile();
            let log = LoggedProfile::of(&t.ctx);
            let log = of([&log.speed, &log.acceleration, &log.yaw_rate]).clone();
            (!log.is_empty()).then(|| [of([&own.speed, &own.acceleration, &own.yaw_rate]).clone(), log])
        }
    };
    let published = |of: fn([&Vec<f64>; 3]) -> &Vec<f64>| {
        move |t: &T| {
            let own = t.release_ctx.candidate(t.candidate.trajectory().clone());
            let own = own.profile();
            let log = LoggedProfile::published(t.release_ctx.adversary());
            let own = of([&own.speed, &own.acceleration_norm, &own.yaw_rate]).clone();
            Some([own, of([&log.speed, &log.acceleration, &log.yaw_rate]).clone()])
        }
    };
    let pooled = |quantity: &str| {
        format!("Wasserstein distance of the {quantity} of all scenes from those of all logs")
    };
    let mistaken = |quantity: &str| {
        format!(
            "distance of the {quantity} from those of a standing car, by the published mistake in a mask: the mean of their absolute values"
        )
    };
    [
        Metric::pooled("pooled WD speed", right(|[x, ..]| x))
            .unit("m/s")
            .about(pooled("speeds"))
            .less_is_better(),
        Metric::pooled("pooled WD acceleration", right(|[_, x, _]| x))
            .unit("m/s²")
            .about(pooled("accelerations"))
            .less_is_better(),
        Metric::pooled("pooled WD yaw rate", right(|[.., x]| x))
            .unit("rad/s")
            .about(pooled("yaw rates"))
            .less_is_better(),
        Metric::pooled("published WD speed", published(|[x, ..]| x)).unit("m/s").about(mistaken("speeds")),
        Metric::pooled("published WD acceleration", published(|[_, x, _]| x))
            .unit("m/s²")
            .about(mistaken("norms of the accelerations")),
        Metric::pooled("published WD yaw rate", published(|[.., x]| x))
            .unit("rad/s")
            .about(mistaken("yaw rates")),
    ]
}

impl Metrics<MeasuredTrajectory> {
    /// Adds the registered rewards and rules that no built-in metric shows: a mean for each reward, and the share of
    /// scenes in which a rule is satisfied. Their values are those of [`Scores`].
    ///
    /// *Errors*: a reward has the name of another metric.
    pub fn with_parts<'n>(
        self,
        rewards: impl Iterator<Item = &'n str>,
        rules: impl Iterator<Item = &'n str>,
    ) -> Result<Self, Error> {
        let reward = |name: &str| {
            let of = name.to_owned();
            Metric::mean(of.clone(), move |t: &MeasuredTrajectory| {
                t.paper.rewards.get(&of).copied().flatten()
            })
            .about("a registered reward")
        };
        let rule = |name: &str| {
            let of = name.to_owned();
            Metric::share(of.clone(), move |t: &MeasuredTrajectory| t.paper.rules.get(&of).map(Vec::is_empty))
                .about("a registered rule is satisfied")
        };
        let rewards: Vec<_> = rewards.map(reward).collect();
        let rules: Vec<_> = rules.map(rule).collect();
        self.with_all(rewards)?.with_all(rules)
    }
}
