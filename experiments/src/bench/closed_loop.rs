//! Attacks on drivers as rows record them.

use sage_core::objective::Context;
use sage_sim::{attack_test::AttackOutcome, episode::Verdict};
use serde::{Deserialize, Serialize};

use crate::contact_row::ContactRow;

/// Result of one attack on a driver.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Driven {
    /// Whether the attack works.
    pub verdict: Verdict,
    /// The ego's first contact, if any.
    pub contact: Option<ContactRow>,
    /// Progress along the logged route by its length, until the end; `None` if the route is short.
    pub completion: Option<f64>,
    /// The paper's adversarial reward with the contact of the simulation.
    pub reward: f64,
    /// The published reward: the ego's path is cut at its end, so a contact scores little.
    pub reward_cut: f64,
}

impl Driven {
    /// The result of an outcome; `ctx` is that of the attack.
    pub(crate) fn of(outcome: &AttackOutcome, ctx: &Context) -> Self {
        let first = outcome.episode.first_contacts().next();
        Self {
            verdict: outcome.verdict,
            completion: outcome.episode.completion,
            reward: outcome.reward(),
            reward_cut: outcome.reward_cut(ctx),
            contact: first.map(|contact| ContactRow::of(contact, ctx.scene())),
        }
    }
}
