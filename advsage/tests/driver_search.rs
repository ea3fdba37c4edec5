//! Attacks in training that were searched with the driver in the loop.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

use std::{path::Path, sync::Arc};

use advsage::{
    Registries, driver_search::DriverSearch, generators::Generators, part::Part, search::rule,
    selection::Selection,
};
use sage_backbones::weights::Weights;
use sage_core::{generator::OperatingPoint, motion::Trajectory, scene::SceneIndex};
use sage_data::procedural::{Kind, generate};
use sage_merging::ExpertSet;
use sage_sim::{
    SimScene,
    attack_test::AttackTest,
    attacker::Attacker,
    policy::{EgoPolicy, policies},
};

fn scenes() -> Vec<Arc<SimScene>> {
    let kinds = [Kind::FourWay, Kind::Straight, Kind::Roundabout, Kind::Curve, Kind::Merge];
    let scenes = kinds.into_iter().flat_map(|kind| (1..=6).map(move |seed| (kind, seed)));
    let attackable = scenes.filter_map(|(kind, seed)| {
        let scene = Arc::new(generate(kind, seed, 0).unwrap());
        scene.attackable_horizon().ok()?;
        Some(SimScene::new(scene.clone(), SceneIndex::new(scene.map.clone())).unwrap())
    });
    attackable.collect()
}

fn searching(drives: usize) -> DriverSearch {
    let registries = Registries::shipped().unwrap();
    let selection = Selection::of(&registries, "natural", None).unwrap();
    let (experts, _) = ExpertSet::load(
        &Weights::at(Path::new(env!("CARGO_MANIFEST_DIR")).join("../weights/procedural").as_path()),
        &registries.backbones,
    )
    .unwrap();
    let generators = Generators::new(&registries, &Part::named("linear"), &selection, 0).unwrap();
    let generator = generators.with_experts(&experts).build(&Part::named("sage"), &[]).unwrap();
    DriverSearch::new(generator, rule(&registries, None).unwrap(), drives)
}

fn searched(search: &DriverSearch, policy: &dyn EgoPolicy, scene: &Arc<SimScene>) -> Trajectory {
    search.searched(policy, scene, &OperatingPoint::at(1.0, 1.0), 0).unwrap().unwrap()
}

/// Whether the driver touches the adversary and is at fault.
fn fails(policy: &dyn EgoPolicy, scene: &Arc<SimScene>, plan: &Trajectory) -> bool {
    let verdict = AttackTest::new(policy, scene, 0).unwrap().attack(plan, true).unwrap().verdict;
    verdict.attack && verdict.at_fault
}

#[test]
fn more_drives_find_more_failures_and_never_fewer() {
    let policy = policies().unwrap().build_default("idm").unwrap();
    let searches = [1, 4, 16].map(searching);
    let mut failures = [0; 3];
    let scenes = scenes();
    assert!(scenes.len() >= 20, "{}", scenes.len());
    for scene in &scenes {
        for (search, count) in searches.iter().zip(&mut failures) {
            let plan = searched(search, &*policy, scene);
            assert_eq!(plan, searched(search, &*policy, scene), "the same search gives the same plan");
            *count += usize::from(fails(&*policy, scene, &plan));
        }
    }
    let [one, some, many] = failures;
    assert!(many >= some && some >= one && many > one && many >= 5, "{failures:?} of {}", scenes.len());
}
