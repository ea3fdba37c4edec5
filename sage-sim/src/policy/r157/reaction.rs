//! How the careful and competent driver of UN R157 reacts to one other road user: perception, evaluation of the
//! risk, delay, braking ramp.

use sage_core::motion::DT;
use serde::{Deserialize, Serialize};

/// A road user is perceived when it is this far from the line that it followed, metres.
const WANDERING: f64 = 0.375;
/// Further distance, metres, or time, seconds, in which the risk is evaluated.
const EVALUATION_DISTANCE: f64 = 0.72;
const EVALUATION_TIME: f64 = 0.4;
/// Time to collision from which on a situation is critical, seconds; the same for the time headway after a cut-out.
const CRITICAL: f64 = 2.0;
/// Time from the decision to the first braking, seconds.
const DELAY: f64 = 0.75;
/// Time in which the deceleration rises, seconds, and where it ends, m/s² (0.774 g).
const RAMP: f64 = 0.6;
const DECELERATION: f64 = 0.774 * 9.81;
/// Deceleration while the foot leaves the accelerator, in the reading by overlap, m/s².
const ROLLING_OFF: f64 = 0.4;
/// Deceleration of a leader that is perceived at once, m/s².
const HARD: f64 = 5.0;
/// Times that differ by less are the same, seconds.
const ROUNDING: f64 = 1e-6;

/// When a road user that comes in is perceived, and how its risk is evaluated. Public implementations of the
/// regulation differ in this.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Reading {
    /// Perceived 0.375 m from its line, evaluated over 0.72 m more (esmini).
    #[default]
    Distance,
    /// Perceived 0.375 m from its line, evaluated for 0.4 s (the regulation's time).
    Time,
    /// Perceived when the bodies overlap sideways, not evaluated; rolls off during the delay (JRC).
    Overlap,
}

/// What the driver sees of one road user.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Seen {
    /// How far it has moved from its line towards the own path, metres.
    pub(super) deviation: f64,
    /// Whether it overlaps the own path.
    pub(super) is_inside: bool,
    /// Free distance along the own path, metres.
    pub(super) gap: f64,
    /// Own speed minus its speed along the own path, m/s.
    pub(super) closing: f64,
    /// Own speed, m/s.
    pub(super) speed: f64,
    /// Its deceleration along the own path, m/s².
    pub(super) deceleration: f64,
}

impl Seen {
    pub(super) fn time_to_collision(&self) -> f64 {
        if self.closing > 0.0 { self.gap.max(0.0) / self.closing } else { f64::INFINITY }
    }
}

