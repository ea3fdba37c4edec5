//! All measures of one candidate, as one row of results.
//!
//! [`Scores`] are not an objective: [`Scorer`] lists more measures than any selection weighs, and calls the functions that the
//! rewards call.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::{
    AdversarialReward, BehaviorPenalty, Candidate, Context, DistributionDistances, DrivableFeasibility,
    EgoPath, Feasibility, KinematicPenalty, LoggedProfile, MapFeasibility, ObjectiveSpec, PersonFeasibility,
    RealismPenalty, Reason, Reward, Situation, Violation, behavior_penalty,
    believable::{doubts, holds_1},
    criticality::{Criticality, ImpactSpeed, RequiredDeceleration},
    kinematic_penalty,
    violation::{AGENT, ROAD_EDGE},
};
use crate::{
    Error,
    registry::{Entry, Registry},
};

/// All measures of one candidate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scores {
    /// Early contact with the ego, else closeness.
    pub adversarial_reward: f64,
    /// Number of steps that are evaluated: those that are recorded, at most 80.
    pub horizon: usize,
    /// Whether ego and adversary touch; `None` if they overlap *now*, where contact is not measured.
    pub collision: Option<bool>,
    /// First step with contact, 1 to the horizon.
    pub collision_step: Option<usize>,
    /// P_kin.
    pub kinematic_penalty: f64,
    /// P_beh.
    pub behavior_penalty: f64,
    /// 50 if a road boundary is touched, else 0; `None` on a map without any.
    pub cross_line: Option<f64>,
    /// 10 if another road user is touched, else 0.
    pub crash_object: f64,
    /// Whether there is neither; of a pedestrian or cyclist, whether the rule `person` holds.
    pub feasible: bool,
    /// Whether the rule `drivable` also holds.
    pub feasible_drivable: bool,
    /// Violations of the rule of `feasible`.
    pub violations: Vec<Violation>,
    /// Violations of the rule of `feasible_drivable`.
    pub violations_drivable: Vec<Violation>,
    /// Whether a person would believe the attack; `None` without contact.
    pub believable: Option<bool>,
    /// The same by the definition before, which knows neither turns nor the time across the lanes.
    #[serde(default, rename = "believable-1", skip_serializing_if = "Option::is_none")]
    pub believable_1: Option<bool>,
    /// Why it is not believable.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub unbelievable: Vec<Reason>,
    /// Distances from the logged future.
    #[serde(flatten)]
    pub distances: DistributionDistances,
    /// Criticality of the encounter.
    #[serde(flatten)]
    pub criticality: Criticality,
    /// Further rewards by name; `None` if one cannot be measured.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub rewards: BTreeMap<String, Option<f64>>,
    /// Violations of further feasibility rules, by name.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub rules: BTreeMap<String, Vec<Violation>>,
}

/// Rewards and rules that are measured in addition to the fields of [`Scores`].
#[derive(Default)]
pub struct FurtherMeasures {
    rewards: Vec<(&'static str, Box<dyn Reward>)>,
    rules: Vec<(&'static str, Box<dyn Feasibility>)>,
}

impl FurtherMeasures {
    /// All registered parts except those with a field in [`Scores`], and costly rewards that the selection does not
    /// name. A part that the selection names once has the selection's options, any other part its defaults. A part that
    /// the selection does not name and that cannot be built is left out: it may need a file that is not there.
    ///
    /// *Errors*: [`Error::Options`] for an entry that the selection names and that refuses its options.
    pub fn of(
        rewards: &Registry<dyn Reward>,
        rules: &Registry<dyn Feasibility>,
        selection: Option<&ObjectiveSpec>,
    ) -> Result<Self, Error> {
        let terms = selection.iter().flat_map(|spec| &spec.terms).map(|term| (&term.name, &term.options));
        let rule = selection.map(|spec| (&spec.feasibility.name, &spec.feasibility.options));
        let given: Vec<_> = terms.chain(rule).collect();
        let known = [
            AdversarialReward::NAME,
            KinematicPenalty::NAME,
            BehaviorPenalty::NAME,
            RealismPenalty::NAME,
            ImpactSpeed::NAME,
            RequiredDeceleration::NAME,
            <MapFeasibility as Entry<dyn Feasibility>>::NAME,
            <DrivableFeasibility as Entry<dyn Feasibility>>::NAME,
            // Of a person it is the rule of `feasible`.
            PersonFeasibility::NAME,
        ];
        let mut rewards = all_but(rewards, &known, &given)?;
        // Only the proposer knows a trajectory's likelihood under the prior.
        let is_named = |name: &str| given.iter().any(|(given, _)| *given == name);
        rewards.retain(|(name, reward)| !reward.needs_prior() && (!reward.is_costly() || is_named(name)));
        Ok(Self { rewards, rules: all_but(rules, &known, &given)? })
    }

    /// As [`FurtherMeasures::of`], but only what a list names: `*` stands for all that are cheap, and a costly reward is
    /// measured if the list or the selection names it.
    ///
    /// *Errors*: as [`FurtherMeasures::of`].
    pub fn listed(
        rewards: &Registry<dyn Reward>,
        rules: &Registry<dyn Feasibility>,
        selection: Option<&ObjectiveSpec>,
        names: &[String],
    ) -> Result<Self, Error> {
        let mut all = Self::of(rewards, rules, selection)?;
        let is_named = |name: &str| names.iter().any(|known| known == name);
        for entry in rewards.entries().iter().filter(|entry| is_named(entry.name)) {
            if all.rewards.iter().all(|(name, _)| *name != entry.name) {
                all.rewards.push((entry.name, rewards.build_default(entry.name)?));
            }
        }
        if !is_named("*") {
            all.rewards.retain(|(name, _)| is_named(name));
            all.rules.retain(|(name, _)| is_named(name));
        }
        Ok(all)
    }

    /// Names of the rewards.
    pub fn rewards(&self) -> impl Iterator<Item = &'static str> {
        self.rewards.iter().map(|(name, _)| *name)
    }

    /// Names of the rules.
    pub fn rules(&self) -> impl Iterator<Item = &'static str> {
        self.rules.iter().map(|(name, _)| *name)
    }
}

