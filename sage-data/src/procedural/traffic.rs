//! Cars that follow routes: the Intelligent Driver Model, lights, and one at a time in each other's
//! way at junctions.

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

/// How far ahead a driver looks, metres.
const SIGHT: f64 = 60.0;
/// Distance from a path within which a car is in its way, metres.
const IN_THE_WAY: f64 = 2.2;
/// Distance below which two ways across a junction conflict, metres.
const CONFLICT: f64 = 3.0;
/// Where cars wait before a junction, metres.
const STOP_LINE: f64 = 1.0;
/// Time that a car on the major road must be away for one from the minor road to go, s.
const GAP: f64 = 4.0;
/// Green and yellow of a light, s.
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
    /// Way along the path, of its centre, and speed.
    pub(super) s: f64,
    pub(super) v: f64,
    /// Way at which the path's lanes begin, and their limits.
    limits: Vec<(f64, f64)>,
    crossings: Vec<Crossing>,
    driver: Idm,
    /// Share of the speed limit that the driver likes.
    keen: f64,
    /// Crossing that it may drive.
    holds: Option<usize>,
}

/// What is seen of a car in one frame; `None` once it has left the map.
pub(super) type Seen = Option<(Point, f64, f64)>;

impl Car {
    /// A point of the path, and the direction there.
    pub(super) fn on_path(&self, s: f64) -> (Point, f64) {
        let at = |s: f64| {
            let place = (s / STEP).clamp(0.0, (self.path.len() - 1) as f64);
            let k = (place as usize).min(self.path.len() - 2);
            let part = place - k as f64;
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

/// A route from a lane on, at random, at least `length` metres if the network goes that far.
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
    let keen = rng.uniform(0.85, 1.1);
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
        keen,
        holds: None,
    }
}

/// Cars spread over the lanes of a network.
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
        // Ways that end on a short map would leave it at once.
        if car.length() > s + 30.0 && !cars.iter().any(near) && clear_of_junctions(&car) {
            cars.push(car);
        }
    }
    cars
}

/// Whether a car is far enough from every junction to stop before it.
fn clear_of_junctions(car: &Car) -> bool {
    car.crossings.iter().all(|c| {
        let way = c.enter - car.s;
        way > 4.0 + car.v * car.v / 5.0 || c.leave + 6.0 < car.s
    })
}

