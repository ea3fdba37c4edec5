//! A recorded follower that reacts: whether one that runs into the ego from behind would still do so as a UN R157 driver.

use sage_core::{
    geometry::{OrientedBox, boxes_meet_between, distance},
    motion::{DT, HORIZON},
    objective::Context,
};

/// Delay of a driver by UN R157, seconds, its deceleration, m/s², and the time in which that rises.
const DELAY: f64 = 0.75;
const DECELERATION: f64 = 0.774 * 9.81;
const RAMP: f64 = 0.6;

/// Whether a follower that brakes on its recorded path, from 0.75 s after the ego's evasive manoeuvre begins, meets the boxes of the
/// ego; `None` if it is not recorded throughout. `own` has the ego's boxes at steps 0 to 80. One that met the ego before
/// the evasive manoeuvre began does so whatever it does then.
pub(super) fn is_hit(ctx: &Context, track: usize, own: &[OrientedBox], start: usize) -> Option<bool> {
    let other = ctx.others().iter().find(|other| other.track == track)?;
    let recorded: Vec<OrientedBox> =
        (0..=HORIZON.min(own.len() - 1)).map_while(|step| other.at(step).copied()).collect();
    if recorded.len() < own.len() {
        return None;
    }
    let meets =
        |other: [&OrientedBox; 2], step: usize| boxes_meet_between(other, [&own[step - 1], &own[step]]);
    if (1..=start).any(|step| meets([&recorded[step - 1], &recorded[step]], step)) {
        return Some(true);
    }
    let mut follower = Follower { recorded: &recorded[start..], leg: 0, into: 0.0 };
    let logged = |step: usize| distance(recorded[step - 1].center, recorded[step].center) / DT;
    let (mut before, mut speed) = (recorded[start], logged(start.max(1)));
    for step in start + 1..own.len() {
        let time = DT * (step - start) as f64;
        // It keeps to its recording until it reacts, and is never faster than that.
        let free = if time <= DELAY { logged(step) } else { speed.min(logged(step)) };
        let next = (free - DT * DECELERATION * rising(time - DELAY)).max(0.0);
        let way = if time <= DELAY { free } else { 0.5 * (free + next) } * DT;
        speed = next;
        let Some(area) = follower.advance(way) else { return Some(false) };
        if meets([&before, &area], step) {
            return Some(true);
        }
        before = area;
    }
    Some(false)
}

/// Mean share of the deceleration over the step that ends a time after the reaction, seconds.
fn rising(end: f64) -> f64 {
    let filled = |time: f64| {
        let time = time.max(0.0);
        if time < RAMP { 0.5 * time * time / RAMP } else { time - 0.5 * RAMP }
    };
    (filled(end) - filled(end - DT)) / DT
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
