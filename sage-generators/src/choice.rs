//! The choice among candidates: the best preference among the feasible.

use sage_core::{
    Error,
    motion::Trajectory,
    objective::{
        Candidate, Context, Encounter, Feasibility, MapFeasibility, Rule, StrictFeasibility,
        behavior_penalty, coarse_lane_distance, kinematic_penalty, touches_boundary,
    },
    registry::Entry,
};
use serde::{Deserialize, Serialize};

/// What is weighed beside the preference.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Choice {
    /// `μ R_adv − (1 − μ) P_real`, as in the paper.
    Paper,
    /// The same less a little of the distance from the lanes and of the surprise under the prior.
    Natural,
}

impl Choice {
    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Paper => "paper",
            Self::Natural => "natural",
        }
    }
}

/// Cost of a metre of mean lane distance in [`Choice::Natural`].
const LANE: f64 = 0.1;
/// Cost of a nat of surprise.
const SURPRISE: f64 = 0.05;
/// Cost of a touched edge where nothing is feasible, as published.
const EDGE: f64 = 50.0;
/// Cost of a touched agent.
const AGENT: f64 = 10.0;

/// What a candidate is worth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Judged {
    /// Adversarial reward.
    pub reward: f64,
    /// Penalty for driving unlike a car.
    pub penalty: f64,
    /// Cost of what it touches.
    pub map_penalty: f64,
    /// Whether it hits the ego.
    pub hits: bool,
    /// Cost of being unnatural; 0 in [`Choice::Paper`].
    pub unnatural: f64,
}

impl Judged {
    /// Whether it touches nothing that it must not.
    pub fn is_feasible(&self) -> bool {
        self.map_penalty == 0.0
    }

    /// What the choice makes large at a weight μ.
    pub fn value(&self, mu: f64) -> f64 {
        mu * self.reward - (1.0 - mu) * self.penalty - self.unnatural
    }
}

/// What a car is taken to be able to do: where the kinematic penalty begins to bite.
const LIMITS: Limits = Limits { along: 7.0, across: 6.0, yaw_rate: 0.8 };

struct Limits {
    /// Acceleration and braking, m/s².
    along: f64,
    /// Acceleration across, m/s².
    across: f64,
    /// Yaw rate, rad/s.
    yaw_rate: f64,
}

/// Whether a car could drive a path here: at every step within 7 m/s² along, 6 m/s² across and
/// 0.8 rad/s, and over no road edge, which the driver knows as well as we do.
pub fn is_drivable(candidate: &Candidate, ctx: &Context) -> bool {
    let profile = candidate.profile();
    let mut steps = profile.speed.iter().zip(&profile.acceleration).zip(&profile.yaw_rate);
    let within = steps.all(|((speed, along), yaw_rate)| {
        along.abs() <= LIMITS.along
            && (speed * yaw_rate).abs() <= LIMITS.across
            && yaw_rate.abs() <= LIMITS.yaw_rate
    });
    within && !touches_boundary(candidate, ctx)
}

/// The first `most` of some paths that a car could drive, with their numbers and in their order; if they
/// are fewer, the others follow. What comes after the last of them is not asked for.
///
/// *Errors*: the first of a path.
pub fn drivable(
    paths: impl IntoIterator<Item = Result<Trajectory, Error>>,
    most: usize,
    ctx: &Context,
) -> Result<Vec<(usize, Candidate)>, Error> {
    let (mut kept, mut others) = (Vec::with_capacity(most), Vec::new());
    let mut paths = paths.into_iter().enumerate();
    while kept.len() < most
        && let Some((number, path)) = paths.next()
    {
        let candidate = ctx.candidate(path?);
        if is_drivable(&candidate, ctx) {
            kept.push((number, candidate));
        } else if others.len() < most {
            others.push((number, candidate));
        }
    }
    let missing = most - kept.len();
    kept.extend(others.into_iter().take(missing));
    Ok(kept)
}

