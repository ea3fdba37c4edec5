//! `sage merge` as a user runs it.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod program;

use std::{fs, path::Path};

use insta::assert_snapshot;
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
    assert_snapshot!("card_of_a_merged_network", redacted(&card));

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
    // Task arithmetic takes weights of any sum, as in mergekit.
    fs::write(&file, recipe("task_arithmetic", [1.0, 1.0], "{}")).unwrap();
    stdout(&sage(&["merge", text(&file), "--out", text(&folder.path().join("sum"))]));
    let error =
        failure(&["generate", &scene, "--weights", text(&merged), "--out", text(&folder.path().join("c"))]);
    assert_snapshot!(redacted(&error), @"error: weights `[folder]/merged`: `[folder]/merged/realistic.safetensors`: does not exist: `sage finetune` tunes experts from a prior");
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
    let wrong = [
        ("weights that sum to 1.2", recipe("slerp", [0.3, 0.9], "{}")),
        ("an unknown parameter", recipe("linear", [0.3, 0.7], "{phi: 1}")),
        ("logit", recipe("logit", [0.3, 0.7], "{}")),
        ("passthrough", recipe("passthrough", [0.3, 0.7], "{}")),
        ("a missing file", linear.replace("adversarial.safetensors", "missing.safetensors")),
        ("a prior for an expert", linear.replace("adversarial.safetensors", "prior.safetensors")),
        ("weights of greedy-soup", linear.replace("linear", "greedy-soup").replace("{}", "{scenes: x}")),
        ("an unknown base model", linear.replace("base_model: procedural", "base_model: nothing")),
        ("slices", format!("{linear}slices: []\n")),
        ("an unknown field", format!("{linear}colour: red\n")),
    ];
    assert_snapshot!("wrong_recipes", messages(wrong.map(|(name, recipe)| (name, error(&recipe)))));
}

#[test]
fn mergers_are_compared_over_lambda() {
    let folder = tempfile::tempdir().unwrap();
    let (scenes, out) = (folder.path().join("scenes"), folder.path().join("out"));
    stdout(&sage(&["scenes", "--count", "3", "--seed", "4", "--out", text(&scenes)]));
    let mergers = "linear,vector-extrapolation,trajectory";
    let table = sage(&["bench", "pareto", text(&scenes), "--merger", mergers, "--out", text(&out)]);
    // Between the experts, vector extrapolation is interpolation.
    assert_snapshot!("mergers_over_lambda", stdout(&table));
    let csv = fs::read_to_string(out.join("estimates.csv")).unwrap();
    // 21 values of λ for three mergers with selection, and for two without.
    assert_eq!(csv.lines().filter(|line| line.contains(",P_real,")).count(), 21 * 5);
    for chart in
        ["pareto.svg", "pareto-without-selection.svg", "control.svg", "control-without-selection.svg"]
    {
        assert!(fs::read_to_string(out.join(chart)).unwrap().contains("linear"), "{chart}");
    }
}

#[test]
fn the_geometry_of_experts_ends_at_the_experts() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let page = sage(&["analyse", "connectivity", "--out", text(&out)]);
    assert_snapshot!("geometry_of_experts", redacted(stdout(&page)));
    let read = |file: &str| fs::read_to_string(out.join(file)).unwrap();
    let path: Vec<Vec<f64>> = (read("path.csv").lines().skip(1))
        .map(|line| line.split(',').map(|x| x.parse().unwrap()).collect())
        .collect();
    // The cosine to the adversarial expert rises to 1.
    assert!(path.windows(2).all(|pair| pair[1][2] > pair[0][2]) && (path[20][2] - 1.0).abs() < 1e-9);
    let shares: f64 = (read("layers.csv").lines().skip(1))
        .map(|line| line.split(',').nth(3).unwrap().parse::<f64>().unwrap())
        .sum();
    assert!((shares - 1.0).abs() < 1e-9, "{shares}");
    // Three experts and their prior are in the components; distances there are at most those in full.
    let components = read("components.csv");
    let point = |name: &str| -> [f64; 2] {
        let line = components.lines().find(|line| line.starts_with(&format!("{name},"))).unwrap();
        let mut numbers = line.split(',').skip(1).map(|x| x.parse().unwrap());
        [numbers.next().unwrap(), numbers.next().unwrap()]
    };
    let [[a, b], [c, d]] = [point("prior"), point("adversarial")];
    let (shown, whole) = ((a - c).hypot(b - d), path[20][1]);
    assert!(shown <= whole + 1e-9 && shown > 0.8 * whole, "{shown} of {whole}");
    point("lawful");
}

