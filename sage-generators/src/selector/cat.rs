//! CAT's selection: the candidate that most probably collides early.
//!
//! It selects the candidate of largest `p · 0.99^(f+1)`, where f is the first compared frame with contact.
//! If none makes contact, it selects the nearest one. Details of the published code are reproduced: ranks
//! from the seventh on count as equally likely, every fifth frame is compared, contact means crossing edges
//! (a box inside another is none), distances are truncated to whole metres. Source: CAT (Zhang et al.
//! 2023).

use sage_core::{
    Error,
    generator::{Knowledge, Note, Proposal},
    geometry::{OrientedBox, Point, cross, distance, sub},
    motion::{HISTORY, NOW},
    objective::{Context, Situation},
};

use super::{Choice, Selector};
use crate::Facts;

/// First rank, from 0, of those that count as equally likely.
const FLATTENED: usize = 6;
/// Frames between two comparisons.
pub const STRIDE: usize = 5;
/// Largest number of compared frames.
const COMPARED: usize = 16;
/// Discount per compared frame of delay.
const DECAY: f64 = 0.99;

/// CAT's selector.
pub struct CatSelector;

impl CatSelector {
    /// Properties of a generator that selects so among the prior's proposals.
    pub const FACTS: Facts = Facts::of_selection(
        Knowledge { ego_future: true, others_future: false, own_future: false, ..Knowledge::NOW },
        false,
    );
}

impl Selector for CatSelector {
    fn select(&self, proposals: &[Proposal], ctx: &Context, _: f64) -> Result<Choice, Error> {
        let log_probs = proposals.iter().map(|p| p.log_prob).collect::<Option<Vec<f64>>>();
        let log_probs = log_probs.ok_or_else(|| Error::Scene {
            scene: ctx.scene().id.clone(),
            problem: "CAT selects by probability, and a proposal has none".to_owned(),
        })?;
        let trajectories: Vec<&[Point]> = proposals.iter().map(|p| p.trajectory.points()).collect();
        let ego: Vec<_> = ctx.egos().iter().map(|ego| (ego.positions(), ego.weight())).collect();
        let result = cat_select(&trajectories, &log_probs, &ego, ctx.size(), ctx.ego_size());
        let note = (!result.collides).then(|| note(proposals, ctx));
        Ok(Choice { chosen: result.chosen, note })
    }
}

/// The note of a selection for which CAT's comparison finds no contact. It misses contacts between the compared frames,
/// and scores do not: the note must agree with them.
fn note(proposals: &[Proposal], ctx: &Context) -> Note {
    let touches = |proposal: &Proposal| {
        let candidate = ctx.candidate(proposal.trajectory.clone());
        ctx.egos().iter().any(|ego| Situation::new(&candidate, ego, ctx).encounter.contact.is_some())
    };
    if proposals.iter().any(touches) { Note::Nearest } else { Note::NoContact }
}

/// Result of CAT's selection.
#[derive(Clone, Debug, PartialEq)]
pub struct CatSelection {
    /// Index of the selected candidate.
    pub chosen: usize,
    /// Whether any candidate makes contact.
    pub collides: bool,
    /// Probabilities after flattening.
    pub probabilities: Vec<f64>,
    /// Scores.
    pub scores: Vec<f64>,
    /// Least centre distance in whole metres, over frames up to the first contact.
    pub whole_metres: Vec<i64>,
    /// First compared frame with contact, for each ego path and candidate.
    pub first_contact: Vec<Vec<Option<usize>>>,
}

