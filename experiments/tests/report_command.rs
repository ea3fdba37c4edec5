//! `sage report`: failures as a page.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod found_failures;
mod program;

use std::{
    fs,
    path::{Path, PathBuf},
};

use found_failures::*;
use insta::assert_snapshot;
use program::*;
use serde_json::Value;

/// The data of a page.
fn data_of(page: &Path) -> Value {
    let page = fs::read_to_string(page).unwrap();
    let (_, data) = page.split_once("type=\"application/json\">").unwrap();
    serde_json::from_str(data.split_once("</script>").unwrap().0).unwrap()
}

#[test]
fn a_report_shows_every_failure_of_all_searches_and_needs_no_network() {
    let desk = Desk::new();
    let search = ["search", &desk.at("scenes"), "--ego", "expert", "--budget", "10", "--format", "native"];
    stdout(&sage(&[&search[..], &WEIGHTS, &["--out", &desk.at("expert")]].concat()));
    stdout(&sage(&["report", &desk.at("found"), &desk.at("expert"), "--out", &desk.at("report")]));
    let data = data_of(&desk.path("report/index.html"));
    let failures = data["items"].as_array().unwrap();
    let rows = |folder: &str| -> Vec<Value> {
        let names = fs::read_dir(desk.path(folder)).unwrap().map(|entry| entry.unwrap().path());
        let is_row = |path: &PathBuf| {
            let name = path.file_name().unwrap().to_str().unwrap();
            name.ends_with(".json")
                && !name.contains("-failure")
                && !name.contains("-drives")
                && name != "run.json"
        };
        names.filter(is_row).map(|path| serde_json::from_slice(&fs::read(path).unwrap()).unwrap()).collect()
    };
    let all: Vec<Value> = [rows("found"), rows("expert")].concat();
    let count: u64 = all.iter().map(|row| row["failures"].as_u64().unwrap()).sum();
    let without = all.iter().filter(|row| row["failures"] == 0).count();
    assert_eq!((failures.len() as u64, data["without"].as_array().unwrap().len()), (count, without));
    assert_eq!(data["title"], "Failures of idm, expert");
    let mut scenes = std::collections::HashSet::new();
    for failure in failures {
        let (page, id) = failure["page"].as_str().unwrap().split_once('#').unwrap();
        let drives = data_of(&desk.path("report").join(page));
        let panels = drives["panels"].as_array().unwrap();
        let panel = panels.iter().find(|panel| panel["id"] == id).unwrap();
        // The drive ends at its contact, with the names of the list.
        let last = panel["end"].as_u64().unwrap();
        assert_eq!(last - 10, (10.0 * failure["contact_after"].as_f64().unwrap()).round() as u64);
        assert_eq!(panel["contact"]["frame"].as_u64(), Some(last));
        assert!(panel["name"].as_str().unwrap().contains(failure["cluster"].as_str().unwrap()));
        assert!(panel["ghost"].is_object() && drives["back"] == "../index.html");
        scenes.insert(failure["scene"].as_u64().unwrap());
    }
    // A scene that both drivers fail in is one scene.
    assert_eq!(scenes.len(), data["scenes"].as_array().unwrap().len());
    let page = fs::read_to_string(desk.path("report/index.html")).unwrap();
    for outside in ["http:", "https:", "src=", "@import", "url(", "fetch(", "innerHTML"] {
        assert!(!page.contains(outside), "{outside}");
    }
    stdout(&sage(&["report", &desk.at("found"), "--keep", "worst", "--out", &desk.at("worst")]));
    let worst = data_of(&desk.path("worst/index.html"))["items"].as_array().unwrap().len();
    assert_eq!(worst, rows("found").iter().filter(|row| row["failures"].as_u64() > Some(0)).count());
    let refused = sage(&["report", &desk.at("scenes"), "--out", &desk.at("no")]);
    assert!(stderr(&refused).contains("it is no output of `sage search`"), "{}", stderr(&refused));
}

