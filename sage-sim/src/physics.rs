//! Contacts between the driven car and the bodies near it, by rapier2d.
//!
//! The physics of a step holds only what can touch the car within the step, and is built anew each step, so most steps need no
//! solver. Its whole state is in the motions that go in and come out: a saved state continues with the same bits. Traffic is
//! kinematic, so nothing pushes it, or dynamic, as in MetaDrive.
//!
//! Only responses are rapier's: it reports contacts 2 cm early and a substep late. Facts are exact tests, by the geometry of
//! `sage-core`, of the boxes at the pose that the car would reach without the response.

use rapier2d_f64::{
    math::Vector,
    parry::mass_properties::MassProperties,
    pipeline::PhysicsWorld,
    prelude::{ColliderBuilder, RigidBodyBuilder, RigidBodyHandle},
};
use sage_core::geometry::{OrientedBox, wrap_angle};

use crate::{
    body::Body,
    vehicle::{Action, Motion, SUBSTEP, Tyres, Vehicle, Wheels},
};

/// Friction between bodies that touch.
const FRICTION: f64 = 0.5;
/// Passes of the solver that remove the velocity with which it separates overlapping bodies. With rapier's default of 1,
/// friction keeps part of that velocity and a substep can gain 2 % of kinetic energy; with eight none does (tested).
const STABILIZATIONS: usize = 8;

/// A body other than the car, as the physics needs it.
pub struct Obstacle {
    /// Its area at the start of the step.
    pub area: OrientedBox,
    /// Its motion at the start of the step; a kinematic body keeps the velocities.
    pub motion: Motion,
    /// Radius, if it is a disc.
    pub disc: Option<f64>,
    /// What contacts can change.
    pub weight: Weight,
}

/// How a body takes part in contacts.
pub enum Weight {
    /// Nothing pushes it.
    Kinematic,
    /// A free body of this mass, kg.
    Free(f64),
    /// A car that rolls on its tyres.
    Car(Box<Vehicle>),
}

struct Slot {
    handle: RigidBodyHandle,
    motion: Motion,
    tyres: Option<(Box<Vehicle>, Wheels, Tyres)>,
    is_dynamic: bool,
}

/// The physics of one step.
pub struct Physics {
    world: PhysicsWorld,
    slots: Vec<Slot>,
}

impl Physics {
    /// Physics of a car among obstacles. `area` is the car's box at the start of the step.
    pub fn new(car: &Vehicle, motion: &Motion, area: &OrientedBox, obstacles: Vec<Obstacle>) -> Self {
        let mut world = PhysicsWorld::new();
        world.gravity = Vector::ZERO;
        world.integration_parameters.dt = SUBSTEP;
        world.integration_parameters.num_internal_stabilization_iterations = STABILIZATIONS;
        let mut physics = Self { world, slots: Vec::with_capacity(1 + obstacles.len()) };
        physics.insert(motion, area, None, Some((car.mass, car.inertia[0])));
        for obstacle in obstacles {
            let Obstacle { area, motion, disc, weight } = obstacle;
            let [length, width] = [2.0 * area.half_length, 2.0 * area.half_width];
            let mass = match &weight {
                Weight::Kinematic => None,
                Weight::Free(mass) => Some((*mass, mass * (length * length + width * width) / 12.0)),
                Weight::Car(car) => Some((car.mass, car.inertia[0])),
            };
            let k = physics.insert(&motion, &area, disc, mass);
            if let Weight::Car(car) = weight {
                let wheels = Wheels::set(&car, Action::default(), motion.speed());
                physics.slots[k].tyres = Some((car, wheels, Tyres::default()));
            }
        }
        physics
    }

    fn insert(
        &mut self,
        motion: &Motion,
        area: &OrientedBox,
        disc: Option<f64>,
        mass: Option<(f64, f64)>,
    ) -> usize {
        let builder = match mass {
            Some((mass, inertia)) => RigidBodyBuilder::dynamic()
                .additional_mass_properties(MassProperties::new(Vector::ZERO, mass, inertia)),
            None => RigidBodyBuilder::kinematic_velocity_based(),
        };
        let [x, y] = motion.position;
        let [vx, vy] = motion.velocity;
        let body = builder
            .translation(Vector::new(x, y))
            .rotation(motion.heading)
            .linvel(Vector::new(vx, vy))
            .angvel(motion.yaw_rate)
            .can_sleep(false);
        let shape = match disc {
            Some(radius) => ColliderBuilder::ball(radius),
            None => ColliderBuilder::cuboid(area.half_length, area.half_width),
        };
        let (handle, _) = self.world.insert(body, shape.density(0.0).friction(FRICTION).restitution(0.0));
        self.slots.push(Slot { handle, motion: *motion, tyres: None, is_dynamic: mass.is_some() });
        self.slots.len() - 1
    }

    /// Advances one substep: positions first, then `impulses` on the car and the tyres of dynamic cars.
    pub fn step(&mut self, impulses: impl FnOnce(&mut Motion)) {
        self.world.step();
        let mut impulses = Some(impulses);
        for slot in &mut self.slots {
            let body = &self.world.bodies[slot.handle];
            let (p, v) = (body.translation(), body.linvel());
            let is_free = [v.x, v.y, body.angvel()]
                == [slot.motion.velocity[0], slot.motion.velocity[1], slot.motion.yaw_rate];
            slot.motion = if is_free {
                // Rapier's rotations drift by 1e-12 rad a step; a body that nothing touched does not.
                slot.motion.coasted(SUBSTEP)
            } else {
                // Rapier keeps angles in (−π, π].
                let turned = wrap_angle(body.rotation().angle() - slot.motion.heading);
                Motion {
                    position: [p.x, p.y],
                    heading: slot.motion.heading + turned,
                    velocity: [v.x, v.y],
                    yaw_rate: body.angvel(),
                }
            };
            if let Some(impulses) = impulses.take() {
                impulses(&mut slot.motion);
            } else if let Some((car, wheels, tyres)) = &mut slot.tyres {
                tyres.apply(car, wheels, &mut slot.motion);
            }
            if slot.is_dynamic {
                let [vx, vy] = slot.motion.velocity;
                let body = &mut self.world.bodies[slot.handle];
                body.set_linvel(Vector::new(vx, vy), true);
                body.set_angvel(slot.motion.yaw_rate, true);
            }
        }
    }

    /// The car's motion.
    pub fn car(&self) -> Motion {
        self.slots[0].motion
    }

    /// Motion of an obstacle, in the order given.
    pub fn obstacle(&self, k: usize) -> Motion {
        self.slots[k + 1].motion
    }
}

impl Obstacle {
    /// A body that moves at constant velocity and yaw rate, whatever touches it.
    pub fn kinematic(area: OrientedBox, motion: Motion, disc: Option<f64>) -> Self {
        Self { area, motion, disc, weight: Weight::Kinematic }
    }

    /// A body that contacts push: MetaDrive's traffic.
    pub fn dynamic(body: &Body) -> Self {
        let motion = Motion {
            position: body.area.center,
            heading: body.heading,
            velocity: body.velocity,
            yaw_rate: body.yaw_rate,
        };
        let car = body.class.and_then(|class| class.vehicle());
        let weight = match car {
            Some(car) => Weight::Car(Box::new(car)),
            None => Weight::Free(body.class.map_or(1000.0, |class| class.mass())),
        };
        Self { area: body.area, motion, disc: body.disc(), weight }
    }
}
