//! Plans of a pedestrian or cyclist: onto the ego's way, at some time, at some speed.
//!
//! No network proposes them. Three quarters are timed: the person is on the ego's way about when the ego would be there, or
//! somewhat later, because drivers brake. The others start at any time for anywhere near. The selected plan is the one that a search
//! with the driver in the loop would try first.

use sage_core::{
    Error,
    generator::{Attack, Generator, Knowledge, Note, OperatingPoint, Proposal},
    geometry::{OrientedBox, Point, distance},
    motion::{DT, NOW},
    objective::{Context, Feasibility as _, PersonFeasibility, PersonLimits, person::promise},
    registry::Entry,
    scene::TrackKind,
    seed::Rng,
};
use serde::{Deserialize, Serialize};

use super::motion::Intent;
use crate::{Facts, GeneratorInputs, GeneratorKind};

/// Speeds on foot and by bicycle, m/s.
const ON_FOOT: [f64; 7] = [0.8, 1.0, 1.2, 1.39, 1.6, 2.0, 2.2];
const BY_BICYCLE: [f64; 6] = [1.5, 2.8, 3.5, 4.1, 5.5, 6.9];
/// Range of accelerations, m/s².
const ACCELERATIONS: [f64; 2] = [0.7, 1.9];
/// Share of timed plans.
const TIMED: f64 = 0.75;
/// When a timed plan is on the ego's way, relative to when the unattacked ego is there, seconds.
const TIMES: [f64; 2] = [-1.0, 2.5];
/// Standard deviation of the aim along the ego's way and across it, metres.
const ALONG: f64 = 1.5;
const ACROSS: f64 = 0.5;
/// Share of that spread towards the ego: people slant away from a car rather than into it.
const TOWARDS: f64 = 0.4;
/// Largest delay of the others, and standard deviation of their aims along the way, seconds and metres.
const DELAY: f64 = 5.0;
const ANYWHERE: f64 = 8.0;

/// The generator `person`.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Person {
    /// Number of plans.
    pub candidates: usize,
    /// Whether speeds keep to the clause `strict`: at most 5 km/h on foot, 15 km/h by bicycle.
    pub strict: bool,
}

impl Default for Person {
    fn default() -> Self {
        Self { candidates: 256, strict: false }
    }
}

impl Person {
    /// Plans in their order.
    fn plans(&self, ctx: &Context, limits: &PersonLimits, seed: u64) -> Result<Vec<Proposal>, Error> {
        let track = ctx.adversary();
        let mut rng = Rng::new(seed, &ctx.scene().id, "person");
        let speeds: Vec<f64> = match track.kind {
            TrackKind::Cyclist => &BY_BICYCLE[..],
            _ => &ON_FOOT[..],
        }
        .iter()
        .copied()
        .filter(|speed| !self.strict || *speed <= limits.strict_speed)
        .collect();
        let way = Way::of(ctx);
        let start = track.point(NOW);
        let own = way.nearest(start);
        let mut plans = Vec::with_capacity(self.candidates);
        for _ in 0..self.candidates {
            let is_timed = rng.unit() < TIMED;
            let spread = if is_timed { ALONG } else { ANYWHERE };
            let along = spread * rng.normal();
            let along = if along < 0.0 { TOWARDS * along } else { along };
            let station = (way.stations[own] + along).clamp(0.0, way.length());
            let aim = way.beside(station, ACROSS * rng.normal());
            let intent = Intent {
                aim,
                delay: rng.uniform(0.0, DELAY),
                speed: speeds[rng.below(speeds.len())],
                acceleration: rng.uniform(ACCELERATIONS[0], ACCELERATIONS[1]),
            };
            let meets = way.time_at(station) + rng.uniform(TIMES[0], TIMES[1]);
            let delay = meets - intent.time_for(distance(start, aim));
            let intent = if is_timed { Intent { delay: delay.max(0.0), ..intent } } else { intent };
            plans.push(Proposal { goal: Some(aim), ..Proposal::of(intent.trajectory(track, limits)?) });
        }
        Ok(plans)
    }
}