#[test]
fn rewards_on_the_plane_of_two_experts_agree_with_those_at_the_experts() {
    let folder = tempfile::tempdir().unwrap();
    let (scenes, out) = (folder.path().join("scenes"), folder.path().join("out"));
    stdout(&sage(&["scenes", "--count", "2", "--seed", "4", "--out", text(&scenes)]));
    let bench = |plane: &str, out: &std::path::Path| {
        let lambda = ["--lambda", "0,0.5,1", "--set", plane];
        sage(&[&["bench", "connectivity", text(&scenes), "--out", text(out)], &lambda[..]].concat())
    };
    let page = bench("plane={experts: [adversarial, realistic], shares: [0, 1]}", &out);
    assert_snapshot!("plane_of_two_experts", stdout(&page));
    let estimates = fs::read_to_string(out.join("estimates.csv")).unwrap();
    let reward = |label: &str| -> f64 {
        let start = format!("policy,sage,{label},R_adv,");
        let line = estimates.lines().find_map(|line| line.strip_prefix(&start)).unwrap();
        line.split(',').nth(1).unwrap().parse().unwrap()
    };
    assert_eq!(reward("\"adversarial=1.00,realistic=0.00 mu 1.00\""), reward("1.00"));
    assert_eq!(reward("\"adversarial=0.00,realistic=1.00 mu 0.00\""), reward("0.00"));
    assert!(fs::read_to_string(out.join("plane-reward.svg")).unwrap().contains("share of the realistic"));
    let one = bench("plane={experts: [adversarial, realistic], shares: [1]}", &folder.path().join("wrong"));
    let linear = sage(&["bench", "connectivity", text(&scenes), "--merger", "linear", "--out", "wrong"]);
    let said = [("a plane of one share", &one), ("--merger linear", &linear)];
    assert_snapshot!("wrong_planes", messages(said.map(|(name, run)| (name, stderr(run)))));
}

#[test]
fn mixtures_of_three_experts_are_measured_on_their_triangle() {
    let folder = tempfile::tempdir().unwrap();
    let (scenes, out) = (folder.path().join("scenes"), folder.path().join("out"));
    stdout(&sage(&["scenes", "--count", "2", "--seed", "4", "--out", text(&scenes)]));
    let bench = |experts: &str, out: &str| {
        let (out, triangle) =
            (folder.path().join(out), format!("triangle={{experts: [{experts}], steps: 2}}"));
        sage(&["bench", "mixtures", text(&scenes), "--set", &triangle, "--out", text(&out)])
    };
    // The corners and the centres of the sides, with selection and without.
    let table = bench("realistic, adversarial, lawful", "out");
    assert_snapshot!("mixtures_of_three_experts", stdout(&table));
    let csv = fs::read_to_string(out.join("estimates.csv")).unwrap();
    assert_eq!(csv.lines().filter(|line| line.contains(",P_real,")).count(), 2 * 6);
    for picture in ["triangle.svg", "triangle-policy.svg"] {
        assert!(fs::read_to_string(out.join(picture)).unwrap().contains("lawful"), "{picture}");
    }
    let error = |experts: &str| stderr(&bench(experts, "wrong")).to_owned();
    let wrong = ["realistic, lawful", "realistic, lawful, calm", "realistic, lawful, lawful"];
    assert_snapshot!("wrong_triangles", messages(wrong.map(|experts| (experts, error(experts)))));
    assert!(!folder.path().join("wrong").exists());
}

