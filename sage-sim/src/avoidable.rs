//! Whether a driver could have avoided an attack: a search for an evasive manoeuvre, and when the last one began.
//!
//! The adversary keeps to its plan and the others to their recording. The ego keeps to its path up to a frame and
//! then follows one of many manoeuvres of a kinematic bicycle within [`AvoidanceOptions`]. A manoeuvre is a *way
//! out* if its box touches nothing up to frame 90: not the adversary, no other road user, no edge, no median,
//! swept between frames. Lines under the box at the start may be left, and a road user that runs into the ego from
//! behind is noted, because a recorded follower does not react. Starts are tried from the contact backwards, so the
//! first evasive manoeuvre that is found is the last one.
//!
//! An evasive manoeuvre that is found exists, and any simulator can replay it. That none is found proves nothing.

mod car;
mod follower;
mod latest_start;
mod limits;
mod manoeuvres;
mod motion;
mod reference_line;
mod surroundings;

use sage_core::{
    geometry::{OrientedBox, Point, dot, sub},
    motion::{DT, NOW},
    objective::{Candidate, Context, Encounter},
    scene::{Hitch, is_one_level},
};
use serde::{Deserialize, Serialize};

pub use latest_start::{LatestStart, LatestStartOptions};
pub use limits::AvoidanceOptions;

use crate::fault::is_in_one_lane;
use car::Car;
use manoeuvres::{Manoeuvre, manoeuvres};
use motion::Motion;
use reference_line::ReferenceLine;
use surroundings::{Moving, Passed, Surroundings, plan};

/// An evasive manoeuvre: box centre and heading at the 80 steps, metres and rad, world frame.
pub type Witness = Vec<[f64; 3]>;

/// Whether an attack is avoidable, and how late.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Avoidable {
    /// Whether an evasive manoeuvre was found, contacts from behind allowed; `None` if the question does not arise.
    pub avoidable: Option<bool>,
    /// Why it does not arise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub avoidable_reason: Option<String>,
    /// Whether an evasive manoeuvre without any contact from behind was found.
    pub avoidable_unhit: Option<bool>,
    /// Whether someone else runs into the ego from behind on the last evasive manoeuvre.
    pub hit_from_behind: Option<bool>,
    /// Whether one of them would do so too as a UN R157 driver, who brakes 0.75 s after the evasive manoeuvre begins; `None` if nobody
    /// runs into the ego, or one that does is not recorded throughout.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hit_by_reactive_follower: Option<bool>,
    /// Whether a straight full brake after frame 90 stays free for 2 s.
    pub recovers: Option<bool>,
    /// Whether the last evasive manoeuvre leaves the lane at a frame at which the ego's own path is in one.
    pub leaves_lane: Option<bool>,
    /// Latest start of an evasive manoeuvre, seconds before the contact; `None` without one.
    pub latest_start: Option<f64>,
    /// The same of braking alone, on the ego's path.
    pub latest_brake: Option<f64>,
    /// The same of steering alone, at the speed of the start.
    pub latest_steer: Option<f64>,
    /// Peak deceleration of the mildest evasive manoeuvre that begins *now*, m/s²; `None` if only later starts have one.
    pub mildest_deceleration: Option<f64>,
    /// The last evasive manoeuvre.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub witness: Option<Witness>,
}

impl Avoidable {
    /// The part of the witness from its start on, and the time of the start, seconds after *now*, of an attack whose
    /// contact is at a step.
    pub fn evasion(&self, contact: usize) -> Option<(f64, &[[f64; 3]])> {
        let start = contact as f64 * DT - self.latest_start?;
        let first = (start / DT).round().max(0.0) as usize;
        Some((start.max(0.0), self.witness.as_ref()?.get(first.saturating_sub(1)..)?))
    }
}

/// A scene and a path of the ego, prepared for all plans of the adversary.
///
/// When the last evasive manoeuvre from the recorded path begins:
///
/// ```
/// use std::sync::Arc;
///
/// use sage_core::{
///     objective::{Context, ContextOptions},
///     scene::SceneIndex,
/// };
/// use sage_data::procedural::{Kind, attacks, generate};
/// use sage_sim::avoidable::{Avoidance, AvoidanceOptions};
///
/// let scene = Arc::new(generate(Kind::Straight, 1, 0).ok_or("no scene for this seed")?);
/// let ctx = Context::new(&scene, &SceneIndex::new(scene.map.clone()), &ContextOptions::default())?;
/// let avoidance = Avoidance::new(&ctx, AvoidanceOptions::default())?;
/// let found: Vec<_> = attacks(&scene).into_iter().map(|(_, plan)| avoidance.of(&ctx.candidate(plan))).collect();
/// // Asked of contacts alone. An avoidable one has a latest start, in seconds before the contact.
/// assert!(found.iter().any(|found| found.avoidable == Some(true)));
/// assert!(found.iter().all(|found| (found.avoidable == Some(true)) == found.latest_start.is_some()));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Avoidance {
    ctx: Context,
    surroundings: Surroundings,
    /// Boxes of the ego at steps 0 to 80, up to the first gap.
    path: Vec<OrientedBox>,
    car: Car,
    line: ReferenceLine,
    /// Station of the rear axle at each step of the path.
    stations: Vec<f64>,
    manoeuvres: Vec<Manoeuvre>,
    options: AvoidanceOptions,
    /// Why nothing can be said about any plan.
    refused: Option<String>,
}