/// CAT's selection among candidates in descending order of log-probability, against weighted paths of the
/// ego. Sizes are length and width.
pub fn cat_select(
    candidates: &[&[Point]],
    log_probs: &[f64],
    ego: &[(&[Point], f64)],
    size: [f64; 2],
    ego_size: [f64; 2],
) -> CatSelection {
    let probabilities = flattened(log_probs);
    let boxes: Vec<Vec<OrientedBox>> = candidates.iter().map(|trajectory| boxes(trajectory, size)).collect();
    let egos: Vec<Vec<OrientedBox>> =
        ego.iter().map(|(positions, _)| self::boxes(positions, ego_size)).collect();
    let mut scores = vec![0.0; candidates.len()];
    let mut whole_metres = vec![1_000_000; candidates.len()];
    let mut first_contact = Vec::new();
    for (ego, (_, weight)) in egos.iter().zip(ego) {
        let mut of_path = Vec::with_capacity(candidates.len());
        for (k, adversary) in boxes.iter().enumerate() {
            let (contact, nearest) = meet(adversary, ego);
            whole_metres[k] = whole_metres[k].min(nearest);
            if let Some(frame) = contact {
                scores[k] += probabilities[k] * weight * DECAY.powi(frame as i32 + 1);
            }
            of_path.push(contact);
        }
        first_contact.push(of_path);
    }
    let best = (0..scores.len()).rev().max_by(|a, b| scores[*a].total_cmp(&scores[*b]));
    let nearest = (0..scores.len()).min_by_key(|k| whole_metres[*k]);
    let collides = first_contact.iter().flatten().any(Option::is_some);
    let chosen = if scores.iter().any(|s| *s != 0.0) { best } else { nearest };
    CatSelection { chosen: chosen.unwrap_or(0), collides, probabilities, scores, whole_metres, first_contact }
}

fn flattened(log_probs: &[f64]) -> Vec<f64> {
    let floor = log_probs.get(FLATTENED).copied();
    let flat = |(rank, log_prob): (usize, &f64)| {
        let level = if rank >= FLATTENED { floor } else { None };
        level.unwrap_or(*log_prob).exp()
    };
    let powers: Vec<f64> = log_probs.iter().enumerate().map(flat).collect();
    let total: f64 = powers.iter().sum();
    powers.into_iter().map(|p| p / total).collect()
}

/// Boxes at the compared frames, with headings by the published rule over the whole trajectory.
pub fn boxes(points: &[Point], [length, width]: [f64; 2]) -> Vec<OrientedBox> {
    let headings = sage_core::motion::kinematics::release::headings(points);
    let frames = (0..points.len()).step_by(STRIDE).take(COMPARED);
    frames.map(|f| OrientedBox::new(points[f], headings[f], length, width)).collect()
}

/// First compared frame with contact, and the least distance in whole metres up to that frame.
fn meet(adversary: &[OrientedBox], ego: &[OrientedBox]) -> (Option<usize>, i64) {
    let mut nearest = 1_000_000;
    for (frame, (a, b)) in adversary.iter().zip(ego).enumerate() {
        let gap = distance(a.center, b.center);
        nearest = nearest.min(gap as i64);
        if gap < a.radius() + b.radius() && edges_cross(a, b) {
            return (Some(frame), nearest);
        }
    }
    (None, nearest)
}

/// Whether an edge of one box properly crosses an edge of the other; touching does not count.
pub fn edges_cross(a: &OrientedBox, b: &OrientedBox) -> bool {
    let [a, b] = [a.corners(), b.corners()];
    let edge = |corners: &[Point; 4], k: usize| [corners[k], corners[(k + 1) % 4]];
    (0..4).any(|i| (0..4).any(|j| properly_cross(edge(&a, i), edge(&b, j))))
}

fn properly_cross([a, b]: [Point; 2], [c, d]: [Point; 2]) -> bool {
    let side = |p: Point, q: Point, r: Point| cross(sub(q, p), sub(r, p));
    side(a, b, c) * side(a, b, d) < 0.0 && side(c, d, a) * side(c, d, b) < 0.0
}

/// The 91 states that CAT passes to a simulator: x, y, vx, vy, heading. Velocities are forward differences,
/// the last one 0. Headings are smoothed across *now*.
pub fn cat_plan(history: &[Point], future: &[Point]) -> Vec<[f64; 5]> {
    debug_assert_eq!(history.len(), HISTORY, "frames 0 to {NOW}");
    let points: Vec<Point> = history.iter().chain(future).copied().collect();
    let headings = sage_core::motion::kinematics::release::headings(&points);
    let state = |k: usize| {
        let [x, y] = points[k];
        let [vx, vy] =
            points.get(k + 1).map_or([0.0, 0.0], |next| [(next[0] - x) / 0.1, (next[1] - y) / 0.1]);
        [x, y, vx, vy, headings[k]]
    };
    (0..points.len()).map(state).collect()
}
