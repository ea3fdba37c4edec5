//! How long a person can be seen from the ego before a contact.
//!
//! Seen means: no box of a recorded vehicle lies on the line from the centre of the ego's box to the person's centre. Buildings,
//! walls and trees are not recorded, so what they hide counts as seen. Vehicles on other levels do not hide.

use crate::{
    motion::{DT, NOW},
    objective::{Candidate, Context, EgoPath},
    scene::is_one_level,
};

/// Seconds for which a plan is seen without a break before the contact at a step, counted from *now* at most.
pub fn seen_for(plan: &Candidate, ego: &EgoPath, ctx: &Context, contact: usize) -> f64 {
    let vehicles: Vec<_> = ctx.others().iter().filter(|other| other.is_vehicle).collect();
    let is_seen = |step: usize| {
        let Some(own) = ego.box_at(step) else { return false };
        let person = plan.boxes()[step - 1].center;
        let reach = own.center_distance(&plan.boxes()[step - 1]);
        let ground = ctx.scene().ego().ground(NOW);
        !vehicles.iter().any(|other| {
            other.at(step).is_some_and(|area| {
                area.center_distance(own) < reach + area.radius()
                    && area.intersects_segment(own.center, person)
                    && is_one_level(ctx.scene().tracks[other.track].ground(NOW + step), ground)
            })
        })
    };
    let steps = (1..=contact).rev().take_while(|step| is_seen(*step)).count();
    steps as f64 * DT
}
