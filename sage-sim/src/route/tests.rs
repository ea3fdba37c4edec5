//! Tests of routes.

use super::*;
use approx::assert_relative_eq;

fn corner() -> Route {
    // 20 m east, then 10 m north, in steps of half a metre.
    let east = (0..=40).map(|k| [0.5 * f64::from(k), 0.0]);
    let north = (1..=20).map(|k| [20.0, 0.5 * f64::from(k)]);
    Route::new(&east.chain(north).collect::<Vec<_>>())
}

#[test]
fn points_on_the_route_come_back() {
    let route = corner();
    assert_relative_eq!(route.length(), 30.0, epsilon = 0.6);
    for along in [-2.0, 0.3, 5.0, 18.9, 25.0, 40.0] {
        for across in [-0.4, 0.0, 0.3] {
            let c = Coordinates { along, across };
            assert!((0..50).all(|leg| route.point_near(c, leg) == route.point(c)));
            let back = route.locate(route.point(c), Localization::Nearest);
            assert_relative_eq!(back.along, along, epsilon = 1e-9);
            assert_relative_eq!(back.across, across, epsilon = 1e-9);
        }
    }
}

#[test]
fn right_is_positive_and_ends_continue_straight() {
    let route = corner();
    let c = route.locate([5.0, -2.0], Localization::Nearest);
    assert_relative_eq!(c.across, 2.0);
    assert_relative_eq!(route.locate([-3.0, 0.0], Localization::Nearest).along, -3.0);
    assert!(route.locate([20.0, 14.0], Localization::Nearest).along > route.length() + 3.9);
}

#[test]
fn the_nearest_point_is_that_of_all_legs() {
    let mut rng = sage_core::seed::Rng::new(0, "route", "test");
    for _ in 0..200 {
        let (mut p, mut heading) = ([rng.uniform(-1e5, 1e5), rng.uniform(-1e5, 1e5)], 0.0_f64);
        let corners: Vec<Point> = (0..1 + rng.below(80))
            .map(|_| {
                heading += rng.uniform(-0.8, 0.8);
                let step = rng.uniform(1.1, 9.0);
                p = [p[0] + step * heading.cos(), p[1] + step * heading.sin()];
                p
            })
            .collect();
        let route = Route::new(&corners);
        for _ in 0..50 {
            let corner = corners[rng.below(corners.len())];
            let away = [1.0, 20.0, 1000.0][rng.below(3)];
            let p = [corner[0] + rng.uniform(-away, away), corner[1] + rng.uniform(-away, away)];
            let legs = route.legs.iter().enumerate().map(|(k, leg)| {
                let local = leg.leg_from_world(p);
                let first = if k == 0 { f64::NEG_INFINITY } else { 0.0 };
                let last = if k + 1 == route.legs.len() { f64::INFINITY } else { leg.length };
                let along = local.along.clamp(first, last);
                let away = (local.along - along).hypot(local.across);
                (away, Coordinates { along: leg.before + along, across: away.copysign(local.across) })
            });
            let first_least = legs.reduce(|a, b| if b.0 < a.0 { b } else { a }).unwrap();
            assert_eq!(route.locate(p, Localization::Nearest), first_least.1);
            let mut leg = rng.below(100);
            assert_eq!(route.locate_near(p, &mut leg), first_least.1);
        }
    }
}

#[test]
fn a_standing_log_gives_a_short_route() {
    let route = Route::new(&[[3.0, 4.0]; 5]);
    assert_relative_eq!(route.length(), 0.1, epsilon = 1e-12);
    assert_relative_eq!(route.heading(0.0), 0.0);
}