/// A plan of the adversary, and the ego's path up to its contact.
struct Attack {
    adversary: Vec<Moving>,
    prefix: Prefix,
}

/// The recorded path before a contact.
struct Prefix {
    /// Last step from which a manoeuvre may start.
    last: usize,
    /// Who runs into the ego from behind: step and track.
    hits: Vec<(usize, usize)>,
}

impl Prefix {
    fn hits_before(&self, start: usize) -> Vec<usize> {
        self.hits.iter().filter(|(step, _)| *step <= start).map(|(_, track)| *track).collect()
    }
}

/// An evasive manoeuvre, step by step.
struct Traced {
    witness: Witness,
    recovers: bool,
    /// Tracks that run into the ego from behind.
    followers: Vec<usize>,
}

/// A rollout that touched nothing.
struct Free {
    manoeuvre: Manoeuvre,
    start: usize,
    is_hit: bool,
}

impl Avoidance {
    /// Prepares the first path of a context.
    ///
    /// *Errors*: [`sage_core::Error::Options`] for options out of range.
    pub fn new(ctx: &Context, options: AvoidanceOptions) -> Result<Self, sage_core::Error> {
        options.check()?;
        let ego = ctx.scene().ego();
        let mut path = vec![ego.oriented_box(NOW)];
        path.extend(ctx.ego().boxes().iter().map_while(|area| *area));
        // The size of the path is that of the scores.
        let size = *path.last().unwrap_or(&path[0]);
        path[0] = OrientedBox { half_length: size.half_length, half_width: size.half_width, ..path[0] };
        let car = Car::new(&size, options);
        let axles: Vec<Point> = path.iter().map(|area| car.axle(area)).collect();
        let line = ReferenceLine::new(&axles, path[0].axis, ctx.index());
        let mut station = line.station_of(axles[0]);
        let stations = axles.iter().map(|axle| {
            station = line.place(*axle, station).station;
            station
        });
        let stations = stations.collect();
        let surroundings = Surroundings::new(ctx);
        let mut avoidance = Self {
            ctx: ctx.clone(),
            surroundings,
            path,
            car,
            line,
            stations,
            manoeuvres: manoeuvres(&options),
            options,
            refused: None,
        };
        avoidance.refused = avoidance.refusal();
        Ok(avoidance)
    }

    fn refusal(&self) -> Option<String> {
        let (scene, index) = (self.ctx.scene(), self.ctx.index());
        if !scene.ego().is_valid(NOW) {
            return Some("the ego is not valid now".to_owned());
        }
        if index.edges().segments().is_empty() {
            return Some("the map has no road edges".to_owned());
        }
        let now = &self.path[0];
        let trailer = Hitch::of(scene, scene.ego).map(|hitch| hitch.trailer);
        let touching = |k: usize| {
            let track = &scene.tracks[k];
            let is_other = k != scene.ego && Some(k) != trailer;
            track.is_valid(NOW) && is_other && track.oriented_box(NOW).intersects(now)
        };
        let found = (0..scene.tracks.len()).find(|k| touching(*k) && !self.is_other_level(*k))?;
        Some(format!("the ego touches `{}` now", scene.tracks[found].id))
    }

    /// Whether a track is above or below the ego *now*.
    fn is_other_level(&self, track: usize) -> bool {
        let scene = self.ctx.scene();
        !is_one_level(scene.tracks[track].ground(NOW), scene.ego().ground(NOW))
    }

    /// Whether a plan of the adversary is avoidable.
    pub fn of(&self, candidate: &Candidate) -> Avoidable {
        self.of_contact(candidate, Encounter::of(candidate, self.ctx.ego()).contact)
    }

