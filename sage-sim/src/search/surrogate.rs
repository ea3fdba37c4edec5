//! Which plan is next: each plan is tried, on paper, in the drives that were seen.
//!
//! Up to the step at which two plans part, the driver sees the same and does the same: nothing has to be learnt about it. So a
//! drive against one plan says what happens against another, as long as the two are alike up to the contact that is expected. A
//! plan's boxes are held against the path that the driver took in each drive; the values of these trials are averaged with
//! weights `exp(−d² / 2h²)`, where d is the mean distance of the two plans up to that contact. The unattacked drive counts with
//! a small weight, which no plan is near to: it speaks where nothing else does. What is unlike all that was driven is worth a
//! little more.
//!
//! Of a pedestrian or cyclist a trial is worth what [`promise`] says.
//!
//! The constants were chosen on recorded scenes that are neither of the training nor of the validation split, for four drivers at once.

use sage_core::{
    geometry::OrientedBox,
    motion::{DT, HORIZON},
    objective::{Context, MIN_DEPTH, person::promise},
};

use super::{AttackedPath, Clause, PoolPlan, Requirement};

/// h: distance of plans within which a drive says much about another, metres.
const BANDWIDTH: f64 = 2.0;
/// Weight of the unattacked drive.
const UNATTACKED: f64 = 0.05;
/// Decay of the value of a trial without contact with its least distance, 1/m.
const DECAY: f64 = 0.2;
/// Value of a contact that becomes solid, beside the 1 of any contact and up to 1 for an early one.
const SOLID: f64 = 0.5;
/// Steps within which it must become solid.
const SOLID_STEPS: usize = 5;
/// Value of a contact in which the ego moves: one that stands is not at fault.
const MOVING: f64 = 0.5;
/// Speed from which it counts as moving, m/s.
const MOVING_SPEED: f64 = 1.0;
/// Value of a plan that is unlike all driven ones, and the distance at which plans are unlike, metres.
const UNLIKE: f64 = 0.3;
const UNLIKE_DISTANCE: f64 = 1.0;

/// What is expected of a plan: sums over the drives that were seen.
#[derive(Clone, Copy)]
struct Expected {
    value: f64,
    weight: f64,
    /// Least distance to a plan that was driven, metres.
    nearest: f64,
}

/// A trial of a plan in a drive.
struct Trial {
    value: f64,
    /// Step of the contact, or of the least distance; 0 the first.
    step: usize,
}

/// Expectations of all plans of a pool.
pub struct Surrogate {
    ego_size: [f64; 2],
    asks_fault: bool,
    is_person: bool,
    unattacked: Vec<OrientedBox>,
    plans: Vec<Vec<OrientedBox>>,
    expected: Vec<Expected>,
    /// Numbers of driven plans, with the boxes of the ego.
    drives: Vec<(usize, Vec<OrientedBox>)>,
}

impl Surrogate {
    /// Knows the unattacked drive alone, which is the ego's path of the context.
    pub fn new(ctx: &Context, requirement: Requirement) -> Self {
        Self {
            ego_size: ctx.ego_size(),
            asks_fault: requirement.holds(Clause::AtFault),
            is_person: ctx.adversary().kind.is_person(),
            unattacked: ctx.ego().boxes().iter().map_while(|area| *area).collect(),
            plans: Vec::new(),
            expected: Vec::new(),
            drives: Vec::new(),
        }
    }

    /// Takes notice of the plans that are new in the pool.
    pub fn see_plans(&mut self, plans: &[PoolPlan]) {
        for plan in plans.iter().skip(self.plans.len()) {
            let boxes = plan.candidate.boxes().to_vec();
            let trial = self.trial(&boxes, &self.unattacked);
            let mut expected =
                Expected { value: UNATTACKED * trial.value, weight: UNATTACKED, nearest: f64::INFINITY };
            for (number, path) in &self.drives {
                expected.add(&self.trial(&boxes, path), &boxes, &self.plans[*number]);
            }
            self.plans.push(boxes);
            self.expected.push(expected);
        }
    }

    /// Takes notice of a drive against a plan.
    pub fn see_drive(&mut self, number: usize, path: &AttackedPath) {
        let [length, width] = self.ego_size;
        let area = |(p, heading): (&[f64; 2], &f64)| OrientedBox::new(*p, *heading, length, width);
        let path: Vec<OrientedBox> = path.positions.iter().zip(&path.headings).map(area).collect();
        for k in 0..self.plans.len() {
            let trial = self.trial(&self.plans[k], &path);
            self.expected[k].add(&trial, &self.plans[k], &self.plans[number]);
        }
        self.drives.push((number, path));
    }

    /// The plan of the largest expected value that was not driven; the first of equals.
    pub fn next(&self, is_driven: &[bool]) -> Option<usize> {
        let mut best: Option<(usize, f64)> = None;
        for (k, expected) in self.expected.iter().enumerate() {
            let value = expected.mean();
            if !is_driven[k] && best.is_none_or(|(_, most)| value > most) {
                best = Some((k, value));
            }
        }
        best.map(|(k, _)| k)
    }

    /// Holds a plan against a path of the ego.
    fn trial(&self, plan: &[OrientedBox], path: &[OrientedBox]) -> Trial {
        if self.is_person {
            let found = promise(plan, path);
            return Trial { value: found.value, step: found.step };
        }
        let (mut nearest, mut at) = (f64::INFINITY, 0);
        for (step, (own, other)) in path.iter().zip(plan).enumerate() {
            let [dx, dy] = [own.center[0] - other.center[0], own.center[1] - other.center[1]];
            let squared = dx * dx + dy * dy;
            if squared < nearest {
                (nearest, at) = (squared, step);
            }
            let reach = own.radius() + other.radius();
            if squared > reach * reach || !own.intersects(other) {
                continue;
            }
            let pairs = path.iter().zip(plan).skip(step).take(SOLID_STEPS + 1);
            let is_solid = pairs.into_iter().any(|(own, other)| own.overlap_depth(other) >= MIN_DEPTH);
            let early = 1.0 - step as f64 / HORIZON as f64;
            let mut value = 1.0 + early + if is_solid { SOLID } else { 0.0 };
            if self.asks_fault {
                let pair = if step == 0 { path.get(..2) } else { path.get(step - 1..=step) };
                let speed = pair.map_or(0.0, |pair| pair[0].center_distance(&pair[1]) / DT);
                value += MOVING * (speed / MOVING_SPEED).min(1.0);
            }
            return Trial { value, step };
        }
        Trial { value: (-DECAY * nearest.sqrt()).exp(), step: at }
    }
}

impl Expected {
    /// Adds the trial of plan `own` in the drive against plan `driven`.
    fn add(&mut self, trial: &Trial, own: &[OrientedBox], driven: &[OrientedBox]) {
        let count = trial.step + 1;
        let pairs = own.iter().zip(driven).take(count);
        let distance = pairs.map(|(a, b)| a.center_distance(b)).sum::<f64>() / count as f64;
        let weight = closeness(distance / BANDWIDTH);
        self.value += weight * trial.value;
        self.weight += weight;
        self.nearest = self.nearest.min(distance);
    }

    fn mean(&self) -> f64 {
        self.value / self.weight + UNLIKE * (1.0 - closeness(self.nearest / UNLIKE_DISTANCE))
    }
}

fn closeness(ratio: f64) -> f64 {
    (-0.5 * ratio * ratio).exp()
}
