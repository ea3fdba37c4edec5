//! Manifests: what they say, and folders that are not as they say.

use std::fs;

use insta::assert_snapshot;
use serde_json::json;

use super::*;

const GENERATE: [&str; 9] =
    ["generate", "scenes", "--lambda", "1", "--format", "rows", "--no-pages", "--weights", "procedural"];

/// Runs a shard into `out` and returns what it said. Its exit code must be one of a run that ended.
fn shard(root: &Path, out: &str, shard: &str) -> String {
    let output = sage_in(root, &[&GENERATE[..], &["--out", out, "--shard", shard]].concat());
    assert!(matches!(output.status.code(), Some(0 | BAD_SCENES)), "{}", stderr(&output));
    stderr(&output).to_owned()
}

/// What `sage status` says, and its exit code.
fn status(root: &Path, more: &[&str]) -> (String, i32) {
    let output = sage_in(root, &[&["status", "out"], more].concat());
    let said = String::from_utf8(output.stdout.clone()).unwrap();
    assert!(output.stderr.is_empty(), "{}", stderr(&output));
    // Hours depend on the machine.
    let said = said.lines().filter(|line| !line.contains("core-hours")).collect::<Vec<_>>().join("\n");
    (said, output.status.code().unwrap())
}

fn lines(path: &Path) -> Vec<Value> {
    fs::read_to_string(path).unwrap().lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn status_says_what_is_done_and_its_commands_finish_the_run() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    scenes(root, 12);
    let mut said = Vec::new();
    for number in [3, 1] {
        shard(root, "out", &format!("{number}/8"));
        let (text, code) = status(root, &[]);
        said.push((format!("after shard {number}/8, exit status {code}"), text));
    }
    let unfinished: Value = serde_json::from_str(&status(root, &["--json"]).0).unwrap();
    assert_eq!(unfinished["shards"]["ended"], json!([1, 3]));
    let commands = unfinished["finish"].as_array().unwrap();
    for line in commands {
        let program = env!("CARGO_BIN_EXE_sage");
        let line = line.as_str().unwrap().replace("sage ", &format!("{program} "));
        Command::new("bash").args(["-c", &line]).current_dir(root).output().unwrap();
    }
    let (text, code) = status(root, &["--verify"]);
    said.push((format!("after these commands, exit status {code}"), text));
    assert_eq!(code, BAD_SCENES);
    assert_snapshot!("status", messages(said));
    let whole = sage_in(root, &[&GENERATE[..], &["--out", "whole"]].concat());
    assert_eq!(whole.status.code(), Some(BAD_SCENES));
    assert_same(&root.join("out"), &root.join("whole"));
    // When the bad scene is mended, its shard finishes the run.
    fs::remove_file(root.join("scenes/broken.pkl")).unwrap();
    let other = sage_in(root, &[&GENERATE[..], &["--out", "out"]].concat());
    assert_eq!(other.status.code(), Some(0), "{}", stderr(&other));
    assert_eq!(status(root, &[]).1, 0);
}

#[test]
fn a_manifest_counts_scenes_and_has_the_hashes_of_their_files() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    scenes(root, 6);
    shard(root, "out", "1/2");
    let manifest = lines(&root.join("out/shards/1-of-2.jsonl"));
    let head = &manifest[0];
    assert_eq!(head["scenes"].as_u64().unwrap() as usize, manifest.len() - 1);
    assert_eq!((&head["shard"]["number"], &head["shard"]["of"]), (&json!(1), &json!(2)));
    assert!(head["shard"]["seconds"].as_f64().unwrap() > 0.0);
    let row = manifest[1..].iter().find_map(|scene| scene["files"][0]["name"].as_str());
    assert_eq!(head["run_hash"], json(&root.join("out").join(row.unwrap()))["run_hash"]);
    for scene in &manifest[1..] {
        if scene["state"] == "bad" {
            assert!(scene["reason"].as_str().unwrap().contains("broken.pkl"), "{scene}");
            continue;
        }
        for file in scene["files"].as_array().unwrap() {
            let bytes = fs::read(root.join("out").join(file["name"].as_str().unwrap())).unwrap();
            assert_eq!(file["bytes"], bytes.len());
            assert_eq!(file["blake3"], blake3::hash(&bytes).to_hex()[..32]);
        }
    }
}