/// The entries that are not in `known`, with the options given under their names.
fn all_but<T: ?Sized>(
    registry: &Registry<T>,
    known: &[&str],
    given: &[(&String, &Map<String, Value>)],
) -> Result<Vec<(&'static str, Box<T>)>, Error> {
    let further = registry.entries().iter().filter(|entry| !known.contains(&entry.name));
    let build = |name: &'static str| {
        let mut options = given.iter().filter(|(given, _)| *given == name).map(|(_, options)| *options);
        match (options.next(), options.next()) {
            (Some(options), None) => Some(registry.build(name, &Value::Object(options.clone()))),
            // One column cannot show several options.
            (Some(_), Some(_)) => Some(registry.build_default(name)),
            (None, _) => registry.build_default(name).ok().map(Ok),
        }
    };
    further.filter_map(|entry| Some(build(entry.name)?.map(|part| (entry.name, part)))).collect()
}

/// Measures candidates of one context against its first ego path.
///
/// The measures of `candidate`, a plan in the scene of `ctx`:
///
/// ```
/// # use std::sync::Arc;
/// # use sage_core::{motion::Trajectory, objective::{Context, ContextOptions}, scene::SceneIndex};
/// use sage_core::objective::Scorer;
///
/// # let scene = Arc::new(include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/road.rs")));
/// # let ctx = Context::new(&scene, &SceneIndex::new(scene.map.clone()), &ContextOptions::default())?;
/// # let at = |t: f64| [20.0 + 4.0 * t, (4.0 - 2.0 * t).max(0.0)];
/// # let plan = Trajectory::new("plan", (1..=80).map(|step| at(0.1 * f64::from(step))).collect())?;
/// # let candidate = ctx.candidate(plan);
/// // The adversary cuts in, and is hit at step 27. The paper's reward is 10 (1 − t / 80) at the contact.
/// let scores = Scorer::new(&ctx).scores(&candidate);
/// assert_eq!((scores.collision_step, scores.feasible), (Some(27), true));
/// assert_eq!(scores.adversarial_reward, 10.0 * (1.0 - 27.0 / 80.0));
/// # Ok::<(), sage_core::Error>(())
/// ```
pub struct Scorer<'c> {
    ctx: &'c Context,
    ego: &'c EgoPath,
    logged: LoggedProfile,
    map: MapFeasibility,
    drivable: DrivableFeasibility,
    further: Option<&'c FurtherMeasures>,
}

impl<'c> Scorer<'c> {
    /// A scorer with the default rules.
    pub fn new(ctx: &'c Context) -> Self {
        let (map, drivable) = (MapFeasibility::default(), DrivableFeasibility::default());
        Self { ctx, ego: ctx.ego(), logged: LoggedProfile::of(ctx), map, drivable, further: None }
    }

    /// A scorer with further measures.
    pub fn with(ctx: &'c Context, further: &'c FurtherMeasures) -> Self {
        Self { further: Some(further), ..Self::new(ctx) }
    }

    /// All measures of a candidate.
    pub fn scores(&self, candidate: &Candidate) -> Scores {
        let ctx = self.ctx;
        let situation = Situation::new(candidate, self.ego, ctx);
        let (violations, violations_drivable) = if ctx.adversary().kind.is_person() {
            let violations = PersonFeasibility.violations(candidate, ctx);
            (violations.clone(), violations)
        } else {
            (self.map.violations(candidate, ctx), self.drivable.violations(candidate, ctx))
        };
        let doubts = doubts(&situation, &violations);
        let cost = |rule: &str| {
            violations.iter().filter(|v| v.rule == rule).map(|v| v.cost).fold(0.0, |sum, cost| sum + cost)
        };
        let rewards = self.further.iter().flat_map(|further| &further.rewards);
        let rules = self.further.iter().flat_map(|further| &further.rules);
        Scores {
            adversarial_reward: situation.encounter.reward(ctx.convention()),
            horizon: ctx.horizon(),
            collision: (!ctx.is_in_contact_now()).then_some(situation.encounter.contact.is_some()),
            collision_step: situation.encounter.contact,
            kinematic_penalty: kinematic_penalty(candidate.profile()),
            behavior_penalty: behavior_penalty(candidate.profile()),
            cross_line: (!ctx.index().boundaries().segments().is_empty()).then(|| cost(ROAD_EDGE)),
            crash_object: cost(AGENT),
            feasible: violations.is_empty(),
            feasible_drivable: violations_drivable.is_empty(),
            believable: doubts.as_ref().map(Vec::is_empty),
            believable_1: doubts.as_deref().map(holds_1),
            unbelievable: doubts.unwrap_or_default(),
            distances: self.logged.distances(candidate, ctx.convention()),
            criticality: Criticality::of(&situation),
            rewards: rewards.map(|(name, reward)| ((*name).to_owned(), reward.score(&situation))).collect(),
            rules: rules.map(|(name, rule)| ((*name).to_owned(), rule.violations(candidate, ctx))).collect(),
            violations,
            violations_drivable,
        }
    }
}
