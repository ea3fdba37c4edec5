//! Refined selections: never worse by the selection, within the limits of a car, and on only where they should be.
#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

use std::sync::Arc;

use sage_backbones::{backbones, weights::Weights};
use sage_core::{
    generator::{Attack, Generator, OperatingPoint},
    objective::{
        Context, ContextOptions, Objective, ObjectiveSpec, feasibilities, is_within_limits, rewards,
        turning::{TURN, tight_turn},
    },
    scene::SceneIndex,
};
use sage_data::procedural::{Kind, generate};
use sage_generators::{GeneratorInputs, generators, selector::best_of};
use sage_merging::{ExpertSet, mergers};
use serde_json::{Value, json};

fn objective(name: &str) -> Arc<Objective> {
    let spec = ObjectiveSpec::preset(name).unwrap();
    Arc::new(Objective::new(&spec, &rewards().unwrap(), &feasibilities().unwrap()).unwrap())
}

fn generator(name: &str, options: &Value, selection: &Arc<Objective>) -> Box<dyn Generator> {
    let weights = Weights::Carried { name: "procedural", files: &sage_weights::PROCEDURAL };
    let (experts, _) = ExpertSet::load(&weights, &backbones().unwrap()).unwrap();
    let inputs = GeneratorInputs {
        experts: Some(experts),
        merger: mergers().unwrap().build_default("linear").unwrap().into(),
        seed: 0,
        selection: selection.clone(),
    };
    generators().unwrap().build(name, options).unwrap().build(&inputs).unwrap()
}

fn contexts() -> impl Iterator<Item = Context> {
    let scenes = Kind::ALL.into_iter().filter_map(|kind| generate(kind, 5, 0));
    scenes.map(|scene| {
        let (index, scene) = (SceneIndex::new(scene.map.clone()), Arc::new(scene));
        Context::new(&scene, &index, &ContextOptions::default()).unwrap()
    })
}

const MUS: [f64; 4] = [0.0, 0.02, 0.5, 1.0];

fn attacks(generator: &dyn Generator, ctx: &Context) -> Vec<Attack> {
    generator.attacks(ctx, &MUS.map(|mu| OperatingPoint::at(mu, mu)), 3).unwrap()
}

#[test]
fn the_selection_prefers_a_refined_plan_which_a_car_can_drive() {
    let natural = objective("natural");
    let (refined, plain) =
        (generator("sage", &json!({}), &natural), generator("sage", &json!({"refine": []}), &natural));
    let (mut better, mut all) = (0, 0);
    for ctx in contexts() {
        for ((attack, before), mu) in attacks(&*refined, &ctx).iter().zip(&attacks(&*plain, &ctx)).zip(MUS) {
            all += 1;
            let count = before.candidates.len();
            assert_eq!(attack.candidates[..count], before.candidates);
            if attack.candidates.len() == count {
                assert_eq!(attack.chosen, before.chosen);
                continue;
            }
            assert!(mu > 0.0, "nothing is refined where no attack is asked for");
            better += 1;
            assert_eq!((attack.candidates.len(), attack.chosen), (count + 1, count));
            let last = &attack.candidates[count];
            assert!(last.nll.is_none() && last.log_prob.is_none() && last.goal.is_none());
            let candidates =
                [before.trajectory(), attack.trajectory()].map(|plan| ctx.candidate(plan.clone()));
            let evaluations = [0, 1].map(|k| natural.evaluate(&candidates[k], &ctx));
            assert_eq!(best_of(&evaluations, &natural, mu).chosen, 1, "{}", ctx.scene().id);
            assert!(evaluations[1].is_feasible());
            assert!(is_within_limits(candidates[1].profile()) && tight_turn(&candidates[1], TURN).is_none());
        }
    }
    assert!(2 * better > all, "{better} of {all} are refined");
}

#[test]
fn the_same_seed_gives_the_same_plan_and_points_do_not_depend_on_others() {
    let sage = generator("sage", &json!({}), &objective("natural"));
    let ctx = contexts().next().unwrap();
    let all = attacks(&*sage, &ctx);
    assert_eq!(attacks(&*sage, &ctx), all);
    let alone = sage.attacks(&ctx, &[OperatingPoint::at(0.5, 0.5)], 3).unwrap();
    assert_eq!(alone[0], all[2]);
    let other = sage.attacks(&ctx, &[OperatingPoint::at(0.5, 0.5)], 4).unwrap();
    assert_ne!(other[0].trajectory(), alone[0].trajectory());
}

#[test]
fn the_papers_selections_and_other_generators_are_refined_on_request_alone() {
    let ctx = contexts().next().unwrap();
    let count = |name: &str, options: Value, selection: &str| {
        let attacks = attacks(&*generator(name, &options, &objective(selection)), &ctx);
        attacks[3].candidates.len()
    };
    assert_eq!(count("sage", json!({}), "natural"), 49);
    assert_eq!(count("sage", json!({}), "paper-selection"), 48);
    assert_eq!(count("sage-published", json!({}), "natural"), 32);
    assert_eq!(count("sage-drawn", json!({}), "natural"), 4);
    let rounds = json!({"refine": [[4, 30]]});
    for name in ["random", "prior"] {
        assert_eq!(count(name, json!({}), "natural"), 48, "{name}");
        assert_eq!(count(name, rounds.clone(), "natural"), 49, "{name}");
    }
    let error = |refine: Value| {
        generators().unwrap().build("sage", &json!({ "refine": refine })).err().unwrap().to_string()
    };
    assert!(error(json!([[4, 0]])).contains("4 plans with 0 tries"));
    assert!(error(json!([[1000, 1000]])).contains("at most 50000"));
}