#[test]
fn another_number_of_shards_finishes_what_one_began() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    scenes(root, 8);
    shard(root, "out", "2/3");
    let first = lines(&root.join("out/shards/2-of-3.jsonl")).len() - 1;
    let before = hostile::snapshot(&root.join("out"));
    let said: Vec<String> = ["1/2", "2/2"].map(|number| shard(root, "out", number)).to_vec();
    // What is done stays done, whoever did it.
    let found: usize = said
        .iter()
        .filter_map(|said| {
            said.split_once(" of them finished before")?.0.rsplit(' ').next()?.parse::<usize>().ok()
        })
        .sum();
    assert!(found >= first - 1 && found > 0, "{found} of {first}: {said:?}");
    let after = hostile::snapshot(&root.join("out"));
    assert!(before.iter().all(|(name, bytes)| after[name] == *bytes));
    let joined = sage_in(root, &["join", "out"]);
    assert_eq!(joined.status.code(), Some(BAD_SCENES), "{}", stderr(&joined));
    sage_in(root, &[&GENERATE[..], &["--out", "whole"]].concat());
    assert_same(&root.join("out"), &root.join("whole"));
    // So does a run without shards; and a join may be repeated.
    shard(root, "rest", "3/4");
    sage_in(root, &[&GENERATE[..], &["--out", "rest"]].concat());
    assert_same(&root.join("rest"), &root.join("whole"));
    assert_eq!(sage_in(root, &["join", "rest"]).status.code(), Some(BAD_SCENES));
    assert_same(&root.join("rest"), &root.join("whole"));
}

#[test]
fn a_folder_that_is_not_as_its_manifests_say_is_named_and_repaired() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    scenes(root, 8);
    for number in ["1/2", "2/2"] {
        shard(root, "out", number);
    }
    let out = root.join("out");
    let good = hostile::snapshot(&out);
    let [one, two] = [1, 2].map(|number| out.join(format!("shards/{number}-of-2.jsonl")));
    let restore = || {
        fs::remove_dir_all(&out).unwrap();
        for (name, bytes) in &good {
            fs::create_dir_all(out.join(name).parent().unwrap()).unwrap();
            fs::write(out.join(name), bytes).unwrap();
        }
    };
    let row = lines(&one)[1..].iter().find_map(|scene| Some(scene["files"][0]["name"].as_str()?.to_owned()));
    let row = out.join(row.unwrap());
    let text_of = |path: &Path| fs::read_to_string(path).unwrap();
    let lies: [(&str, &dyn Fn()); 9] = [
        ("a row is missing", &|| fs::remove_file(&row).unwrap()),
        ("a row is cut", &|| fs::write(&row, &fs::read(&row).unwrap()[..1000]).unwrap()),
        ("a row is another of the same size", &|| {
            fs::write(&row, text_of(&row).replacen("\"seed\":0", "\"seed\":1", 1)).unwrap();
        }),
        ("a manifest is cut", &|| {
            let text = text_of(&one);
            fs::write(&one, &text[..text.len() - 40]).unwrap();
        }),
        ("a manifest says that a bad scene is done", &|| {
            for path in [&one, &two] {
                fs::write(path, text_of(path).replace("\"state\":\"bad\"", "\"state\":\"done\"")).unwrap();
            }
        }),
        ("a manifest has another shard's name", &|| {
            fs::copy(&two, &one).unwrap();
        }),
        ("a manifest is no manifest", &|| fs::write(&one, "{}\n").unwrap()),
        ("a manifest is empty", &|| fs::write(&one, "").unwrap()),
        ("a manifest is missing", &|| fs::remove_file(&one).unwrap()),
    ];
    let mut said = Vec::new();
    for (what, lie) in lies {
        restore();
        lie();
        let before = hostile::snapshot(&out);
        let needs_hash = what.contains("same size");
        let (text, code) = status(root, if needs_hash { &["--verify"] } else { &[] });
        let unfinished = text.lines().filter(|line| !line.starts_with("  ")).collect::<Vec<_>>().join("\n");
        said.push((format!("{what}, exit status {code}"), unfinished));
        assert_eq!(code, if what.ends_with("is missing") { RETRY } else { 1 }, "{what}: {text}");
        if !needs_hash {
            let joined = sage_in(root, &["join", "out"]);
            // What is missing may only be seen late.
            let expected = if what.ends_with("is missing") { RETRY } else { 1 };
            assert_eq!(joined.status.code(), Some(expected), "{what}: {}", stderr(&joined));
            said.push((format!("{what}, join"), stderr(&joined).to_owned()));
        }
        assert_eq!(hostile::snapshot(&out), before, "{what}: nothing is changed");
        for number in ["1/2", "2/2"] {
            let other = if number == "1/2" { &two } else { &one };
            let untouched = fs::read(other).ok();
            shard(root, "out", number);
            assert_eq!(fs::read(other).ok(), untouched, "{what}: the other shard's manifest is changed");
        }
        assert_eq!(status(root, &["--verify"]).1, RETRY, "{what}: only the join is missing");
    }
    assert_snapshot!("manifests_that_lie", redacted(&messages(said)));
}

