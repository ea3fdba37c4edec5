//! Outputs never take the place of inputs, whichever way the command line names them.

use std::path::{Path, PathBuf};

use insta::assert_snapshot;

use crate::{experts, has_failed, hostile, program::*, quick, recipe};

/// A folder with a scene, weights and a policy, and its content.
fn inputs() -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::copy(example(), at("crossing.pkl")).unwrap();
    std::fs::copy(Path::new(&example()).with_extension("json"), at("c.json")).unwrap();
    let weights = experts(folder.path());
    std::fs::create_dir(at("policies")).unwrap();
    let policy = Path::new(env!("CARGO_MANIFEST_DIR")).join("../weights/procedural/td3.safetensors");
    std::fs::copy(policy, at("policies/crossing-lambda1.00.safetensors")).unwrap();
    std::fs::write(at("recipe.yaml"), recipe::linear(text(&weights))).unwrap();
    let root = folder.path().to_owned();
    (folder, root)
}

#[test]
fn no_command_replaces_an_input() {
    let (_keep, root) = inputs();
    let at = |name: &str| root.join(name).display().to_string();
    let (scene, weights, policy) =
        (at("crossing.pkl"), at("experts"), at("policies/crossing-lambda1.00.safetensors"));
    let ego = format!("td3:{policy}");
    let in_json = format!(r#"td3{{"file": "{policy}"}}"#);
    let prior = at("experts/prior.safetensors");
    let before = hostile::snapshot(&root);
    let attacks: Vec<Vec<&str>> = vec![
        vec!["draw", &scene, "--out", &scene],
        vec!["draw", &scene, "--candidates", "C", "--out", "C"],
        vec!["predict", &scene, "--weights", &weights, "--out", &scene],
        vec!["predict", &scene, "--weights", &weights, "--out", &prior],
        vec!["calibrate", "--procedural", "3", "--weights", &weights, "--out", &prior],
        vec!["calibrate", &scene, "--weights", &prior, "--out", &prior],
        vec!["merge", "RECIPE", "--out", &weights],
        vec!["merge", "RECIPE", "--out", "ROOT"],
        vec!["generate", &scene, "--lambda", "1", "--ego", &ego, "--out", "POLICIES"],
        vec!["generate", &scene, "--lambda", "1", "--ego", &in_json, "--out", "POLICIES"],
        vec!["generate", &scene, "--lambda", "1", "--weights", &weights, "--out", &weights],
        vec!["simulate", &scene, "--ego", &ego, "--out", "ROOT"],
        vec!["finetune", &scene, "--prior", &weights, "--out", &weights],
        vec!["pretrain", &scene, "--from", &prior, "--out", &weights],
        vec!["bench", "front", &scene, "--method", "rule", "--weights", &weights, "--out", &weights],
        vec!["bench", "closed-loop", &scene, "--ego", &ego, "--out", "POLICIES"],
        vec!["bench", "drivers", &scene, "--ego", &ego, "--unattacked", "--out", "ROOT"],
    ];
    let [candidates, recipe, policies, all] =
        [at("c.json"), at("recipe.yaml"), at("policies"), root.display().to_string()];
    let mut refused = Vec::new();
    for attack in attacks {
        let place = |word: &&str| match *word {
            "C" => candidates.clone(),
            "RECIPE" => recipe.clone(),
            "POLICIES" => policies.clone(),
            "ROOT" => all.clone(),
            word => word.to_owned(),
        };
        let mut attack: Vec<String> = attack.iter().map(place).collect();
        attack.push("--force".to_owned());
        let (code, said) = quick(&attack.iter().map(String::as_str).collect::<Vec<_>>());
        let mut now = hostile::snapshot(&root);
        // A simulation may write beside its inputs, under other names.
        now.retain(|name, _| before.contains_key(name));
        assert!(now == before, "{attack:?}: an input changed: {said}");
        if attack[0] != "simulate" {
            assert!(has_failed(code), "{attack:?}: {said}");
            refused.push((attack.join(" "), said));
        }
    }
    assert_snapshot!("outputs_in_place_of_inputs", messages(refused));
}
