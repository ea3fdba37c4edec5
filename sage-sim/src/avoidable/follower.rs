//! A recorded follower that reacts: whether one that runs into the ego from behind would still do so as a careful driver.

use sage_core::{
    geometry::{OrientedBox, boxes_meet_between, distance},
    motion::{DT, HORIZON},
    objective::Context,
};

/// Delay of a careful driver, seconds, its deceleration, m/s², and the time in which that rises (UN R157).
const DELAY: f64 = 0.75;
const DECELERATION: f64 = 0.774 * 9.81;
const RAMP: f64 = 0.6;

/// Whether a follower that brakes on its recorded path, from 0.75 s after the ego's way out begins, meets the boxes of the
/// ego. `own` has the ego's boxes at steps 0 to 80.
pub(super) fn is_hit(ctx: &Context, track: usize, own: &[OrientedBox], start: usize) -> bool {
    let Some(other) = ctx.others().iter().find(|other| other.track == track) else { return false };
    let recorded: Vec<OrientedBox> = (start..=HORIZON).map_while(|step| other.at(step).copied()).collect();
    let Some(first) = recorded.first() else { return false };
    let mut follower = Follower { recorded: &recorded, leg: 0, into: 0.0 };
    let (mut before, mut speed) = (*first, 0.0);
    for step in start + 1..own.len() {
        let time = DT * (step - start) as f64;
        if let Some(pair) = recorded.get(step - 1 - start..=step - start) {
            let logged = distance(pair[0].center, pair[1].center) / DT;
            // Until it reacts, and never faster than recorded.
            speed = if time <= DELAY { logged } else { f64::min(speed, logged) };
        }
        if time > DELAY {
            let rising = ((time - DELAY) / RAMP).min(1.0);
            speed = (speed - DT * rising * DECELERATION).max(0.0);
        }
        let Some(area) = follower.advance(speed * DT) else { return false };
        if boxes_meet_between([&before, &area], [&own[step - 1], &own[step]]) {
            return true;
        }
        before = area;
    }
    false
}

/// A follower on its recorded path.
struct Follower<'a> {
    recorded: &'a [OrientedBox],
    /// Leg of the path, and metres into it.
    leg: usize,
    into: f64,
}

impl Follower<'_> {
    /// The box after a way; `None` beyond the end of the recording.
    fn advance(&mut self, way: f64) -> Option<OrientedBox> {
        self.into += way;
        loop {
            let (from, to) = (self.recorded.get(self.leg)?, self.recorded.get(self.leg + 1));
            let Some(to) = to else { return (self.into <= 0.0).then_some(*from) };
            let length = distance(from.center, to.center);
            if self.into < length {
                return Some(from.between(to, self.into / length));
            }
            self.into -= length;
            self.leg += 1;
        }
    }
}
