//! Studies that compare generators and variants of tuning, as a user runs them.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod program;

use insta::assert_snapshot;
use program::*;

#[test]
fn fronts_group_the_weights_of_a_generator_and_compare_with_the_first() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, out) = (example(), folder.path().join("front"));
    let methods = r#"sage,king,king{"adversarial":0.5},king{"start":"prior"},rule"#;
    let front = ["bench", "front", &scene, "--method", methods, "--lambda", "0,1", "--out", text(&out)];
    let output = sage(&[&front[..], &WEIGHTS].concat());
    assert_snapshot!("fronts_of_generators", stdout(&output));
    let points = std::fs::read_to_string(out.join("estimates.csv")).unwrap();
    assert_eq!(points.lines().filter(|line| line.contains(",R_adv,")).count(), 7);
    for chart in ["attack-realism.svg", "attack-lane.svg", "attack-nll.svg", "reward-realism.svg"] {
        assert!(std::fs::read_to_string(out.join(chart)).unwrap().contains("rule"), "{chart}");
    }
    let other = folder.path().join("twice");
    let twice = ["bench", "front", &scene, "--method", "rule,rule", "--out", text(&other)];
    assert_snapshot!(failure(&[&twice[..], &WEIGHTS].concat()), @r"
    note: weights `procedural` (network densetnt)
    error: the row `rule` is given twice
    ");
}

#[test]
fn the_variants_of_the_ablation_are_tuned_and_compared_with_the_first() {
    let folder = tempfile::tempdir().unwrap();
    let [scenes, experts, out] = ["scenes", "experts", "ablation"].map(|name| folder.path().join(name));
    stdout(&sage(&["scenes", "--count", "3", "--seed", "1", "--out", text(&scenes)]));
    let config = folder.path().join("variants.json");
    let quick =
        r#"{"epochs": 1, "candidates": 16, "experts": {"hgpo": {}, "dpo": {"pairing": "best-worst"}}}"#;
    std::fs::write(&config, quick).unwrap();
    let finetune = ["finetune", "--procedural", "2", "--roles", "0", "--variants", text(&config)];
    stdout(&sage(&[&finetune[..], &["--out", text(&experts)]].concat()));
    assert!(std::fs::read_to_string(experts.join("loss.svg")).unwrap().contains("dpo"));
    let bench = ["bench", "ablation", text(&scenes), "--weights", text(&experts), "--out", text(&out)];
    let table = sage(&[&bench[..], &["--set", "mix=[{hgpo: 1}, {dpo: 1}]", "--wide"]].concat());
    let table = stdout(&table);
    assert!(table.contains("| sage hgpo=1.00 mu 1.00 | 3 |"), "{table}");
    assert!(table.contains("| sage dpo=1.00 mu 1.00 | sage hgpo=1.00 mu 1.00 |"), "{table}");
    // The shipped variants are known by name; they take long.
    assert_snapshot!(redacted(&failure(&["finetune", "--variants", "nothing", "--out", text(&out)])), @"error: --variants: expected a file or one of paper, ablation, paper-ablation, paper-parts, paper-reuse: cannot read `nothing`: No such file or directory (os error 2)");
}

#[test]
fn variants_of_several_seeds_are_compared_by_arm() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, out) = (example(), folder.path().join("experts"));
    let shipped = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../weights/procedural");
    let weights = format!("A={0},A={0},B=procedural", shipped.display());
    let bench = ["bench", "experts", &scene, "--weights", &weights, "--out", text(&out)];
    // The same weights: no difference.
    assert_snapshot!("arms_of_several_seeds", stdout(&sage(&[&bench[..], &["--wide"]].concat())));
}
