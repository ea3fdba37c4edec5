//! The layers of the workspace: which crate may use which, and no circle of uses between the files of a crate.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
};

/// The crates of the workspace that each crate may depend on.
const MAY_USE: [(&str, &[&str]); 14] = [
    ("sage-core", &[]),
    ("weights", &[]),
    ("sage-data", &["sage-core"]),
    ("sage-backbones", &["sage-core"]),
    ("sage-merging", &["sage-core", "sage-backbones"]),
    ("sage-generators", &["sage-core", "sage-backbones", "sage-merging"]),
    ("sage-sim", &["sage-core", "sage-weights"]),
    ("theory_checks", &["sage-core"]),
    (
        "advsage",
        &[
            "sage-core",
            "sage-data",
            "sage-backbones",
            "sage-merging",
            "sage-generators",
            "sage-sim",
            "sage-weights",
        ],
    ),
    ("sage-view", &["sage-core", "sage-sim", "advsage"]),
    (
        "sage-run",
        &[
            "sage-core",
            "sage-data",
            "sage-backbones",
            "sage-merging",
            "sage-generators",
            "sage-sim",
            "advsage",
            "sage-view",
        ],
    ),
    (
        "sage-bench",
        &[
            "sage-core",
            "sage-data",
            "sage-backbones",
            "sage-merging",
            "sage-generators",
            "sage-sim",
            "theory_checks",
            "advsage",
        ],
    ),
    (
        "experiments",
        &[
            "sage-core",
            "sage-data",
            "sage-backbones",
            "sage-merging",
            "sage-generators",
            "sage-sim",
            "theory_checks",
            "advsage",
            "sage-view",
            "sage-run",
            "sage-bench",
        ],
    ),
    (
        "sage-python",
        &[
            "sage-core",
            "sage-data",
            "sage-backbones",
            "sage-merging",
            "sage-generators",
            "sage-sim",
            "advsage",
            "sage-view",
            "sage-run",
            "sage-bench",
        ],
    ),
];

fn workspace() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

#[test]
fn each_crate_depends_on_lower_layers_alone() {
    for (name, allowed) in MAY_USE {
        let manifest = fs::read_to_string(workspace().join(name).join("Cargo.toml")).unwrap();
        let sections = manifest.split("\n[");
        let dependencies = sections.into_iter().find_map(|section| section.strip_prefix("dependencies]"));
        let own = |line: &str| {
            let name = line.split(['.', '=', ' ']).next().unwrap_or_default().to_owned();
            let is_own = ["theory_checks", "experiments", "advsage"].contains(&&*name);
            (is_own || name.starts_with("sage-")).then_some(name)
        };
        for dependency in dependencies.unwrap_or_default().lines().filter_map(own) {
            assert!(allowed.contains(&&*dependency), "{name} depends on {dependency}");
        }
    }
}

/// A module of a crate: the names on its path.
type Module = Vec<String>;

/// The modules of a crate with their text, without tests and comments.
fn modules(source: &Path) -> BTreeMap<Module, String> {
    let mut found = BTreeMap::new();
    let mut folders = vec![source.to_owned()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).expect("a folder of sources") {
            let path = entry.expect("a file of sources").path();
            if path.is_dir() {
                folders.push(path);
                continue;
            }
            let relative = path.strip_prefix(source).expect("a path within the sources").with_extension("");
            let mut module: Module =
                relative.iter().map(|part| part.to_str().expect("a plain name").to_owned()).collect();
            if path.extension().is_none_or(|kind| kind != "rs") || module.iter().any(|part| part == "tests") {
                continue;
            }
            if ["lib", "main"].contains(&&*module[module.len() - 1]) {
                module.pop();
            }
            let text = fs::read_to_string(&path).expect("a source file");
            let text = text.split("#[cfg(test)]").next().unwrap_or_default();
            let code = text.lines().map(|line| line.split("//").next().unwrap_or_default());
            found.insert(module, code.collect::<Vec<_>>().join("\n"));
        }
    }
    found
}

