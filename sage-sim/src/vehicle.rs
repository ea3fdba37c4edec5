//! Response of the driven car: a planar ray-cast vehicle on four tyres.
//!
//! The model is that of Bullet's ray-cast vehicle, reduced to the plane. In each substep of 0.02 s each tyre
//! gives an impulse along its wheel (drive, brake or rolling resistance) and one across it, limited by the
//! friction of its load. Loads follow the accelerations of the substep before.
//!
//! Positions advance first, with the velocity at the start of the substep; the impulses follow.

use sage_core::geometry::{Point, dot};
use serde::{Deserialize, Serialize};

/// Duration of a substep, s.
pub const SUBSTEP: f64 = 0.02;
/// Substeps per step of 0.1 s, the interval of control and of the frames of a scene.
pub const SUBSTEPS: usize = 5;

/// Acceleration of gravity, m/s².
pub(crate) const GRAVITY: f64 = 9.81;
/// Share of the slip velocity across a wheel that its tyre removes in a substep.
const SIDE_STIFFNESS: f64 = 0.2;
/// Weight of longitudinal impulses in the friction limit: braking reaches almost twice the lateral limit.
const LONGITUDINAL_SHARE: f64 = 0.5;
/// Impulse of the rolling resistance of a wheel that is neither driven nor braked, N s per substep.
const ROLLING: f64 = 2.0;

/// Constants of a car. The default is the ego of MetaDrive 0.3.
///
/// ```
/// use sage_sim::vehicle::{Action, Vehicle};
///
/// let car = Vehicle::default();
/// // How much of the pedals an acceleration of 1 m/s² takes, and a deceleration of 4.
/// let [gas, brake] = [1.0, -4.0].map(|acceleration| car.throttle_for(acceleration));
/// assert!((gas * car.full_throttle() - 1.0).abs() < 1e-12 && (brake * car.full_brake() + 4.0).abs() < 1e-12);
/// // A car does not brake harder than fully, and no action is beyond ±1.
/// assert_eq!(car.throttle_for(-100.0), -1.0);
/// assert_eq!(Action { steer: 3.0, throttle: f64::NAN }.limited(), Action { steer: 1.0, throttle: 0.0 });
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Vehicle {
    /// Length and width of the model's body, metres. Contacts use the box of the world, not these.
    pub size: [f64; 2],
    /// Mass, kg.
    pub mass: f64,
    /// Moments of inertia around the vertical, lateral and longitudinal axes, kg m².
    pub inertia: [f64; 3],
    /// Distance from the centre to the front axle, metres.
    pub front: f64,
    /// Distance from the centre to the rear axle, metres.
    pub rear: f64,
    /// Distance of the wheels from the longitudinal axis, metres.
    pub half_track: f64,
    /// Height of the centre of mass above the ground, metres.
    pub center_of_mass: f64,
    /// Friction of the tyres.
    pub friction: f64,
    /// Share of the lateral load transfer that acts on the wheels.
    pub roll_influence: f64,
    /// Angle of the front wheels at full steering, rad.
    pub max_steering: f64,
    /// Drive force per wheel at full throttle, N.
    pub engine_force: f64,
    /// Brake impulse per wheel and substep at full brake, N s.
    pub brake_impulse: f64,
    /// Speed above which the engine gives no force, m/s.
    pub max_speed: f64,
}

impl Default for Vehicle {
    fn default() -> Self {
        Self {
            size: [4.515, 1.852],
            mass: 1100.0,
            inertia: [2183.05, 1998.45, 444.22],
            front: 1.05234,
            rear: 1.4166,
            half_track: 0.815,
            center_of_mass: 0.487,
            friction: 0.9,
            roll_influence: 0.5,
            max_steering: 40f64.to_radians(),
            engine_force: 800.0,
            brake_impulse: 130.0,
            max_speed: 80.0 / 3.6,
        }
    }
}