#[test]
fn a_greedy_soup_keeps_what_does_not_lower_its_value() {
    let folder = tempfile::tempdir().unwrap();
    let [scenes, file, out] = ["scenes", "soup.yaml", "soup"].map(|name| folder.path().join(name));
    stdout(&sage(&["scenes", "--count", "3", "--seed", "4", "--out", text(&scenes)]));
    let weights = Path::new(env!("CARGO_MANIFEST_DIR")).join("../weights/procedural");
    let models: String = ["realistic", "adversarial", "lawful", "adversarial"]
        .map(|name| format!("  - model: {}\n", weights.join(format!("{name}.safetensors")).display()))
        .concat();
    let parameters = "parameters: {scenes: scenes, mu: 1.0}";
    let recipe =
        format!("merge_method: greedy-soup\nbase_model: procedural\nmodels:\n{models}{parameters}\n");
    fs::write(&file, &recipe).unwrap();
    stdout(&sage(&["merge", text(&file), "--out", text(&out)]));
    let card = fs::read_to_string(out.join("README.md")).unwrap();
    // The steps of the search: the best first; a second copy of it changes nothing, so it stays.
    assert_snapshot!("card_of_a_greedy_soup", redacted(&card));
    fs::write(&file, recipe.replace("scenes: scenes", "scenes: nowhere")).unwrap();
    let error = failure(&["merge", text(&file), "--out", text(&folder.path().join("none"))]);
    assert!(!folder.path().join("none").exists());
    assert_snapshot!(redacted(&error), @"error: `[folder]/soup.yaml`: cannot read `nowhere`: No such file or directory (os error 2)");
}

#[test]
fn experts_with_their_own_encoders_are_tuned_and_mixed() {
    let folder = tempfile::tempdir().unwrap();
    let [config, experts, file] =
        ["tune.json", "experts", "recipe.yaml"].map(|name| folder.path().join(name));
    let tune = r#"{"tunes": "all", "epochs": 1, "candidates": 16, "weight_decay": 0.01, "experts": {"realistic": {}, "adversarial": {}}}"#;
    fs::write(&config, tune).unwrap();
    let finetune =
        ["finetune", "--procedural", "2", "--roles", "0", "--config", text(&config), "--out", text(&experts)];
    let done = sage(&finetune);
    assert!(done.status.success(), "{}", stderr(&done));
    // The encoder moved; the decoder of trajectories, which the loss does not see, did not.
    let tensors = |name: &str| {
        let file = experts.join(format!("{name}.safetensors"));
        sage_backbones::Parameters::load(&file).unwrap().0
    };
    let (prior, expert) = (tensors("prior"), tensors("adversarial"));
    let moved: Vec<&str> = prior
        .iter()
        .filter(|(name, tensor)| {
            let numbers = |tensor: &sage_backbones::candle::Tensor| -> Vec<f32> {
                tensor.flatten_all().unwrap().to_vec1().unwrap()
            };
            // A file holds the tensors that fine-tuning changes.
            expert.get(name).is_some_and(|tuned| numbers(tensor) != numbers(tuned))
        })
        .map(|(name, _)| name)
        .collect();
    let begins = |start: &str| moved.iter().any(|name| name.starts_with(start));
    assert!(begins("sub_graph.") && begins("rounds.") && !begins("decoder.tnt_"), "{moved:?}");
    let scene = example();
    let attack = |more: &[&str], out: &str| {
        let out = folder.path().join(out);
        let all = ["generate", &scene, "--weights", text(&experts), "--json", "--out", text(&out)];
        rows(&sage(&[&all[..], more].concat())).remove(0)["candidates"].clone()
    };
    let linear = attack(&["--lambda", "0.5"], "linear");
    assert_ne!(linear, attack(&["--lambda", "1"], "end"));
    assert_ne!(linear, attack(&["--lambda", "0.5", "--merger", "logit"], "logit"));
    let path = |name: &str| experts.join(format!("{name}.safetensors"));
    let recipe = format!(
        "merge_method: linear\nbase_model: {}\nmodels:\n  - {{model: {}, parameters: {{weight: 1}}}}\n",
        text(&experts),
        path("adversarial").display()
    );
    fs::write(&file, recipe).unwrap();
    let error = failure(&["merge", text(&file), "--out", text(&folder.path().join("merged"))]);
    assert_snapshot!(redacted(&error), @"error: `[folder]/recipe.yaml`: these experts have their own encoders, and their trajectories are the prior's: one network cannot hold both; mix them with --mix or --lambda");
}
