//! Every page that a command writes, in a browser as wide as a phone. Left out, with a note, where there is no Chromium.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod found_failures;
mod program;

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use found_failures::*;
use program::*;

/// Width of a common phone, CSS pixels.
const PHONE: u32 = 390;

/// Names of the browser.
const BROWSERS: [&str; 4] = ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable"];

/// The browser, from `SAGE_CHROMIUM` or by a common name.
fn browser() -> Option<String> {
    let named = std::env::var("SAGE_CHROMIUM").ok();
    let known = named.into_iter().chain(BROWSERS.map(str::to_owned));
    let runs =
        |name: &String| Command::new(name).arg("--version").output().is_ok_and(|run| run.status.success());
    known.into_iter().find(runs)
}

/// All pages below a folder.
fn pages(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()) {
        if entry.is_dir() {
            pages(&entry, found);
        } else if entry.extension().is_some_and(|ending| ending == "html") {
            found.push(entry);
        }
    }
}

/// What is asked of a page in a frame: how wide it is, its title, and how much text it shows.
const PROBE: &str = r#"<script>
window.addEventListener("load", () => setTimeout(() => {
  const lines = [...document.querySelectorAll("iframe")].map((frame) => {
    const page = frame.contentDocument, root = page.documentElement;
    const view = Math.max(-1, ...[...page.querySelectorAll(".view")].map((v) => v.getBoundingClientRect().height / frame.clientHeight));
    return ["PAGE", frame.dataset.name, root.scrollWidth, page.title.length, page.body.innerText.trim().length, view.toFixed(2)].join("|");
  });
  document.body.innerHTML = "<pre>" + lines.join("\n") + "</pre>";
}, 1500));
</script>"#;

#[test]
fn every_page_fits_a_phone_without_scrolling_sideways() {
    let Some(browser) = browser() else {
        return eprintln!("left out: pages on a phone need Chromium (or SAGE_CHROMIUM)");
    };
    let desk = Desk::new();
    let at = |name: &str| desk.at(name);
    let sweep = ["generate", &at("scenes"), "--lambda", "0:1:0.25", "--format", "rows", "--quiet"];
    stdout(&sage(&[&sweep[..], &["--out", &at("pages/attacks")]].concat()));
    stdout(&sage(&["generate", &example(), "--out", &at("pages/attack")]));
    let drive =
        ["simulate", &at("scenes"), "--ego", "replay,idm,expert", "--method", "sage", "--lambda", "0,1"];
    stdout(&sage(&[&drive[..], &["--out", &at("pages/drives")]].concat()));
    let drive = ["simulate", &example(), "--ego", "idm", "--method", "sage", "--lambda", "0:1:0.1"];
    stdout(&sage(&[&drive[..], &["--out", &at("pages/sweep")]].concat()));
    stdout(&sage(&["report", &at("found"), "--out", &at("pages/report")]));
    stdout(&sage(&["theory", "--instances", "20", "--out", &at("pages/theory")]));
    stdout(&sage(&[
        "bench",
        "open-loop",
        &at("scenes"),
        "--method",
        "log,sage",
        "--out",
        &at("pages/table"),
    ]));
    let mut all = Vec::new();
    pages(&desk.path("pages"), &mut all);
    assert!(all.len() > 20, "{all:?}");
    let frame = |page: &PathBuf| {
        let name = page.strip_prefix(desk.path("pages")).unwrap().display().to_string();
        format!(
            "<iframe data-name=\"{name}\" src=\"pages/{name}\" style=\"width:{PHONE}px;height:844px;border:0\"></iframe>"
        )
    };
    let frames: String = all.iter().map(frame).collect();
    fs::write(desk.path("probe.html"), format!("<!doctype html>{PROBE}<body>{frames}</body>")).unwrap();
    let output = Command::new(browser)
        .args(["--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking"])
        .args(["--allow-file-access-from-files", "--disable-web-security"])
        .arg(format!("--user-data-dir={}", at("profile")))
        .args(["--virtual-time-budget=20000", "--timeout=60000", "--dump-dom"])
        .arg(format!("file://{}", at("probe.html")))
        .output()
        .unwrap();
    let dom = String::from_utf8_lossy(&output.stdout).into_owned();
    let found: Vec<Vec<&str>> = dom
        .lines()
        .filter_map(|line| Some(line.split_once("PAGE|")?.1.split("</pre>").next()?.split('|').collect()))
        .collect();
    assert_eq!(found.len(), all.len(), "{dom}");
    let number = |text: &str| text.parse::<f64>().unwrap();
    for page in found {
        let [name, width, title, text, view] = page[..] else { panic!("{page:?}") };
        assert!(number(width) <= f64::from(PHONE), "{name} is {width} px wide");
        assert!(number(title) > 0.0 && number(text) > 20.0, "{name} shows nothing: {page:?}");
        // Pages that play a scene give it most of the screen.
        assert!(number(view) < 0.0 || number(view) > 0.45, "{name}: the scene has {view} of the height");
    }
}
