//! `sage studio`: what its page shows is what `sage simulate` makes, and it answers this page alone.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod program;
mod studio;

use std::{
    fs,
    io::{Read as _, Write as _},
    net::TcpStream,
    path::Path,
    process::Command,
};

use program::*;
use serde_json::{Value, json};
use studio::Studio;

const DRIVERS: [&str; 3] = ["idm", "expert", "pdm"];

/// Sums of the differences that a page holds, in metres.
fn sums(differences: &Value) -> Vec<f64> {
    let all = differences.as_array().unwrap().iter().map(|value| value.as_i64().unwrap());
    let sums = all.scan(0, |sum, difference| {
        *sum += difference;
        Some(*sum as f64 / 100.0)
    });
    sums.collect()
}

/// Runs lines of a shell with the real binary as `sage`.
fn shell(lines: &str, folder: &Path) {
    let binaries = Path::new(env!("CARGO_BIN_EXE_sage")).parent().unwrap();
    let path = format!("{}:{}", binaries.display(), std::env::var("PATH").unwrap_or_default());
    let mut command = Command::new("sh");
    let output = command.args(["-ec", lines]).current_dir(folder).env("PATH", path).output().unwrap();
    assert!(output.status.success(), "{lines}\n{}", stderr(&output));
}

fn wanted(scene: usize, step: usize, drivers: &[usize]) -> Value {
    json!({"scene": scene, "generator": 0, "dial": "lambda", "step": step, "drivers": drivers, "adversary": null, "without": [], "goal": null})
}

/// Compares the drives of an answer with those of its own command, run in a folder.
fn compare(answer: &Value, origin: &Value, folder: &Path) {
    let command = answer["command"].as_str().unwrap();
    for old in ["drives", "invented"] {
        let _ = fs::remove_dir_all(folder.join(old));
    }
    shell(command, folder);
    let rows = rows_in(&folder.join("drives"));
    let panels = answer["drives"]["panels"].as_array().unwrap();
    assert_eq!(rows.len(), panels.len(), "{command}");
    for panel in panels {
        compare_drive(panel, rows.iter().find(|row| row["ego"] == panel["name"]).unwrap(), origin, command);
    }
}

#[test]
fn the_page_shows_what_its_command_makes() {
    let folder = tempfile::tempdir().unwrap();
    let mut studio =
        Studio::start(&["--procedural", "14", "--seed", "3", "--ego", &DRIVERS.join(",")], folder.path());
    let session = studio.session();
    let ask = |path: &str, body: &Value| -> Value {
        let (status, answer) = studio.post(path, Some(&session), &body.to_string());
        assert_eq!(status, 200, "{body}: {answer}");
        serde_json::from_str(&answer).unwrap()
    };
    for scene in 0..14 {
        let described = ask("/scene", &json!({"scene": scene}));
        let origin = &described["data"]["origin"];
        let mut wanted = wanted(scene, 4 * (scene % 6), &[scene % 3, (scene + 1) % 3]);
        let answer = ask("/drive", &wanted);
        compare(&answer, origin, folder.path());
        // Another adversary, somebody away, a goal.
        let users = described["users"].as_array().unwrap();
        let others: Vec<&Value> = users.iter().filter(|user| user["id"] != described["adversary"]).collect();
        match scene % 3 {
            0 => {
                wanted["adversary"] = others
                    .iter()
                    .find(|user| user["canAttack"] == true)
                    .map_or(Value::Null, |user| user["id"].clone())
            }
            1 => wanted["without"] = others.iter().take(2).map(|user| user["id"].clone()).collect(),
            _ => {
                let (x, y) = (
                    &answer["drives"]["panels"][0]["adversary"]["runs"][0]["x"],
                    &answer["drives"]["panels"][0]["adversary"]["runs"][0]["y"],
                );
                let [x, y] = [(x, 0), (y, 1)]
                    .map(|(d, axis)| sums(d).last().unwrap() + origin[axis].as_f64().unwrap());
                wanted["goal"] = json!([x + 4.0, y - 3.0]);
            }
        }
        compare(&ask("/drive", &wanted), origin, folder.path());
    }
}

