//! Search with the driver in the loop: pool, clauses, order, failures.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod hand_made;

use std::{
    ops::ControlFlow,
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
};

use hand_made::{car, prepared, road, scene};
use sage_core::{
    generator::Proposal,
    motion::{HORIZON, NOW, Trajectory},
    objective::{Candidate, Context, Feasibility, Violation},
};
use sage_sim::{
    Error, SimScene,
    attack_test::AttackTest,
    policy::{Driver, EgoPolicy, OtherWay, Start, View, policies},
    search::{
        AttackedPath, Clause, Evaluated, Hooks, Order, PlanDrives, Pool, Reason, Requirement, SearchOptions,
        SearchResult, search,
    },
    world::Control,
};

fn policy(name: &str) -> Box<dyn EgoPolicy> {
    policies().unwrap().build_default(name).unwrap()
}

/// Every plan is feasible.
struct Anything;

impl Feasibility for Anything {
    fn violations(&self, _: &Candidate, _: &Context) -> Vec<Violation> {
        Vec::new()
    }
}

/// Plans that end north of the road are not feasible.
struct South;

impl Feasibility for South {
    fn violations(&self, candidate: &Candidate, _: &Context) -> Vec<Violation> {
        let violation =
            Violation { rule: "north".into(), cost: 1.0, step: 1, place: [0.0; 2], with: String::new() };
        if candidate.points()[HORIZON - 1][1] > 0.0 { vec![violation] } else { Vec::new() }
    }
}

/// The ego at 10 m/s along x; the adversary 30 m ahead, 6 m to the left, at the same speed.
fn overtaken() -> Arc<SimScene> {
    prepared(scene(road(), vec![car("ego", [0.0, 0.0], 0.0, 10.0), car("adversary", [30.0, 6.0], 0.0, 10.0)]))
}

/// A plan that drives at a speed and, from a step on, drifts to the right at 2 m/s until it is `across` metres aside.
fn cut_in(speed: f64, from: usize, across: f64) -> Proposal {
    let at = |step: usize| {
        let t = 0.1 * step as f64;
        let drift = (0.2 * step.saturating_sub(from) as f64).min(across);
        [40.0 + speed * t, 6.0 - drift]
    };
    Proposal::of(Trajectory::new("cut-in", (1..=HORIZON).map(at).collect()).unwrap())
}

/// Plans of all speeds and times; only some of them meet the ego.
fn plans() -> Vec<Proposal> {
    let speeds = [2.0, 4.0, 6.0, 8.0, 10.0, 12.0];
    let mut all = Vec::new();
    for from in [0, 20, 40] {
        for across in [2.0, 6.0, 12.0] {
            all.extend(speeds.iter().map(|speed| cut_in(*speed, from, across)));
        }
    }
    all
}

fn searched(name: &str, options: &SearchOptions) -> (Pool, SearchResult) {
    searched_with(name, options, 0)
}

fn searched_with(name: &str, options: &SearchOptions, seed: u64) -> (Pool, SearchResult) {
    let (simulated, driver) = (overtaken(), policy(name));
    let test = AttackTest::new(&*driver, &simulated, 0).unwrap();
    let ctx = test.context().unwrap();
    let mut pool = Pool::new(&ctx, &Anything, vec![plans()], 256);
    let result = search(&test, &ctx, &Anything, &mut pool, options, seed, Hooks::default()).unwrap();
    (pool, result)
}

fn until(clause: Clause) -> Requirement {
    Requirement::of(&Clause::ALL.into_iter().take_while(|c| *c <= clause).collect::<Vec<_>>())
}

/// A driver that keeps its speed, and offers to brake fully instead.
struct KeepsOrBrakes(Box<dyn EgoPolicy>);

impl EgoPolicy for KeepsOrBrakes {
    fn start(&self, start: &Start) -> Result<Box<dyn Driver>, Error> {
        self.0.start(start)
    }

    fn other_ways(&self) -> Result<Vec<OtherWay>, Error> {
        let policy = policies()?.build("constant", &serde_json::json!({"throttle": -1}))?;
        Ok(vec![OtherWay { name: "braking".to_owned(), policy }])
    }
}

