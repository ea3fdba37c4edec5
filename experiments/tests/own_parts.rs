//! Parts from outside, as `docs/extending.md` describes them: each example program does the whole of it.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod program;

use std::path::Path;

use insta::assert_snapshot;
use program::*;
use serde_json::Value;

fn crossing() -> String {
    example().replace("crossing.pkl", "crossing.json")
}

#[test]
fn a_reward_is_a_column_of_score_a_term_of_objectives_and_a_column_of_the_table() {
    let Some(program) = own("own_reward") else { return };
    let (scene, candidates) = (example(), crossing());
    assert_snapshot!(added(&program, &["list"]), @r"
    near-miss              closeness of the two cars without contact
                             options: scale = 5.0
    ");
    let score = ["score", &scene, "--candidates", &candidates];
    assert_snapshot!("score_with_a_column_of_an_own_reward", stdout(&run(&program, &score)));
    let scored = rows(&run(&program, &[&score[..], &["--json"]].concat()));
    let value = |row: &Value| row["rewards"]["near-miss"].as_f64().unwrap();
    assert!(scored.iter().all(|row| (0.0..=1.0).contains(&value(row))));
    let hit = scored.iter().find(|row| row["collision"] == true).unwrap();
    assert_eq!(value(hit), 1.0, "boxes that touch have no gap");

    // Selected by it alone, with a sign: as near as can be, and as far as can be.
    let folder = tempfile::tempdir().unwrap();
    let chosen = |name: &str, weight: f64| {
        let file = folder.path().join(format!("{name}.json"));
        let spec = format!(
            r#"{{"terms": [{{"name": "near-miss", "weight": {weight}, "options": {{"scale": 30}}}}]}}"#
        );
        std::fs::write(&file, spec).unwrap();
        let out = folder.path().join(name);
        let generate = ["generate", &scene, "--selection", text(&file), "--json", "--out", text(&out)];
        let row = rows(&run(&program, &[&generate[..], &WEIGHTS].concat())).remove(0);
        row["scores"]["rewards"]["near-miss"].as_f64().unwrap()
    };
    assert!(chosen("near", 1.0) > chosen("far", -1.0));

    // Tuned for it: the expert says so, and the table has a column.
    let config = folder.path().join("tune.json");
    let objective =
        r#"{"terms": [{"name": "near-miss", "weight": 1.0}, {"name": "realism", "weight": -0.1}]}"#;
    let tune = format!(
        r#"{{"epochs": 1, "candidates": 16, "experts": {{"realistic": {{}}, "adversarial": {{"objective": {objective}}}}}}}"#
    );
    std::fs::write(&config, tune).unwrap();
    let experts = folder.path().join("experts");
    let finetune =
        ["finetune", "--procedural", "2", "--roles", "0", "--config", text(&config), "--out", text(&experts)];
    let done = run(&program, &finetune);
    assert!(done.status.success(), "{}", stderr(&done));
    let file = experts.join("adversarial.safetensors");
    let (_, header) = sage_backbones::Parameters::load(&file).unwrap();
    assert!(header.notes["options"].contains("near-miss"), "{:?}", header.notes);
    let table = folder.path().join("table");
    let bench = ["bench", "open-loop", &scene, "--method", "sage,log", "--lambda", "1"];
    let output = run(&program, &[&bench[..], &["--weights", text(&experts), "--out", text(&table)]].concat());
    let page = std::fs::read_to_string(table.join("table.md")).unwrap();
    assert!(output.status.success() && page.contains("| near-miss |"), "{page}");
    let estimates = std::fs::read_to_string(table.join("estimates.csv")).unwrap();
    assert!(estimates.contains("sage 1.00,near-miss,"), "{estimates}");
}

#[test]
fn a_feasibility_rule_with_a_name_and_cost_of_its_own_changes_what_is_chosen() {
    let Some(program) = own("own_feasibility") else { return };
    let scene = example();
    let folder = tempfile::tempdir().unwrap();
    let chosen = |name: &str, rule: &str| -> Value {
        let out = folder.path().join(name);
        let generate = ["generate", &scene, "--feasibility", rule, "--json", "--out", text(&out)];
        rows(&run(&program, &[&generate[..], &WEIGHTS].concat())).remove(0)
    };
    let top = |row: &Value| {
        let points = row["trajectory"].as_array().unwrap();
        let at = |k: usize| [0, 1].map(|axis| points[k][axis].as_f64().unwrap());
        (1..points.len())
            .map(|k| (at(k)[0] - at(k - 1)[0]).hypot(at(k)[1] - at(k - 1)[1]) / 0.1)
            .fold(0.0, f64::max)
    };
    let free = chosen("free", "paper");
    let limit = 0.8 * top(&free);
    let slow = chosen("slow", &format!(r#"speed-limit{{"limit": {limit}}}"#));
    assert!(free["trajectory"] != slow["trajectory"]);
    assert!(slow["feasible"] == false || top(&slow) <= limit, "{} over {limit}", top(&slow));
    // Where nothing is feasible its own cost and name are told.
    let never = chosen("never", r#"speed-limit{"limit": 0.001, "cost": 7.0}"#);
    assert_eq!(never["feasible"], false);
    let broken = never["violations"].as_array().unwrap().iter().find(|v| v["rule"] == "speed_limit").unwrap();
    assert_eq!(broken["cost"], 7.0);
    assert!(never["note"].as_str().unwrap().contains("no candidate is feasible"));
    let score = run(&program, &["score", &scene, "--candidates", &crossing(), "--json"]);
    assert!(rows(&score).iter().all(|row| row["rules"]["speed-limit"].is_array()));
    let wrong = run(
        &program,
        &[
            "generate",
            &scene,
            "--feasibility",
            "speed-limit{\"limt\": 3}",
            "--out",
            text(&folder.path().join("x")),
        ],
    );
    assert_snapshot!(stderr(&wrong), @"error: selection `natural`: options of feasibility `speed-limit`: unknown field `limt`, expected `limit` or `cost`");
}

#[test]
fn a_merger_mixes_three_experts() {
    let Some(program) = own("own_merger") else { return };
    let scene = example();
    let folder = tempfile::tempdir().unwrap();
    let config = folder.path().join("tune.json");
    let lawful = r#"{"objective": {"terms": [{"name": "lane-distance", "weight": -1.0}, {"name": "realism", "weight": -0.5}]}}"#;
    let tune = format!(
        r#"{{"epochs": 1, "candidates": 16, "experts": {{"lawful": {lawful}, "adversarial": {{}}, "realistic": {{}}}}}}"#
    );
    std::fs::write(&config, tune).unwrap();
    let experts = folder.path().join("experts");
    let finetune =
        ["finetune", "--procedural", "2", "--roles", "0", "--config", text(&config), "--out", text(&experts)];
    let done = sage(&finetune);
    assert!(done.status.success(), "{}", stderr(&done));
    assert!(experts.join("lawful.safetensors").is_file());
    let generate = |out: &str, more: &[&str]| {
        let out = folder.path().join(out);
        let all = ["generate", &scene, "--weights", text(&experts), "--json", "--out", text(&out)];
        run(&program, &[&all[..], more].concat())
    };
    let mix = ["--mix", "realistic=0.5,adversarial=0.3,lawful=0.2"];
    let [own, linear, soup] = ["strongest", "linear", "uniform-soup"].map(|merger| {
        let row = rows(&generate(merger, &[&mix[..], &["--merger", merger]].concat())).remove(0);
        assert_eq!((row["mu"].as_f64(), row["mix"]["lawful"].as_f64()), (Some(0.3), Some(0.2)), "{row}");
        row["candidates"].clone()
    });
    assert!(own != linear && linear != soup);
    // λ stays what it was: between two of them.
    let lambda = rows(&generate("lambda", &["--lambda", "0.3"])).remove(0);
    let named = ["--mix", "realistic=0.7,adversarial=0.3"];
    assert_eq!(lambda["candidates"], rows(&generate("named", &named)).remove(0)["candidates"]);
    let wrong = |more: &[&str]| stderr(&generate("wrong", more)).to_owned();
    let refused = [
        ["--mix", "realistic=0.5,adversarial=0.3"],
        ["--mix", "kind=1"],
        ["--mix", "lawful=0.4,realistic=0.4"],
        ["--mix", "lawful"],
        ["--merger", r#"strongest{"by": 2}"#],
    ];
    assert_snapshot!(
        "wrong_mixtures_of_three_experts",
        messages(refused.map(|more| (more.join(" "), wrong(&more))))
    );
    // A further expert that is renamed or damaged is refused like the first two.
    std::fs::rename(experts.join("lawful.safetensors"), experts.join("polite.safetensors")).unwrap();
    assert_snapshot!(redacted(&wrong(&["--lambda", "1"])), @"error: weights `[folder]/experts`: `[folder]/experts/polite.safetensors`: the header names the lawful expert, expected the polite one: the files were swapped or renamed");
    std::fs::write(experts.join("polite.safetensors"), "cut off").unwrap();
    assert_snapshot!(redacted(&wrong(&["--lambda", "1"])), @"error: weights `[folder]/experts`: `[folder]/experts/polite.safetensors`: is no whole file of weights (header too small); copy or train it again");
}

#[test]
fn a_set_needs_no_realistic_expert_and_a_likelihood_teaches() {
    let (scene, folder) = (example(), tempfile::tempdir().unwrap());
    let tune = |name: &str, objective: &str| {
        let (config, out) = (folder.path().join(format!("{name}.json")), folder.path().join(name));
        let text_of = format!(
            r#"{{"epochs": 1, "candidates": 16, "experts": {{"usual": {{"objective": {objective}}}}}}}"#
        );
        std::fs::write(&config, text_of).unwrap();
        let done = sage(&[
            "finetune",
            "--procedural",
            "2",
            "--roles",
            "0",
            "--config",
            text(&config),
            "--out",
            text(&out),
        ]);
        (out, done)
    };
    let (out, done) = tune("usual", r#"{"terms": [{"name": "nll", "weight": -1.0}]}"#);
    let said = stderr(&done);
    let pairs = said.lines().find(|line| line.starts_with("usual epoch 1")).unwrap();
    let number = |after: &str| -> f64 {
        let rest = pairs.split(after).nth(1).unwrap();
        rest.trim_start().split([' ', ',']).next().unwrap().parse().unwrap()
    };
    assert!(number("pairs") > number("("), "likelihood makes pairs of its own: {pairs}");
    let generate = |more: &[&str]| {
        let to = folder.path().join("attacked");
        let all = ["generate", &scene, "--weights", text(&out), "--force", "--out", text(&to)];
        sage(&[&all[..], more].concat())
    };
    stdout(&generate(&["--mix", "usual=1"]));
    assert_snapshot!(redacted(stderr(&generate(&["--lambda", "1"]))), @r"
    note: weights `[folder]/usual` (network densetnt)
    error: no expert `realistic`; there are usual
    ");
    let (_, refused) = tune("by-mu", r#""natural""#);
    assert_snapshot!(redacted(stderr(&refused)), @"error: `[folder]/by-mu.json`: expert `usual`: the weight of term `adversarial` depends on mu; an expert's weights are plain numbers");
}

#[test]
fn a_dial_is_for_the_terms_it_was_fitted_for() {
    let folder = tempfile::tempdir().unwrap();
    let experts = folder.path().join("experts");
    std::fs::create_dir(&experts).unwrap();
    let shipped = Path::new(env!("CARGO_MANIFEST_DIR")).join("../weights/procedural");
    for file in ["prior", "realistic", "adversarial"].map(|name| format!("{name}.safetensors")) {
        std::fs::copy(shipped.join(&file), experts.join(&file)).unwrap();
    }
    let selection = folder.path().join("mine.json");
    let spec = |weight: f64| {
        let terms = format!(
            r#"{{"terms": [{{"name": "adversarial", "weight": {{"mu0": 0, "mu1": 1}}}}, {{"name": "realism", "weight": {weight}}}]}}"#
        );
        std::fs::write(&selection, terms).unwrap();
    };
    spec(-1.0);
    let dial = experts.join("dial.json");
    let calibrate =
        ["calibrate", "--procedural", "4", "--weights", text(&experts), "--selection", text(&selection)];
    let done = sage(&[&calibrate[..], &["--out", text(&dial)]].concat());
    assert!(done.status.success(), "{}", stderr(&done));
    let generate = |file: &Path, out: &str| {
        let out = folder.path().join(out);
        let scene = example();
        let arguments = ["generate", &scene, "--weights", text(&experts), "--selection", text(file)];
        sage(&[&arguments[..], &["--aggression", "0.5", "--out", text(&out)]].concat())
    };
    // The same terms under another name, and other terms under the same name.
    let copy = folder.path().join("copy.json");
    std::fs::copy(&selection, &copy).unwrap();
    stdout(&generate(&copy, "copied"));
    spec(-2.0);
    let refused = generate(&selection, "other");
    assert_snapshot!(redacted(stderr(&refused)), @r"
    note: weights `[folder]/experts` (network densetnt)
    error: `[folder]/experts/dial.json` has no dial for the selection `[folder]/mine.json`: `sage calibrate` fits one
    ");
    // The merger is part of it: another one is used with a warning.
    spec(-1.0);
    let warned = sage(&[
        "generate",
        &example(),
        "--weights",
        text(&experts),
        "--selection",
        text(&selection),
        "--merger",
        "uniform-soup",
        "--aggression",
        "0.5",
        "--out",
        text(&folder.path().join("soup")),
    ]);
    assert_snapshot!(redacted(stderr(&warned)), @r"
    note: weights `[folder]/experts` (network densetnt)
    warning: the dial was fitted for the merger `linear`; with `uniform-soup` the attack rate may not rise linearly
    1 scene, 1 attempt in `[folder]/soup` ([time])
    why there is no attack: `sage explain [folder]/soup/crossing-aggression0.50.json`
    to look at the attacks, open `[folder]/soup/index.html`
    ");
}

#[test]
fn a_generator_needs_no_experts_and_follows_the_dial() {
    let Some(program) = own("own_generator") else { return };
    let folder = tempfile::tempdir().unwrap();
    assert_snapshot!(added(&program, &["list"]), @r"
    brake                  brakes straight on
                             options: hardest = 6.0
    ");
    let (scene, out) = (example(), folder.path().join("out"));
    let generate = ["generate", &scene, "--method", "brake", "--lambda", "0,1", "--out", text(&out)];
    let output = run(&program, &generate);
    assert_eq!(stdout(&output).lines().filter(|line| line.starts_with("crossing lambda")).count(), 2);
    assert_snapshot!("an_own_generator_loads_no_experts", redacted(stderr(&output)));
    assert!(pickle(&out, "crossing-lambda1.00").is_file());
    let table = folder.path().join("table");
    let bench = ["bench", "open-loop", &scene, "--method", "brake", "--lambda", "0,1", "--out", text(&table)];
    let output = run(&program, &[&bench[..], &WEIGHTS].concat());
    assert_snapshot!("table_of_an_own_generator", stdout(&output));
}

#[test]
fn a_policy_drives_and_is_attacked() {
    let Some(program) = own("own_policy") else { return };
    let folder = tempfile::tempdir().unwrap();
    assert_snapshot!(added(&program, &["list"]), @r"
    cautious               constant speed, brakes for road users in a cone ahead
                             options: braking = 4.0, speed = 8.0
    ");
    let (scene, out) = (example(), folder.path().join("drivers"));
    let drivers =
        ["bench", "drivers", &scene, "--ego", r#"cautious,cautious{"speed":3}"#, "--out", text(&out)];
    assert_snapshot!("table_of_an_own_policy", stdout(&run(&program, &drivers)));
    let attacked = folder.path().join("attacked");
    let generate = ["generate", &scene, "--ego", "cautious", "--json", "--out", text(&attacked)];
    let row = rows(&run(&program, &[&generate[..], &WEIGHTS].concat())).remove(0);
    assert_eq!(row["ego"], "cautious");
}

#[test]
fn a_claim_is_checked_with_its_injected_faults_and_has_a_section_of_the_page() {
    let Some(program) = own("own_claim") else { return };
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("page");
    let theory = ["theory", "--only", "safest", "--instances", "100", "--json"];
    let row = rows(&run(&program, &[&theory[..], &["--out", text(&out)]].concat())).remove(0);
    assert_eq!((&row["verdict"], &row["report"]["violations"]), (&Value::from("holds"), &Value::from(0)));
    let page = std::fs::read_to_string(out.join("theory.md")).unwrap();
    assert!(page.contains("## safest: equal curvature") && page.contains("| safest | λ = 1 | caught |"));
    let injected = run(&program, &["theory", "--only", "safest", "--inject", "--instances", "100"]);
    assert_snapshot!(stdout(&injected), @r"
    safest  caught  η/4 in place of η/8
    safest  caught  λ = 1
    caught 2 of 2
    ");
    assert_snapshot!(added(&program, &["list"]), @"  safest                 equal curvature: λ = ½ has the smallest loss in the worst case over μ");
}

#[test]
fn a_proposer_goes_with_the_shipped_selector() {
    let Some(program) = own("own_proposer") else { return };
    let folder = tempfile::tempdir().unwrap();
    let (scene, out) = (example(), folder.path().join("out"));
    let generate = [
        "generate",
        &scene,
        "--method",
        r#"straight-on{"candidates": 9}"#,
        "--lambda",
        "0,1",
        "--json",
        "--out",
        text(&out),
    ];
    let output = run(&program, &generate);
    let rows = rows(&output);
    assert_snapshot!(redacted(stderr(&output)), @r"
    1 scene, 2 attempts in `[folder]/out` ([time])
    | λ    | scenes |  attacked | believable | avoidable | by R157 | why not, most often     |
    | ---- | -----: | --------: | ---------: | --------: | ------: | ----------------------- |
    | 0.00 |      1 |   0 (0 %) |    0 (0 %) |         - |       - | a miss rates higher (1) |
    | 1.00 |      1 | 1 (100 %) |  1 (100 %) |    1 of 1 |  1 of 1 | -                       |
    why there is no attack: `sage explain [folder]/out/crossing-lambda0.00.json`
    to look at the attacks, open `[folder]/out/index.html`
    ");
    assert!(rows.iter().all(|row| row["candidates"].as_array().unwrap().len() == 9));
    let reward = |k: usize| rows[k]["scores"]["adversarial_reward"].as_f64().unwrap();
    assert!(reward(1) >= reward(0));
}

#[test]
fn a_curriculum_is_listed_and_decides_the_attacks_of_a_training() {
    let Some(program) = own("own_curriculum") else { return };
    assert_snapshot!(added(&program, &["list"]), @r"
    patient                attacks from a success rate without attack on
                             options: least = 0.7
    ");
    let folder = tempfile::tempdir().unwrap();
    let attacks = |least: &str| {
        let out = folder.path().join(least);
        let curriculum = format!(r#"patient{{"least": {least}}}"#);
        let size = ["--procedural", "6", "--updates", "300", "--evaluations", "1"];
        let train = ["train-ego", "--method", "rule", "--curriculum", &curriculum, "--out", text(&out)];
        let small = [
            "--config",
            r#"{"td3": {"hidden": [8, 8], "batch": 8, "random_steps": 300}}"#,
            "--eval-method",
            "none",
        ];
        stdout(&run(&program, &[&train[..], &size, &small].concat()));
        let record: Value = serde_json::from_slice(&std::fs::read(out.join("run.json")).unwrap()).unwrap();
        record["results"]["seeds"][0]["counters"]["attacked"].as_u64().unwrap()
    };
    assert!(attacks("0") > 0);
    assert_eq!(attacks("1"), 0);
}
