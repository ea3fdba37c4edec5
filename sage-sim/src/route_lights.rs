//! Traffic lights on a route: where a car has to stop.
//!
//! A light is on a route if the route uses the lane that the light controls. The lane's centre line is followed
//! in steps of a metre over the length of the route; the route uses it where it lies within 1.85 m and in the same
//! direction. Several lanes often begin at one stop point, to the left, straight on and to the right:
//! of these the one counts that the route uses most, and it must use half of it. The car has to stop at the
//! light's stop point, or at the start of the lane where none is recorded. Lights of lanes that are not in the
//! map, and of bike lanes, are left out.

use std::collections::HashMap;

use sage_core::{
    geometry::{Point, distance, dot, norm, sub},
    scene::{LightState, MapFeature, Scene},
};

use crate::route::{Localization, Route, resampled};

/// Largest distance of a lane that the route uses, metres.
const HALF_LANE: f64 = 1.85;
/// Largest distance of a stop point from the route, metres: half a lane, and what a car drives beside its middle.
const STOP_REACH: f64 = 2.5;
/// Cosine of the largest angle between route and lane (45°).
const ALONG: f64 = std::f64::consts::FRAC_1_SQRT_2;
/// Distance of the samples on a lane, metres, and the largest number of them: longer lanes are sampled more coarsely.
const SAMPLE: f64 = 1.0;
const MOST_SAMPLES: f64 = 1000.0;
/// Least share of a lane that the route must use.
const LEAST_SHARE: f64 = 0.5;
/// Stop points closer than this along the route are one place, metres.
const ONE_PLACE: f64 = 5.0;
/// Most lights of a route: a crowded junction has twenty.
const MOST: usize = 256;

/// A place on a route at which a light makes a car stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StopPlace {
    /// Index of the light in [`Scene::lights`].
    pub light: usize,
    /// Distance of the stop point along the route, metres.
    pub along: f64,
}

/// The lights on a route, in the order in which they are met.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RouteLights {
    stops: Vec<StopPlace>,
}

impl RouteLights {
    /// The lights of a scene that are on a route.
    pub fn new(scene: &Scene, route: &Route) -> Self {
        let mut shares: HashMap<&str, Option<f64>> = HashMap::new();
        let found = |(light, lane): (usize, &MapFeature)| {
            let points = scene.map.points_of(lane);
            let stop = scene.lights[light].stop_point.or_else(|| points.first().copied())?;
            let place = route.locate([stop[0], stop[1]], Localization::Nearest);
            if place.across.abs() > STOP_REACH {
                return None;
            }
            let lane = scene.lights[light].lane.as_str();
            let share = (*shares.entry(lane).or_insert_with(|| used_share(points, route)))?;
            (share >= LEAST_SHARE).then_some((share, StopPlace { light, along: place.along }))
        };
        // The first of an id.
        let by_id: HashMap<&str, &MapFeature> = match scene.lights.is_empty() {
            true => HashMap::new(),
            false => scene.map.features.iter().rev().map(|feature| (feature.id.as_str(), feature)).collect(),
        };
        let lane_of = |light: usize| {
            let id = &scene.lights[light].lane;
            let lane = *by_id.get(id.as_str())?;
            lane.kind.is_motor_lane().then_some((light, lane))
        };
        let mut all: Vec<(f64, StopPlace)> =
            (0..scene.lights.len()).filter_map(lane_of).filter_map(found).take(MOST).collect();
        all.sort_by(|(_, a), (_, b)| a.along.total_cmp(&b.along).then(a.light.cmp(&b.light)));
        let is_best = |(share, stop): &&(f64, StopPlace)| {
            let beats = |(other, at): &(f64, StopPlace)| {
                *other > *share && (at.along - stop.along).abs() <= ONE_PLACE
            };
            !all.iter().any(beats)
        };
        Self { stops: all.iter().filter(is_best).map(|(_, stop)| *stop).collect() }
    }

    /// Lights at these places, in the order of the route.
    #[cfg(test)]
    pub(crate) fn of(stops: Vec<StopPlace>) -> Self {
        Self { stops }
    }

    /// The stop places in the order of the route.
    pub fn stops(&self) -> &[StopPlace] {
        &self.stops
    }

    /// The lights of the scene that are not on the route (indices into [`Scene::lights`]).
    pub fn elsewhere(&self, scene: &Scene) -> impl Iterator<Item = usize> {
        (0..scene.lights.len()).filter(|light| self.stops.iter().all(|stop| stop.light != *light))
    }
}

/// Share of a lane that a route uses, of the part beside the route; `None` if no part is.
fn used_share(points: &[[f64; 3]], route: &Route) -> Option<f64> {
    let line: Vec<Point> = points.iter().map(|[x, y, _]| [*x, *y]).collect();
    if line.len() < 2 {
        return None;
    }
    let length: f64 = line.windows(2).map(|pair| distance(pair[0], pair[1])).sum();
    let samples = resampled(&line, SAMPLE.max(length / MOST_SAMPLES));
    let (mut used, mut all) = (0, 0);
    for pair in samples.windows(2) {
        let place = route.locate(pair[0], Localization::Nearest);
        if !(0.0..=route.length()).contains(&place.along) {
            continue;
        }
        all += 1;
        let (sin, cos) = route.heading(place.along).sin_cos();
        let d = sub(pair[1], pair[0]);
        let is_along = dot(d, [cos, sin]) >= ALONG * norm(d);
        used += usize::from(is_along && place.across.abs() <= HALF_LANE);
    }
    (all > 0).then(|| used as f64 / all as f64)
}

/// State of a light at a frame; unknown beyond its recording.
pub(crate) fn state(scene: &Scene, light: usize, frame: usize) -> LightState {
    scene.lights[light].states.get(frame).copied().unwrap_or(LightState::Unknown)
}

#[cfg(test)]
mod tests {
    use approx::assert_relative_eq;

    use super::*;

    #[test]
    fn a_lane_is_used_as_far_as_the_route_lies_on_it() {
        let route = Route::new(&[[0.0, 0.0], [50.0, 0.0], [100.0, 0.0]]);
        let share = |points: &[[f64; 2]]| {
            used_share(&points.iter().map(|[x, y]| [*x, *y, 0.0]).collect::<Vec<_>>(), &route)
        };
        assert_eq!(share(&[[10.0, 1.8], [40.0, 1.8]]), Some(1.0));
        assert_eq!(share(&[[10.0, 1.9], [40.0, 1.9]]), Some(0.0));
        // Against the route, across it, beyond its end, one point.
        assert_eq!(share(&[[40.0, 0.0], [10.0, 0.0]]), Some(0.0));
        assert_eq!(share(&[[20.0, -10.0], [20.0, 10.0]]), Some(0.0));
        assert_eq!(share(&[[110.0, 0.0], [140.0, 0.0]]), None);
        assert_eq!(share(&[[10.0, 0.0]]), None);
        // 20 m on the route, then 20 m away from it.
        let half = share(&[[10.0, 0.0], [30.0, 0.0], [30.0 + 14.0, 14.0]]).unwrap();
        assert_relative_eq!(half, 0.5, epsilon = 0.1);
    }
}