/// Traffic in time.
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

    /// What the lights of a phase show: 0 green, 1 yellow, 2 red.
    pub(super) fn light(&self, phase: usize) -> usize {
        let cycle = 2.0 * (PHASES[0] + PHASES[1]);
        let into = (self.time + phase as f64 * 0.5 * cycle).rem_euclid(cycle);
        match into {
            t if t < PHASES[0] => 0,
            t if t < PHASES[0] + PHASES[1] => 1,
            _ => 2,
        }
    }

    /// What is seen of all cars now.
    pub(super) fn seen(&self) -> Vec<Seen> {
        let see = |car: &Car| {
            (car.s + 0.5 * car.size[0] < car.length()).then(|| {
                let (at, heading) = car.on_path(car.s);
                (at, heading, car.v)
            })
        };
        self.cars.iter().map(see).collect()
    }

    /// One frame on.
    pub(super) fn step(&mut self) {
        self.hand_out_junctions();
        let seen = self.seen();
        let gains: Vec<f64> = (0..self.cars.len()).map(|k| self.acceleration(k, &seen)).collect();
        for (car, gain) in self.cars.iter_mut().zip(gains) {
            let v = (car.v + gain.clamp(-6.0, 2.5) * DT).max(0.0);
            car.s += 0.5 * (car.v + v) * DT;
            car.v = v;
        }
        self.time += DT;
    }

    /// Decides who may drive into which junction.
    fn hand_out_junctions(&mut self) {
        for k in 0..self.cars.len() {
            let car = &self.cars[k];
            if let Some(held) = car.holds {
                if car.s - 0.5 * car.size[0] > car.crossings[held].leave {
                    self.cars[k].holds = None;
                } else {
                    continue;
                }
            }
            let car = &self.cars[k];
            let ahead = car.crossings.iter().position(|c| c.leave > car.s - 0.5 * car.size[0]);
            let Some(ahead) = ahead else { continue };
            let way = car.crossings[ahead].enter - car.s - 0.5 * car.size[0];
            if way < 8.0 + car.v * car.v / 4.0 && self.may_cross(k, ahead, way) {
                self.cars[k].holds = Some(ahead);
            }
        }
    }

    fn may_cross(&mut self, k: usize, ahead: usize, way: f64) -> bool {
        let (mine, v) = (self.cars[k].crossings[ahead].clone(), self.cars[k].v);
        let junction = &self.net.junctions[mine.junction];
        if junction.lights {
            let shown = self.light(junction.phases[mine.arm]);
            let cannot_stop = v * v / (2.0 * 3.5) > way;
            if shown == 2 || (shown == 1 && !cannot_stop) {
                return false;
            }
        }
        let minor = junction.minor.contains(&mine.arm);
        for j in (0..self.cars.len()).filter(|j| *j != k) {
            let other = &self.cars[j];
            let holding =
                other.holds.map(|held| other.crossings[held].clone()).filter(|c| c.junction == mine.junction);
            let coming = other
                .crossings
                .iter()
                .find(|c| c.junction == mine.junction && c.leave > other.s)
                .filter(|c| {
                    let first = !self.net.junctions[c.junction].minor.contains(&c.arm);
                    let time = (c.enter - other.s) / other.v.max(1.0);
                    minor && first && time < GAP && (!junction.lights)
                })
                .cloned();
            for theirs in [holding, coming].into_iter().flatten() {
                if theirs.arm == mine.arm && theirs.lane == mine.lane {
                    continue;
                }
                if self.in_conflict(mine.lane, theirs.lane) {
                    return false;
                }
            }
        }
        true
    }

    /// Whether two ways across a junction come too near each other.
    fn in_conflict(&mut self, a: usize, b: usize) -> bool {
        let net = self.net;
        *self.conflicts.entry((a.min(b), a.max(b))).or_insert_with(|| {
            let (p, q) = (&net.lanes[a].points, &net.lanes[b].points);
            // Ways out of one lane part: following is enough until they have.
            let together = distance(p[0], q[0]) < 0.5;
            !together && p.iter().any(|x| q.iter().any(|y| distance(*x, *y) < CONFLICT))
        })
    }

    fn acceleration(&self, k: usize, seen: &[Seen]) -> f64 {
        let car = &self.cars[k];
        let front = car.s + 0.5 * car.size[0];
        let mut gain = f64::INFINITY;
        let mut follow = |leader: Option<Leader>, desired: f64| {
            let driver = Idm { desired_speed: desired, ..car.driver };
            gain = gain.min(driver.acceleration(car.v, leader));
        };
        follow(None, self.desired_speed(car));
        if let Some(leader) = self.leader(k, seen) {
            follow(Some(leader), self.desired_speed(car));
        }
        // Stop before the next junction until it may be crossed.
        let next = car.crossings.iter().position(|c| c.leave > car.s - 0.5 * car.size[0]);
        if let Some(next) = next.filter(|next| car.holds != Some(*next)) {
            let way = car.crossings[next].enter - STOP_LINE - front;
            if way < SIGHT {
                // The law keeps its standing gap to what it follows; the line is to be reached.
                let line = Leader { gap: way + car.driver.standing_gap, speed: 0.0 };
                follow(Some(line), self.desired_speed(car));
            }
        }
        gain
    }

    /// Speed that limits allow here and ahead.
    fn desired_speed(&self, car: &Car) -> f64 {
        let comfortable = 2.0;
        let ahead = car.limits.iter().enumerate().filter_map(|(k, (begin, limit))| {
            let end = car.limits.get(k + 1).map_or(f64::INFINITY, |(next, _)| *next);
            if end < car.s {
                return None;
            }
            let way = (begin - car.s).max(0.0);
            Some((limit * limit + 2.0 * comfortable * way).sqrt())
        });
        (car.keen * ahead.fold(f64::INFINITY, f64::min)).max(1.0)
    }

    /// The nearest car in the way.
    fn leader(&self, k: usize, seen: &[Seen]) -> Option<Leader> {
        let car = &self.cars[k];
        let (here, _) = car.on_path(car.s);
        let first = (car.s / STEP) as usize;
        let last = (first + (SIGHT / STEP) as usize).min(car.path.len());
        let mut nearest: Option<Leader> = None;
        for (j, other) in seen.iter().enumerate() {
            let Some((at, heading, v)) = other else { continue };
            if j == k || distance(here, *at) > SIGHT {
                continue;
            }
            let close = (first..last).step_by(3).filter(|p| distance(car.path[*p], *at) < IN_THE_WAY);
            let Some(place) =
                close.min_by(|p, q| distance(car.path[*p], *at).total_cmp(&distance(car.path[*q], *at)))
            else {
                continue;
            };
            let along = place as f64 * STEP - car.s;
            let (_, direction) = car.on_path(place as f64 * STEP);
            let speed = v * (heading - direction).cos();
            // Cars beside or behind, and those that come the other way in their own lane.
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
