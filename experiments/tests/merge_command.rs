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
        (recipe("slerp", [0.3, 0.9], "{}"), "that sum to 1"),
        (recipe("linear", [0.3, 0.7], "{phi: 1}"), "unknown field `phi`"),
        (recipe("logit", [0.3, 0.7], "{}"), "`logit` mixes outputs"),
        (recipe("passthrough", [0.3, 0.7], "{}"), "unknown merger `passthrough`"),
        (linear.replace("adversarial.safetensors", "missing.safetensors"), "missing.safetensors"),
        (linear.replace("adversarial.safetensors", "prior.safetensors"), "does not say which expert it is"),
        (
            linear.replace("linear", "greedy-soup").replace("{}", "{scenes: x}"),
            "`greedy-soup` finds the weights",
        ),
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

#[test]
fn connectivity_has_its_figures_and_ends_at_the_experts() {
    let folder = tempfile::tempdir().unwrap();
    let (scenes, out) = (folder.path().join("scenes"), folder.path().join("out"));
    stdout(&sage(&["scenes", "--count", "2", "--seed", "4", "--out", text(&scenes)]));
    let page = sage(&["analyse", "connectivity", text(&scenes), "--out", text(&out)]);
    let page = stdout(&page);
    assert!(page.contains("| angle | ") && page.contains("| 0.9 R_adv - 0.1 P_real |"), "{page}");
    let rows = |file: &str| -> Vec<Vec<f64>> {
        let text = fs::read_to_string(out.join(file)).unwrap();
        text.lines().skip(1).map(|line| line.split(',').map(|x| x.parse().unwrap()).collect()).collect()
    };
    let (path, landscape) = (rows("path.csv"), rows("landscape.csv"));
    assert_eq!((path.len(), landscape.len()), (21, 441));
    // The landscape has no cell at the experts, but its rows lie around those of the path.
    let rewards: Vec<f64> = landscape.iter().map(|row| row[2]).collect();
    let (low, high) =
        (rewards.iter().copied().fold(f64::MAX, f64::min), rewards.iter().copied().fold(0.0, f64::max));
    assert!(path.iter().all(|row| row[3] >= low - 0.5 && row[3] <= high + 0.5));
    // The cosine to the adversarial expert rises to 1.
    assert!(path.windows(2).all(|pair| pair[1][2] > pair[0][2]) && (path[20][2] - 1.0).abs() < 1e-9);
    let layers = fs::read_to_string(out.join("layers.csv")).unwrap();
    let shares: f64 =
        layers.lines().skip(1).map(|line| line.split(',').nth(3).unwrap().parse::<f64>().unwrap()).sum();
    assert!((shares - 1.0).abs() < 1e-9, "{shares}");
}
