//! `sage merge` as a user runs it.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod program;

use std::{fs, path::Path};

use program::*;

/// A recipe of the experts in the binary, whose files lie in the project.
fn recipe(method: &str, weights: [f64; 2], parameters: &str) -> String {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../weights/procedural");
    let models = ["realistic", "adversarial"].iter().zip(weights).map(|(name, weight)| {
        let file = folder.join(format!("{name}.safetensors"));
        format!("  - model: {}\n    parameters: {{weight: {weight}}}\n", file.display())
    });
    let models: String = models.collect();
    format!("merge_method: {method}\nbase_model: procedural\nmodels:\n{models}parameters: {parameters}\n")
}

#[test]
fn a_merged_network_attacks_as_its_experts_do_at_that_mixture() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("recipe.yaml");
    let written = recipe("linear", [0.3, 0.7], "{}");
    fs::write(&file, &written).unwrap();
    let merged = folder.path().join("merged");
    stdout(&sage(&["merge", text(&file), "--out", text(&merged)]));
    assert_eq!(fs::read_to_string(merged.join("recipe.yaml")).unwrap(), written);
    let card = fs::read_to_string(merged.join("README.md")).unwrap();
    assert!(card.contains("| merger | `linear` |") && card.contains("| adversarial | 0.7 |"), "{card}");

    // The paper's selection does not ask for the likelihood under the prior, which differs.
    let scene = example();
    let attack = |more: &[&str], out: &str| {
        let out = folder.path().join(out);
        let own = ["generate", &scene, "--selection", "paper-selection", "--json", "--out", text(&out)];
        let row = rows(&sage(&[&own[..], more].concat())).remove(0);
        (row["trajectory"].clone(), row["candidates"].as_array().unwrap().len())
    };
    let by_merged = ["--weights", text(&merged), "--method", "prior", "--mu", "0.7"];
    let by_mixture = ["--weights", "procedural", "--mix", "realistic=0.3,adversarial=0.7"];
    assert_eq!(attack(&by_merged, "a"), attack(&by_mixture, "b"));
    let error =
        failure(&["generate", &scene, "--weights", text(&merged), "--out", text(&folder.path().join("c"))]);
    assert!(error.contains("realistic.safetensors"), "{error}");
}

#[test]
fn wrong_recipes_are_named_and_nothing_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let (file, out) = (folder.path().join("recipe.yaml"), folder.path().join("out"));
    let error = |recipe: &str| {
        fs::write(&file, recipe).unwrap();
        let error = failure(&["merge", text(&file), "--out", text(&out)]);
        assert!(!out.exists(), "{error}");
        error
    };
    let linear = recipe("linear", [0.3, 0.7], "{}");
    for (recipe, named) in [
        (recipe("linear", [0.3, 0.9], "{}"), "that sum to 1"),
        (recipe("linear", [0.3, 0.7], "{phi: 1}"), "unknown field `phi`"),
        (recipe("logit", [0.3, 0.7], "{}"), "`logit` mixes outputs"),
        (recipe("passthrough", [0.3, 0.7], "{}"), "unknown merger `passthrough`"),
        (linear.replace("adversarial.safetensors", "missing.safetensors"), "missing.safetensors"),
        (linear.replace("adversarial.safetensors", "prior.safetensors"), "does not say which expert it is"),
        (linear.replace("adversarial.safetensors", "realistic.safetensors"), "two experts `realistic`"),
        (linear.replace("base_model: procedural", "base_model: nothing"), "no weights `nothing`"),
        (format!("{linear}slices: []\n"), "`slices` is not supported"),
        (format!("{linear}colour: red\n"), "unknown field `colour`"),
    ] {
        let found = error(&recipe);
        assert!(found.contains(named), "{named}: {found}");
    }
}

#[test]
fn mergers_are_compared_over_lambda() {
    let folder = tempfile::tempdir().unwrap();
    let (scenes, out) = (folder.path().join("scenes"), folder.path().join("out"));
    stdout(&sage(&["scenes", "--count", "3", "--seed", "4", "--out", text(&scenes)]));
    let mergers = "linear,vector-extrapolation,trajectory";
    let table = sage(&["bench", "pareto", text(&scenes), "--mergers", mergers, "--out", text(&out)]);
    let table = stdout(&table);
    // Between the experts, vector extrapolation is interpolation.
    assert!(
        table.contains("| vector-extrapolation | 3 |") && table.contains("| 0.000 [0.000, 0.000] |"),
        "{table}"
    );
    let csv = fs::read_to_string(out.join("pareto.csv")).unwrap();
    // 21 values of λ for three mergers with selection, and for two without.
    assert_eq!(csv.lines().count(), 1 + 21 * 5);
    for chart in
        ["pareto.svg", "pareto-without-selection.svg", "control.svg", "control-without-selection.svg"]
    {
        assert!(fs::read_to_string(out.join(chart)).unwrap().contains("linear"), "{chart}");
    }
}
