//! The dial in seconds: of an attack's candidates, the most adversarial one whose latest evasive manoeuvre begins a given
//! time before the contact.

use sage_core::{
    generator::{Attack, Note},
    objective::{Context, Objective},
};
use sage_sim::avoidable::Avoidance;

use crate::operating_point::number;

/// Times within this of the target count as equal to it, seconds.
pub const WITHIN: f64 = 0.25;
/// Longest target, seconds.
pub const LONGEST: f64 = 8.0;

/// A target as text.
///
/// *Errors*: it is no number of seconds from 0 to [`LONGEST`].
pub fn seconds(text: &str) -> Result<f64, String> {
    let seconds = number(text)?;
    if !(0.0..=LONGEST).contains(&seconds) {
        return Err(format!("{seconds} is not a time from 0 to {LONGEST} seconds"));
    }
    Ok(seconds)
}

/// A feasible hit that is avoidable, among the candidates of an attack.
pub struct Avoided {
    /// Its index among the candidates.
    pub candidate: usize,
    /// Its latest start, seconds before the contact.
    pub time: f64,
    /// Its value in the selection.
    value: f64,
}

/// All candidates that are feasible hits by the rule of an objective and avoidable.
pub fn avoidable_candidates(
    attack: &Attack,
    ctx: &Context,
    objective: &Objective,
    mu: f64,
    avoidance: &Avoidance,
) -> Vec<Avoided> {
    let one = |(candidate, proposal): (usize, &sage_core::generator::Proposal)| {
        let prepared = ctx.candidate(proposal.trajectory.clone()).with_nll(proposal.nll);
        let evaluation = objective.evaluate(&prepared, ctx);
        if !evaluation.is_attack() {
            return None;
        }
        let time = avoidance.of(&prepared).latest_start?;
        Some(Avoided { candidate, time, value: objective.value(&evaluation, mu) })
    };
    attack.candidates.iter().enumerate().filter_map(one).collect()
}

/// The best within a quarter of a second of a target, else the nearest; `None` if there is none.
pub fn nearest_to(all: &[Avoided], target: f64) -> Option<&Avoided> {
    let gap = |one: &Avoided| (one.time - target).abs();
    let within = all.iter().filter(|one| gap(one) <= WITHIN + 1e-9);
    let best = within.max_by(|a, b| a.value.total_cmp(&b.value).then(b.candidate.cmp(&a.candidate)));
    let nearer = |a: &&Avoided, b: &&Avoided| {
        gap(a).total_cmp(&gap(b)).then(b.value.total_cmp(&a.value)).then(a.candidate.cmp(&b.candidate))
    };
    best.or_else(|| all.iter().min_by(nearer))
}

/// Chooses again among the candidates of an attack, and notes what was not found.
///
/// An attack of which the recorded ego could get out until 1.5 s before the contact:
///
/// ```
/// use std::{path::Path, sync::Arc};
///
/// use advsage::{
///     Against, AvoidanceOptions, GeneratorSpec, Prepared, Recording, Registries,
///     latest_start::{avoidable_candidates, choose, nearest_to},
///     sage_sim::avoidable::Avoidance,
/// };
///
/// # let file = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/crossing.pkl"));
/// let scene = Arc::new(Recording::read(file)?.scene);
/// let recorded = Prepared::recorded(&scene)?;
/// let sage = GeneratorSpec::named(r#"sage{"candidates": 16}"#)?.at(1.0, None).build(&Registries::of_attacks()?)?;
/// let mut attack = sage.attacks(&recorded.ctx, Against::Recording)?.remove(0);
///
/// let avoidance = Avoidance::new(&recorded.ctx, AvoidanceOptions::default())?;
/// let all = avoidable_candidates(&attack, &recorded.ctx, &sage.selection.objective, 1.0, &avoidance);
/// choose(&mut attack, &all, 1.5);
/// assert!(nearest_to(&all, 1.5).is_none_or(|nearest| nearest.candidate == attack.chosen));
/// # Ok::<(), advsage::Error>(())
/// ```
pub fn choose(attack: &mut Attack, all: &[Avoided], target: f64) {
    let note = match nearest_to(all, target) {
        None => Some(format!("no candidate is an avoidable attack, for a latest start of {target} s")),
        Some(one) => {
            attack.chosen = one.candidate;
            attack.note = None;
            let is_within = (one.time - target).abs() <= WITHIN + 1e-9;
            (!is_within).then(|| {
                format!("no candidate has a latest start of {target} s; the nearest has {:.1} s", one.time)
            })
        }
    };
    if let Some(note) = note {
        attack.note = Some(Note::Other(note));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_best_within_a_quarter_of_a_second_is_chosen_and_else_the_nearest() {
        let option = |candidate, time, value| Avoided { candidate, time, value };
        let options = [option(0, 0.4, 9.0), option(3, 1.3, 1.0), option(4, 1.7, 2.0), option(7, 1.5, 2.0)];
        let of = |target| nearest_to(&options, target).map(|one| one.candidate);
        // Both 4 and 7 have the value 2: the first of equals.
        assert_eq!((of(1.5), of(0.5), of(0.0), of(8.0)), (Some(4), Some(0), Some(0), Some(4)));
        assert!(nearest_to(&[], 1.0).is_none());
    }
}
