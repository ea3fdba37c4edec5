//! Trials in one scene: a curve as a plan, what the ego does against it, and what a policy sees of that.

use sage_core::{
    Error,
    generator::{DrivenEgo, DriverUnderTest},
    geometry::{Point, distance},
    motion::{HORIZON, NOW, Pose, Trajectory},
    objective::{Candidate, Context},
    scene::Track,
};

use super::{
    curve::{CONTROL_POINTS, Curve},
    features::{View, pose_of, scaled},
    goal::{Goal, Outcome, attack_outcome, kinematics},
};
use crate::goose::networks::{Features, GooseOptions, REST};

/// Distance of a drive in which ego and adversary do not meet after *now*, metres.
const NEVER_MET: f64 = 1000.0;
/// Units of a goal, if numbers are scaled: 50 m, 10 m/s², 1 rad/s.
const GOAL_UNITS: Goal = [50.0, 10.0, 1.0];
/// Unit of weights and of positions.
const CURVE_UNITS: [f64; 2] = [1.0, 50.0];

/// A scene in which curves are tried.
pub struct TrialScene<'c> {
    ctx: &'c Context,
    is_scaled: bool,
    first_frame: usize,
    /// Steps of the recording that a curve covers.
    steps: usize,
    /// Origin and x axis of the curves.
    origin: Pose,
    first: Curve,
}

/// A curve that was tried.
#[derive(Clone, Debug)]
pub struct Trial {
    /// The curve.
    pub curve: Curve,
    /// Its positions at frames 11 to 90, world frame.
    pub plan: Trajectory,
    /// What a policy sees of the drive.
    pub rows: Vec<Features>,
    /// What it achieves.
    pub achieved: Goal,
    /// Its reward.
    pub outcome: Outcome,
    /// Whether the ego's drive ends with a contact with the adversary.
    pub is_hit: bool,
    is_scaled: bool,
}

impl<'c> TrialScene<'c> {
    /// A scene with the curve through the adversary's recording, from *now* or from frame 0 on.
    ///
    /// *Errors*: [`Error::Scene`] for an adversary without a valid frame there.
    pub fn new(ctx: &'c Context, options: &GooseOptions) -> Result<Self, Error> {
        let first_frame = if options.from_start { 0 } else { NOW };
        let log = ctx.adversary();
        let path = filled(log, first_frame, (NOW + HORIZON).min(ctx.scene().frames - 1));
        let local = |origin: &Pose| -> Vec<Point> {
            path.iter().map(|pose| to_local(origin, pose.position)).collect()
        };
        let found = path.first().and_then(|origin| Some((*origin, Curve::fit(&local(origin))?)));
        let (origin, first) = found.ok_or_else(|| Error::Scene {
            scene: ctx.scene().id.clone(),
            problem: format!("adversary `{}` is not valid from frame {first_frame} on", log.id),
        })?;
        let steps = path.len().saturating_sub(1).max(1);
        Ok(Self { ctx, is_scaled: !options.unscaled, first_frame, steps, origin, first })
    }

    /// The curve through the recording.
    pub fn first_curve(&self) -> &Curve {
        &self.first
    }

    /// Lets a driver drive against a curve.
    ///
    /// *Errors*: those of the driver; [`Error::TooLong`] for a curve whose points are too far apart.
    pub fn trial(&self, curve: Curve, driver: &dyn DriverUnderTest) -> Result<Trial, Error> {
        let plan = self.plan(&curve)?;
        let candidate = self.ctx.candidate(plan.clone());
        let ego = driver.drive(&plan)?;
        let adversary = |frame: usize| pose_in_plan(self.ctx.adversary(), &candidate, frame);
        let ego_at = |frame: usize| ego.poses.get(frame).copied().flatten();
        let last = (NOW + candidate.horizon()).min(ego.poses.len().saturating_sub(1));
        let view = View {
            scene: self.ctx.scene(),
            origin: self.origin,
            first_frame: self.first_frame.min(last),
            is_scaled: self.is_scaled,
        };
        let gap = |frame: usize| Some(distance(adversary(frame)?.position, ego_at(frame)?.position));
        let least = (NOW + 1..=last).filter_map(gap).min_by(f64::total_cmp).unwrap_or(NEVER_MET);
        let [acceleration, yaw_rate] = kinematics(candidate.points(), &self.start(&curve, candidate.start()));
        let achieved = [least, acceleration, yaw_rate];
        Ok(Trial {
            rows: view.rows(&adversary, &ego_at, last),
            outcome: attack_outcome(&achieved, ego.hits_adversary),
            is_hit: ego.hits_adversary,
            is_scaled: self.is_scaled,
            curve,
            plan,
            achieved,
        })
    }