/// Judges candidates and chooses.
pub struct Judge {
    rule: Box<dyn Feasibility>,
    choice: Choice,
    mu: f64,
}

impl Judge {
    /// A judge by the `paper` or the strict rule.
    ///
    /// *Errors*: a μ outside [0, 1].
    pub fn new(choice: Choice, mu: f64, strict: bool) -> Result<Self, String> {
        if !(0.0..=1.0).contains(&mu) {
            return Err(format!("mu is {mu}; expected 0 to 1"));
        }
        let rule = if strict {
            StrictFeasibility::build(Default::default())?
        } else {
            MapFeasibility::build(Default::default())?
        };
        Ok(Self { rule, choice, mu })
    }

    /// Whether surprise is weighed at all.
    pub fn needs_surprise(&self) -> bool {
        self.choice == Choice::Natural
    }

    /// Judges one way; `surprise` is its −log p under the prior, up to what all candidates share.
    pub fn judge(&self, candidate: &Candidate, surprise: f64, ctx: &Context) -> Judged {
        let costs = self.rule.violations(candidate, ctx);
        let is_feasible = costs.is_empty();
        let cost = |rule: Rule| if rule == Rule::Agent { AGENT } else { EDGE };
        let at_best = self.at_best(candidate, surprise, ctx);
        Judged {
            map_penalty: costs.iter().map(|reason| cost(reason.rule)).sum(),
            unnatural: match self.choice {
                // Only the feasible are compared by it.
                Choice::Natural if is_feasible => {
                    LANE * coarse_lane_distance(candidate, ctx) + at_best.unnatural
                }
                _ => 0.0,
            },
            ..at_best
        }
    }

    /// What a way is worth if it touches nothing and keeps to the lanes: the map is not asked.
    fn at_best(&self, candidate: &Candidate, surprise: f64, ctx: &Context) -> Judged {
        let encounter = Encounter::of(candidate, ctx);
        Judged {
            reward: encounter.reward(ctx.convention()),
            penalty: kinematic_penalty(candidate.profile()) + behavior_penalty(candidate.profile()),
            map_penalty: 0.0,
            hits: encounter.contact.is_some(),
            unnatural: match self.choice {
                Choice::Natural => SURPRISE * surprise,
                Choice::Paper => 0.0,
            },
        }
    }

    /// Judges many paths with their surprises and chooses as [`Judge::choose`] does, the most promising
    /// first: what can no longer win is not asked what it touches.
    pub fn search<'p>(
        &self,
        ways: impl Iterator<Item = (&'p Trajectory, f64)>,
        ctx: &Context,
    ) -> (usize, Option<String>) {
        let at_best = |(path, surprise): (&Trajectory, f64)| {
            self.at_best(&ctx.candidate(path.clone()), surprise, ctx).value(self.mu)
        };
        let ways: Vec<_> = ways.collect();
        let mut order: Vec<(f64, usize)> = ways.iter().map(|&way| at_best(way)).zip(0..).collect();
        order.sort_by(|a, b| b.0.total_cmp(&a.0));
        let (mut most, mut judged) = (f64::NEG_INFINITY, Vec::new());
        for (at_best, k) in order {
            if at_best < most {
                break;
            }
            let (path, surprise) = ways[k];
            let j = self.judge(&ctx.candidate(path.clone()), surprise, ctx);
            if j.is_feasible() {
                most = most.max(j.value(self.mu));
            }
            judged.push((k, j));
        }
        judged.sort_by_key(|(k, _)| *k);
        let (numbers, judged): (Vec<_>, Vec<_>) = judged.into_iter().unzip();
        let (chosen, note) = self.choose(&judged);
        (numbers.get(chosen).copied().unwrap_or(0), note)
    }

    /// The best of the feasible, the first of equals; if none is, the one that breaks least, and a note.
    pub fn choose(&self, judged: &[Judged]) -> (usize, Option<String>) {
        best_at(judged, self.mu)
    }
}

