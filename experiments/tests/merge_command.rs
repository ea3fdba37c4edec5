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
    // Task arithmetic takes weights of any sum, as in mergekit.
    fs::write(&file, recipe("task_arithmetic", [1.0, 1.0], "{}")).unwrap();
    stdout(&sage(&["merge", text(&file), "--out", text(&folder.path().join("sum"))]));
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
        table.contains("| vector-extrapolation | 21 | 3 |") && table.contains("| 0.000 [0.000, 0.000] |"),
        "{table}"
    );
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
    assert!(stdout(&page).contains("| angle | "), "{}", stdout(&page));
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
    assert!(stdout(&page).contains("| sage | 0.9 R_adv - 0.1 P_real |"), "{}", stdout(&page));
    let estimates = fs::read_to_string(out.join("estimates.csv")).unwrap();
    let reward = |label: &str| -> f64 {
        let start = format!("policy,sage,{label},R_adv,");
        let line = estimates.lines().find_map(|line| line.strip_prefix(&start)).unwrap();
        line.split(',').nth(1).unwrap().parse().unwrap()
    };
    assert_eq!(reward("\"adversarial=1.00,realistic=0.00 mu 1.00\""), reward("1.00"));
    assert_eq!(reward("\"adversarial=0.00,realistic=1.00 mu 0.00\""), reward("0.00"));
    assert!(fs::read_to_string(out.join("plane-reward.svg")).unwrap().contains("share of the realistic"));
    let error = |plane: &str| stderr(&bench(plane, &folder.path().join("wrong"))).to_owned();
    let one = error("plane={experts: [adversarial, realistic], shares: [1]}");
    assert!(one.contains("`plane` has 1 shares; expected 2 to 101"), "{one}");
    let linear = sage(&["bench", "connectivity", text(&scenes), "--merger", "linear", "--out", "wrong"]);
    assert!(stderr(&linear).contains("expected"), "{}", stderr(&linear));
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
    let table = bench("realistic, adversarial, lawful", "out");
    // The corners and the centres of the sides, with selection and without.
    assert_eq!(stdout(&table).lines().filter(|line| line.contains("lawful=")).count(), 2 * 6);
    let csv = fs::read_to_string(out.join("estimates.csv")).unwrap();
    assert_eq!(csv.lines().filter(|line| line.contains(",P_real,")).count(), 2 * 6);
    for picture in ["triangle.svg", "triangle-policy.svg"] {
        assert!(fs::read_to_string(out.join(picture)).unwrap().contains("lawful"), "{picture}");
    }
    let error = |experts: &str| stderr(&bench(experts, "wrong")).to_owned();
    assert!(error("realistic, lawful").contains("triangle"), "{}", error("realistic, lawful"));
    assert!(error("realistic, lawful, calm").contains("no expert `calm`"));
    assert!(error("realistic, lawful, lawful").contains("names an expert twice"));
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
    let steps: Vec<&str> =
        card.lines().filter(|line| line.ends_with("| yes |") || line.ends_with("| no |")).collect();
    assert_eq!(steps.len(), 4, "{card}");
    assert!(steps[0].starts_with("| adversarial |") && steps[0].ends_with("| yes |"), "{card}");
    assert!(steps[1].starts_with("| adversarial 2 |") && steps[1].ends_with("| yes |"), "{card}");
    fs::write(&file, recipe.replace("scenes: scenes", "scenes: nowhere")).unwrap();
    let error = failure(&["merge", text(&file), "--out", text(&folder.path().join("none"))]);
    assert!(error.contains("nowhere") && !folder.path().join("none").exists(), "{error}");
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
            numbers(tensor) != numbers(expert.get(name).unwrap())
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
    assert!(error.contains("own encoders"), "{error}");
}