/// Compares a drive of an answer with its row.
fn compare_drive(panel: &Value, row: &Value, origin: &Value, what: &str) {
    let run = &panel["ego"]["runs"][0];
    let shown = sums(&run["x"]).into_iter().zip(sums(&run["y"]));
    for ((x, y), state) in shown.zip(row["trajectory"].as_array().unwrap()) {
        let at = |axis: usize| state[axis].as_f64().unwrap() - origin[axis].as_f64().unwrap();
        assert!((x - at(0)).abs() < 0.0051 && (y - at(1)).abs() < 0.0051, "{what}");
    }
    assert_eq!(panel["verdict"], row["attack"]["verdict"]["attack"], "{what}");
    let contact = row["contacts"].as_array().unwrap().first();
    let step = contact.map(|contact| contact["step"].as_i64().unwrap() + 10);
    assert_eq!(panel["contact"]["frame"].as_i64(), step, "{what}");
}

/// Rows in a folder of `sage simulate`.
fn rows_in(folder: &Path) -> Vec<Value> {
    let files = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let is_row = |name: &str| name.ends_with(".json") && !["run.json", "manifest.json"].contains(&name);
    files
        .filter(|path| is_row(path.file_name().unwrap().to_str().unwrap()))
        .map(|path| serde_json::from_slice(&fs::read(path).unwrap()).unwrap())
        .collect()
}

#[test]
fn three_hundred_drives_of_the_page_are_rows_of_simulate() {
    const SCENES: usize = 20;
    let folder = tempfile::tempdir().unwrap();
    let drivers = DRIVERS.join(",");
    shell(
        &format!(
            "sage scenes --count {SCENES} --seed 6 --out invented
             sage simulate invented --ego {drivers} --method sage --lambda 0,0.25,0.5,0.75,1 --out drives"
        ),
        folder.path(),
    );
    let rows = rows_in(&folder.path().join("drives"));
    let mut studio = Studio::start(&["invented", "--ego", &drivers], folder.path());
    let session = studio.session();
    let ask = |path: &str, body: &Value| -> Value {
        let (status, answer) = studio.post(path, Some(&session), &body.to_string());
        assert_eq!(status, 200, "{body}: {answer}");
        serde_json::from_str(&answer).unwrap()
    };
    let names = ask("/offered", &json!({}))["scenes"].clone();
    let (mut compared, mut attacks) = (0, 0);
    for scene in 0..SCENES {
        let origin = ask("/scene", &json!({"scene": scene}))["data"]["origin"].clone();
        let name = names[scene].as_str().unwrap().split('.').next().unwrap();
        for (driver, label) in DRIVERS.into_iter().enumerate() {
            for place in 0..5 {
                let row = rows.iter().find(|row| {
                    row["scene"] == name && row["ego"] == label && row["lambda"] == 0.25 * f64::from(place)
                });
                let Some(row) = row else { continue };
                let answer = ask("/drive", &wanted(scene, 5 * place as usize, &[driver]));
                let what = format!("{name} {label} {place}");
                compare_drive(&answer["drives"]["panels"][0], row, &origin, &what);
                compared += 1;
                attacks += usize::from(row["attack"]["verdict"]["attack"] == true);
            }
        }
    }
    assert!(compared == 5 * 3 * SCENES && attacks > 20, "{compared} drives, {attacks} attacks");
}

