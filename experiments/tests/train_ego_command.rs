//! `sage train-ego`, its policies, and `sage bench closed-loop` as a user runs them.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod program;

use std::fs;

use insta::assert_snapshot;
use program::*;

/// A run of seconds.
const QUICK: [&str; 13] = [
    "--procedural",
    "9",
    "--updates",
    "400",
    "--evaluations",
    "2",
    "--config",
    r#"{"td3": {"hidden": [16, 16], "batch": 32, "random_steps": 200}}"#,
    "--weights",
    "procedural",
    "--checkpoint-every",
    "100",
    "--method",
];

fn train(more: &[&str]) -> std::process::Output {
    sage(&[&["train-ego"], &QUICK[..], more].concat())
}

#[test]
fn a_trained_policy_drives_and_is_compared() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let [run, again, table] = ["run", "again", "table"].map(path);
    let one = train(&["sage", "--seeds", "0..2", "--out", text(&run)]);
    assert!(stdout(&one).contains("| 1 | attacked |"), "{}", stdout(&one));
    // One thread, and one of the seeds alone.
    stdout(&train(&["sage", "--seeds", "1..2", "--threads", "1", "--out", text(&again)]));
    let policy = run.join("seed-1/policy.safetensors");
    let read = |path: &std::path::Path| fs::read(path).unwrap();
    for name in
        ["seed-1/policy.safetensors", "seed-1/episodes.csv", "seed-1/evaluations.csv", "seed-1/README.md"]
    {
        assert!(read(&run.join(name)) == read(&again.join(name)), "{name} depends on threads or other seeds");
    }
    assert!(!run.join("seed-1/buffer.rows").exists());
    assert!(fs::read_to_string(run.join("seed-1/README.md")).unwrap().contains("| generator | sage |"));
    let done = train(&["sage", "--seeds", "0..2", "--out", text(&run)]);
    assert_snapshot!(redacted(stderr(&done)), @r"
    note: weights `procedural` (network densetnt)
    read 9 scenes ([time])
    read 9 scenes ([time])
    read 3 scenes ([time])
    read 3 scenes ([time])
    note: `[folder]/run` holds this run, and it is done
    ");

    let ego = format!("td3,td3:{}", policy.display());
    let drives =
        rows(&sage(&["simulate", &example(), "--ego", &ego, "--json", "--out", text(&path("drives"))]));
    assert_eq!(drives.len(), 2);

    let named = format!("sage={},none={}", run.display(), again.display());
    let bench = |more: &[&str]| {
        let scenes =
            ["bench", "closed-loop", "--procedural", "3", "--untrained", "1", "--ego", "idm", "--wide"];
        let runs = ["--runs", &named, "--weights", "procedural", "--out", text(&table)];
        sage(&[&scenes[..], &runs, more].concat())
    };
    let first = bench(&[]);
    let markdown = stdout(&first).to_owned();
    assert!(markdown.contains("*45.14 ± 3.27*"), "{markdown}");
    assert!(markdown.contains("| completion in sage scenes, sage less none |"), "{markdown}");
    let rows = fs::read_to_string(table.join("rows.csv")).unwrap();
    let heads = rows.lines().next().unwrap().split(',').count();
    // Three policies of each of two runs, one untrained and one by name; unchanged and under three attacks.
    assert_eq!(rows.lines().filter(|line| line.contains(",completion,")).count(), 8 * 4 * 3);
    assert!(heads == 20 && stdout(&bench(&[])) == markdown, "a run that is done is shown again");
    let other = bench(&["--tested", "none", "--force"]);
    let markdown = stdout(&other);
    assert!(markdown.contains("| at fault in sage scenes, none less sage |"), "{markdown}");
    assert!(!markdown.contains("reproduced") && !markdown.contains("The paper's orderings"), "{markdown}");
    let unknown = bench(&["--tested", "nobody", "--force"]);
    assert_snapshot!(redacted(stderr(&unknown)), @"error: --tested names `nobody`, which is none of --runs: sage, none");
}