/// Mean over a step of a demand that rises from 0 to 1 within `rise` seconds; the step begins `since` seconds after
/// the rise, or before it.
pub(super) fn ramp(since: f64, rise: f64) -> f64 {
    let area = |at: f64| if at < rise { 0.5 * at.max(0.0).powi(2) / rise } else { at - 0.5 * rise };
    (area(since + DT) - area(since)) / DT
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Stage {
    /// Nothing has been perceived.
    Watching,
    /// Perceived at a time; the risk is evaluated.
    Evaluating { since: f64 },
    /// Evaluated; tested at every step.
    Evaluated,
    /// Braking begins after the delay.
    Reacting { since: f64 },
    /// Braking.
    Braking { since: f64 },
}

/// The reaction to one road user.
#[derive(Clone, Copy, Debug)]
pub(super) struct Reaction {
    stage: Stage,
    /// Deviation at the look before, metres.
    before: f64,
    /// Whether it was revealed by a leader that left: its headway counts too.
    is_revealed: bool,
}

impl Reaction {
    /// The reaction to a road user when it is first seen. One inside the own path is known already.
    pub(super) fn new(seen: &Seen) -> Self {
        let stage = if seen.is_inside { Stage::Evaluated } else { Stage::Watching };
        Self { stage, before: seen.deviation, is_revealed: false }
    }

    /// A leader left and revealed the road user at a time, seconds.
    pub(super) fn reveal(&mut self, time: f64) {
        self.is_revealed = true;
        if self.stage == Stage::Evaluated {
            self.stage = Stage::Evaluating { since: time };
        }
    }

    /// The deceleration that the road user demands at a time (seconds), m/s², at least 0.
    pub(super) fn deceleration(&mut self, seen: &Seen, time: f64, reading: Reading) -> f64 {
        let was_evaluating = matches!(self.stage, Stage::Evaluating { .. });
        self.stage = self.next(seen, time, reading);
        self.before = seen.deviation;
        // The headway to one that a leader revealed is tested once, at the end of its evaluation.
        self.is_revealed &= !was_evaluating || matches!(self.stage, Stage::Evaluating { .. });
        match self.stage {
            Stage::Braking { since } => DECELERATION * ramp(time - since, RAMP),
            Stage::Reacting { .. } if reading == Reading::Overlap => ROLLING_OFF,
            _ => 0.0,
        }
    }

    /// When it began to brake, seconds.
    #[cfg(test)]
    fn brakes_since(&self) -> Option<f64> {
        if let Stage::Braking { since } = self.stage { Some(since) } else { None }
    }

    /// When the deviation reached a value since the look before, seconds.
    fn reached(&self, deviation: f64, seen: &Seen, time: f64) -> f64 {
        let moved = seen.deviation - self.before;
        if moved <= 0.0 || self.before >= deviation {
            return time;
        }
        time - DT * ((seen.deviation - deviation) / moved).clamp(0.0, 1.0)
    }

    fn next(&self, seen: &Seen, time: f64, reading: Reading) -> Stage {
        // One that is back on its line, or has left the path, is only watched.
        if !seen.is_inside && (reading == Reading::Overlap || seen.deviation < WANDERING) {
            return Stage::Watching;
        }
        let mut stage = self.stage;
        if stage == Stage::Watching {
            stage = Stage::Evaluating { since: self.reached(WANDERING, seen, time) };
        }
        let mut evaluated = time;
        if let Stage::Evaluating { since } = stage {
            let far = WANDERING + EVALUATION_DISTANCE;
            let by_time = since + EVALUATION_TIME;
            evaluated = match reading {
                Reading::Distance if seen.deviation >= far => self.reached(far, seen, time),
                // One that comes in without leaving a line is evaluated by time.
                Reading::Distance if seen.is_inside => by_time,
                Reading::Distance => f64::INFINITY,
                Reading::Time => by_time,
                Reading::Overlap => time,
            };
            if evaluated > time + ROUNDING {
                return stage;
            }
            stage = Stage::Evaluated;
        }
        if stage == Stage::Evaluated {
            let headway = if seen.speed > 0.0 { seen.gap / seen.speed } else { f64::INFINITY };
            let is_critical = seen.time_to_collision() <= CRITICAL
                || (seen.is_inside && seen.deceleration >= HARD && seen.gap.is_finite())
                || (self.is_revealed && seen.closing > 0.0 && headway < CRITICAL);
            if !is_critical {
                return stage;
            }
            // A leader that brakes hard is evaluated first.
            let since = if seen.deceleration >= HARD { time + EVALUATION_TIME } else { evaluated };
            stage = Stage::Reacting { since };
        }
        if let Stage::Reacting { since } = stage {
            if since + DELAY >= time + DT - ROUNDING {
                return stage;
            }
            stage = Stage::Braking { since: since + DELAY };
        }
        // It is not approached any more.
        if seen.closing <= 0.0 || seen.speed <= 0.0 {
            return Stage::Evaluated;
        }
        stage
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const STEP: f64 = DT;

    /// A cut-in at constant speeds: gap when the other begins to move sideways, speeds in km/h. Returns the time of the
    /// first braking and the least gap, `None` for a contact.
    fn cut_in(gap: f64, [own, other]: [f64; 2], sideways: f64, reading: Reading) -> (f64, Option<f64>) {
        let (mut speed, other) = (own / 3.6, other / 3.6);
        let (mut gap, mut first, mut least) = (gap, f64::INFINITY, f64::INFINITY);
        let mut reaction: Option<Reaction> = None;
        for step in 0..200 {
            let time = f64::from(step) * STEP;
            let deviation = (sideways * time).min(3.5);
            let seen = Seen {
                deviation,
                is_inside: deviation >= 1.6,
                gap,
                closing: speed - other,
                speed,
                deceleration: 0.0,
            };
            let reaction = reaction.get_or_insert_with(|| Reaction::new(&seen));
            let deceleration = reaction.deceleration(&seen, time, reading);
            first = reaction.brakes_since().map_or(first, |since| since.min(first));
            let next = (speed - deceleration * STEP).max(0.0);
            gap -= (0.5 * (speed + next) - other) * STEP;
            speed = next;
            least = least.min(gap);
            if seen.is_inside && gap <= 0.0 {
                return (first, None);
            }
        }
        (first, Some(least))
    }

    #[test]
    fn worked_cut_ins_come_out() {
        // Speeds in km/h, sideways m/s, gap; first braking and final gap of the closed form.
        for (speeds, sideways, gap, brakes, last) in [
            ([60.0, 40.0], 1.0, 15.0, 1.845, Some(1.165)),
            ([60.0, 30.0], 1.0, 24.0, 1.845, Some(1.666)),
            ([60.0, 40.0], 1.8, 12.0, 1.358, Some(0.869)),
            ([100.0, 60.0], 1.0, 34.0, 1.845, Some(2.151)),
            ([60.0, 30.0], 1.0, 20.0, 1.845, None),
            ([60.0, 40.0], 1.0, 12.0, 1.845, None),
        ] {
            let (first, found) = cut_in(gap, speeds, sideways, Reading::Distance);
            let closing = (speeds[0] - speeds[1]) / 3.6;
            assert!((brakes..=brakes + STEP + 1e-9).contains(&first), "{speeds:?} {gap}: {first}");
            match (found, last) {
                (Some(found), Some(last)) => {
                    assert!((found - last).abs() <= STEP * closing, "{speeds:?} {gap}: {found} and {last}");
                }
                (found, last) => assert_eq!(found.is_some(), last.is_some(), "{speeds:?} {gap}"),
            }
        }
    }

    #[test]
    fn the_gap_decides_as_in_the_closed_form() {
        // Gap at the start of the lateral motion that just avoids a contact, by distance and by time.
        for (speeds, sideways, by_distance, by_time) in [
            ([60.0, 40.0], 1.0, 13.835, 12.057),
            ([60.0, 40.0], 1.8, 11.131, 11.131),
            ([60.0, 30.0], 1.0, 22.334, 19.667),
            ([50.0, 20.0], 1.0, 22.334, 19.667),
            ([100.0, 60.0], 1.0, 31.849, 28.294),
            ([40.0, 30.0], 0.5, 9.394, 6.505),
        ] {
            let closing = (speeds[0] - speeds[1]) / 3.6;
            for (reading, least) in [(Reading::Distance, by_distance), (Reading::Time, by_time)] {
                let avoids = |gap| cut_in(gap, speeds, sideways, reading).1.is_some();
                // Braking begins up to a step later than in continuous time.
                for k in 0..4 {
                    let margin = (1.0 + f64::from(k)) * 2.0 * STEP * closing;
                    assert!(avoids(least + margin), "{speeds:?} {reading:?} {margin}");
                    assert!(!avoids(least - 0.5 * margin), "{speeds:?} {reading:?} −{margin}");
                }
            }
        }
    }

    #[test]
    fn what_is_not_critical_is_not_answered_and_what_leaves_is_forgotten() {
        // A time to collision of 2.145 s at the end of the evaluation.
        let reaction = |gap: f64, closing: f64| {
            let seen = |deviation| Seen { deviation, gap, closing, speed: 16.0, ..Seen::default() };
            let mut reaction = Reaction::new(&seen(0.0));
            (0..60)
                .map(|k| {
                    reaction.deceleration(&seen(0.1 * f64::from(k)), 0.1 * f64::from(k), Reading::Distance)
                })
                .fold(0.0, f64::max)
        };
        assert_eq!(reaction(12.0, 5.556), 0.0);
        assert!(reaction(11.0, 5.556) > 7.5);
        assert_eq!(reaction(11.0, -1.0), 0.0);
        // Within the wandering zone nothing is perceived.
        let near = Seen { deviation: 0.37, gap: 1.0, closing: 10.0, speed: 16.0, ..Seen::default() };
        let mut watching = Reaction::new(&near);
        assert!((0..50).all(|k| watching.deceleration(&near, 0.1 * f64::from(k), Reading::Time) == 0.0));
        // By overlap it is perceived later, and the foot leaves the accelerator at once.
        let (by_distance, _) = cut_in(15.0, [60.0, 40.0], 1.0, Reading::Distance);
        let (by_overlap, _) = cut_in(15.0, [60.0, 40.0], 1.0, Reading::Overlap);
        assert!((by_overlap - 2.4).abs() < STEP && by_overlap > by_distance, "{by_overlap}");
    }

    #[test]
    fn one_that_goes_back_or_has_left_is_passed_without_braking() {
        let strongest = |deviations: &[f64], starts_inside: bool, reading| {
            let seen = |deviation, is_inside| Seen {
                deviation,
                is_inside,
                gap: 8.0,
                closing: 5.0,
                speed: 16.0,
                ..Seen::default()
            };
            let mut reaction = Reaction::new(&seen(0.0, starts_inside));
            let steps = deviations.iter().enumerate();
            steps
                .map(|(k, d)| reaction.deceleration(&seen(*d, false), 0.1 * k as f64, reading))
                .fold(0.0, f64::max)
        };
        // Over the zone and evaluated, but back on its line before the delay is over.
        let swing: Vec<f64> =
            (0..8).map(|k| 0.2 * f64::from(k)).chain(std::iter::repeat_n(0.1, 40)).collect();
        assert_eq!(strongest(&swing, false, Reading::Distance), 0.0);
        // A former leader in the next lane.
        for reading in [Reading::Distance, Reading::Time, Reading::Overlap] {
            assert_eq!(strongest(&[-3.5; 40], true, reading), 0.0);
        }
    }

    #[test]
    fn a_revealed_headway_is_tested_once() {
        let seen = |closing| Seen { is_inside: true, gap: 20.0, closing, speed: 16.0, ..Seen::default() };
        let brakes = |closing: fn(usize) -> f64| {
            let mut reaction = Reaction::new(&seen(0.0));
            reaction.reveal(0.0);
            (0..40).any(|k| reaction.deceleration(&seen(closing(k)), 0.1 * k as f64, Reading::Distance) > 0.0)
        };
        // A headway of 1.25 s, approached at the end of the evaluation; approached only later.
        assert!(brakes(|_| 1.0));
        assert!(!brakes(|k| if k > 10 { 1.0 } else { 0.0 }));
    }

    #[test]
    fn a_leader_that_brakes_hard_is_answered_after_evaluation_and_delay() {
        // 60 km/h, 2 s behind a leader that brakes with 0.774 g: it stands 9.281 m behind.
        let start = 60.0 / 3.6;
        let (mut own, mut other, mut gap) = (start, start, 2.0 * start);
        let seen = |own: f64, other: f64, gap, deceleration| Seen {
            is_inside: true,
            gap,
            closing: own - other,
            speed: own,
            deceleration,
            ..Seen::default()
        };
        let mut reaction = Reaction::new(&seen(own, other, gap, 0.0));
        for step in 0..100 {
            let time = f64::from(step) * STEP;
            let braking = if other > 0.0 { DECELERATION } else { 0.0 };
            let deceleration =
                reaction.deceleration(&seen(own, other, gap, braking), time, Reading::Distance);
            let next = [(own - deceleration * STEP).max(0.0), (other - braking * STEP).max(0.0)];
            gap += 0.5 * STEP * (other + next[1] - own - next[0]);
            [own, other] = next;
        }
        assert!(own == 0.0 && (gap - 9.281).abs() < 0.1 * start, "{gap}");
    }
}
