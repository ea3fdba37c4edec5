//! A running `sage studio`, and requests to it as a browser sends them.

#![allow(dead_code, clippy::unwrap_used)] // Each test program uses a part of it. A failed unwrap is a failed test.

use std::{
    io::{BufRead as _, BufReader, Read as _, Write as _},
    net::TcpStream,
    path::Path,
    process::{Child, ChildStderr, Command, Stdio},
    time::Duration,
};

use serde_json::{Value, json};

/// What the page asks for: drivers in a scene, attacked by the first generator at a place of λ.
pub fn wanted(scene: usize, step: usize, drivers: &[usize]) -> Value {
    json!({"scene": scene, "generator": 0, "dial": "lambda", "step": step, "drivers": drivers, "adversary": null, "without": [], "goal": null})
}

/// The lines of an answer that comes in several.
pub fn lines(answer: &str) -> Vec<Value> {
    answer
        .lines()
        .filter(|line| line.starts_with('{'))
        .map(|line| serde_json::from_str(line).unwrap())
        .collect()
}

/// One that ends with the test.
pub struct Studio {
    program: Child,
    messages: BufReader<ChildStderr>,
    pub address: String,
    /// The key of the newest link.
    pub key: String,
}

impl Studio {
    pub fn start(arguments: &[&str], folder: &Path) -> Self {
        let mut program =
            Command::new(std::env::var("SAGE_COMMAND").unwrap_or(env!("CARGO_BIN_EXE_sage").to_owned()))
                .arg("studio")
                .args(arguments)
                .current_dir(folder)
                .env_remove("SAGE_WEIGHTS")
                .stderr(Stdio::piped())
                .spawn()
                .unwrap();
        let messages = BufReader::new(program.stderr.take().unwrap());
        let mut studio = Self { program, messages, address: String::new(), key: String::new() };
        studio.read_link();
        studio
    }

    /// Waits for the next link that is printed.
    pub fn read_link(&mut self) {
        let mut line = String::new();
        loop {
            line.clear();
            assert!(self.messages.read_line(&mut line).unwrap() > 0, "it ended without a link");
            let Some((_, link)) = line.split_once("http://") else { continue };
            let (address, key) = link.trim().split_once("/#key=").unwrap();
            (self.address, self.key) = (address.to_owned(), key.to_owned());
            return;
        }
    }

    pub fn link(&self) -> String {
        format!("http://{}/#key={}", self.address, self.key)
    }

    /// A session, as the page opens it.
    pub fn session(&mut self) -> String {
        let (status, answer) = self.post("/session", None, &serde_json::json!({"key": self.key}).to_string());
        assert_eq!(status, 200, "{answer}");
        self.read_link();
        serde_json::from_str::<Value>(&answer).unwrap()["session"].as_str().unwrap().to_owned()
    }

    pub fn post(&self, path: &str, session: Option<&str>, body: &str) -> (u16, String) {
        let session = session.map(|session| format!("X-Session: {session}\r\n")).unwrap_or_default();
        let head = format!(
            "POST {path} HTTP/1.1\r\nHost: {}\r\n{session}Content-Type: application/json\r\nContent-Length: {}\r\n",
            self.address,
            body.len()
        );
        self.send(&format!("{head}Connection: close\r\n\r\n{body}"))
    }

    /// Status and body of the answer to a whole request; 0 if the connection ends without one.
    pub fn send(&self, request: &str) -> (u16, String) {
        let mut stream = TcpStream::connect(&self.address).unwrap();
        stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
        // The server may answer, and close, before it has read all.
        let _ = stream.write_all(request.as_bytes());
        let mut answer = Vec::new();
        let _ = stream.read_to_end(&mut answer);
        let answer = String::from_utf8_lossy(&answer).into_owned();
        let (head, body) = answer.split_once("\r\n\r\n").unwrap_or((&answer, ""));
        let status = head.split(' ').nth(1).and_then(|status| status.parse().ok()).unwrap_or(0);
        (status, body.to_owned())
    }
}

impl Drop for Studio {
    fn drop(&mut self) {
        let _ = self.program.kill();
        let _ = self.program.wait();
    }
}
