//! `sage studio` answers its page alone, and goes on whatever it is asked.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod studio;

use std::{
    fs,
    io::{Read as _, Write as _},
    net::TcpStream,
};

use serde_json::{Value, json};
use studio::{Studio, wanted};

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
