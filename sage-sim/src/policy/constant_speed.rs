//! The logged route at the speed of frame 0: what a car does that nobody drives. A baseline for drivers.

use sage_core::{
    motion::{DT, Pose},
    registry::{Entry, NoOptions},
};

use super::{Driver, EgoPolicy, Start, View};
use crate::{
    Error,
    route::{Coordinates, Localization},
    world::Control,
};

/// The policy `constant-speed`.
#[derive(Clone, Copy, Debug, Default)]
pub struct ConstantSpeed {
    /// Speed, m/s, and distance along the route, once the drive has begun.
    state: Option<[f64; 2]>,
}

impl Entry<dyn EgoPolicy> for ConstantSpeed {
    const NAME: &'static str = "constant-speed";
    const SUMMARY: &'static str = "the logged route at the speed of frame 0; reacts to nothing";
    const SOURCE: &'static str = "this project";
    type Options = NoOptions;

    fn build(_: NoOptions) -> Result<Box<dyn EgoPolicy>, String> {
        Ok(Box::new(Self::default()))
    }
}

impl EgoPolicy for ConstantSpeed {
    fn start(&self, _: &Start) -> Result<Box<dyn Driver>, Error> {
        Ok(Box::new(Self::default()))
    }
}

impl Driver for ConstantSpeed {
    fn control(&mut self, view: &View) -> Result<Control, Error> {
        let (route, motion) = (view.route(), view.motion());
        let [speed, along] = self
            .state
            .unwrap_or_else(|| [motion.speed(), route.locate(motion.position, Localization::Nearest).along]);
        let along = along + speed * DT;
        self.state = Some([speed, along]);
        let [x, y] = route.point(Coordinates { along, across: 0.0 });
        let heading = route.heading(along);
        let velocity = [speed * heading.cos(), speed * heading.sin()];
        Ok(Control::Pose { pose: Pose::new(x, y, heading), velocity: Some(velocity) })
    }

    fn boxed_clone(&self) -> Result<Box<dyn Driver>, Error> {
        Ok(Box::new(*self))
    }
}