#[test]
fn wrong_uses_are_refused_with_the_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("run");
    let error = |more: &[&str]| {
        let output = train(&[more, &["--out", text(&out)]].concat());
        assert_eq!(output.status.code(), Some(1), "{more:?}");
        stderr(&output).to_owned()
    };
    let scene = example();
    let wrong: [&[&str]; 11] = [
        &["cta"],
        &["sage", "--curriculum", "papre"],
        &["sage", "--sampler", "some"],
        &["sage", "--curriculum", r#"constant{"lambda": 2}"#],
        &["none", "--ratio", "4"],
        &["none", "--steps", "4000"],
        &["none", "--teacher", "expert"],
        &["none", "--reward", "0.1*smoth"],
        &["none", "--search", "4"],
        &["goose", "--search", "4"],
        &["none", &scene, "--eval", &scene],
    ];
    assert_snapshot!("wrong_options_of_train_ego", messages(wrong.map(|more| (more.join(" "), error(more)))));
    let ppo = ["train-ego", "--learner", "ppo", "--updates", "5", "--out", text(&out)];
    assert_snapshot!(failure(&ppo), @"error: --updates is no option of `--learner ppo`; its length is given by --steps");
    let teacher = |name: &str| {
        failure(&[
            "train-ego",
            "--learner",
            "ppo",
            "--eval-method",
            "none",
            "--teacher",
            name,
            "--procedural",
            "3",
            "--out",
            text(&folder.path().join(name)),
        ])
    };
    assert_snapshot!(
        "wrong_teachers",
        messages(["exprt", "replay", "ppo", "cmd:planner"].map(|name| (name, redacted(&teacher(name)))))
    );
    let configurations = [r#"{"updates": 5}"#, r#"{"max_step": 5}"#, r#"{"max_steps": 1}"#, "nowhere.yaml"];
    let config = |text_of: &str| failure(&["train-ego", "--config", text_of, "--out", text(&out)]);
    assert_snapshot!(
        "wrong_configurations_of_train_ego",
        messages(configurations.map(|text_of| (text_of, config(text_of))))
    );
    let drive = |ego: &str| failure(&["simulate", &scene, "--ego", ego, "--out", text(&out)]);
    let files = ["td3:none.safetensors".to_owned(), format!("td3:{scene}")];
    assert_snapshot!("files_that_are_no_policies", messages(files.map(|ego| (ego.clone(), drive(&ego)))));
    let runs = format!("none={}", folder.path().display());
    assert_snapshot!(redacted(&failure(&["bench", "closed-loop", "--runs", &runs, "--out", text(&out)])), @r"
    note: weights `procedural` (network densetnt)
    error: `[folder]` holds no policies of finished seeds; expected `seed-0/policy-….safetensors`
    ");
}

#[test]
fn a_policy_by_the_recipe_for_drivers_drives_everywhere() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let [run, again, table] = ["run", "again", "table"].map(path);
    let scene = example();
    let config = r#"{"ppo": {"hidden": [16, 16], "environments": 8, "horizon": 10, "minibatch": 40}}"#;
    let written_out = r#"{"ppo": {"hidden": [16, 16], "environments": 8, "horizon": 10, "minibatch": 40, "gamma": 0.98, "kept": 0.6,
        "entropy": 0.003}}"#;
    let of_recipe = [
        "--learner",
        "ppo",
        "--goes-on",
        "--egos",
        "all",
        "--mirrored",
        "0.5",
        "--teacher",
        "expert",
        "--procedural-share",
        "0.2",
        "--reward",
        r#"contact-ends{"penalty":30},5*off-road,2*speed-limit,smooth"#,
        "--config",
        written_out,
    ];
    let options = [
        "train-ego",
        &scene,
        "--steps",
        "800",
        "--procedural",
        "6",
        "--evaluations",
        "2",
        "--checkpoint-every",
        "200",
        "--method",
        "rule",
        "--eval-method",
        "none",
    ];
    let train = |more: &[&str]| sage(&[&options[..], more].concat());
    let first = train(&["--recipe", "driver", "--config", config, "--seeds", "0..2", "--out", text(&run)]);
    assert!(stdout(&first).contains("| 1 | unchanged |"), "{}", stdout(&first));
    assert!(stderr(&first).contains("scenes, each with one ego"), "{}", stderr(&first));
    let alone = ["--seeds", "1..2", "--threads", "1", "--out", text(&again)];
    stdout(&train(&[&of_recipe[..], &alone].concat()));
    let read = |path: &std::path::Path| fs::read(path).unwrap();
    for name in
        ["policy.safetensors", "episodes.csv", "evaluations.csv", "README.md"].map(|n| format!("seed-1/{n}"))
    {
        assert!(
            read(&run.join(&name)) == read(&again.join(&name)),
            "{name} depends on threads, other seeds, or how the options are given"
        );
    }
    let policy = run.join("seed-1/policy.safetensors");
    let ego = format!("ppo:{}", policy.display());
    let drives = rows(&sage(&["simulate", &scene, "--ego", &ego, "--json", "--out", text(&path("drives"))]));
    assert_eq!(drives.len(), 1);
    let runs = format!("quick={}", run.display());
    let bench = [
        "bench",
        "closed-loop",
        "--procedural",
        "3",
        "--runs",
        &runs,
        "--method",
        "rule",
        "--out",
        text(&table),
    ];
    assert!(stdout(&sage(&bench)).contains("quick"));
}

#[test]
fn attacks_that_were_searched_depend_on_no_threads() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let [whole, threads, one_shot] = ["whole", "threads", "one-shot"].map(path);
    let config = r#"{"ppo": {"hidden": [16, 16], "environments": 8, "horizon": 10, "minibatch": 40}}"#;
    let train = |more: &[&str]| {
        let options =
            ["train-ego", "--procedural", "9", "--learner", "ppo", "--steps", "1600", "--config", config];
        let attacks = [
            "--curriculum",
            "constant",
            "--method",
            "sage",
            "--eval-method",
            "none",
            "--evaluations",
            "2",
            "--seeds",
            "0..2",
        ];
        stdout(&sage(&[&options[..], &attacks, more].concat())).to_owned()
    };
    train(&["--search", "3", "--checkpoint-every", "400", "--out", text(&whole)]);
    train(&["--search", "3", "--checkpoint-every", "80", "--threads", "1", "--out", text(&threads)]);
    train(&["--checkpoint-every", "400", "--out", text(&one_shot)]);
    let read = |path: &std::path::Path, seed: usize| {
        fs::read(path.join(format!("seed-{seed}/episodes.csv"))).unwrap()
    };
    for seed in 0..2 {
        assert!(read(&whole, seed) == read(&threads, seed), "the same search gives other attacks");
        assert!(read(&whole, seed) != read(&one_shot, seed), "the search changes nothing");
    }
}