#[test]
fn a_failure_holds_if_it_is_one_in_every_variant_of_the_drive() {
    let options = SearchOptions { require: "attack,believable".parse().unwrap(), ..SearchOptions::default() };
    let holding =
        SearchOptions { require: "attack,believable,holds".parse().unwrap(), refine: 0.0, ..options };
    let (_, all) = searched("constant-speed", &SearchOptions { refine: 0.0, ..options });
    let (_, held) = searched("constant-speed", &holding);
    assert!(
        !all.failures.is_empty() && all.driven.len() == held.driven.len(),
        "variants are no drives of the budget"
    );
    for evaluated in held.driven.iter().filter(|evaluated| evaluated.clauses.believable == Some(true)) {
        let names: Vec<&str> = evaluated.variations.iter().map(|variation| &*variation.variant).collect();
        assert_eq!(names, ["0.1 m ahead", "0.1 m/s faster", "another seed"]);
        let holds = evaluated.variations.iter().all(|variation| variation.missing.is_none());
        assert_eq!(evaluated.clauses.holds, Some(holds));
    }
    assert!(!held.failures.is_empty());
    // Who brakes fully is elsewhere when the other car comes.
    let (simulated, driver) = (overtaken(), KeepsOrBrakes(policy("constant-speed")));
    let test = AttackTest::new(&driver, &simulated, 0).unwrap();
    let ctx = test.context().unwrap();
    let mut pool = Pool::new(&ctx, &Anything, vec![plans()], 256);
    let result = search(&test, &ctx, &Anything, &mut pool, &holding, 0, Hooks::default()).unwrap();
    assert!(result.failures.is_empty());
    assert_eq!(result.reason, Some(Reason::NotInEveryVariant));
    let failed = result.driven.iter().find(|evaluated| !evaluated.variations.is_empty()).unwrap();
    assert_eq!(failed.variations[0].variant, "followed by `braking`");
    assert!(failed.variations[0].missing.is_some());
}

#[test]
fn a_pool_takes_from_all_sources_in_turn_and_merges_what_is_alike() {
    let (simulated, driver) = (overtaken(), policy("replay"));
    let ctx = AttackTest::new(&*driver, &simulated, 0).unwrap().context().unwrap();
    let nearly = |proposal: &Proposal, by: f64| {
        let points = proposal.trajectory.points().iter().map(|[x, y]| [x + by, *y]).collect();
        Proposal::of(Trajectory::new("moved", points).unwrap())
    };
    let [a, b, c] = [cut_in(2.0, 0, 12.0), cut_in(4.0, 0, 12.0), cut_in(6.0, 0, 2.0)];
    let sources = vec![vec![a.clone(), nearly(&b, 0.09), c], vec![b.clone(), nearly(&a, 0.2)]];
    let pool = Pool::new(&ctx, &South, sources.clone(), 256);
    let sources_of: Vec<usize> = pool.plans.iter().map(|plan| plan.source).collect();
    // a, then b of the second source; the near copy of b is merged; c ends north; a moved by 0.2 m is another plan.
    assert_eq!(sources_of, [0, 1, 1]);
    let counts = pool.counts;
    assert_eq!((counts.proposed, counts.merged, counts.infeasible, counts.beyond), (5, 1, 1, 0));
    let full = Pool::new(&ctx, &South, sources, 1);
    assert_eq!((full.plans.len(), full.counts.beyond), (1, 4));
}

#[test]
fn every_order_drives_against_every_plan_once_and_finds_the_same() {
    let all = |order| SearchOptions { order, budget: 1000, refine: 0.0, ..SearchOptions::default() };
    for name in ["replay", "idm", "expert"] {
        let mut found = Vec::new();
        for order in [Order::Surrogate, Order::Random, Order::Pool] {
            let (pool, result) = searched(name, &all(order));
            let mut driven = result.driven.clone();
            driven.sort_by_key(|evaluated| evaluated.plan);
            assert!(
                driven.iter().map(|evaluated| evaluated.plan).eq(0..pool.plans.len()),
                "{name}, {order:?}"
            );
            assert_eq!(result.left, 0);
            found.push(driven);
        }
        assert!(found.windows(2).all(|pair| pair[0] == pair[1]), "{name}");
    }
    let order_of = |order| -> Vec<usize> {
        searched("idm", &all(order)).1.driven.iter().map(|evaluated| evaluated.plan).collect()
    };
    assert_eq!(order_of(Order::Random), order_of(Order::Random));
    assert_ne!(order_of(Order::Random), order_of(Order::Pool));
}

