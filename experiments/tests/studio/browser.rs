//! A browser that a test drives, by the WebDriver protocol.

#![allow(dead_code, clippy::print_stderr)] // Each program uses a part of it.

use std::{
    io::{BufRead as _, BufReader, Read as _, Write as _},
    net::TcpStream,
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};

use serde_json::{Value, json};

pub struct Browser {
    driver: Child,
    address: String,
    session: String,
}

impl Browser {
    /// `None`, with a note, where there is no Chromium with its driver, or it does not start.
    pub fn start(width: u32, height: u32) -> Option<Self> {
        let started = Self::started(width, height);
        if started.is_none() {
            eprintln!(
                "left out: the page of the studio needs Chromium with ChromeDriver (or SAGE_CHROMEDRIVER)"
            );
        }
        started
    }

    fn started(width: u32, height: u32) -> Option<Self> {
        let driver = std::env::var("SAGE_CHROMEDRIVER").unwrap_or_else(|_| "chromedriver".to_owned());
        let mut driver = Command::new(driver).arg("--port=0").stdout(Stdio::piped()).spawn().ok()?;
        let mut lines = BufReader::new(driver.stdout.take().unwrap()).lines();
        let port = lines.find_map(|line| {
            let line = line.ok()?;
            let port =
                line.split_once("started successfully on port ")?.1.trim_end_matches('.').parse::<u16>();
            port.ok()
        });
        let port = port?;
        // What it goes on to print must find a reader.
        std::thread::spawn(move || lines.for_each(drop));
        let mut browser = Self { driver, address: format!("127.0.0.1:{port}"), session: String::new() };
        let arguments = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking"];
        let size = format!("--window-size={width},{height}");
        let arguments: Vec<&str> = arguments.into_iter().chain([&*size]).collect();
        let wanted = json!({"capabilities": {"alwaysMatch": {
            "goog:chromeOptions": {"args": arguments},
            "goog:loggingPrefs": {"browser": "ALL"},
        }}});
        let made = browser.ask("POST", "/session", &wanted)?;
        browser.session = format!("/session/{}", made["sessionId"].as_str()?);
        Some(browser)
    }

    fn ask(&self, method: &str, path: &str, body: &Value) -> Option<Value> {
        let mut stream = TcpStream::connect(&self.address).ok()?;
        stream.set_read_timeout(Some(Duration::from_secs(60))).ok()?;
        let body = if method == "GET" { String::new() } else { body.to_string() };
        let head = format!(
            "{method} {path} HTTP/1.1\r\nHost: {}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
            self.address,
            body.len()
        );
        stream.write_all((head + &body).as_bytes()).ok()?;
        // It keeps connections open, whatever it is asked.
        let mut answer = BufReader::new(stream);
        let (mut line, mut length) = (String::new(), 0);
        while answer.read_line(&mut line).ok()? > 2 {
            if let Some((_, value)) = line.to_lowercase().split_once("content-length:") {
                length = value.trim().parse().ok()?;
            }
            line.clear();
        }
        let mut body = vec![0; length];
        answer.read_exact(&mut body).ok()?;
        let value: Value = serde_json::from_slice(&body).ok()?;
        if let Some(error) = value["value"].get("error") {
            eprintln!("{path}: {error}: {}", value["value"]["message"]);
            return None;
        }
        Some(value["value"].clone())
    }

    fn of_session(&self, method: &str, path: &str, body: &Value) -> Value {
        self.ask(method, &format!("{}{path}", self.session), body).expect("the browser answers")
    }

    pub fn open(&self, link: &str) {
        self.of_session("POST", "/url", &json!({"url": link}));
    }

    /// What a function body of JavaScript returns.
    pub fn run(&self, script: &str) -> Value {
        self.of_session("POST", "/execute/sync", &json!({"script": script, "args": []}))
    }

    /// What a function body gives to its last argument, which is a function.
    pub fn run_async(&self, script: &str) -> Value {
        self.of_session("POST", "/execute/async", &json!({"script": script, "args": []}))
    }

    /// Waits until an expression is true.
    pub fn wait(&self, expression: &str) {
        let start = Instant::now();
        while self.run(&format!("return Boolean({expression})")) != true {
            assert!(
                start.elapsed() < Duration::from_secs(30),
                "{expression} after 30 s: {}",
                self.messages()
            );
            std::thread::sleep(Duration::from_millis(20));
        }
    }

    /// Presses keys, one after the other; `\u{E00C}` is Escape, `\u{E004}` Tab.
    pub fn press(&self, keys: &str) {
        let each = keys.chars().flat_map(|key| {
            [json!({"type": "keyDown", "value": key}), json!({"type": "keyUp", "value": key})]
        });
        let actions: Vec<Value> = each.collect();
        self.of_session(
            "POST",
            "/actions",
            &json!({"actions": [{"type": "key", "id": "keys", "actions": actions}]}),
        );
    }

    /// Presses the mouse at the first place and releases it at the last.
    pub fn drag(&self, places: &[[f64; 2]]) {
        let to =
            |[x, y]: [f64; 2]| json!({"type": "pointerMove", "duration": 50, "x": x.round(), "y": y.round()});
        let mut actions = vec![to(places[0]), json!({"type": "pointerDown", "button": 0})];
        actions.extend(places[1..].iter().map(|place| to(*place)));
        actions.push(json!({"type": "pointerUp", "button": 0}));
        let mouse = json!({"type": "pointer", "id": "mouse", "parameters": {"pointerType": "mouse"}, "actions": actions});
        self.of_session("POST", "/actions", &json!({"actions": [mouse]}));
    }

    /// Tells the page that its reader prefers dark pages.
    pub fn at_night(&self) {
        let feature = json!({"name": "prefers-color-scheme", "value": "dark"});
        let wanted = json!({"cmd": "Emulation.setEmulatedMedia", "params": {"features": [feature]}});
        self.of_session("POST", "/goog/cdp/execute", &wanted);
    }

    /// Messages of the page: errors of scripts, and what the policy of its content refused.
    pub fn messages(&self) -> String {
        let all = self.of_session("POST", "/se/log", &json!({"type": "browser"}));
        let all = all.as_array().into_iter().flatten().filter_map(|one| one["message"].as_str());
        all.collect::<Vec<_>>().join("\n")
    }
}

impl Drop for Browser {
    fn drop(&mut self) {
        let _ = self.ask("DELETE", &self.session, &json!({}));
        let _ = self.driver.kill();
        let _ = self.driver.wait();
    }
}
