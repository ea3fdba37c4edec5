//! An adversary that follows its plan and, from a frame on, is driven by a policy that sees what is around it.

use std::sync::Arc;

use sage_core::{
    generator::{Reaction, ReactiveDriver},
    scene::Scene,
};

use crate::{
    Error,
    body::Body,
    observation::{Driving, LENGTH, ObservationKind, Seat, observe},
    route::{Localization, Route},
    traffic::Plan,
    vehicle::{Action, Motion},
    world::{Control, World},
};

/// The adversary of a plan that reacts.
#[derive(Clone)]
pub(crate) struct Reacting {
    reaction: Reaction,
    track: usize,
    /// The path of its plan.
    route: Arc<Route>,
    /// `None` until it takes over.
    state: Option<State>,
    /// Whether it brakes, as after a contact.
    brakes: bool,
}

/// The policy at the wheel.
struct State {
    driver: Box<dyn ReactiveDriver>,
    driving: Driving,
    action: Action,
    /// Its motion one step ago.
    before: Motion,
}

impl Clone for State {
    fn clone(&self) -> Self {
        Self { driver: self.driver.boxed_clone(), ..*self }
    }
}

impl Reacting {
    /// The adversary of a plan; `None` if it does not react.
    pub(crate) fn of(plan: &Plan, scene: &Scene) -> Option<Self> {
        let reaction = plan.reaction.clone()?;
        debug_assert_eq!(Some(plan.track), scene.adversary);
        let route = Arc::new(Route::of_track(&plan.motion, 0, false));
        Some(Self { reaction, track: plan.track, route, state: None, brakes: false })
    }

    /// From now on it brakes: a driver that has hit somebody stops, and no learned one knows what follows a contact.
    pub(crate) fn brake(&mut self) {
        self.brakes = true;
    }

    /// The control of the next step; `None` while it follows its plan.
    ///
    /// *Errors*: as [`World::drive_adversary`], and those of the policy.
    pub(crate) fn control(&mut self, world: &mut World) -> Result<Option<Control>, Error> {
        let frame = world.step_count();
        if frame < self.reaction.from {
            return Ok(None);
        }
        let how = Localization::Nearest;
        if self.state.is_none() && world.adversary_motion().is_none() {
            world.drive_adversary()?;
        }
        let Some((&motion, &body)) = world.adversary_motion() else { return Ok(None) };
        if self.brakes {
            return Ok(Some(Control::Drive(Action { steer: 0.0, throttle: -1.0 })));
        }
        let state = match &mut self.state {
            Some(state) => {
                state.driving.advance(state.action, &self.route, how, &motion);
                state
            }
            empty => {
                let driver = self.reaction.policy.start(&world.scene().scene().id, self.reaction.seed);
                let driving = Driving::start(ObservationKind::Corrected, &self.route, how, &motion);
                let was = world.bodies_before().iter().find(|body| body.track == self.track);
                let heading = was.map_or(motion.heading, |body| body.heading);
                let before = Motion { heading, ..motion };
                empty.insert(State { driver, driving, action: Action::default(), before })
            }
        };
        let mut others: Vec<Body> =
            world.bodies().iter().filter(|body| body.track != self.track).copied().collect();
        others.push(world.ego_body());
        let seat = Seat {
            world,
            motion: &motion,
            before: &state.before,
            route: &self.route,
            others: &others,
            ground: body.ground,
        };
        let mut observation = [0.0; LENGTH];
        observe(&seat, &state.driving, ObservationKind::Corrected, &mut observation);
        let [steer, throttle] = state.driver.action(frame, &observation)?;
        state.action = Action { steer, throttle }.limited();
        state.before = motion;
        Ok(Some(Control::Drive(state.action)))
    }
}