/// The lines of an answer that comes in several.
fn lines(answer: &str) -> Vec<Value> {
    answer
        .lines()
        .filter(|line| line.starts_with('{'))
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

#[test]
fn what_the_page_finds_is_what_search_finds_and_can_be_kept() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = ["--procedural", "3", "--ego", "idm,expert", "--budget", "24", "--out", "suite"];
    let mut studio = Studio::start(&arguments, folder.path());
    let session = studio.session();
    let post = |path: &str, body: &Value| studio.post(path, Some(&session), &body.to_string());
    let ask = |path: &str, body: &Value| -> Value {
        let (status, answer) = post(path, body);
        assert_eq!(status, 200, "{body}: {answer}");
        serde_json::from_str(&answer).unwrap()
    };
    let mut choice = wanted(2, 20, &[0, 1]);
    choice["found"] = json!({"number": 0, "without": []});
    let early = post("/drive", &choice);
    assert!(early.0 == 422 && early.1.contains("search again"), "{early:?}");
    let (status, answer) = post("/search", &wanted(2, 20, &[0, 1]));
    let said = lines(&answer);
    let (drives, last) = said.split_at(said.len() - 1);
    assert_eq!((status, drives.len()), (200, 24), "{answer}");
    assert!(drives.iter().enumerate().all(|(k, line)| line["drives"] == k + 1), "{answer}");
    let found = last[0]["found"].as_array().unwrap();
    assert!(!found.is_empty(), "{answer}");

    // A failure on both drivers, by the commands that the page gives.
    let origin = ask("/scene", &json!({"scene": 2}))["data"]["origin"].clone();
    for number in 0..found.len() {
        choice["found"] = json!({"number": number, "without": []});
        compare(&ask("/drive", &choice), &origin, folder.path());
        let _ = fs::remove_dir_all(folder.path().join("found"));
    }
    choice["found"] = json!({"number": 0, "without": []});
    let explained = ask("/explain", &choice);
    let words = explained["words"][0]["text"].as_str().unwrap();
    assert!(
        explained["words"][0]["failure"] == true
            && words.starts_with("A failure. The driver of UN R157 would "),
        "{words}"
    );
    assert!(words.contains(" After "), "{words}");

    // Nothing is written until something is kept; the same failure is one test.
    assert!(!folder.path().join("suite").exists());
    let kept = ask("/keep", &choice);
    assert_eq!(ask("/keep", &choice), kept, "twice");
    // The same plan where somebody is not there, by the commands of the page too.
    let users = ask("/scene", &json!({"scene": 2}));
    let away =
        users["users"].as_array().unwrap().iter().rfind(|user| user["id"] != users["adversary"]).unwrap();
    choice["without"] = json!([away["id"]]);
    compare(&ask("/drive", &choice), &origin, folder.path());
    choice["found"]["without"] = choice["without"].clone();
    let (status, answer) = post("/keep", &choice);
    assert!(status == 422 && answer.contains("search again"), "{answer}");
    // All places of the slider.
    let swept = lines(&post("/sweep", &wanted(2, 20, &[0])).1);
    let mut steps: Vec<u64> = swept.iter().filter_map(|line| line["step"].as_u64()).collect();
    steps.sort_unstable();
    assert_eq!(steps, (0..21).collect::<Vec<_>>());
    for line in swept.iter().take(4) {
        let at = wanted(2, line["step"].as_u64().unwrap() as usize, &[0]);
        let is_failure = ask("/explain", &at)["words"][0]["failure"] == true;
        assert_eq!(line["becomes"] == "failure", is_failure, "{line}");
    }
    let not = post("/keep", &wanted(0, 0, &[0]));
    assert!(not.0 == 422 && not.1.contains("no driver here fails"), "{not:?}");
    drop(studio);
    let folder = folder.path();
    let suite: Value = serde_json::from_slice(&fs::read(folder.join("suite/suite.json")).unwrap()).unwrap();
    let tests = suite["tests"].as_array().unwrap();
    assert_eq!(tests.len(), kept["tests"].as_u64().unwrap() as usize);
    assert!(!folder.join("suite/.sage-unfinished").exists());
    let tested = Command::new(env!("CARGO_BIN_EXE_sage"))
        .args(["test", "suite", "--ego", "idm"])
        .current_dir(folder)
        .output()
        .unwrap();
    assert_eq!(tested.status.code(), Some(1), "it fails there: {}", stderr(&tested));

    // Another session adds to it, here a scene without somebody; a folder of something else is refused.
    let mut studio = Studio::start(&arguments, folder);
    let session = studio.session();
    let mut altered = wanted(2, 20, &[0]);
    let users = studio.post("/scene", Some(&session), r#"{"scene": 2}"#).1;
    let users: Value = serde_json::from_str(&users).unwrap();
    let far =
        users["users"].as_array().unwrap().iter().rfind(|user| user["id"] != users["adversary"]).unwrap();
    altered["without"] = json!([far["id"]]);
    let found = lines(&studio.post("/search", Some(&session), &altered.to_string()).1);
    assert!(!found.last().unwrap()["found"].as_array().unwrap().is_empty(), "{found:?}");
    altered["found"] = json!({"number": 0, "without": [far["id"]]});
    let (status, answer) = studio.post("/keep", Some(&session), &altered.to_string());
    assert_eq!(status, 200, "{answer}");
    let suite: Value = serde_json::from_slice(&fs::read(folder.join("suite/suite.json")).unwrap()).unwrap();
    assert_eq!(suite["tests"].as_array().unwrap().len(), tests.len() + 1, "{answer}");
    let scene = suite["tests"][tests.len()]["scene"].as_str().unwrap();
    assert!(scene.contains("-without-"), "{scene}");
    let scene = sage_data::Recording::read(&folder.join("suite/scenes").join(scene)).unwrap().scene;
    assert!(scene.tracks.iter().all(|track| far["id"] != *track.id), "it is gone");
    fs::create_dir(folder.join("other")).unwrap();
    fs::write(folder.join("other/notes.txt"), "x").unwrap();
    let refused = sage(&["studio", "--procedural", "1", "--out", folder.join("other").to_str().unwrap()]);
    assert!(stderr(&refused).contains("is not empty and holds no suite"), "{}", stderr(&refused));
}

#[test]
fn every_generator_is_offered_with_every_weights() {
    let folder = tempfile::tempdir().unwrap();
    let other = Path::new(env!("CARGO_MANIFEST_DIR")).join("../weights/procedural");
    let weights = format!("procedural,{}", other.display());
    let arguments = ["--procedural", "1", "--method", "sage", "--method", "rule", "--weights", &*weights];
    let mut studio = Studio::start(&arguments, folder.path());
    let session = studio.session();
    let offered: Value = serde_json::from_str(&studio.post("/offered", Some(&session), "").1).unwrap();
    let names: Vec<&str> =
        offered["generators"].as_array().unwrap().iter().map(|one| one["name"].as_str().unwrap()).collect();
    assert_eq!((names.len(), names[0], names[1]), (4, "sage, procedural", "rule, procedural"));
    let mut choice = wanted(0, 20, &[0]);
    choice["generator"] = json!(2);
    let answer: Value =
        serde_json::from_str(&studio.post("/drive", Some(&session), &choice.to_string()).1).unwrap();
    assert!(answer["command"].as_str().unwrap().contains(&other.display().to_string()), "{answer}");
}

#[test]
fn names_of_strangers_reach_the_shell_as_they_are() {
    let folder = tempfile::tempdir().unwrap();
    let name = "it's $(touch broken) \"x\" `id`.pkl";
    fs::copy(example(), folder.path().join(name)).unwrap();
    let mut studio = Studio::start(&[name], folder.path());
    let session = studio.session();
    let (status, answer) = studio.post("/drive", Some(&session), &wanted(0, 20, &[0]).to_string());
    assert_eq!(status, 200, "{answer}");
    let answer: Value = serde_json::from_str(&answer).unwrap();
    shell(answer["command"].as_str().unwrap(), folder.path());
    assert!(folder.path().join("drives/run.json").is_file() && !folder.path().join("broken").exists());
}

#[test]
fn a_link_opens_one_session_and_nobody_else_is_answered() {
    let folder = tempfile::tempdir().unwrap();
    let mut studio = Studio::start(&["--procedural", "2"], folder.path());
    let first = studio.key.clone();
    let session = studio.session();
    let again = studio.post("/session", None, &json!({"key": first}).to_string());
    assert_eq!(again.0, 401, "{again:?}");
    assert!(again.1.contains("used before"), "{again:?}");
    // The page itself holds nothing of a scene.
    let host = format!("Host: {}\r\n", studio.address);
    let (status, page) = studio.send(&format!("GET / HTTP/1.1\r\n{host}Connection: close\r\n\r\n"));
    assert!(status == 200 && !page.contains("straight-0-0"));
    for path in ["/offered", "/scene", "/drive"] {
        for session in [None, Some(""), Some("00000000000000000000000000000000"), Some(&*first)] {
            assert_eq!(
                studio.post(path, session, &wanted(0, 0, &[0]).to_string()).0,
                if path == "/scene" { 400 } else { 401 },
                "{path} {session:?}"
            );
        }
    }
    assert_eq!(studio.post("/scene", None, r#"{"scene": 0}"#).0, 401);
    let own = format!("X-Session: {session}\r\n");
    for (head, expected) in [
        ("Host: attacker.example\r\n".to_owned(), 403),
        (format!("{host}Origin: http://attacker.example\r\n"), 403),
        (format!("{host}Origin: null\r\n"), 403),
        (String::new(), 400),
    ] {
        let (status, _) = studio.send(&format!(
            "POST /offered HTTP/1.1\r\n{head}{own}Content-Length: 0\r\nConnection: close\r\n\r\n"
        ));
        assert!(status == expected || (head.is_empty() && status == 403), "{head}: {status}");
    }
    assert_eq!(studio.post("/offered", Some(&session), "").0, 200);
}

#[test]
fn wrong_requests_get_an_error_and_the_next_one_an_answer() {
    let folder = tempfile::tempdir().unwrap();
    let mut studio = Studio::start(&["--procedural", "2"], folder.path());
    let session = studio.session();
    let with = |key: &str, value: Value| {
        let mut one = wanted(0, 20, &[0]);
        one[key] = value;
        one.to_string()
    };
    let deep = "[".repeat(5000) + &"]".repeat(5000);
    for (body, expected) in [
        (String::new(), 400),
        ("null".to_owned(), 400),
        ("{".to_owned(), 400),
        (deep, 400),
        (format!("\"{}\"", "x".repeat(70_000)), 413),
        (with("scene", json!(2)), 422),
        (with("scene", json!(-1)), 400),
        (with("scene", json!("../../etc/passwd")), 400),
        (with("scene", json!(18_446_744_073_709_551_615_u64)), 422),
        (with("generator", json!(1)), 422),
        (with("dial", json!("mu")), 400),
        (with("step", json!(21)), 422),
        (with("step", json!(1.5)), 400),
        (with("drivers", json!([])), 422),
        (with("drivers", json!([0, 1, 0])), 422),
        (with("drivers", json!([9])), 422),
        (with("drivers", json!("idm")), 400),
        (with("adversary", json!("nobody")), 422),
        (with("adversary", json!(["6"])), 400),
        (with("without", json!(["<script>"])), 422),
        (with("without", json!("6")), 400),
        (with("without", json!(vec!["x"; 8000])), 422),
        (with("goal", json!([1.0])), 400),
        (with("goal", json!(["1", "2"])), 400),
        (with("command", json!("rm")), 400),
    ] {
        let (status, answer) = studio.post("/drive", Some(&session), &body);
        assert_eq!(status, expected, "{} {answer}", &body[..body.len().min(200)]);
        if status != 413 {
            assert!(serde_json::from_str::<Value>(&answer).unwrap()["error"].is_string(), "{answer}");
        }
    }
    // The other requests choose in the same way.
    for path in ["/explain", "/search", "/keep", "/drive"] {
        for (body, expected) in
            [("{".to_owned(), 400), ("[]".to_owned(), 400), (with("found", json!("../x")), 400)]
        {
            assert_eq!(studio.post(path, Some(&session), &body).0, expected, "{path} {body}");
        }
        for wrong in [
            with("drivers", json!([7])),
            with("scene", json!(99)),
            with("found", json!({"number": 3, "without": []})),
        ] {
            let (status, answer) = studio.post(path, Some(&session), &wrong);
            // A search finds its own failures, and says in its answer what is wrong.
            let is_found = path == "/search" && wrong.contains("number");
            assert!(is_found || answer.contains("\"error\":\""), "{path} {wrong}: {status} {answer}");
        }
    }
    assert!(
        studio.post("/keep", Some(&session), &wanted(0, 20, &[0]).to_string()).1.contains("--out FOLDER")
    );
    assert_eq!(studio.post("/thumbnail", Some(&session), r#"{"scene": 7}"#).0, 422);
    assert_eq!(studio.post("/thumbnail", None, r#"{"scene": 0}"#).0, 401);
    for turn in ["x", "-1", "1e3", "99999999999999999999"] {
        let host = &studio.address;
        let (status, answer) = studio.send(&format!(
            "POST /drive HTTP/1.1\r\nHost: {host}\r\nX-Session: {session}\r\nX-Turn: {turn}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n{}",
            wanted(0, 0, &[0]).to_string().len(),
            wanted(0, 0, &[0])
        ));
        assert!(status == 400 && answer.contains("x-turn"), "{turn}: {status} {answer}");
    }
    for path in ["/nothing", "/../secret", "/drive/x", "/%2e%2e"] {
        assert_eq!(studio.post(path, Some(&session), "{}").0, 404, "{path}");
    }
    // A goal far away is none that a plan reaches, but one that is nearest.
    assert_eq!(studio.post("/drive", Some(&session), &with("goal", json!([1e300, -1e300]))).0, 200);
    assert_eq!(studio.post("/drive", Some(&session), &wanted(1, 0, &[1, 0]).to_string()).0, 200);
}

/// Sends a request without reading its answer.
fn sent(studio: &Studio, path: &str, session: &str, body: &str) -> TcpStream {
    let mut stream = TcpStream::connect(&studio.address).unwrap();
    let (host, length) = (&studio.address, body.len());
    let head = format!(
        "POST {path} HTTP/1.1\r\nHost: {host}\r\nX-Session: {session}\r\nConnection: close\r\nContent-Length: {length}\r\n\r\n"
    );
    stream.write_all((head + body).as_bytes()).unwrap();
    stream
}

#[test]
fn a_search_ends_with_its_tab_and_a_newer_request_takes_its_place() {
    let folder = tempfile::tempdir().unwrap();
    // It would take minutes, and there is one thread.
    let arguments = ["--procedural", "3", "--ego", "pdm", "--budget", "5000", "--threads", "1"];
    let mut studio = Studio::start(&arguments, folder.path());
    let (first, second) = (studio.session(), studio.session());
    let body = wanted(1, 20, &[0]).to_string();
    let begun = |session: &str| {
        let mut stream = sent(&studio, "/search", session, &body);
        let mut answer = [0; 512];
        assert!(stream.read(&mut answer).unwrap() > 0);
        stream
    };
    drop(begun(&first));
    assert_eq!(studio.post("/drive", Some(&second), &body).0, 200);
    let mut searching = begun(&second);
    assert_eq!(studio.post("/drive", Some(&second), &body).0, 200);
    let mut rest = Vec::new();
    searching.read_to_end(&mut rest).unwrap_or_default();
    assert!(String::from_utf8_lossy(&rest).contains("a newer request took its place"));
}

#[test]
fn a_planner_that_hangs_is_given_up_and_others_are_answered() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("planner.sh"), "exec sleep 1000\n").unwrap();
    let drivers = ["--ego", "idm", "--ego", "hangs=cmd:sh planner.sh"];
    let limits = ["--ego-timeout", "2,2,2", "--threads", "2"];
    let mut studio = Studio::start(&[&["--procedural", "2"][..], &drivers, &limits].concat(), folder.path());
    let (first, second) = (studio.session(), studio.session());
    let hanging = sent(&studio, "/drive", &first, &wanted(0, 20, &[1]).to_string());
    assert_eq!(studio.post("/drive", Some(&second), &wanted(1, 20, &[0]).to_string()).0, 200);
    let (status, answer) = studio.post("/drive", Some(&first), &wanted(0, 20, &[1]).to_string());
    assert!(status == 422 && answer.contains("hangs"), "{status} {answer}");
    drop(hanging);
    assert_eq!(studio.post("/drive", Some(&first), &wanted(0, 20, &[0]).to_string()).0, 200);
}

#[test]
fn closed_connections_and_many_tabs_leave_it_running() {
    let folder = tempfile::tempdir().unwrap();
    let mut studio = Studio::start(&["--procedural", "4"], folder.path());
    let sessions: Vec<String> = (0..40).map(|_| studio.session()).collect();
    // The oldest ended.
    assert_eq!(studio.post("/offered", Some(&sessions[0]), "").0, 401);
    let session = &sessions[39];
    for _ in 0..20 {
        let body = wanted(3, 7, &[0, 1]).to_string();
        drop(sent(&studio, "/drive", session, &body));
        // Half of one.
        let mut stream = TcpStream::connect(&studio.address).unwrap();
        let (host, length) = (&studio.address, body.len());
        let head = format!("POST /drive HTTP/1.1\r\nHost: {host}\r\nContent-Length: {length}\r\n\r\n");
        stream.write_all((head + &body[..length / 2]).as_bytes()).unwrap();
    }
    // Of requests at once the newest is always answered; older ones may be given up.
    std::thread::scope(|scope| {
        let asked: Vec<_> = (0..8)
            .map(|step| {
                let (studio, body) = (&studio, wanted(step % 4, step, &[0]).to_string());
                scope.spawn(move || studio.post("/drive", Some(session), &body).0)
            })
            .collect();
        let found: Vec<u16> = asked.into_iter().map(|thread| thread.join().unwrap()).collect();
        assert!(found.contains(&200) && found.iter().all(|status| [200, 204].contains(status)), "{found:?}");
    });
    assert_eq!(studio.post("/drive", Some(&sessions[20]), &wanted(0, 0, &[0]).to_string()).0, 200);
}
