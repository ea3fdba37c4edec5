//! Contacts of the physics: momentum and energy of free bodies, and speeds measured in MetaDrive.

use sage_core::{geometry::OrientedBox, seed::Rng};
use sage_sim::{
    body::BodyClass,
    physics::{Obstacle, Physics, Weight},
    vehicle::{Action, Motion, SUBSTEPS, Tyres, Vehicle, Wheels},
};

fn area(motion: &Motion, size: [f64; 2]) -> OrientedBox {
    OrientedBox::new(motion.position, motion.heading, size[0], size[1])
}

#[test]
fn free_bodies_conserve_momentum_and_gain_no_energy() {
    let mut rng = Rng::new(1, "contact", "momentum");
    let car = Vehicle::default();
    let (mass, size) = (1300.0, [4.87, 2.046]);
    let inertia = mass * (size[0] * size[0] + size[1] * size[1]) / 12.0;
    let mut contacts = 0;
    for _ in 0..2000 {
        let own = Motion {
            velocity: [rng.uniform(0.0, 15.0), 0.0],
            yaw_rate: rng.uniform(-0.5, 0.5),
            ..Motion::default()
        };
        let other = Motion {
            position: [rng.uniform(4.6, 6.0), rng.uniform(-1.8, 1.8)],
            heading: rng.uniform(-3.1, 3.1),
            velocity: [rng.uniform(-10.0, 5.0), rng.uniform(-5.0, 5.0)],
            yaw_rate: 0.0,
        };
        let (own_area, other_area) = (area(&own, car.size), area(&other, size));
        if own_area.intersects(&other_area) {
            continue;
        }
        let obstacle = Obstacle { area: other_area, motion: other, disc: None, weight: Weight::Free(mass) };
        let mut physics = Physics::new(&car, &own, &own_area, vec![obstacle]);
        let state = |physics: &Physics| {
            let (a, b) = (physics.car(), physics.obstacle(0));
            let momentum = [0, 1].map(|k| car.mass * a.velocity[k] + mass * b.velocity[k]);
            let moving = car.mass * a.speed().powi(2) + mass * b.speed().powi(2);
            let turning = car.inertia[0] * a.yaw_rate.powi(2) + inertia * b.yaw_rate.powi(2);
            (momentum, 0.5 * (moving + turning))
        };
        let (start, first) = state(&physics);
        let scale = car.mass * own.speed() + mass * other.speed();
        let mut energy = first;
        for _ in 0..40 {
            physics.step(|_| ());
            let (momentum, now) = state(&physics);
            for k in 0..2 {
                assert!((momentum[k] - start[k]).abs() <= 1e-4 * scale);
            }
            assert!(now <= energy * (1.0 + 1e-6), "{now} after {energy}");
            energy = now;
        }
        contacts += usize::from(energy < 0.999 * first);
    }
    assert!(contacts > 1000, "only {contacts} contacts");
}

/// Speed of the ego after the first step of a contact with a body that starts at rest or with `velocity`.
fn first_step(
    own: [f64; 2],
    class: Option<BodyClass>,
    offset: [f64; 2],
    heading: f64,
    velocity: [f64; 2],
) -> f64 {
    let car = Vehicle::default();
    let other = class.and_then(BodyClass::vehicle).unwrap_or_default();
    let own = Motion { velocity: own, ..Motion::default() };
    let motion = Motion { position: offset, heading, velocity, yaw_rate: 0.0 };
    let weight = match class.filter(|class| class.vehicle().is_none()) {
        Some(class) => Weight::Free(class.mass()),
        None => Weight::Car(Box::new(other)),
    };
    let size = class.map_or(car.size, BodyClass::size);
    let disc = (class == Some(BodyClass::Pedestrian)).then_some(0.35);
    let obstacle = Obstacle { area: area(&motion, size), motion, disc, weight };
    let mut physics = Physics::new(&car, &own, &area(&own, car.size), vec![obstacle]);
    let (wheels, mut tyres) = (Wheels::set(&car, Action::default(), own.speed()), Tyres::default());
    for _ in 0..SUBSTEPS {
        physics.step(|motion| tyres.apply(&car, &wheels, motion));
    }
    physics.car().speed()
}

/// Speeds measured in MetaDrive after the first step, within 1 m/s.
#[test]
fn first_steps_of_contacts_are_as_in_metadrive() {
    let front = |class: Option<BodyClass>| {
        let length = class.map_or(4.515, |class| class.size()[0]);
        [0.5 * (4.515 + length) + 0.01, 0.0]
    };
    let close = |found: f64, measured: f64| {
        assert!((found - measured).abs() <= 1.0, "{found} m/s, measured {measured} m/s");
    };
    let medium = Some(BodyClass::Medium);
    close(first_step([10.0, 0.0], None, front(None), 0.0, [0.0; 2]), 4.0);
    close(first_step([10.0, 0.0], medium, front(medium), 0.0, [0.0; 2]), 4.5);
    // Half a metre of overlap across.
    let aside = [front(None)[0], 1.852 - 0.5];
    close(first_step([10.0, 0.0], None, aside, 0.0, [0.0; 2]), 4.6);
    // At rest, hit on the side at 10 m/s.
    let beside = [0.0, 0.5 * (1.852 + 4.515) + 0.01];
    close(first_step([0.0; 2], None, beside, -std::f64::consts::FRAC_PI_2, [0.0, -10.0]), 5.1);
    for class in [BodyClass::Pedestrian, BodyClass::Cyclist] {
        let ahead = [0.5 * (4.515 + class.size()[0]) + 0.01, 0.0];
        close(first_step([5.0, 0.0], Some(class), ahead, 0.0, [0.0; 2]), 4.7);
    }
}
