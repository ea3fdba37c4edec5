//! Traffic on routes: the Intelligent Driver Model, lights, and priority among conflicting cars at
//! junctions.
//!
//! Junctions are reserved: a car enters if its path conflicts with no holder and the light allows it. From the minor road, no
//! car on the major one may be near. Logs stay free of contact.

use std::collections::HashMap;

use sage_core::{
    geometry::{Point, distance},
    motion::{
        DT,
        idm::{Idm, Leader},
    },
    seed::Rng,
};

use super::{curve::STEP, network::Network};

/// Distance ahead within which a driver reacts, metres.
const LOOKAHEAD: f64 = 60.0;
/// Distance from a car's path within which another car blocks it, metres.
const BLOCKING_DISTANCE: f64 = 2.2;
/// Distance below which two lanes across a junction conflict, metres.
const CONFLICT: f64 = 3.0;
/// Distance of the stop line from a junction, metres.
const STOP_LINE: f64 = 1.0;
/// Least arrival time of a car on the major road for a car on the minor road to go, s.
const GAP: f64 = 4.0;
/// Durations of green and yellow of a light, s.
const PHASES: [f64; 2] = [11.0, 2.5];

/// A stretch of a route across a junction.
#[derive(Clone, Debug)]
struct Crossing {
    junction: usize,
    arm: usize,
    lane: usize,
    enter: f64,
    leave: f64,
}

/// A car on its route.
#[derive(Clone, Debug)]
pub(super) struct Car {
    pub(super) path: Vec<Point>,
    pub(super) size: [f64; 3],
    /// Arc length of its centre along the path, and speed.
    pub(super) s: f64,
    pub(super) v: f64,
    /// Arc lengths at which the path's lanes start, and their speed limits.
    limits: Vec<(f64, f64)>,
    crossings: Vec<Crossing>,
    driver: Idm,
    /// Desired fraction of the speed limit.
    speed_factor: f64,
    /// Crossing that it may enter.
    reserved: Option<usize>,
}

/// Position, heading and speed of a car in one frame; `None` after it has left the map.
pub(super) type VehicleState = Option<(Point, f64, f64)>;

impl Car {
    /// A point of the path, and the heading there.
    pub(super) fn on_path(&self, s: f64) -> (Point, f64) {
        let at = |s: f64| {
            let position = (s / STEP).clamp(0.0, (self.path.len() - 1) as f64);
            let k = (position as usize).min(self.path.len() - 2);
            let part = position - k as f64;
            [0, 1].map(|c| self.path[k][c] + part * (self.path[k + 1][c] - self.path[k][c]))
        };
        let (a, b) = (at(s - 0.75), at(s + 0.75));
        (at(s), (b[1] - a[1]).atan2(b[0] - a[0]))
    }

    /// Length of the path, metres.
    pub(super) fn length(&self) -> f64 {
        (self.path.len() - 1) as f64 * STEP
    }
}

/// A random route from a lane, at least `length` metres long if the network allows it.
fn route(net: &Network, start: usize, length: f64, rng: &mut Rng) -> Vec<usize> {
    let mut lanes = vec![start];
    let mut driven = 0.0;
    while driven < length {
        let lane = &net.lanes[lanes[lanes.len() - 1]];
        driven += (lane.points.len() - 1) as f64 * STEP;
        if lane.exits.is_empty() {
            break;
        }
        lanes.push(lane.exits[rng.below(lane.exits.len())]);
    }
    lanes
}

/// A car on a route, `s` metres along it.
fn car(net: &Network, lanes: &[usize], s: f64, rng: &mut Rng) -> Car {
    let mut path: Vec<Point> = Vec::new();
    let mut limits = Vec::new();
    let mut crossings: Vec<Crossing> = Vec::new();
    for &k in lanes {
        let lane = &net.lanes[k];
        let begin = path.len().saturating_sub(1) as f64 * STEP;
        limits.push((begin, lane.limit));
        path.extend(lane.points.iter().skip(usize::from(!path.is_empty())));
        let leave = (path.len() - 1) as f64 * STEP;
        if let Some((junction, arm)) = lane.crossing {
            match crossings.last_mut() {
                Some(last) if last.junction == junction && last.leave == begin => last.leave = leave,
                _ => crossings.push(Crossing { junction, arm, lane: k, enter: begin, leave }),
            }
        }
    }
    let long = rng.below(12) == 0;
    let length = if long { rng.uniform(6.5, 9.0) } else { rng.uniform(4.2, 5.1) };
    let width = if long { 2.4 } else { rng.uniform(1.75, 2.05) };
    let speed_factor = rng.uniform(0.85, 1.1);
    let driver = Idm {
        time_gap: rng.uniform(1.0, 1.7),
        standing_gap: 2.0,
        acceleration: rng.uniform(1.2, 2.0),
        deceleration: 2.5,
        ..Idm::default()
    };
    let here = limits.iter().rev().find(|(begin, _)| *begin <= s).map_or(10.0, |(_, limit)| *limit);
    Car {
        path,
        size: [length, width, if long { 2.8 } else { rng.uniform(1.4, 1.8) }],
        s,
        v: here * rng.uniform(0.6, 0.95),
        limits,
        crossings,
        driver,
        speed_factor,
        reserved: None,
    }
}

