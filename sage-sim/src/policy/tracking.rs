//! Tracking of the recording through the tyres: the logged path at the logged times, as far as a car can.

use std::sync::Arc;

use sage_core::{
    geometry::Point,
    motion::DT,
    registry::{Entry, NoOptions},
    scene::Track,
};

use super::{Driver, EgoPolicy, Knowledge, Start, View, steering};
use crate::{
    Error,
    route::{Coordinates, Localization, Route},
    vehicle::Action,
    world::Control,
};

/// Acceleration for each metre behind the log, 1/s², and for each m/s too slow, 1/s.
const GAINS: [f64; 2] = [2.0, 2.5];

/// The policy `tracking`.
#[derive(Clone, Copy, Debug, Default)]
pub struct Tracking;

impl Entry<dyn EgoPolicy> for Tracking {
    const NAME: &'static str = "tracking";
    const SUMMARY: &'static str = "the recording through the tyres: a controller follows its path and times";
    const SOURCE: &'static str = "this project";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn EgoPolicy>, String> {
        Ok(Box::new(Self))
    }
}

impl EgoPolicy for Tracking {
    fn knows(&self) -> Knowledge {
        Knowledge::OwnLog
    }

    fn start(&self, start: &Start) -> Result<Box<dyn Driver>, Error> {
        let log = start.own_log().ok_or_else(|| start.error("tracking needs its recording".to_owned()))?;
        Ok(Box::new(TrackingDriver(Arc::new(Reference::of(log)))))
    }
}

/// The log as distances along its path.
struct Reference {
    route: Route,
    /// Distance along the route and speed at each frame.
    progress: Vec<[f64; 2]>,
}

impl Reference {
    fn of(track: &Track) -> Self {
        let route = Route::of_track(track, 0, false);
        let mut last = 0.0;
        let along = (0..track.valid.len()).map(|frame| {
            if track.is_valid(frame) {
                last = route.locate(track.point(frame), Localization::Nearest).along;
            }
            last
        });
        let along: Vec<f64> = along.collect();
        // Recorded velocities need not agree with the positions, so speeds are central differences.
        let speed = |frame: usize| {
            let (before, after) = (frame.saturating_sub(1), (frame + 1).min(along.len() - 1));
            (along[after] - along[before]) / (DT * (after - before).max(1) as f64)
        };
        Self { progress: (0..along.len()).map(|frame| [along[frame], speed(frame)]).collect(), route }
    }
}

#[derive(Clone)]
struct TrackingDriver(Arc<Reference>);

impl Driver for TrackingDriver {
    fn control(&mut self, view: &View) -> Result<Control, Error> {
        let Reference { route, progress } = &*self.0;
        let motion = view.motion();
        let place = route.locate(motion.position, Localization::Nearest).along;
        let at = |frame: usize| progress[frame.min(progress.len() - 1)];
        let [now, next] = [at(view.step()), at(view.step() + 1)];
        let wanted = (next[1] - now[1]) / DT;
        let acceleration = wanted + GAINS[0] * (now[0] - place) + GAINS[1] * (now[1] - motion.speed());
        let target: Point =
            route.point(Coordinates { along: place + steering::look_ahead(motion.speed()), across: 0.0 });
        Ok(Control::Drive(Action {
            steer: steering::towards(view.car(), motion, target),
            throttle: view.car().throttle_for(acceleration),
        }))
    }

    fn boxed_clone(&self) -> Result<Box<dyn Driver>, Error> {
        Ok(Box::new(self.clone()))
    }
}