#[test]
fn against_a_driver_that_does_not_react_the_surrogate_is_right_at_once() {
    let options = SearchOptions { require: until(Clause::Attack), first: true, ..SearchOptions::default() };
    for name in ["replay", "constant-speed"] {
        let (_, result) = searched(name, &options);
        assert_eq!(result.driven.len(), 1, "{name}: {:?}", result.driven);
        assert_eq!(result.failures.len(), 1);
        assert_eq!(result.reason, None);
    }
}

#[test]
fn a_reacting_driver_is_found_sooner_than_at_random() {
    let drives = |order, seed| {
        let options =
            SearchOptions { require: until(Clause::Attack), first: true, order, ..SearchOptions::default() };
        let (_, result) = searched_with("idm", &options, seed);
        assert_eq!(result.failures.len(), 1, "{order:?}");
        result.driven.len()
    };
    let at_random: usize = (0..20).map(|seed| drives(Order::Random, seed)).sum();
    assert!(20 * drives(Order::Surrogate, 0) < at_random, "{at_random} drives in 20 searches at random");
}

#[test]
fn budget_first_and_reasons_are_kept() {
    let (pool, result) = searched("idm", &SearchOptions { budget: 3, ..SearchOptions::default() });
    assert_eq!((result.driven.len(), result.left), (3, pool.plans.len() - 3));
    // No reference driver is asked, so nothing is preventable, and no plan meets all clauses.
    assert!(result.failures.is_empty());
    assert_eq!(result.reason, Some(Reason::Budget));
    let (_, whole) = searched("idm", &SearchOptions { budget: 1000, ..SearchOptions::default() });
    assert_eq!(whole.reason, whole.reached);
    assert!(matches!(whole.reason, Some(Reason::NotPreventable | Reason::NotAtFault)), "{:?}", whole.reason);
    let attacks =
        searched("idm", &SearchOptions { require: until(Clause::Attack), ..SearchOptions::default() }).1;
    assert_eq!(attacks.failures.len(), attacks.count(Clause::Attack));
    assert!(attacks.count(Clause::Believable) <= attacks.count(Clause::Attack));
}