    /// The same for a contact at a known step, 1 or later. The path of a driver that a contact pushed aside need not
    /// show it.
    pub fn of_contact(&self, candidate: &Candidate, contact: Option<usize>) -> Avoidable {
        let (contact, attack) = match self.prepared(candidate, contact) {
            Ok(prepared) => prepared,
            Err(reason) => return Avoidable { avoidable_reason: Some(reason), ..Avoidable::default() },
        };
        let search = |latest: usize, fits: &dyn Fn(&Manoeuvre) -> bool| self.latest(latest, &attack, fits);
        let react = search(attack.prefix.last, &|_| true);
        let seconds = |free: &Option<Free>| free.as_ref().map(|free| (contact - free.start) as f64 / 10.0);
        let Some(way) = &react else {
            return Avoidable {
                avoidable: Some(false),
                avoidable_unhit: Some(false),
                ..Avoidable::default()
            };
        };
        let unhit = !way.is_hit || {
            (0..=way.start).rev().any(|start| self.evasion(start, &attack, &|_| true, false).is_some())
        };
        // Later starts than that of the last evasive manoeuvre have failed with every manoeuvre.
        let Traced { witness, recovers, followers } = self.trace(way, &attack);
        Avoidable {
            avoidable: Some(true),
            avoidable_reason: None,
            avoidable_unhit: Some(unhit),
            hit_from_behind: Some(way.is_hit),
            hit_by_reactive_follower: self.is_hit_by_r157(&followers, &witness, way.start),
            recovers: Some(recovers),
            leaves_lane: self.leaves_lane(&witness, way.start),
            latest_start: seconds(&react),
            latest_brake: seconds(&search(way.start, &Manoeuvre::brakes)),
            latest_steer: seconds(&search(way.start, &Manoeuvre::steers)),
            mildest_deceleration: self.mildest(&attack),
            witness: Some(witness),
        }
    }

    /// Latest start, seconds before a contact at a known step, and nothing else of [`Avoidance::of_contact`];
    /// `None` without a manoeuvre, or if the question does not arise.
    pub fn latest_start(&self, candidate: &Candidate, contact: usize) -> Option<f64> {
        let (contact, attack) = self.prepared(candidate, Some(contact)).ok()?;
        let free = self.latest(attack.prefix.last, &attack, &|_| true)?;
        Some((contact - free.start) as f64 / 10.0)
    }

    /// The same of manoeuvres that brake and do not steer.
    pub fn latest_brake(&self, candidate: &Candidate, contact: usize) -> Option<f64> {
        let (contact, attack) = self.prepared(candidate, Some(contact)).ok()?;
        let free = self.latest(attack.prefix.last, &attack, &Manoeuvre::brakes)?;
        Some((contact - free.start) as f64 / 10.0)
    }

    /// The step of the contact and what a search for manoeuvres needs.
    ///
    /// *Errors*: why the question does not arise.
    fn prepared(&self, candidate: &Candidate, contact: Option<usize>) -> Result<(usize, Attack), String> {
        if let Some(reason) = &self.refused {
            return Err(reason.clone());
        }
        let contact = contact.filter(|step| *step > 0).ok_or("no contact")?;
        if contact >= self.path.len() {
            return Err("the ego's path has a gap before the contact".to_owned());
        }
        let track = self.ctx.scene().adversary_index().unwrap_or_default();
        let is_level = |step: usize| self.ctx.ego().is_on_level_of(candidate, step);
        let adversary = plan(track, candidate.box_now(), candidate.boxes(), is_level);
        Ok((contact, Attack { prefix: self.prefix(contact, &adversary), adversary }))
    }

    /// The last evasive manoeuvre that starts at a step or before.
    fn latest(&self, step: usize, attack: &Attack, fits: &dyn Fn(&Manoeuvre) -> bool) -> Option<Free> {
        (0..=step).rev().find_map(|start| self.evasion(start, attack, fits, true))
    }

    /// Least deceleration of an evasive manoeuvre that begins *now*, m/s².
    fn mildest(&self, attack: &Attack) -> Option<f64> {
        let mut by_deceleration: Vec<&Manoeuvre> = self.manoeuvres.iter().collect();
        by_deceleration.sort_by(|a, b| a.deceleration().total_cmp(&b.deceleration()));
        let is_free = |m: &&&Manoeuvre| self.roll_out(0, m, attack, &mut |_, _| {}).is_some();
        by_deceleration.iter().find(is_free).map(|manoeuvre| manoeuvre.deceleration())
    }

    /// The recorded path up to the contact, as far as it touches nothing.
    fn prefix(&self, contact: usize, adversary: &[Moving]) -> Prefix {
        let mut passed = Passed::default();
        let mut prefix = Prefix { last: contact - 1, hits: Vec::new() };
        for step in 1..contact {
            let pair = [step - 1, step].map(|k| self.car.grown(&self.path[k]));
            let bounds = pair[0].aabb().union(&pair[1].aabb());
            let pair = [&pair[0], &pair[1]];
            let known = passed.from_behind.len();
            if self.surroundings.met(step, pair, &bounds, adversary, self.car.rear, &mut passed).is_some() {
                prefix.last = step - 1;
                break;
            }
            prefix.hits.extend(passed.from_behind[known..].iter().map(|track| (step, *track)));
        }
        prefix
    }