impl Generator for Person {
    fn attacks(&self, ctx: &Context, at: &[OperatingPoint], seed: u64) -> Result<Vec<Attack>, Error> {
        let track = ctx.adversary();
        let fail = |problem: String| Err(Error::Scene { scene: ctx.scene().id.clone(), problem });
        let Some(limits) = PersonLimits::of(&track.kind) else {
            return fail(format!(
                "`person` plans for pedestrians and cyclists, but the adversary `{}` is a {}: name another one, or place one with --adversary-type",
                track.id,
                track.kind.name()
            ));
        };
        if !track.is_valid(NOW) {
            return fail(format!("`person` cannot plan for `{}`: it is not valid at frame {NOW}", track.id));
        }
        let plans = self.plans(ctx, &limits, seed)?;
        let ego: Vec<OrientedBox> = ctx.ego().boxes().iter().map_while(|area| *area).collect();
        let mut best: Option<(usize, f64, bool)> = None;
        for (k, plan) in plans.iter().enumerate() {
            let candidate = ctx.candidate(plan.trajectory.clone());
            if !PersonFeasibility.is_feasible(&candidate, ctx) {
                continue;
            }
            let value = promise(candidate.boxes(), &ego).value;
            if best.is_none_or(|(_, most, _)| value > most) {
                best = Some((k, value, value > 1.0));
            }
        }
        let (chosen, note) = match best {
            None => (0, Some(Note::NoneFeasible)),
            Some((k, _, false)) => (k, Some(Note::NoContact)),
            Some((k, _, true)) => (k, None),
        };
        Ok(vec![Attack::of(plans, chosen, note); at.len()])
    }
}

impl GeneratorKind for Person {
    fn facts(&self) -> Facts {
        Facts::without_operating_point(Knowledge { ego_future: true, others_future: true, ..Knowledge::NOW })
    }

    fn build(&self, _: &GeneratorInputs) -> Result<Box<dyn Generator>, crate::Error> {
        Ok(Box::new(*self))
    }
}

impl Entry<dyn GeneratorKind> for Person {
    const NAME: &'static str = "person";
    const SUMMARY: &'static str = "a pedestrian or cyclist who steps onto the ego's way, within human limits";
    const SOURCE: &'static str = "this project; speeds of Euro NCAP, UN R152 and UN R157";
    type Options = Self;

    fn build(options: Self) -> Result<Box<dyn GeneratorKind>, String> {
        if options.candidates == 0 {
            return Err("`candidates` is 0; expected a whole number from 1 on".to_owned());
        }
        Ok(Box::new(options))
    }
}

/// The ego's way without the attack.
struct Way {
    points: Vec<Point>,
    /// Distance along it at each point, metres.
    stations: Vec<f64>,
}

impl Way {
    fn of(ctx: &Context) -> Self {
        let mut points = vec![ctx.scene().ego().point(NOW)];
        points.extend(ctx.ego().positions());
        let mut station = 0.0;
        let lengths = points.windows(2).map(|pair| distance(pair[0], pair[1]));
        let stations = std::iter::once(0.0).chain(lengths.map(|length| {
            station += length;
            station
        }));
        Self { stations: stations.collect(), points }
    }

    fn length(&self) -> f64 {
        self.stations.last().copied().unwrap_or(0.0)
    }

    /// The point nearest to another one.
    fn nearest(&self, p: Point) -> usize {
        let near =
            |a: &usize, b: &usize| distance(self.points[*a], p).total_cmp(&distance(self.points[*b], p));
        (0..self.points.len()).min_by(near).unwrap_or(0)
    }

    /// First point at or after a station.
    fn after(&self, station: f64) -> usize {
        self.stations.partition_point(|s| *s < station).min(self.points.len() - 1)
    }

    /// Seconds after *now* at which the ego is at a station.
    fn time_at(&self, station: f64) -> f64 {
        self.after(station) as f64 * DT
    }

    /// The point at a station, some metres to the left.
    fn beside(&self, station: f64, left: f64) -> Point {
        let k = self.after(station).max(1).min(self.points.len() - 1);
        let (a, b) = (self.points[k - 1], self.points[k]);
        let length = (self.stations[k] - self.stations[k - 1]).max(1e-6);
        let share = ((station - self.stations[k - 1]) / length).clamp(0.0, 1.0);
        let way = [(b[0] - a[0]) / length, (b[1] - a[1]) / length];
        [a[0] + share * (b[0] - a[0]) - left * way[1], a[1] + share * (b[1] - a[1]) + left * way[0]]
    }
}
