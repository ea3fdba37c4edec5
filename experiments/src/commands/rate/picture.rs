//! The picture of a rate: the goals of the density by probability and outcome, and the likeliest failure.

use std::collections::HashMap;

use advsage::rows::rate::{GoalRow, Outcome as Driven, RateRow};
use sage_core::{motion::NOW, scene::Scene};
use sage_sim::rate::{Nominal, NominalPlan};
use sage_view::drawing::{self, Outcome, Picture, Tried};

/// Draws all feasible plans; `scene` holds the unattacked drive.
pub(super) fn draw(title: &str, scene: &Scene, nominal: &Nominal, row: &RateRow) -> String {
    // Timings of a goal end at the same place: those with one outcome are one dot.
    let place = |goal: &GoalRow| (goal.goal.map(|point| point.map(f64::to_bits)), goal.outcome);
    let mut sums: HashMap<_, f64> = HashMap::new();
    for goal in &row.goals {
        *sums.entry(place(goal)).or_default() += goal.probability;
    }
    let largest = sums.values().copied().fold(f64::MIN_POSITIVE, f64::max);
    let start = scene.adversary.map(|adversary| scene.tracks[adversary].point(NOW));
    let tried = |(plan, goal): (&NominalPlan, &GoalRow)| {
        let outcome = match goal.outcome {
            None => Outcome::NotDriven,
            Some(Driven::NoContact) => Outcome::NoContact,
            Some(Driven::Contact) => Outcome::OtherContact,
            Some(Driven::Attack) => Outcome::Attack,
            Some(Driven::Failure) => Outcome::Failure,
        };
        let trajectory = &plan.proposal.trajectory;
        let likeliest = row.likeliest.as_ref().filter(|failure| failure.trajectory == *trajectory);
        let met = likeliest.and_then(|failure| failure.contact.as_ref());
        let at_contact =
            met.and_then(|met| trajectory.points().get(usize::try_from(met.step).ok()?.checked_sub(1)?));
        Tried {
            points: start.iter().chain(trajectory.points()).copied().collect(),
            dot: sums.remove(&place(goal)).map(|probability| probability / largest),
            outcome,
            words: outcome.words(),
            contact: at_contact.map(|point| [*point; 2]),
        }
    };
    let tried = nominal.plans.iter().zip(&row.goals).map(tried).collect();
    drawing::draw(scene, &Picture { title: title.to_owned(), tried, ..Picture::default() })
}