/// Cars on random lanes of a network.
pub(super) fn spawn(net: &Network, count: usize, rng: &mut Rng) -> Vec<Car> {
    let lanes: Vec<usize> = (0..net.lanes.len())
        .filter(|k| {
            !net.lanes[*k].bike && net.lanes[*k].crossing.is_none() && net.lanes[*k].points.len() > 30
        })
        .collect();
    let mut cars: Vec<Car> = Vec::new();
    for _ in 0..8 * count {
        if cars.len() == count || lanes.is_empty() {
            break;
        }
        let start = lanes[rng.below(lanes.len())];
        let s = rng.uniform(6.0, (net.lanes[start].points.len() as f64 * STEP - 4.0).max(7.0));
        let lanes = route(net, start, s + 260.0, rng);
        let car = car(net, &lanes, s, rng);
        let near = |other: &Car| distance(other.on_path(other.s).0, car.on_path(car.s).0) < 14.0;
        // Cars on short remaining routes would leave the map at once.
        if car.length() > s + 30.0 && !cars.iter().any(near) && clear_of_junctions(&car) {
            cars.push(car);
        }
    }
    cars
}

/// Whether a car can stop before every junction.
fn clear_of_junctions(car: &Car) -> bool {
    car.crossings.iter().all(|c| {
        let ahead_distance = c.enter - car.s;
        ahead_distance > 4.0 + car.v * car.v / 5.0 || c.leave + 6.0 < car.s
    })
}

/// The simulation of the traffic.
pub(super) struct Traffic<'n> {
    net: &'n Network,
    pub(super) cars: Vec<Car>,
    time: f64,
    conflicts: HashMap<(usize, usize), bool>,
}

impl<'n> Traffic<'n> {
    pub(super) fn new(net: &'n Network, cars: Vec<Car>, time: f64) -> Self {
        Self { net, cars, time, conflicts: HashMap::new() }
    }

    /// State of the lights of a phase: 0 green, 1 yellow, 2 red.
    pub(super) fn light(&self, phase: usize) -> usize {
        let cycle = 2.0 * (PHASES[0] + PHASES[1]);
        let into = (self.time + phase as f64 * 0.5 * cycle).rem_euclid(cycle);
        match into {
            t if t < PHASES[0] => 0,
            t if t < PHASES[0] + PHASES[1] => 1,
            _ => 2,
        }
    }

    /// Current states of all cars.
    pub(super) fn states(&self) -> Vec<VehicleState> {
        let state = |car: &Car| {
            (car.s + 0.5 * car.size[0] < car.length()).then(|| {
                let (at, heading) = car.on_path(car.s);
                (at, heading, car.v)
            })
        };
        self.cars.iter().map(state).collect()
    }

    /// Advances by one frame.
    pub(super) fn step(&mut self) {
        self.reserve_junctions();
        let states = self.states();
        let gains: Vec<f64> = (0..self.cars.len()).map(|k| self.acceleration(k, &states)).collect();
        for (car, gain) in self.cars.iter_mut().zip(gains) {
            let v = (car.v + gain.clamp(-6.0, 2.5) * DT).max(0.0);
            car.s += 0.5 * (car.v + v) * DT;
            car.v = v;
        }
        self.time += DT;
    }

    /// Decides which cars may enter which junction.
    fn reserve_junctions(&mut self) {
        for k in 0..self.cars.len() {
            let car = &self.cars[k];
            if let Some(crossing) = car.reserved {
                if car.s - 0.5 * car.size[0] > car.crossings[crossing].leave {
                    self.cars[k].reserved = None;
                } else {
                    continue;
                }
            }
            let car = &self.cars[k];
            let ahead = car.crossings.iter().position(|c| c.leave > car.s - 0.5 * car.size[0]);
            let Some(ahead) = ahead else { continue };
            let ahead_distance = car.crossings[ahead].enter - car.s - 0.5 * car.size[0];
            if ahead_distance < 8.0 + car.v * car.v / 4.0 && self.may_cross(k, ahead, ahead_distance) {
                self.cars[k].reserved = Some(ahead);
            }
        }
    }

