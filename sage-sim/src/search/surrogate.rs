//! Which plan is next: what each plan would do in the drives that were seen, trusting most those whose plan is like it.
//!
//! Up to the step at which two plans part, the driver sees the same and does the same. So a plan is tried, on paper, in
//! every drive that was seen: its boxes against the path that the driver took there. The answers count by how near the two
//! plans are up to the contact that is expected.

use sage_core::{
    geometry::OrientedBox,
    motion::{DT, HORIZON},
    objective::Context,
};

use super::{AttackedPath, Clause, Judged, PoolPlan, Requirement};
use crate::{attack_test::AttackTest, body::BodyKind, fault::classify_meeting};

/// Distance of plans within which a drive says much about another, metres.
const BANDWIDTH: f64 = 2.0;
/// Weight of the unattacked drive, which no plan is near to.
const UNATTACKED: f64 = 0.05;
/// Value of an expected contact in which the ego would be at fault.
const FAULT: f64 = 1.0;
/// Decay of closeness with distance, 1/m.
const DECAY: f64 = 0.2;

/// A drive as plans are tried in it.
struct Seen {
    boxes: Vec<OrientedBox>,
    speeds: Vec<f64>,
}

/// What is expected of a plan: sums over the drives that were seen.
#[derive(Clone, Copy, Default)]
struct Expected {
    value: f64,
    weight: f64,
}

/// Expectations of all plans of a pool.
pub struct Surrogate {
    ego_size: [f64; 2],
    rear: f64,
    index: std::sync::Arc<sage_core::scene::SceneIndex>,
    asks_fault: bool,
    unattacked: Seen,
    plans: Vec<Vec<OrientedBox>>,
    expected: Vec<Expected>,
    drives: Vec<(usize, Seen)>,
}

impl Surrogate {
    /// Knows the unattacked drive alone.
    pub fn new(ctx: &Context, test: &AttackTest, requirement: Requirement) -> Self {
        let boxes: Vec<OrientedBox> = ctx.ego().boxes().iter().map_while(|area| *area).collect();
        let speeds = speeds(&boxes);
        Self {
            ego_size: ctx.ego_size(),
            rear: test.car().rear,
            index: ctx.index().clone(),
            asks_fault: requirement.holds(Clause::AtFault),
            unattacked: Seen { boxes, speeds },
            plans: Vec::new(),
            expected: Vec::new(),
            drives: Vec::new(),
        }
    }

    /// Takes notice of plans that are new in the pool.
    pub fn see_plans(&mut self, plans: &[PoolPlan]) {
        for plan in &plans[self.plans.len()..] {
            let boxes = plan.candidate.boxes().to_vec();
            let mut expected = Expected::default();
            expected.add(UNATTACKED, self.value(&boxes, &self.unattacked).0);
            for (number, seen) in &self.drives {
                let (value, step) = self.value(&boxes, seen);
                expected.add(weight(&boxes, &self.plans[*number], step), value);
            }
            self.plans.push(boxes);
            self.expected.push(expected);
        }
    }

    /// Takes notice of a drive against a plan.
    pub fn see_drive(&mut self, number: usize, _: &Judged, path: &AttackedPath) {
        let [length, width] = self.ego_size;
        let boxes: Vec<OrientedBox> = path
            .positions
            .iter()
            .zip(&path.headings)
            .map(|(p, heading)| OrientedBox::new(*p, *heading, length, width))
            .collect();
        let seen = Seen { speeds: speeds(&boxes), boxes };
        for k in 0..self.plans.len() {
            let (value, step) = self.value(&self.plans[k], &seen);
            let weight = weight(&self.plans[k], &self.plans[number], step);
            self.expected[k].add(weight, value);
        }
        self.drives.push((number, seen));
    }

    /// The plan that is expected to be the worst for the driver; the first of equals.
    pub fn next(&self, is_driven: &[bool]) -> Option<usize> {
        let mut best: Option<(usize, f64)> = None;
        for (k, expected) in self.expected.iter().enumerate() {
            let mean = expected.value / expected.weight;
            if !is_driven[k] && best.is_none_or(|(_, most)| mean > most) {
                best = Some((k, mean));
            }
        }
        best.map(|(k, _)| k)
    }

    /// Value of a plan in a drive, and the step of the contact or of the least distance.
    fn value(&self, plan: &[OrientedBox], seen: &Seen) -> (f64, usize) {
        let mut nearest = (f64::INFINITY, 0);
        for (step, (own, other)) in seen.boxes.iter().zip(plan).enumerate() {
            let [dx, dy] = [own.center[0] - other.center[0], own.center[1] - other.center[1]];
            let distance = dx * dx + dy * dy;
            if distance < nearest.0 {
                nearest = (distance, step);
            }
            if own.intersects(other) {
                let before = plan[step.saturating_sub(1)].center;
                let theirs = (other.center[0] - before[0]).hypot(other.center[1] - before[1]) / DT;
                let speeds = [seen.speeds[step], theirs];
                let class = || classify_meeting([own, other], speeds, BodyKind::Vehicle, self.rear, &self.index);
                let is_fault = !self.asks_fault || class().is_at_fault() == Some(true);
                let early = 1.0 - step as f64 / HORIZON as f64;
                return (1.0 + 0.1 * early + if is_fault { FAULT } else { 0.0 }, step);
            }
        }
        ((-DECAY * nearest.0.sqrt()).exp(), nearest.1)
    }
}

impl Expected {
    fn add(&mut self, weight: f64, value: f64) {
        self.value += weight * value;
        self.weight += weight;
    }
}

/// How much a drive against one plan says about another: by their mean distance up to a step.
fn weight(a: &[OrientedBox], b: &[OrientedBox], step: usize) -> f64 {
    let count = step.min(a.len() - 1) + 1;
    let distance = |(a, b): (&OrientedBox, &OrientedBox)| a.center_distance(b);
    let mean = a.iter().zip(b).take(count).map(distance).sum::<f64>() / count as f64;
    (-0.5 * (mean / BANDWIDTH).powi(2)).exp()
}

/// Speed at each step, m/s.
fn speeds(boxes: &[OrientedBox]) -> Vec<f64> {
    let of = |pair: &[OrientedBox]| pair[0].center_distance(&pair[1]) / DT;
    let mut speeds: Vec<f64> = boxes.windows(2).map(of).collect();
    speeds.insert(0, speeds.first().copied().unwrap_or_default());
    speeds
}