#[test]
fn who_watches_a_search_sees_every_drive_and_may_end_it() {
    let (simulated, driver) = (overtaken(), policy("idm"));
    let test = AttackTest::new(&*driver, &simulated, 0).unwrap();
    let ctx = test.context().unwrap();
    let options = SearchOptions { budget: 12, refine: 0.0, ..SearchOptions::default() };
    let watched = |stop: usize| {
        let mut seen = Vec::new();
        let watch = |_: &Pool, result: &SearchResult| {
            seen.push((result.driven.len(), result.failures.len()));
            if result.driven.len() == stop { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
        };
        let hooks = Hooks { watch: Some(Box::new(watch)), ..Hooks::default() };
        let mut pool = Pool::new(&ctx, &Anything, vec![plans()], 256);
        let result = search(&test, &ctx, &Anything, &mut pool, &options, 0, hooks).unwrap();
        (seen, result)
    };
    let (seen, whole) = watched(usize::MAX);
    assert_eq!(whole, searched("idm", &options).1, "watching changes nothing");
    assert_eq!(seen.iter().map(|(drives, _)| *drives).collect::<Vec<_>>(), (1..=12).collect::<Vec<_>>());
    assert_eq!(seen.last().unwrap().1, whole.failures.len());
    let (seen, ended) = watched(5);
    assert_eq!((seen.len(), &ended.driven[..]), (5, &whole.driven[..5]));
    assert!(!ended.failures.is_empty() || ended.reason == Some(Reason::Budget));
}

#[test]
fn without_a_plan_or_a_meeting_the_reason_says_so() {
    let (simulated, driver) = (overtaken(), policy("idm"));
    let test = AttackTest::new(&*driver, &simulated, 0).unwrap();
    let ctx = test.context().unwrap();
    let reason = |plans: Vec<Proposal>| {
        let mut pool = Pool::new(&ctx, &South, vec![plans], 256);
        search(&test, &ctx, &South, &mut pool, &SearchOptions::default(), 0, Hooks::default()).unwrap().reason
    };
    assert_eq!(reason(Vec::new()), Some(Reason::NoFeasiblePlan));
    assert_eq!(reason(vec![cut_in(10.0, 0, 2.0)]), Some(Reason::NoFeasiblePlan));
    assert_eq!(reason(vec![cut_in(12.0, 40, 12.0)]), Some(Reason::NeverHit));
}

#[test]
fn the_attacked_path_goes_on_at_constant_velocity_after_the_contact() {
    let (simulated, plan) = (overtaken(), cut_in(2.0, 0, 6.0));
    let path = |name: &str| {
        let driver = policy(name);
        let test = AttackTest::new(&*driver, &simulated, 0).unwrap();
        let outcome = test.attack(&plan.trajectory, true).unwrap();
        let step = outcome.episode.contacts[0].contact.step - NOW;
        (AttackedPath::of(&outcome.episode, test.unattacked()), step, test.unattacked().clone())
    };
    let (path_of, step, _) = path("constant-speed");
    assert_eq!(path_of.positions.len(), HORIZON);
    assert!(step > 0 && step < HORIZON);
    // 10 m/s along x throughout, although the contact pushed the car.
    for (k, [x, y]) in path_of.positions.iter().enumerate() {
        assert!((x - (10.0 + (k + 1) as f64)).abs() < 1e-6 && y.abs() < 1e-6, "step {}: {x} {y}", k + 1);
        assert!(path_of.headings[k].abs() < 1e-9);
    }
    // A replayed ego follows its recording.
    let (replayed, _, unattacked) = path("replay");
    let recorded: Vec<[f64; 2]> =
        unattacked.motions[NOW + 1..].iter().map(|motion| motion.position).collect();
    assert_eq!(replayed.positions, recorded);
}

/// A policy that cannot be copied and fails in every second attacked drive.
struct Unreliable(AtomicUsize);

struct UnreliableDriver {
    inner: Box<dyn Driver>,
    fails: bool,
}

impl Driver for UnreliableDriver {
    fn control(&mut self, view: &View) -> Result<Control, Error> {
        if self.fails {
            return Err(Error::Policy { scene: "hand-made".to_owned(), problem: "no road ahead".to_owned() });
        }
        self.inner.control(view)
    }

    fn boxed_clone(&self) -> Result<Box<dyn Driver>, Error> {
        Err(Error::Clone { problem: "it holds a connection".to_owned() })
    }
}

impl EgoPolicy for Unreliable {
    fn start(&self, start: &Start) -> Result<Box<dyn Driver>, Error> {
        // The first drive is the unattacked one, the second tries to share what comes before now.
        let number = self.0.fetch_add(1, Ordering::Relaxed);
        let fails = number >= 2 && number.is_multiple_of(2);
        Ok(Box::new(UnreliableDriver { inner: policy("constant-speed").start(start)?, fails }))
    }
}

#[test]
fn an_error_of_the_driver_counts_as_a_drive_and_as_nothing_else() {
    let driver = Unreliable(AtomicUsize::new(0));
    let simulated = overtaken();
    let test = AttackTest::new(&driver, &simulated, 0).unwrap();
    let ctx = test.context().unwrap();
    let mut pool = Pool::new(&ctx, &Anything, vec![plans()], 256);
    let options =
        SearchOptions { require: until(Clause::Attack), order: Order::Pool, ..SearchOptions::default() };
    let result = search(&test, &ctx, &Anything, &mut pool, &options, 0, Hooks::default()).unwrap();
    assert_eq!(result.driven.len(), pool.plans.len());
    let failed = result.driven.iter().filter(|evaluated| evaluated.error.is_some());
    let count = failed.clone().count();
    assert_eq!(count, pool.plans.len().div_ceil(2));
    for evaluated in failed {
        assert_eq!((evaluated.contact.is_none(), evaluated.clauses.attack), (true, false));
        assert_eq!(evaluated.error.as_deref(), Some("scene `hand-made`: no road ahead"));
    }
    // The strongest drive is none that ended in an error.
    assert!(result.strongest().unwrap().error.is_none());
    let strength = |drive: &Evaluated| {
        (Clause::ALL.iter().filter(|clause| drive.clauses.reach(**clause)).count(), drive.reward)
    };
    let drives = result.driven.iter().filter(|drive| drive.error.is_none());
    let most = drives.map(strength).max_by(|a, b| a.partial_cmp(b).unwrap()).unwrap();
    assert_eq!(strength(result.strongest().unwrap()), most);
    let mut pool = Pool::new(&ctx, &Anything, vec![plans()[..1].to_vec()], 256);
    driver.0.store(1, Ordering::Relaxed);
    let result = search(&test, &ctx, &Anything, &mut pool, &options, 0, Hooks::default()).unwrap();
    assert_eq!((result.reason, result.strongest()), (Some(Reason::Error), None));
}

#[test]
fn plans_are_evaluated_one_by_one_and_equal_ones_once() {
    let (simulated, driver) = (overtaken(), policy("idm"));
    let test = AttackTest::new(&*driver, &simulated, 0).unwrap();
    let ctx = test.context().unwrap();
    let plans = [cut_in(2.0, 0, 12.0), cut_in(6.0, 0, 2.0), cut_in(2.0, 0, 12.0)];
    let mut drives = PlanDrives::new(&test, &ctx, &South, &SearchOptions::default()).unwrap();
    let mut evaluate = |(k, plan)| drives.evaluate(k, plan).unwrap();
    let evaluated: Vec<_> = plans.iter().enumerate().map(&mut evaluate).collect();
    assert!(evaluated[1].is_none(), "not feasible");
    assert_eq!(evaluated[0], evaluated[2]);
    let (_, whole) = searched("idm", &SearchOptions { budget: 1000, ..SearchOptions::default() });
    let same = evaluated[0].as_ref().unwrap();
    assert!(whole.driven.iter().any(|other| other.contact == same.contact && other.clauses == same.clauses));
}

#[test]
fn what_the_pool_does_not_hold_is_refined_from_what_came_nearest() {
    let scene = overtaken();
    let driver = policy("constant-speed");
    let test = AttackTest::new(&*driver, &scene, 0).unwrap();
    let ctx = test.context().unwrap();
    // They brake and move over, but not enough of both.
    let miss = |brakes: f64, across: f64| {
        let at = |step: usize| {
            let (t, s) = (0.1 * step as f64, step as f64 / HORIZON as f64);
            let lost = if t < 2.0 { 0.5 * brakes * t * t } else { brakes * (2.0 * t - 2.0) };
            [40.0 + 10.0 * t - lost, 6.0 - across * s * s * (3.0 - 2.0 * s)]
        };
        Proposal::of(Trajectory::new("miss", (1..=HORIZON).map(at).collect()).unwrap())
    };
    let misses = || vec![miss(1.5, 3.4), miss(1.0, 3.0), miss(1.5, 2.0)];
    let found = |refine: f64, order: Order| {
        let mut pool = Pool::new(&ctx, &Anything, vec![misses()], 256);
        let require = Requirement::of(&[Clause::Attack]);
        let options = SearchOptions { budget: 12, require, refine, order, ..SearchOptions::default() };
        let result = search(&test, &ctx, &Anything, &mut pool, &options, 0, Hooks::default()).unwrap();
        let refined: Vec<Option<usize>> =
            result.driven.iter().map(|driven| pool.plans[driven.plan].refined_from).collect();
        (result, refined, pool.plans.len())
    };
    let (plain, ..) = found(0.0, Order::Surrogate);
    assert_eq!((plain.failures.len(), plain.driven.len()), (0, 3));
    assert_eq!(found(0.75, Order::Random).0, found(0.0, Order::Random).0, "an order that does not learn");
    let (result, refined, plans) = found(0.75, Order::Surrogate);
    assert!(!result.failures.is_empty(), "{refined:?}");
    assert_eq!(refined[..3], [None; 3], "the pool comes first");
    let after = result.failures[0].drive + 1;
    assert!(refined[3..after].iter().all(Option::is_some));
    assert_eq!(plans, result.driven.len() + result.left);
    assert_eq!(found(0.75, Order::Surrogate).0, result, "the same again");
}
