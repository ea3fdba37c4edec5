//! Numbers of merged experts; the rest of `sage merge` is in `commands/merge.md`.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod program;

use std::{fs, path::Path};

use insta::assert_snapshot;
use program::*;

/// A recipe of the experts in the binary, whose files lie in the project.
fn recipe(weights: [f64; 2]) -> String {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../weights/procedural");
    let models = ["realistic", "adversarial"].iter().zip(weights).map(|(name, weight)| {
        let file = folder.join(format!("{name}.safetensors"));
        format!("  - model: {}\n    parameters: {{weight: {weight}}}\n", file.display())
    });
    let models: String = models.collect();
    format!("merge_method: linear\nbase_model: procedural\nmodels:\n{models}")
}

#[test]
fn a_merged_network_attacks_as_its_experts_do_at_that_mixture() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("recipe.yaml");
    fs::write(&file, recipe([0.3, 0.7])).unwrap();
    let merged = folder.path().join("merged");
    stdout(&sage(&["merge", text(&file), "--out", text(&merged)]));
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
}

#[test]
fn the_geometry_of_experts_ends_at_the_experts() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    stdout(&sage(&["analyse", "connectivity", "--out", text(&out)]));
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
    stdout(&page);
    let estimates = fs::read_to_string(out.join("estimates.csv")).unwrap();
    let reward = |label: &str| -> f64 {
        let start = format!("policy,sage,{label},R_adv,");
        let line = estimates.lines().find_map(|line| line.strip_prefix(&start)).unwrap();
        line.split(',').nth(1).unwrap().parse().unwrap()
    };
    assert_eq!(reward("\"adversarial=1.00,realistic=0.00 mu 1.00\""), reward("1.00"));
    assert_eq!(reward("\"adversarial=0.00,realistic=1.00 mu 0.00\""), reward("0.00"));
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