impl Vehicle {
    /// The default car with the strength of engine and brake that MetaDrive draws for each scene.
    ///
    /// `strength` in [0, 1]: drive force 750 + 100 · strength N, brake impulse 80 + 100 · strength N s.
    pub fn of_strength(strength: f64) -> Self {
        Self {
            engine_force: 750.0 + 100.0 * strength,
            brake_impulse: 80.0 + 100.0 * strength,
            ..Self::default()
        }
    }

    /// A car of another length, width and mass, with the default car's proportions.
    pub fn of_size(length: f64, width: f64, mass: f64, friction: f64) -> Self {
        let car = Self::default();
        let [along, across] = [length / car.size[0], width / car.size[1]];
        let yaw = mass * (length * length + width * width) / 12.0;
        let scale = mass / car.mass;
        Self {
            size: [length, width],
            mass,
            inertia: [yaw, car.inertia[1] * scale * along * along, car.inertia[2] * scale * across * across],
            front: car.front * along,
            rear: car.rear * along,
            half_track: car.half_track * across,
            friction,
            ..car
        }
    }

    /// Acceleration at full throttle, m/s².
    pub fn full_throttle(&self) -> f64 {
        4.0 * self.engine_force / self.mass
    }

    /// Deceleration at full brake while the tyres grip, m/s².
    pub fn full_brake(&self) -> f64 {
        4.0 * self.brake_impulse / (self.mass * SUBSTEP)
    }

    /// Deceleration without throttle or brake, m/s².
    pub fn rolling_resistance(&self) -> f64 {
        4.0 * ROLLING / (self.mass * SUBSTEP)
    }

    /// The action that gives an acceleration (m/s²) in straight driving, as throttle (> 0) or brake (< 0).
    pub fn throttle_for(&self, acceleration: f64) -> f64 {
        let rolling = self.rolling_resistance();
        if acceleration >= 0.0 {
            acceleration / self.full_throttle()
        } else if acceleration > -rolling {
            // Coasting already decelerates as much or more.
            0.0
        } else {
            acceleration / self.full_brake()
        }
        .clamp(-1.0, 1.0)
    }
}

/// Action of a driver: both in [−1, 1].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Action {
    /// Steering, positive to the left.
    pub steer: f64,
    /// Throttle, or brake if negative.
    pub throttle: f64,
}

impl Action {
    /// The action with both parts limited to [−1, 1]. NaN becomes 0.
    pub fn limited(self) -> Self {
        let limit = |x: f64| if x.is_nan() { 0.0 } else { x.clamp(-1.0, 1.0) };
        Self { steer: limit(self.steer), throttle: limit(self.throttle) }
    }
}

/// Motion of a car's centre.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Motion {
    /// Position, metres.
    pub position: Point,
    /// Heading, rad; driving does not wrap it.
    pub heading: f64,
    /// Velocity in the world frame, m/s.
    pub velocity: Point,
    /// Yaw rate, rad/s.
    pub yaw_rate: f64,
}

impl Motion {
    /// Whether all numbers are finite.
    pub fn is_finite(&self) -> bool {
        let [x, y] = self.position;
        let [vx, vy] = self.velocity;
        [x, y, self.heading, vx, vy, self.yaw_rate].iter().all(|v| v.is_finite())
    }

    /// Speed, m/s.
    pub fn speed(&self) -> f64 {
        dot(self.velocity, self.velocity).sqrt()
    }

    /// Velocity forward and to the left, m/s.
    pub fn body_velocity(&self) -> [f64; 2] {
        let (s, c) = self.heading.sin_cos();
        let [vx, vy] = self.velocity;
        [vx * c + vy * s, vy * c - vx * s]
    }

    /// The motion after `dt` seconds at constant velocity and yaw rate.
    pub fn coasted(&self, dt: f64) -> Self {
        let [x, y] = self.position;
        let [vx, vy] = self.velocity;
        Self { position: [x + vx * dt, y + vy * dt], heading: self.heading + self.yaw_rate * dt, ..*self }
    }
}

