//! `sage bench front` and `bench ablation` as a user runs them.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod program;

use program::*;

#[test]
fn fronts_group_the_weights_of_a_generator_and_compare_with_the_first() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, out) = (example(), folder.path().join("front"));
    let methods = r#"sage,king,king{"adversarial":0.5},king{"start":"prior"},rule"#;
    let front = ["bench", "front", &scene, "--methods", methods, "--lambda", "0,1", "--out", text(&out)];
    let output = sage(&[&front[..], &WEIGHTS].concat());
    let table = stdout(&output);
    for row in
        ["| sage | 2 | 1 |", "| king | 2 | 1 |", r#"| king{"start":"prior"} | 2 | 1 |"#, "| rule | 1 | 1 |"]
    {
        assert!(table.contains(row), "{row}: {table}");
    }
    assert!(table.contains("`sage` at equal P_real minus it"), "{table}");
    let points = std::fs::read_to_string(out.join("points.csv")).unwrap();
    assert_eq!(points.lines().count(), 8);
    for chart in ["attack-realism.svg", "attack-lane.svg", "attack-nll.svg", "reward-realism.svg"] {
        assert!(std::fs::read_to_string(out.join(chart)).unwrap().contains("rule"), "{chart}");
    }
    let other = folder.path().join("twice");
    let twice = ["bench", "front", &scene, "--methods", "rule,rule", "--out", text(&other)];
    assert!(failure(&[&twice[..], &WEIGHTS].concat()).contains("`rule` is given twice"));
}

#[test]
fn an_ablation_tunes_every_variant_and_resumes() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("ablation");
    let ablation = |threads: &str| {
        let size = ["--procedural", "3", "--roles", "0", "--epochs", "1"];
        let run = ["bench", "ablation", "--out", text(&out), "--threads", threads];
        stdout(&sage(&[&run[..], &size].concat())).to_owned()
    };
    let table = ablation("2");
    for variant in [
        "| HGPO | 3 |",
        "| without map constraint | 3 |",
        "| margin 2 | 3 |",
        "| one model, weights 7:3 | 3 |",
    ] {
        assert!(table.contains(variant), "{variant}: {table}");
    }
    assert!(out.join("experts/margin-2.safetensors").exists() && out.join("loss.svg").exists());
    let curves = std::fs::read_to_string(out.join("experts/finetune.csv")).unwrap();
    assert_eq!(curves.lines().count(), 12);
    assert_eq!(ablation("1"), table, "a finished tuning is not repeated, and the evaluation is the same");
}