    /// Where a curve is *now*. A curve that begins earlier is elsewhere than the recording.
    fn start(&self, curve: &Curve, now: &Pose) -> Pose {
        if self.first_frame == NOW {
            return *now;
        }
        Pose { position: self.place(curve, NOW), ..*now }
    }

    /// Position of a curve at a frame; after a shorter recording its end.
    fn place(&self, curve: &Curve, frame: usize) -> Point {
        let share = (frame - self.first_frame) as f64 / self.steps as f64;
        to_world(&self.origin, curve.at(share))
    }

    /// Positions of a curve at equal steps of its parameter: speed follows from the weights.
    fn plan(&self, curve: &Curve) -> Result<Trajectory, Error> {
        let at = |frame: usize| self.place(curve, frame);
        Trajectory::new("curve of the adversary", (NOW + 1..=NOW + HORIZON).map(at).collect())
    }
}

impl Trial {
    /// Whether ego and adversary were both there after *now*: else no plan makes a difference.
    pub fn is_met(&self) -> bool {
        self.achieved[0] < NEVER_MET
    }

    /// The numbers of a policy's state beside the encoded drive: the curve, the achieved and a desired goal.
    pub fn rest(&self, desired: &Goal) -> [f32; REST] {
        let unit = |unit: f64| self.is_scaled.then_some(unit);
        let curve = self.curve.state();
        let curve = curve.iter().enumerate().map(|(k, number)| {
            let [of_weights, of_points] = CURVE_UNITS;
            scaled(*number, unit(if k < CONTROL_POINTS - 1 { of_weights } else { of_points }))
        });
        let goal = |goal: &Goal| [0, 1, 2].map(|k| scaled(goal[k], unit(GOAL_UNITS[k])));
        let goals = goal(&self.achieved).into_iter().chain(goal(desired));
        let mut rest = [0.0; REST];
        rest.iter_mut().zip(curve.chain(goals)).for_each(|(to, number)| *to = number);
        rest
    }
}

/// An ego that repeats its path whatever the adversary does: its drives need no simulation.
pub struct RepeatedEgo<'c>(pub &'c Context);

impl DriverUnderTest for RepeatedEgo<'_> {
    fn drive(&self, plan: &Trajectory) -> Result<DrivenEgo, Error> {
        let ctx = self.0;
        let candidate = ctx.candidate(plan.clone());
        let ego = ctx.ego();
        let mut poses: Vec<Option<Pose>> = (0..=NOW).map(|frame| pose_of(ctx.scene().ego(), frame)).collect();
        for (step, (own, other)) in candidate.steps().zip(candidate.boxes().iter().zip(ego.boxes())) {
            poses.push(other.map(|area| {
                let [x, y] = area.axis;
                Pose { position: area.center, heading: y.atan2(x) }
            }));
            if other.is_some_and(|area| area.overlap_depth(own) > 0.0) && ego.is_on_level_of(&candidate, step)
            {
                return Ok(DrivenEgo { poses, hits_adversary: true });
            }
        }
        Ok(DrivenEgo { poses, hits_adversary: false })
    }
}

/// Pose of an adversary that follows a plan from *now* on.
fn pose_in_plan(log: &Track, plan: &Candidate, frame: usize) -> Option<Pose> {
    let Some(step) = frame.checked_sub(NOW + 1) else { return pose_of(log, frame) };
    let [x, y] = *plan.profile().axis.get(step)?;
    Some(Pose { position: *plan.points().get(step)?, heading: y.atan2(x) })
}

/// Poses of a track at each frame of a range; where it is not valid the last valid one, else the next one. Empty without a
/// valid frame.
fn filled(track: &Track, first: usize, last: usize) -> Vec<Pose> {
    let all: Vec<Option<Pose>> = (first..=last).map(|frame| pose_of(track, frame)).collect();
    let Some(mut pose) = all.iter().flatten().next().copied() else { return Vec::new() };
    let mut fill = |found: Option<Pose>| {
        pose = found.unwrap_or(pose);
        pose
    };
    all.into_iter().map(&mut fill).collect()
}

fn to_local(origin: &Pose, point: Point) -> Point {
    let ([x, y], (sin, cos)) = (sage_core::geometry::sub(point, origin.position), origin.heading.sin_cos());
    [cos * x + sin * y, cos * y - sin * x]
}

fn to_world(origin: &Pose, [forward, left]: Point) -> Point {
    origin.shifted(forward, left).position
}