/// What an action sets on the wheels for a step.
#[derive(Clone, Copy, Debug)]
pub struct Wheels {
    /// Cosine and sine of the angle of the front wheels.
    direction: Point,
    /// Drive force per wheel, N.
    drive: f64,
    /// Brake impulse per wheel and substep, N s.
    brake: f64,
}

impl Wheels {
    /// Wheels under an action. `speed` (m/s) at the start of the step decides whether the engine is cut.
    pub fn set(car: &Vehicle, action: Action, speed: f64) -> Self {
        let (sin, cos) = (action.steer * car.max_steering).sin_cos();
        let throttle = action.throttle;
        let is_cut = speed > car.max_speed;
        Self {
            direction: [cos, sin],
            drive: if throttle > 0.0 && !is_cut { car.engine_force * throttle } else { 0.0 },
            brake: if throttle < 0.0 { -throttle * car.brake_impulse } else { ROLLING },
        }
    }
}

/// Tyres of a car: they carry the accelerations of the substep before, from which the loads follow.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tyres {
    /// Forward and leftward acceleration by the tyres, m/s².
    acceleration: [f64; 2],
}

impl Tyres {
    /// Applies the impulses of one substep to the velocities of `motion`.
    pub fn apply(&mut self, car: &Vehicle, wheels: &Wheels, motion: &mut Motion) {
        let (sin, cos) = motion.heading.sin_cos();
        let [vx, vy] = motion.velocity;
        let (forward, left) = (vx * cos + vy * sin, vy * cos - vx * sin);
        let wheelbase = car.front + car.rear;
        let height = car.center_of_mass;
        let [yaw, pitch, roll] = car.inertia;
        let [ax, ay] = self.acceleration;
        let pitching = car.mass * ax * height / (2.0 * wheelbase);
        let rolling = car.mass * ay * car.roll_influence * height / (2.0 * car.half_track);
        let (mut along, mut across, mut turning) = (0.0, 0.0, 0.0);
        for is_front in [true, false] {
            let a = if is_front { car.front } else { -car.rear };
            let share = if is_front { car.rear } else { car.front } / wheelbase;
            let standing = car.mass * GRAVITY * share / 2.0 + if is_front { -pitching } else { pitching };
            let f = if is_front { wheels.direction } else { [1.0, 0.0] };
            let l = [-f[1], f[0]];
            for side in [1.0, -1.0] {
                let b = side * car.half_track;
                let load = (standing - side * rolling * share).max(0.0);
                let slip = [forward - motion.yaw_rate * b, left + motion.yaw_rate * a];
                let lever = |d: Point| a * d[1] - b * d[0];
                let (lever_l, lever_f) = (lever(l), lever(f));
                let mut across_wheel = -SIDE_STIFFNESS * dot(slip, l)
                    / (1.0 / car.mass + lever_l * lever_l / yaw + height * height / roll);
                let mut along_wheel = if wheels.drive == 0.0 {
                    let stop = -dot(slip, f)
                        / (1.0 / car.mass + lever_f * lever_f / yaw + height * height / pitch)
                        / 4.0;
                    stop.clamp(-wheels.brake, wheels.brake)
                } else {
                    wheels.drive * SUBSTEP
                };
                let grip = load * SUBSTEP * car.friction;
                let weighted = LONGITUDINAL_SHARE * along_wheel;
                let impulse = (weighted * weighted + across_wheel * across_wheel).sqrt();
                if impulse > grip {
                    along_wheel *= grip / impulse;
                    across_wheel *= grip / impulse;
                }
                let j = [along_wheel * f[0] + across_wheel * l[0], along_wheel * f[1] + across_wheel * l[1]];
                along += j[0];
                across += j[1];
                turning += a * j[1] - b * j[0];
            }
        }
        let change = [along / car.mass, across / car.mass];
        self.acceleration = change.map(|dv| dv / SUBSTEP);
        motion.velocity[0] += change[0] * cos - change[1] * sin;
        motion.velocity[1] += change[0] * sin + change[1] * cos;
        motion.yaw_rate += turning / yaw;
    }
}
