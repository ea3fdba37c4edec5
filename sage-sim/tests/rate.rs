//! Rates against a brute-force enumeration of the same density.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod hand_made;

use std::sync::Arc;

use hand_made::{car, prepared, road, scene};
use sage_core::{
    generator::Proposal,
    motion::{DT, HORIZON, Trajectory},
    objective::{Context, ContextOptions, DrivableFeasibility, Feasibility as _},
    seed::Rng,
};
use sage_sim::{
    SimScene,
    attack_test::AttackTest,
    policy::policies,
    rate::{Driven, Event, Given, Nominal},
    search::{Requirement, SearchOptions},
};

/// An ego, and an adversary beside and before it.
fn beside() -> Arc<SimScene> {
    prepared(scene(road(), vec![car("ego", [0.0, 0.0], 0.0, 10.0), car("other", [12.0, 3.5], 0.0, 9.0)]))
}

/// Constant accelerations and drifts to a side, with log-probabilities that do not sum to 1.
fn plans(simulated: &SimScene) -> Vec<Proposal> {
    let now = simulated.scene().adversary().unwrap().point(sage_core::motion::NOW);
    let mut rng = Rng::new(7, "plans", "test");
    let mut all = Vec::new();
    for acceleration in -4..=3 {
        for drift in -12..=12 {
            let (acceleration, drift) = (f64::from(acceleration), 0.4 * f64::from(drift));
            let at = |step: usize| {
                let t = step as f64 * DT;
                let stops = if acceleration < 0.0 { t.min(-9.0 / acceleration) } else { t };
                let share = (t / 4.0).min(1.0);
                let along = 9.0 * stops + 0.5 * acceleration * stops * stops;
                [now[0] + along, now[1] + drift * share * share * (3.0 - 2.0 * share)]
            };
            let trajectory = Trajectory::new("plan", (1..=HORIZON).map(at).collect()).unwrap();
            all.push(Proposal { log_prob: Some(3.0 * rng.normal()), ..Proposal::of(trajectory) });
        }
    }
    all
}

/// The density with all its drives.
fn driven(driver: &str, temperature: f64) -> (Nominal, Vec<Driven>, Context) {
    let simulated = beside();
    let policy = policies().unwrap().build_default(driver).unwrap();
    let test = AttackTest::new(&*policy, &simulated, 0).unwrap();
    let recorded = Context::new(simulated.scene(), simulated.index(), &ContextOptions::default()).unwrap();
    let at = |plan: Proposal| {
        (Proposal { log_prob: plan.log_prob.map(|log_prob| log_prob / temperature), ..plan }, 0.0)
    };
    let tempered = plans(&simulated).into_iter().map(at).collect();
    let nominal = Nominal::new(&recorded, &DrivableFeasibility::default(), tempered);
    let options = SearchOptions { budget: usize::MAX, ..SearchOptions::default() };
    let ctx = test.context().unwrap();
    let inclusions = nominal.inclusions(&ctx, Given::default(), options.budget);
    let driven =
        nominal.drive(&test, &ctx, &DrivableFeasibility::default(), &options, &inclusions, 0).unwrap();
    (nominal, driven, ctx)
}

fn contact(driven: &Driven) -> bool {
    Event::Contact.happens(&driven.evaluated, Requirement::default())
}

#[test]
fn all_plans_give_the_sum_that_an_enumeration_gives() {
    let simulated = beside();
    let policy = policies().unwrap().build_default("idm").unwrap();
    let test = AttackTest::new(&*policy, &simulated, 0).unwrap();
    let recorded = Context::new(simulated.scene(), simulated.index(), &ContextOptions::default()).unwrap();
    let (nominal, driven, _) = driven("idm", 1.7);
    let all = plans(&simulated);
    assert_eq!(nominal.all, all.len());
    let weight = |plan: &Proposal| (plan.log_prob.unwrap() / 1.7).exp();
    let total: f64 = all.iter().map(weight).sum();
    let (mut feasible, mut hits, mut hit_mass, mut mass) = (0, 0, 0.0, 0.0);
    for plan in &all {
        let candidate = recorded.candidate(plan.trajectory.clone());
        if !DrivableFeasibility::default().is_feasible(&candidate, &recorded) {
            continue;
        }
        feasible += 1;
        mass += weight(plan) / total;
        if test.attack(&plan.trajectory, true).unwrap().meets_adversary() {
            hits += 1;
            hit_mass += weight(plan) / total;
        }
    }
    assert!(feasible > 50 && hits > 5 && hits < feasible, "{hits} of {feasible}");
    assert_eq!((nominal.plans.len(), driven.len()), (feasible, feasible));
    let rate = nominal.rate(&driven, Given::Feasible, |e| Event::Contact.happens(e, Requirement::default()));
    let rate = rate.unwrap();
    assert!((rate.rate - hit_mass / mass).abs() < 1e-12, "{rate:?} and {}", hit_mass / mass);
    // All driven: the estimate is the sum, to the bit.
    assert_eq!(rate.rate.to_bits(), rate.low.to_bits());
    assert!((rate.high - rate.low).abs() < 1e-12);
}

#[test]
fn samples_have_no_bias_and_their_bounds_hold_the_truth() {
    for driver in ["idm", "constant-speed", "expert"] {
        let (nominal, all, unattacked) = driven(driver, 1.0);
        for given in Given::ALL {
            let happens =
                |driven: &sage_sim::search::Evaluated| Event::Contact.happens(driven, Requirement::default());
            let truth = nominal.rate(&all, given, happens).unwrap().rate;
            for budget in [4, 16, 64] {
                let inclusions = nominal.inclusions(&unattacked, given, budget);
                let mut rng = Rng::new(3, driver, "starts");
                let starts = 1000;
                let (mut sum, mut squares) = (0.0, 0.0);
                for k in 0..starts {
                    let start = (f64::from(k) + rng.unit()) / f64::from(starts);
                    let chosen = nominal.sample(&inclusions, start);
                    assert!(chosen.len().abs_diff(budget) <= 1, "{} of {budget}", chosen.len());
                    let some: Vec<Driven> = chosen
                        .into_iter()
                        .map(|plan| Driven { inclusion: inclusions[plan], ..all[plan].clone() })
                        .collect();
                    let rate = nominal.rate(&some, given, happens).unwrap();
                    assert!(rate.low <= truth + 1e-12 && truth <= rate.high + 1e-12, "{rate:?} and {truth}");
                    sum += rate.rate;
                    squares += rate.rate * rate.rate;
                }
                let mean = sum / f64::from(starts);
                let variance = (squares / f64::from(starts) - mean * mean).max(0.0);
                let error = 3.0 * (variance / f64::from(starts)).sqrt();
                assert!((mean - truth).abs() <= error + 1e-9, "{driver} {budget}: {mean} and {truth}");
            }
        }
    }
}

#[test]
fn who_repeats_the_recording_has_rate_0_among_plans_clear_of_it() {
    let (nominal, all, _) = driven("replay", 1.0);
    let rate = |given| {
        let happens =
            |driven: &sage_sim::search::Evaluated| Event::Contact.happens(driven, Requirement::default());
        nominal.rate(&all, given, happens).unwrap()
    };
    let clear = rate(Given::ClearOfRecordedEgo);
    assert_eq!((clear.rate, clear.low, clear.high), (0.0, 0.0, 0.0));
    assert!(rate(Given::Feasible).rate > 0.01, "it is hit by others");
    assert!(all.iter().any(contact));
    assert!(nominal.mass(Given::ClearOfRecordedEgo) < nominal.mass(Given::Feasible));
}