#[test]
fn a_manifest_cannot_name_files_outside_of_its_folder() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    scenes(root, 2);
    shard(root, "out", "1/1");
    fs::write(root.join("secret"), "mine").unwrap();
    let path = root.join("out/shards/1-of-1.jsonl");
    let text = fs::read_to_string(&path).unwrap();
    let (head, rest) = text.split_once('\n').unwrap();
    let rest =
        rest.replacen("\"files\":[", "\"files\":[{\"name\":\"../secret\",\"bytes\":4,\"blake3\":\"\"},", 1);
    let mut head: Value = serde_json::from_str(head).unwrap();
    head["blake3"] = json!(blake3::hash(rest.as_bytes()).to_hex()[..32]);
    fs::write(&path, format!("{head}\n{rest}")).unwrap();
    let (said, code) = status(root, &["--verify"]);
    assert!(code == 1 && said.contains("leads out of the folder"), "{said}");
}

#[test]
fn shards_of_another_program_command_or_list_of_scenes_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    scenes(root, 6);
    shard(root, "out", "1/2");
    let out = root.join("out");
    let record = fs::read_to_string(out.join("run.json")).unwrap();
    let before = hostile::snapshot(&out);
    let mut said = Vec::new();
    let mut refused = |what: &str, more: &[&str]| {
        let mut arguments = GENERATE.to_vec();
        arguments.extend(["--out", "out", "--shard", "2/2"]);
        arguments.extend(more);
        let output = sage_in(root, &arguments);
        assert_eq!(output.status.code(), Some(1), "{what}");
        said.push((what.to_owned(), stderr(&output).to_owned()));
        let joined = sage_in(root, &["join", "out"]);
        assert!(matches!(joined.status.code(), Some(1 | RETRY)), "{what}");
        said.push((format!("{what}, join"), stderr(&joined).to_owned()));
    };
    refused("another command", &["--seed", "1"]);
    assert_eq!(hostile::snapshot(&out), before);
    let [version, program] = ["version", "program"]
        .map(|key| json(&out.join("run.json"))["run"][key].as_str().unwrap().to_owned());
    for (what, from) in [("another version", version), ("another program", program)] {
        fs::write(out.join("run.json"), record.replace(&format!("\"{from}\""), "\"0.0.9\"")).unwrap();
        refused(what, &[]);
    }
    fs::write(out.join("run.json"), &record).unwrap();
    assert_eq!(hostile::snapshot(&out), before);
    fs::remove_file(root.join("scenes/curve-1-1.pkl")).unwrap();
    refused("a scene less", &[]);
    assert_eq!(hostile::snapshot(&out), before);
    assert_snapshot!("other_shards", redacted(&messages(said)));
}

#[test]
fn folders_without_shards_have_a_status_and_no_join() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    scenes(root, 2);
    fs::create_dir(root.join("empty")).unwrap();
    stdout(&sage_in(root, &["scenes", "--count", "1", "--out", "plain"]));
    let demo = [
        "pretrain",
        "scenes",
        "--dev",
        "scenes",
        "--epochs",
        "1",
        "--network",
        r#"{"hidden": 16, "rounds": 1}"#,
    ];
    sage_in(root, &[&demo[..], &["--out", "trained"]].concat());
    let mut said = Vec::new();
    for name in ["empty", "plain", "nowhere", "trained"] {
        for command in ["status", "join"] {
            let output = sage_in(root, &[command, name]);
            let code = output.status.code().unwrap();
            let both = [&output.stdout[..], &output.stderr[..]].concat();
            said.push((format!("{command} {name}, exit status {code}"), String::from_utf8(both).unwrap()));
        }
    }
    assert_snapshot!("folders_without_shards", redacted(&messages(said)));
}

