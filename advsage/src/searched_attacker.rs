//! An attacker whose plans a search found: those that a driver fails at.

use std::sync::{Arc, Mutex, PoisonError};

use sage_core::generator::OperatingPoint;
use sage_sim::{
    Error, SimScene, attack_test::AttackTest, attacker::Attacker, batch::Recent, drive::Drive,
    policy::EgoPolicy, reference::Reference, search::SearchOptions, traffic::Plan,
};

use crate::{Result, error::in_one_line, named_search::NamedSearch, prepared::DriverInScene};

/// Scenes whose plans are kept.
const SCENES: usize = 1024;

/// Attacks by the plans that a driver fails at. Each scene is searched when it is first attacked.
pub struct SearchedAttacker {
    search: NamedSearch,
    policy: Arc<dyn EgoPolicy>,
    references: Arc<Vec<Reference>>,
    options: SearchOptions,
    seed: u64,
    /// What was found, by identifier of the scene.
    found: Mutex<Recent<String, Found>>,
}

/// The plans of a scene, or why there is none.
type Found = Result<Arc<[Arc<Plan>]>, Error>;

impl SearchedAttacker {
    /// An attacker that has searched no scene yet. The references say whether a contact is preventable.
    pub fn new(
        search: NamedSearch,
        policy: Arc<dyn EgoPolicy>,
        references: Arc<Vec<Reference>>,
        options: SearchOptions,
        seed: u64,
    ) -> Self {
        Self { search, policy, references, options, seed, found: Mutex::new(Recent::new(SCENES)) }
    }

    /// The plans of a scene.
    ///
    /// *Errors*: the scene cannot be attacked or driven; the driver fails at no plan.
    fn plans(&self, scene: &SimScene) -> Found {
        let id = &scene.scene().id;
        let wrong = |problem: String| Error::Plan { scene: id.clone(), problem };
        let search = || -> Result<Vec<Arc<Plan>>> {
            let again = SimScene::new(scene.scene().clone(), scene.index().clone())?;
            let driver = DriverInScene::new(&again, |scene| {
                let test = AttackTest::new(&*self.policy, scene, self.seed)?;
                Ok::<_, Error>(test.with_references(&self.references))
            })?;
            let (pool, result) = self.search.search(&driver, &self.options, self.seed)?;
            let plans = result.failures.iter().map(|failure| {
                let plan = &pool.plans[result.driven[failure.drive].plan];
                Ok(Arc::new(Plan::of_adversary(scene.scene(), plan.candidate.trajectory())?))
            });
            plans.collect()
        };
        let plans = search().map_err(|error| wrong(format!("the search failed: {}", in_one_line(&error))))?;
        if plans.is_empty() {
            return Err(wrong("the search found no plan that the driver fails at".to_owned()));
        }
        Ok(plans.into())
    }
}

impl Attacker for SearchedAttacker {
    fn plan(
        &self,
        scene: &SimScene,
        _: Option<&Drive>,
        _: &OperatingPoint,
        seed: u64,
    ) -> Result<Arc<Plan>, Error> {
        let id = &scene.scene().id;
        let known = self.found.lock().unwrap_or_else(PoisonError::into_inner).get(id).cloned();
        let plans = known.unwrap_or_else(|| {
            let plans = self.plans(scene);
            self.found.lock().unwrap_or_else(PoisonError::into_inner).put(id.clone(), plans.clone());
            plans
        })?;
        Ok(plans[(seed % plans.len() as u64) as usize].clone())
    }

    fn draws(&self) -> bool {
        true
    }
}