/// [`Judge::choose`] at some weight μ.
pub fn best_at(judged: &[Judged], mu: f64) -> (usize, Option<String>) {
    let best = |accept: &dyn Fn(&Judged) -> bool, value: &dyn Fn(&Judged) -> f64| {
        let mut best: Option<(usize, f64)> = None;
        for (k, j) in judged.iter().enumerate().filter(|(_, j)| accept(j)) {
            let value = value(j);
            if best.is_none_or(|(_, most)| value > most) {
                best = Some((k, value));
            }
        }
        best.map(|(k, _)| k)
    };
    if let Some(chosen) = best(&Judged::is_feasible, &|j| j.value(mu)) {
        return (chosen, None);
    }
    let chosen = best(&|_| true, &|j| j.value(mu) - j.map_penalty).unwrap_or(0);
    (chosen, Some("no candidate is feasible; the one that breaks least was taken".to_owned()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn judged(reward: f64, penalty: f64, map_penalty: f64) -> Judged {
        Judged { reward, penalty, map_penalty, hits: reward > 1.0, unnatural: 0.0 }
    }

    fn judge(mu: f64) -> Judge {
        Judge::new(Choice::Paper, mu, false).unwrap()
    }

    #[test]
    fn the_best_of_the_feasible_is_chosen_and_the_first_of_equals() {
        let all =
            [judged(9.0, 2.0, 50.0), judged(3.0, 2.5, 0.0), judged(5.0, 9.0, 0.0), judged(5.0, 9.0, 0.0)];
        assert_eq!(judge(1.0).choose(&all), (2, None));
        assert_eq!(judge(0.0).choose(&all), (1, None), "the gentlest");
        assert_eq!(judge(0.5).choose(&all), (1, None));
    }

    #[test]
    fn where_nothing_is_feasible_the_least_violating_is_taken_and_said() {
        let all = [judged(9.0, 2.0, 60.0), judged(3.0, 2.0, 10.0), judged(9.0, 2.0, 50.0)];
        let (chosen, note) = judge(1.0).choose(&all);
        assert_eq!(chosen, 1);
        assert!(note.unwrap().contains("no candidate is feasible"));
    }

    #[test]
    fn a_weight_out_of_range_is_refused() {
        assert!(Judge::new(Choice::Paper, 1.5, false).is_err());
        assert!(Judge::new(Choice::Natural, f64::NAN, true).is_err());
    }

    #[test]
    fn what_no_car_can_do_comes_last() {
        use sage_core::{
            motion::{HORIZON, NOW},
            objective::ContextOptions,
            scene::SceneIndex,
        };
        let scene = sage_data::procedural::generate(sage_data::procedural::Kind::Straight, 1, 0).unwrap();
        let index = SceneIndex::new(scene.map.clone());
        let ctx = Context::new(&scene, &index, &ContextOptions::default()).unwrap();
        let logged = crate::logged_future(&scene).unwrap();
        // From the log's own place at 90 m/s along x.
        let start = scene.adversary().unwrap().point(NOW);
        let leap = (1..=HORIZON).map(|t| [start[0] + 9.0 * t as f64, start[1]]).collect();
        let leap = Trajectory::new("leap", leap).unwrap();
        let is_drivable = |path: &Trajectory| is_drivable(&ctx.candidate(path.clone()), &ctx);
        assert!(is_drivable(&logged) && !is_drivable(&leap));
        let paths = [leap.clone(), logged.clone(), leap, logged];
        let kept = |most| -> Vec<usize> {
            let kept = drivable(paths.iter().cloned().map(Ok), most, &ctx).unwrap();
            kept.into_iter().map(|(number, _)| number).collect()
        };
        assert_eq!(kept(2), [1, 3]);
        assert_eq!(kept(3), [1, 3, 0]);
    }
}