#[test]
fn a_report_replaces_the_pages_of_an_earlier_one_and_refuses_rows_that_no_search_writes() {
    let desk = Desk::new();
    let report = |more: &[&str]| {
        sage(&[&["report", &desk.at("found"), "--out", &desk.at("report"), "--force"], more].concat())
    };
    let pages = || fs::read_dir(desk.path("report/scenes")).unwrap().count();
    stdout(&report(&[]));
    let all = pages();
    let row = fs::read_dir(desk.path("found")).unwrap().map(|entry| entry.unwrap().path());
    let row = row.filter(|path| path.to_str().unwrap().ends_with("-failure1.json")).min().unwrap();
    let whole = fs::read(&row).unwrap();
    let refused = |change: &dyn Fn(&mut Value)| {
        let mut changed: Value = serde_json::from_slice(&whole).unwrap();
        change(&mut changed);
        fs::write(&row, changed.to_string()).unwrap();
        let output = report(&[]);
        assert_eq!(output.status.code(), Some(1));
        stderr(&output).replace(&desk.at(""), "[folder]/")
    };
    let mut said = vec![
        ("no history", refused(&|row| drop(row.as_object_mut().unwrap().remove("ego_history")))),
        ("a short history", refused(&|row| drop(row["ego_history"].as_array_mut().unwrap().pop()))),
        ("a million poses", refused(&|row| row["witness"] = vec![[0.0; 3]; 1_000_000].into())),
        ("far away", refused(&|row| row["ego_history"][3][0] = 1e300.into())),
        ("no contact", refused(&|row| row["contact"] = Value::Null)),
        ("a late contact", refused(&|row| row["contact"]["step"] = 81.into())),
    ];
    said.iter_mut().for_each(|(_, text)| *text = text.lines().last().unwrap_or_default().to_owned());
    assert_snapshot!("refused_rows", messages(said));
    fs::write(&row, whole).unwrap();
    // Without its other scenes: their pages go.
    let scene = row.file_name().unwrap().to_str().unwrap().replace("-failure1.json", ".pkl");
    let one = desk.path("scenes").join(scene).display().to_string();
    let search = ["search", &one, "--ego", "idm", "--budget", "10", "--force", "--out", &desk.at("found")];
    stdout(&sage(&[&search[..], &WEIGHTS].concat()));
    stdout(&report(&[]));
    assert!(all > 1 && pages() == 1, "{all} pages, then {}", pages());
}

#[cfg(unix)]
#[test]
fn names_of_strangers_are_text_in_a_report() {
    let desk = Desk::new();
    let name = "<img src=x onerror=alert(1)> {{SCRIPT}} ''#?%.pkl";
    let scenes = fs::read_dir(desk.path("scenes")).unwrap().map(|entry| entry.unwrap().path());
    let mut scenes: Vec<PathBuf> =
        scenes.filter(|path| path.extension().is_some_and(|e| e == "pkl")).collect();
    scenes.retain(|path| !path.file_name().unwrap().to_str().unwrap().starts_with("dataset"));
    scenes.sort();
    fs::create_dir(desk.path("strange")).unwrap();
    for (k, scene) in scenes.iter().enumerate() {
        fs::copy(scene, desk.path("strange").join(format!("{k}{name}"))).unwrap();
    }
    let search =
        ["search", &desk.at("strange"), "--ego", "idm", "--budget", "10", "--out", &desk.at("strange-found")];
    stdout(&sage(&[&search[..], &WEIGHTS].concat()));
    stdout(&sage(&["report", &desk.at("strange-found"), "--out", &desk.at("report")]));
    let page = fs::read_to_string(desk.path("report/index.html")).unwrap();
    assert!(!page.contains("<img"), "no name is markup");
    let data = data_of(&desk.path("report/index.html"));
    assert!(data["scenes"][0]["name"].as_str().unwrap().contains("<img src=x"));
    for failure in data["items"].as_array().unwrap() {
        let page = failure["page"].as_str().unwrap().split('#').next().unwrap();
        assert!(page.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"/.-_".contains(&byte)), "{page}");
        assert!(desk.path("report").join(page).is_file());
    }
}
