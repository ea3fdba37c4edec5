//! What explains a failure: the mildest one, its shrunk form, and the road users that it needs.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod hand_made;

use std::sync::Arc;

use hand_made::{car, prepared, road, scene};
use sage_core::{
    generator::Proposal,
    motion::{HORIZON, Trajectory},
    objective::{Candidate, Context, Feasibility, Violation},
};
use sage_sim::{
    Error, SimScene,
    attack_test::AttackTest,
    policy::{Driver, EgoPolicy, Knowledge, Start, View, policies},
    search::{
        Clause, Explained, Explanation, Hooks, PlanDrives, Pool, Requirement, SearchOptions, SearchResult,
        search,
    },
    vehicle::Action,
    world::Control,
};

/// Every plan is feasible.
struct Anything;

impl Feasibility for Anything {
    fn violations(&self, _: &Candidate, _: &Context) -> Vec<Violation> {
        Vec::new()
    }
}

/// Drives at constant speed if all of these road users are in the scene, and else brakes.
#[derive(Clone)]
struct Needs(Vec<&'static str>);

struct NeedsDriver(Needs, Box<dyn Driver>);

impl EgoPolicy for Needs {
    fn start(&self, start: &Start) -> Result<Box<dyn Driver>, Error> {
        let inner = policies().unwrap().build_default("constant-speed").unwrap().start(start)?;
        Ok(Box::new(NeedsDriver(self.clone(), inner)))
    }

    fn knows(&self) -> Knowledge {
        Knowledge::Everything
    }
}

impl Driver for NeedsDriver {
    fn control(&mut self, view: &View) -> Result<Control, Error> {
        let is_there = |id: &&str| view.recording().unwrap().tracks.iter().any(|track| track.id == **id);
        if self.0.0.iter().all(is_there) {
            return self.1.control(view);
        }
        Ok(Control::Drive(Action { steer: 0.0, throttle: -1.0 }))
    }

    fn boxed_clone(&self) -> Result<Box<dyn Driver>, Error> {
        Ok(Box::new(Self(self.0.clone(), self.1.boxed_clone()?)))
    }
}

/// The ego at 10 m/s along x, the adversary 30 m ahead and 6 m to the left at the same speed, and twelve others far aside.
fn crowded() -> Arc<SimScene> {
    let others = "abcdefghijkl".chars().enumerate();
    let others = others.map(|(k, id)| car(&id.to_string(), [6.0 * k as f64, -30.0], 0.0, 10.0));
    let cars = [car("ego", [0.0, 0.0], 0.0, 10.0), car("adversary", [30.0, 6.0], 0.0, 10.0)];
    prepared(scene(road(), cars.into_iter().chain(others).collect()))
}

/// A plan that moves over by `across` metres within 4 s, and brakes by `brakes` m/s² for 2 s.
fn moves_over(across: f64, brakes: f64) -> Proposal {
    let at = |step: usize| {
        let t = 0.1 * step as f64;
        let s = (t / 4.0).min(1.0);
        let lost = if t < 2.0 { 0.5 * brakes * t * t } else { brakes * (2.0 * t - 2.0) };
        [40.0 + 10.0 * t - lost, 6.0 - across * s * s * (3.0 - 2.0 * s)]
    };
    Proposal::of(Trajectory::new("moves-over", (1..=HORIZON).map(at).collect()).unwrap())
}

fn options(explain: Explained) -> SearchOptions {
    let require = Requirement::of(&[Clause::Attack]);
    SearchOptions { require, explain, refine: 0.0, ..SearchOptions::default() }
}

fn searched(policy: &dyn EgoPolicy, explain: Explained) -> (Pool, SearchResult) {
    let simulated = crowded();
    let test = AttackTest::new(policy, &simulated, 0).unwrap();
    let ctx = test.context().unwrap();
    let plans = vec![moves_over(6.0, 4.0), moves_over(6.0, 3.0), moves_over(5.5, 4.5)];
    let mut pool = Pool::new(&ctx, &Anything, vec![plans], 256);
    let result = search(&test, &ctx, &Anything, &mut pool, &options(explain), 0, Hooks::default()).unwrap();
    (pool, result)
}

fn explanation(needs: &[&'static str]) -> Explanation {
    let (_, result) = searched(&Needs(needs.to_vec()), Explained::Mildest);
    assert_eq!(result.failures.len(), 3);
    result.failures.into_iter().find_map(|failure| failure.explanation).unwrap()
}

#[test]
fn the_mildest_failure_is_the_one_that_is_driven_least_differently() {
    let (pool, result) = searched(&Needs(Vec::new()), Explained::None);
    let mildest = result.mildest(&pool).unwrap();
    let accelerations = result.failures.iter().map(|failure| failure.deviation.unwrap().acceleration);
    let least = accelerations.fold(f64::INFINITY, f64::min);
    assert_eq!(mildest.deviation.unwrap().acceleration, least);
    assert!((2.9..3.6).contains(&least), "3 m/s² along and a little across: {least}");
    assert!(result.failures.iter().all(|failure| failure.explanation.is_none()));
}

#[test]
fn one_or_all_failures_are_explained_and_nothing_else_changes() {
    let count = |explain| {
        let (_, mut result) = searched(&Needs(Vec::new()), explain);
        let explained = result.failures.iter().filter(|failure| failure.explanation.is_some()).count();
        result.failures.iter_mut().for_each(|failure| failure.explanation = None);
        (explained, result)
    };
    let [none, mildest, all] = [Explained::None, Explained::Mildest, Explained::All].map(count);
    assert_eq!([none.0, mildest.0, all.0], [0, 1, 3]);
    assert!(none.1 == mildest.1 && mildest.1 == all.1);
    let again = searched(&Needs(Vec::new()), Explained::All);
    assert_eq!(again.1, searched(&Needs(Vec::new()), Explained::All).1, "the same bits");
}

#[test]
fn a_shrunk_failure_is_one_and_a_little_less_of_it_is_none() {
    let policy = Needs(Vec::new());
    let simulated = crowded();
    let test = AttackTest::new(&policy, &simulated, 0).unwrap();
    let ctx = test.context().unwrap();
    let shrunk = explanation(&[]).shrunk.unwrap();
    assert!(shrunk.share < 1.0 && shrunk.less.is_some_and(|less| less < 0.04), "{shrunk:?}");
    let mut drives = PlanDrives::new(&test, &ctx, &Anything, &options(Explained::None)).unwrap();
    let mut is_failure = |trajectory: Trajectory| {
        let evaluated = drives.evaluate(0, &Proposal::of(trajectory)).unwrap().unwrap();
        (evaluated.clauses.attack, evaluated.contact)
    };
    assert_eq!(is_failure(shrunk.trajectory.clone()), (true, shrunk.contact));
    // The same share of the difference, and less of it by what the row says.
    let recorded = |step: usize| [40.0 + step as f64, 6.0];
    let share = (shrunk.share - shrunk.less.unwrap()) / shrunk.share;
    let points = shrunk.trajectory.points().iter().enumerate();
    let less = points.map(|(k, point)| {
        let from = recorded(k + 1);
        [0, 1].map(|axis| from[axis] + share * (point[axis] - from[axis]))
    });
    assert!(!is_failure(Trajectory::new("less", less.collect()).unwrap()).0);
}

#[test]
fn a_failure_needs_nobody_one_or_a_set_of_road_users() {
    let needed = |ids: &[&'static str]| {
        let explanation = explanation(ids);
        let mut found: Vec<String> =
            explanation.needed.road_users.iter().map(|user| user.track.clone()).collect();
        found.sort();
        assert_eq!(explanation.needed.without.is_none(), ids.is_empty());
        (found, explanation.needed.is_minimal, explanation.drives)
    };
    let nobody = needed(&[]);
    assert_eq!((nobody.0.len(), nobody.1), (0, true));
    assert!(nobody.2 <= 8, "{} drives", nobody.2);
    for one in ["a", "f", "l"] {
        let (found, is_minimal, drives) = needed(&[one]);
        assert_eq!(found, [one]);
        assert!(is_minimal && drives <= 36, "{drives} drives");
    }
    let (found, is_minimal, _) = needed(&["b", "c"]);
    // The drives may end before the set is the least one, but those that are needed are in it.
    assert!(found.contains(&"b".to_owned()) && found.contains(&"c".to_owned()));
    assert_eq!(is_minimal, found.len() == 2);
}

#[test]
fn a_scene_among_some_road_users_has_them_and_both_roles() {
    let whole = crowded();
    let some = whole.scene().among(|track| [3, 7].contains(&track));
    let ids: Vec<&str> = some.tracks.iter().map(|track| &*track.id).collect();
    assert_eq!(ids, ["ego", "adversary", "b", "f"]);
    assert_eq!((some.ego().id.as_str(), some.adversary().unwrap().id.as_str()), ("ego", "adversary"));
    assert_eq!(&whole.scene().among(|_| true), &**whole.scene());
}

/// Failures of `idm` by simple attacks in procedural scenes.
#[test]
fn what_an_explanation_says_holds_when_it_is_driven_again() {
    use sage_data::procedural::{Kind, attacks, generate};
    let policy = policies().unwrap().build_default("idm").unwrap();
    let options = SearchOptions {
        require: Requirement::of(&[Clause::Attack]),
        explain: Explained::All,
        refine: 0.0,
        ..SearchOptions::default()
    };
    let (mut shrunk, mut alone, mut needed) = (0, 0, 0);
    for (seed, kind) in
        (0..24).zip([Kind::FourWay, Kind::Merge, Kind::Straight, Kind::TJunction].into_iter().cycle())
    {
        let Some(scene) = generate(kind, seed, 0) else { continue };
        let plans = attacks(&scene).into_iter().map(|(_, plan)| Proposal::of(plan)).collect();
        let simulated = prepared(scene);
        let test = AttackTest::new(&*policy, &simulated, 0).unwrap();
        let ctx = test.context().unwrap();
        let mut pool = Pool::new(&ctx, &Anything, vec![plans], 256);
        let result = search(&test, &ctx, &Anything, &mut pool, &options, 0, Hooks::default()).unwrap();
        for failure in &result.failures {
            let explanation = failure.explanation.as_ref().unwrap();
            let failing = &result.driven[failure.drive];
            let drives = |test: &AttackTest, plan: &Trajectory| {
                let ctx = test.context().unwrap();
                let mut drives = PlanDrives::new(test, &ctx, &Anything, &options).unwrap();
                drives.evaluate(0, &Proposal::of(plan.clone())).unwrap().unwrap()
            };
            if let Some(found) = &explanation.shrunk {
                let again = drives(&test, &found.trajectory);
                assert!(again.clauses.meet(options.require), "{kind:?} {seed}");
                assert_eq!((again.contact, again.clauses), (found.contact.clone(), found.clauses));
                shrunk += 1;
            }
            let plan = &pool.plans[failing.plan].proposal.trajectory;
            let tracks = &simulated.scene().tracks;
            let set: Vec<usize> = explanation
                .needed
                .road_users
                .iter()
                .map(|user| tracks.iter().position(|track| track.id == user.track).unwrap())
                .collect();
            let fails = |set: &[usize]| {
                let test = test.among(|track| set.contains(&track)).unwrap();
                drives(&test, plan).clauses.meet(options.require)
            };
            assert!(fails(&set), "{kind:?} {seed}: {:?}", explanation.needed);
            if explanation.needed.is_minimal {
                for out in &set {
                    let fewer: Vec<usize> = set.iter().copied().filter(|track| track != out).collect();
                    assert!(!fails(&fewer), "{kind:?} {seed}: {:?}", explanation.needed);
                }
            }
            if set.is_empty() { alone += 1 } else { needed += 1 }
        }
    }
    assert!(shrunk > 10 && alone > 5, "{shrunk} shrunk, {alone} alone, {needed} need others");
}