    fn may_cross(&mut self, k: usize, ahead: usize, ahead_distance: f64) -> bool {
        let (own, v) = (self.cars[k].crossings[ahead].clone(), self.cars[k].v);
        let junction = &self.net.junctions[own.junction];
        if junction.lights {
            let shown = self.light(junction.phases[own.arm]);
            let cannot_stop = v * v / (2.0 * 3.5) > ahead_distance;
            if shown == 2 || (shown == 1 && !cannot_stop) {
                return false;
            }
        }
        let minor = junction.minor.contains(&own.arm);
        for j in (0..self.cars.len()).filter(|j| *j != k) {
            let other = &self.cars[j];
            let reserving = other
                .reserved
                .map(|crossing| other.crossings[crossing].clone())
                .filter(|c| c.junction == own.junction);
            let coming = other
                .crossings
                .iter()
                .find(|c| c.junction == own.junction && c.leave > other.s)
                .filter(|c| {
                    let first = !self.net.junctions[c.junction].minor.contains(&c.arm);
                    let time = (c.enter - other.s) / other.v.max(1.0);
                    minor && first && time < GAP && (!junction.lights)
                })
                .cloned();
            for other_crossing in [reserving, coming].into_iter().flatten() {
                if other_crossing.arm == own.arm && other_crossing.lane == own.lane {
                    continue;
                }
                if self.in_conflict(own.lane, other_crossing.lane) {
                    return false;
                }
            }
        }
        true
    }

    /// Whether two lanes across a junction come too close to each other.
    fn in_conflict(&mut self, a: usize, b: usize) -> bool {
        let net = self.net;
        *self.conflicts.entry((a.min(b), a.max(b))).or_insert_with(|| {
            let (p, q) = (&net.lanes[a].points, &net.lanes[b].points);
            // Lanes from the same start diverge: following suffices until then.
            let together = distance(p[0], q[0]) < 0.5;
            !together && p.iter().any(|x| q.iter().any(|y| distance(*x, *y) < CONFLICT))
        })
    }

    fn acceleration(&self, k: usize, states: &[VehicleState]) -> f64 {
        let car = &self.cars[k];
        let front = car.s + 0.5 * car.size[0];
        let mut gain = f64::INFINITY;
        let mut follow = |leader: Option<Leader>, desired: f64| {
            let driver = Idm { desired_speed: desired, ..car.driver };
            gain = gain.min(driver.acceleration(car.v, leader));
        };
        follow(None, self.desired_speed(car));
        if let Some(leader) = self.leader(k, states) {
            follow(Some(leader), self.desired_speed(car));
        }
        // Stop before the next junction until it may be entered.
        let next = car.crossings.iter().position(|c| c.leave > car.s - 0.5 * car.size[0]);
        if let Some(next) = next.filter(|next| car.reserved != Some(*next)) {
            let ahead_distance = car.crossings[next].enter - STOP_LINE - front;
            if ahead_distance < LOOKAHEAD {
                // IDM stops at its standing gap behind a leader, but a car must reach the stop line.
                let line = Leader { gap: ahead_distance + car.driver.standing_gap, speed: 0.0 };
                follow(Some(line), self.desired_speed(car));
            }
        }
        gain
    }

    /// Speed that the limits here and ahead allow.
    fn desired_speed(&self, car: &Car) -> f64 {
        let comfortable = 2.0;
        let ahead = car.limits.iter().enumerate().filter_map(|(k, (begin, limit))| {
            let end = car.limits.get(k + 1).map_or(f64::INFINITY, |(next, _)| *next);
            if end < car.s {
                return None;
            }
            let ahead_distance = (begin - car.s).max(0.0);
            Some((limit * limit + 2.0 * comfortable * ahead_distance).sqrt())
        });
        (car.speed_factor * ahead.fold(f64::INFINITY, f64::min)).max(1.0)
    }

    /// The nearest car on the path ahead.
    fn leader(&self, k: usize, states: &[VehicleState]) -> Option<Leader> {
        let car = &self.cars[k];
        let (here, _) = car.on_path(car.s);
        let first = (car.s / STEP) as usize;
        let last = (first + (LOOKAHEAD / STEP) as usize).min(car.path.len());
        let mut nearest: Option<Leader> = None;
        for (j, other) in states.iter().enumerate() {
            let Some((at, heading, v)) = other else { continue };
            if j == k || distance(here, *at) > LOOKAHEAD {
                continue;
            }
            let close = (first..last).step_by(3).filter(|p| distance(car.path[*p], *at) < BLOCKING_DISTANCE);
            let Some(position) =
                close.min_by(|p, q| distance(car.path[*p], *at).total_cmp(&distance(car.path[*q], *at)))
            else {
                continue;
            };
            let along = position as f64 * STEP - car.s;
            let (_, direction) = car.on_path(position as f64 * STEP);
            let speed = v * (heading - direction).cos();
            // Skip cars beside or behind, and oncoming cars in their own lane.
            if along <= 0.5 || speed < -1.0 {
                continue;
            }
            let gap = along - 0.5 * (car.size[0] + self.cars[j].size[0]);
            if nearest.is_none_or(|n| gap < n.gap) {
                nearest = Some(Leader { gap, speed: speed.max(0.0) });
            }
        }
        nearest
    }
}