#[test]
fn a_shard_that_comes_late_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    scenes(root, 6);
    for number in ["1/2", "2/2"] {
        shard(root, "out", number);
    }
    assert_eq!(sage_in(root, &["join", "out"]).status.code(), Some(BAD_SCENES));
    let joined = hostile::snapshot(&root.join("out"));
    // A scheduler may run a shard once more, after the join and as one of another number.
    for number in ["1/2", "2/2", "2/5"] {
        assert!(shard(root, "out", number).contains("joined already"));
        assert_eq!(hostile::snapshot(&root.join("out")), joined, "{number}");
    }
    assert_eq!(status(root, &["--verify"]).1, BAD_SCENES);
    // A lost manifest of the whole is told, and written again.
    fs::remove_file(root.join("out/manifest.jsonl")).unwrap();
    assert_eq!(status(root, &[]).1, RETRY);
    let again = sage_in(root, &[&GENERATE[..], &["--out", "out"]].concat());
    assert_eq!(again.status.code(), Some(BAD_SCENES));
    let mut expected = joined;
    expected.remove("run.json");
    assert_eq!(files(&root.join("out")), expected);
    // A new scene is missing until a run without shards has attacked it.
    fs::copy(root.join("scenes/curve-1-1.pkl"), root.join("scenes/new.pkl")).unwrap();
    fs::remove_file(root.join("scenes/broken.pkl")).unwrap();
    let refused = sage_in(root, &[&GENERATE[..], &["--out", "out", "--shard", "1/2"]].concat());
    assert!(stderr(&refused).contains("are not those with which"), "{}", stderr(&refused));
    let whole = sage_in(root, &[&GENERATE[..], &["--out", "out"]].concat());
    assert_eq!((whole.status.code(), status(root, &[]).1), (Some(0), 0));
}

#[test]
fn what_is_done_is_told_while_the_first_shards_run() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    scenes(root, 4);
    shard(root, "out", "1/3");
    // As if the shard had been killed before its end.
    fs::remove_file(root.join("out/shards/1-of-3.jsonl")).unwrap();
    fs::write(root.join("out/.sage-lock-shard-2-of-3"), "process 1: gone").unwrap();
    let found: Value = serde_json::from_str(&status(root, &["--json"]).0).unwrap();
    assert_eq!((&found["scenes"]["missing"], &found["shards"]["of"]), (&json!(5), &json!(3)));
    assert_eq!(found["shards"]["begun"], json!([2]));
    assert!(found["finish"][0].as_str().unwrap().contains("--shard 2/3"), "{found}");
}

#[test]
fn files_that_were_changed_are_made_again() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    scenes(root, 4);
    for (name, command) in COMMANDS.iter().filter(|(name, _)| !["open-loop", "drivers"].contains(name)) {
        let run = |more: &[&str]| sage_in(root, &[*command, &["--out", name], more].concat());
        assert_eq!(run(&[]).status.code(), Some(BAD_SCENES));
        let whole = hostile::snapshot(&root.join(name));
        // A file of the same size, and readable: only its hash tells.
        let change = || {
            let scene = lines(&root.join(name).join("manifest.jsonl"))
                .into_iter()
                .find(|line| line["state"] == "done");
            for file in scene.unwrap()["files"].as_array().unwrap() {
                let path = root.join(name).join(file["name"].as_str().unwrap());
                let mut bytes = fs::read(&path).unwrap();
                let place = bytes.iter().rposition(|byte| byte.is_ascii_digit()).unwrap();
                bytes[place] = if bytes[place] == b'1' { b'2' } else { b'1' };
                fs::write(&path, bytes).unwrap();
            }
        };
        change();
        let (said, code) = {
            let output = sage_in(root, &["status", name, "--verify"]);
            (String::from_utf8(output.stdout.clone()).unwrap(), output.status.code())
        };
        assert_eq!(code, Some(1), "{name}: {said}");
        let again = run(&[]);
        assert_eq!(again.status.code(), Some(BAD_SCENES), "{name}: {}", stderr(&again));
        let repaired = hostile::snapshot(&root.join(name));
        let differs = |(file, bytes): &(&String, &Vec<u8>)| *file != "run.json" && whole[*file] != **bytes;
        assert_eq!(repaired.iter().find(differs).map(|(file, _)| file), None, "{name}");
        let verified = sage_in(root, &["status", name, "--verify"]);
        let said = String::from_utf8_lossy(&verified.stdout);
        assert_eq!(verified.status.code(), Some(BAD_SCENES), "{name}: {said} {}", stderr(&verified));
    }
}
