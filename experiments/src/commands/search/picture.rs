//! The picture of a scene's search: all plans by outcome, the failures in front.

use sage_core::scene::Scene;
use sage_sim::search::{Evaluated, Pool, SearchResult};
use sage_view::drawing::{self, Outcome, Picture, Tried};

/// Draws all plans that were driven against, and the attacked drives of the worst and the mildest failure.
pub(super) fn draw(title: &str, scene: &Scene, pool: &Pool, result: &SearchResult) -> String {
    let is_failure = |drive: usize| result.failures.iter().any(|failure| failure.drive == drive);
    let outcome = |drive: usize, evaluated: &Evaluated| match &evaluated.contact {
        _ if is_failure(drive) => Outcome::Failure,
        _ if evaluated.clauses.attack => Outcome::Attack,
        Some(_) => Outcome::OtherContact,
        None => Outcome::NoContact,
    };
    let tried = |(drive, evaluated): (usize, &Evaluated)| {
        let candidate = &pool.plans[evaluated.plan].candidate;
        // Only up to the contact: what comes after it did not happen.
        let steps = evaluated.contact.as_ref().map_or(usize::MAX, |met| met.step.max(0) as usize);
        let points = candidate.points().iter().take(steps).copied();
        let outcome = outcome(drive, evaluated);
        let failure = result.failures.iter().find(|failure| failure.drive == drive);
        Tried {
            points: std::iter::once(candidate.start().position).chain(points).collect(),
            dot: None,
            outcome,
            words: outcome.words(),
            contact: failure.and_then(|failure| {
                let step = steps.checked_sub(1)?;
                Some([*failure.path.positions.get(step)?, *candidate.points().get(step)?])
            }),
        }
    };
    let tried: Vec<Tried> = result.driven.iter().enumerate().map(tried).collect();
    drawing::draw(scene, &Picture { title: title.to_owned(), tried, ..Picture::default() })
}