/// The paths that a use declaration names: `a::{b, c::d}` names `a::b` and `a::c::d`.
fn paths(declaration: &str) -> Vec<Vec<String>> {
    let names = |text: &str| -> Vec<String> {
        let names = text.split("::").map(|name| name.split_whitespace().next().unwrap_or_default());
        names.filter(|name| !name.is_empty()).map(str::to_owned).collect()
    };
    let Some((head, body)) = declaration.split_once('{') else { return vec![names(declaration)] };
    let body = body.rsplit_once('}').map_or(body, |(body, _)| body);
    let (mut parts, mut depth) = (vec![String::new()], 0);
    for letter in body.chars() {
        match letter {
            '{' => depth += 1,
            '}' => depth -= 1,
            _ => {}
        }
        if letter == ',' && depth == 0 {
            parts.push(String::new());
        } else if let Some(part) = parts.last_mut() {
            part.push(letter);
        }
    }
    let inner = parts.iter().filter(|part| !part.trim().is_empty()).flat_map(|part| paths(part.trim()));
    inner.map(|path| [names(head), path].concat()).collect()
}

/// The other modules that a module uses. A module and its parent belong together.
fn uses(module: &Module, text: &str, known: &BTreeMap<Module, String>) -> BTreeSet<Module> {
    let declarations = text.split(';').filter_map(|statement| {
        let at = statement.rfind("use ")?;
        let is_word = at == 0 || statement[..at].ends_with(char::is_whitespace);
        is_word.then(|| &statement[at + 4..])
    });
    let mut found = BTreeSet::new();
    for path in declarations.flat_map(paths) {
        let ups = path.iter().take_while(|name| *name == "super").count();
        let mut target: Module = match path.first().map(String::as_str) {
            Some("crate") => path[1..].to_vec(),
            Some("super") => [&module[..module.len() - ups.min(module.len())], &path[ups..]].concat(),
            _ => continue,
        };
        while !known.contains_key(&target) {
            target.pop();
        }
        if !target.starts_with(module) && !module.starts_with(&target) {
            found.insert(target);
        }
    }
    found
}

/// A circle of uses that leads from a module back to itself.
fn circle(from: &Module, graph: &BTreeMap<Module, BTreeSet<Module>>) -> Option<Vec<Module>> {
    let mut came: BTreeMap<&Module, &Module> = BTreeMap::new();
    let mut waiting = vec![from];
    while let Some(module) = waiting.pop() {
        for next in &graph[module] {
            if next == from {
                let mut circle = vec![from.clone(), module.clone()];
                let mut at = module;
                while let Some(before) = came.get(at) {
                    circle.push((*before).clone());
                    at = before;
                }
                return Some(circle);
            }
            if !came.contains_key(next) {
                came.insert(next, module);
                waiting.push(next);
            }
        }
    }
    None
}

#[test]
fn no_file_uses_another_in_a_circle() {
    for (name, _) in MAY_USE {
        let known = modules(&workspace().join(name).join("src"));
        let graph: BTreeMap<Module, BTreeSet<Module>> =
            known.iter().map(|(module, text)| (module.clone(), uses(module, text, &known))).collect();
        for module in graph.keys() {
            let found = circle(module, &graph).map(|circle| {
                circle.iter().rev().map(|module| module.join("::")).collect::<Vec<_>>().join(" uses ")
            });
            assert_eq!(found, None, "{name}");
        }
    }
}

#[test]
fn circles_are_found() {
    let text = |of: &[(&str, &str)]| -> BTreeMap<Module, String> {
        let module = |path: &str| path.split("::").filter(|n| !n.is_empty()).map(str::to_owned).collect();
        of.iter().map(|(path, text)| (module(path), (*text).to_owned())).collect()
    };
    let known = text(&[
        ("", ""),
        ("a", "use crate::{b::Thing, c};"),
        ("b", "pub use crate::c::d::Other;"),
        ("c", ""),
        ("c::d", "use super::super::a;\nfn f() {}"),
    ]);
    let graph: BTreeMap<Module, BTreeSet<Module>> =
        known.iter().map(|(module, text)| (module.clone(), uses(module, text, &known))).collect();
    let found = circle(&vec!["a".to_owned()], &graph).unwrap();
    assert_eq!(found.len(), 3 + 1, "{found:?}");
    assert_eq!(circle(&vec!["c".to_owned()], &graph), None);
}
