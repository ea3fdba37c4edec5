//! Failures that a search has found, for tests of what is made of them.

#![allow(dead_code)] // Each test program uses a part of it.

use std::{fs, path::PathBuf, process::Output};

use serde_json::Value;

use crate::program::*;

/// A folder with six procedural scenes, a search of them with `idm`, and a suite of all its failures.
pub struct Desk {
    pub folder: tempfile::TempDir,
}

impl Desk {
    pub fn new() -> Self {
        let desk = Self { folder: tempfile::tempdir().unwrap() };
        stdout(&sage(&["scenes", "--count", "6", "--format", "pickle", "--out", &desk.at("scenes")]));
        let search = ["search", &desk.at("scenes"), "--ego", "idm", "--budget", "10"];
        stdout(&sage(&[&search[..], &WEIGHTS, &["--out", &desk.at("found")]].concat()));
        stdout(&sage(&["suite", &desk.at("found"), "--keep", "all", "--out", &desk.at("suite")]));
        desk
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    pub fn at(&self, name: &str) -> String {
        self.path(name).display().to_string()
    }

    pub fn test(&self, ego: &str, more: &[&str]) -> Output {
        sage(&[&["test", &self.at("suite"), "--ego", ego][..], more].concat())
    }

    pub fn suite(&self) -> Value {
        serde_json::from_slice(&fs::read(self.path("suite/suite.json")).unwrap()).unwrap()
    }
}

pub fn results(output: &Output) -> Vec<Value> {
    let lines = std::str::from_utf8(&output.stdout).unwrap().lines();
    lines.map(|line| serde_json::from_str(line).unwrap()).collect()
}
