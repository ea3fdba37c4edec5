//! What the page says of one failure.

use anyhow::{Context as _, Result};
use sage_core::{
    geometry::{Aabb, OrientedBox, Point, distance},
    motion::NOW,
    scene::Track,
};
use sage_sim::{fault::FaultClass, search::Features};
use serde::Serialize;
use serde_json::Value;

use crate::commands::search::{
    failure_name,
    found::{FailureFile, FailureScene, without_folders},
};

/// Length of the paths that a thumbnail shows, and how far it looks around them, metres.
const SHOWN_PATH: f64 = 25.0;
const AROUND: f64 = 25.0;

/// A failure on the page.
#[derive(Serialize)]
pub(super) struct Entry {
    /// Number of its scene.
    scene: usize,
    page: String,
    pub(super) name: String,
    driver: String,
    pub(super) cluster: String,
    collision: &'static str,
    ego_does: &'static str,
    adversary_does: &'static str,
    road: &'static str,
    fault: FaultClass,
    at_fault: Option<bool>,
    pub(super) plan: String,
    pub(super) lambda: Option<f64>,
    time_to_react: Option<f64>,
    avoidable_r157: Option<bool>,
    contact_after: f64,
    impact: f64,
    reward: f64,
    ego: Car,
    adversary: Car,
}

/// A car up to the contact: its path in decimetres as differences, and its box.
#[derive(Serialize)]
struct Car {
    length: f64,
    width: f64,
    heading: f64,
    path: Vec<i64>,
}

impl Entry {
    /// Describes a failure. Also gives the area that its thumbnail shows, metres.
    ///
    /// *Errors*: the row is not as a search writes it.
    pub(super) fn new(
        scene: &FailureScene,
        number: usize,
        failure: &FailureFile,
        page: &str,
    ) -> Result<(Self, Aabb)> {
        let name = failure_name(number);
        let driven = scene.driven(failure).with_context(|| name.clone())?;
        let features = driven.features(failure).with_context(|| name.clone())?;
        let Features { collision, ego, adversary, road, .. } = features;
        let met = failure.contact.as_ref().with_context(|| format!("{name} has no `contact`"))?;
        let step = usize::try_from(met.step).unwrap_or_default();
        let [own, other] = driven.boxes_at(step).with_context(|| name.clone())?;
        let tracks = (scene.scene().ego(), scene.scene().adversary()?);
        let positions: Vec<Point> = failure.ego_path.iter().map(|[x, y, _]| [*x, *y]).collect();
        let paths = [path(tracks.0, &positions, step), path(tracks.1, failure.trajectory.points(), step)];
        let shown = paths.iter().flat_map(|path| path.iter().filter(|p| near_end(p, path)).copied());
        let area = Aabb::of(shown);
        let area = Aabb { min: area.min.map(|x| x - AROUND), max: area.max.map(|x| x + AROUND) };
        let [ego_path, adversary_path] = paths.map(|path| decimetres(&path));
        let method = failure.plan.get("method").and_then(Value::as_str).unwrap_or_default();
        let plan = method.split('{').next().unwrap_or_default().to_owned();
        let lambda = failure.plan.get("lambda").and_then(Value::as_f64).filter(|_| plan != "random");
        let entry = Self {
            scene: 0,
            page: format!("{page}#{name}"),
            name,
            driver: without_folders(&failure.ego),
            cluster: features.cluster(),
            collision: collision.name(),
            ego_does: ego.words(),
            adversary_does: adversary.words(),
            road: road.words(),
            fault: met.class,
            at_fault: met.class.is_at_fault(),
            plan,
            lambda,
            time_to_react: failure.time_to_react,
            avoidable_r157: failure.avoidable_r157,
            contact_after: met.step as f64 / 10.0,
            impact: met.impact_speed,
            reward: failure.reward,
            ego: car(&own, ego_path),
            adversary: car(&other, adversary_path),
        };
        Ok((entry, area))
    }

    /// The same of the scene with a number.
    pub(super) fn of_scene(self, scene: usize) -> Self {
        Self { scene, ..self }
    }

    /// What happened, in one line.
    pub(super) fn words(&self) -> String {
        let fault = match self.at_fault {
            Some(true) => "ego at fault",
            Some(false) => "ego not at fault",
            None => "fault unknown",
        };
        let react = self.time_to_react.map_or(String::new(), |time| {
            format!("; an evasive manoeuvre could begin as late as {time:.1} s before the contact")
        });
        format!(
            "{}; contact after {:.1} s at {:.1} m/s, {fault}; adversary {}{react}",
            self.cluster, self.contact_after, self.impact, self.adversary_does
        )
    }
}

/// The path of a car from *now* to the contact.
fn path(track: &Track, points: &[Point], step: usize) -> Vec<Point> {
    std::iter::once(track.point(NOW)).chain(points.iter().take(step).copied()).collect()
}

fn near_end(p: &Point, path: &[Point]) -> bool {
    path.last().is_some_and(|end| distance(*p, *end) < SHOWN_PATH)
}

fn car(area: &OrientedBox, path: Vec<i64>) -> Car {
    Car {
        length: 2.0 * area.half_length,
        width: 2.0 * area.half_width,
        heading: area.axis[1].atan2(area.axis[0]),
        path,
    }
}

/// Points in decimetres, each as the difference to the one before.
pub(super) fn decimetres(points: &[Point]) -> Vec<i64> {
    let mut before = [0, 0];
    let differences = |p: &Point| {
        let at = p.map(|x| (10.0 * x).round() as i64);
        let difference = [at[0] - before[0], at[1] - before[1]];
        before = at;
        difference
    };
    points.iter().flat_map(differences).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_are_differences_in_decimetres() {
        assert_eq!(decimetres(&[[10.0, -2.0], [10.52, -2.0], [10.5, -1.04]]), [100, -20, 5, 0, 0, 10]);
    }
}