    /// The first manoeuvre from a start that touches nothing; one that nobody runs into is preferred.
    fn evasion(
        &self,
        start: usize,
        attack: &Attack,
        fits: &dyn Fn(&Manoeuvre) -> bool,
        may_be_hit: bool,
    ) -> Option<Free> {
        let mut hit = None;
        for manoeuvre in self.manoeuvres.iter().filter(|manoeuvre| fits(manoeuvre)) {
            let Some(passed) = self.roll_out(start, manoeuvre, attack, &mut |_, _| {}) else { continue };
            let free = Free { manoeuvre: *manoeuvre, start, is_hit: !passed.from_behind.is_empty() };
            if !free.is_hit {
                return Some(free);
            }
            hit = hit.or(Some(free));
        }
        hit.filter(|_| may_be_hit)
    }

    /// Follows a manoeuvre to the last step; `None` if it touches something. `each` gets the boxes of a step and
    /// the speed.
    fn roll_out(
        &self,
        start: usize,
        manoeuvre: &Manoeuvre,
        attack: &Attack,
        each: &mut dyn FnMut(&OrientedBox, f64),
    ) -> Option<Passed> {
        let from = self.car.grown(&self.path[start]);
        let mut passed = self.surroundings.passed(&from, attack.prefix.hits_before(start));
        let mut motion = Motion::new(self, start, manoeuvre);
        let mut before = from;
        for step in start + 1..=self.ctx.horizon() {
            let (area, speed) = motion.step(self, (step - start - 1) as f64 * DT);
            let pair = [&before, &area];
            if self.surroundings.touched(step, pair, &attack.adversary, self.car.rear, &mut passed).is_some()
            {
                return None;
            }
            each(&area, speed);
            before = area;
        }
        Some(passed)
    }

    /// The witness of an evasive manoeuvre, and what happens on it.
    fn trace(&self, way: &Free, attack: &Attack) -> Traced {
        let row = |area: &OrientedBox| [area.center[0], area.center[1], area.axis[1].atan2(area.axis[0])];
        let mut witness: Witness = self.path[1..=way.start].iter().map(row).collect();
        let start = self.car.grown(&self.path[way.start]);
        let (mut last, mut speed) = ([start, start], 0.0);
        let passed = self.roll_out(way.start, &way.manoeuvre, attack, &mut |area, now| {
            witness.push(row(area));
            last = [last[1], *area];
            speed = now;
        });
        let passed = passed.unwrap_or_default();
        let [before, end] = &last;
        let recovers =
            self.surroundings.recovers([before, end], speed, self.options.brake, &attack.adversary, &passed);
        Traced { witness, recovers, followers: passed.from_behind }
    }

    /// Whether one of those who run into the ego would do so as a UN R157 driver.
    fn is_hit_by_r157(&self, followers: &[usize], witness: &Witness, start: usize) -> Option<bool> {
        if followers.is_empty() {
            return None;
        }
        let size = &self.path[0];
        let area = |[x, y, heading]: &[f64; 3]| {
            OrientedBox::new([*x, *y], *heading, 2.0 * size.half_length, 2.0 * size.half_width)
        };
        let own: Vec<OrientedBox> = std::iter::once(self.path[0]).chain(witness.iter().map(area)).collect();
        let found = followers.iter().map(|track| follower::is_hit(&self.ctx, *track, &own, start));
        let found: Vec<Option<bool>> = found.collect();
        // One that is hit decides; without one, all must be known.
        let is_hit = found.contains(&Some(true));
        (is_hit || !found.contains(&None)).then_some(is_hit)
    }

    /// Whether a witness is out of every lane at a step after its start at which the path is in one; `None` on a map
    /// without lanes.
    fn leaves_lane(&self, witness: &Witness, start: usize) -> Option<bool> {
        let index = self.ctx.index();
        let size = &self.path[0];
        for (k, [x, y, heading]) in witness.iter().enumerate().skip(start) {
            let Some(path) = self.path.get(k + 1) else { break };
            let own = OrientedBox::new([*x, *y], *heading, 2.0 * size.half_length, 2.0 * size.half_width);
            if !is_in_one_lane(&own, index)? && is_in_one_lane(path, index)? {
                return Some(true);
            }
        }
        Some(false)
    }

    /// Speed at a step of the path, by backward difference, m/s.
    fn speed(&self, step: usize) -> f64 {
        let area = &self.path[step];
        if step == 0 {
            let ego = self.ctx.scene().ego();
            let before = (NOW > 0 && ego.is_valid(NOW - 1)).then(|| ego.point(NOW - 1));
            let velocity =
                before.map_or(ego.velocity[NOW], |before| sub(area.center, before).map(|x| x / DT));
            return dot(velocity, area.axis).max(0.0);
        }
        dot(sub(area.center, self.path[step - 1].center), area.axis).max(0.0) / DT
    }
}
