//! The layers of the workspace: which crate may use which, and no circle of uses between the files of a crate.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    path::{Path, PathBuf},
};

/// The crates of the workspace from the lowest layer to the highest, each with the lower ones that it may not depend on.
const LAYERS: [(&str, &[&str]); 17] = [
    ("sage-core", &[]),
    ("weights", &["sage-core"]),
    ("sage-data", &["sage-weights"]),
    ("sage-backbones", &["sage-weights", "sage-data"]),
    ("sage-merging", &["sage-weights", "sage-data"]),
    ("sage-generators", &["sage-weights", "sage-data"]),
    ("sage-sim", &["sage-data", "sage-backbones", "sage-merging", "sage-generators"]),
    ("sage-baselines", &["sage-weights", "sage-data"]),
    (
        "sage-learn",
        &["sage-weights", "sage-data", "sage-backbones", "sage-merging", "sage-generators", "sage-baselines"],
    ),
    (
        "sage-view",
        &[
            "sage-weights",
            "sage-data",
            "sage-backbones",
            "sage-merging",
            "sage-generators",
            "sage-baselines",
            "sage-learn",
        ],
    ),
    (
        "theory_checks",
        &[
            "sage-weights",
            "sage-data",
            "sage-backbones",
            "sage-merging",
            "sage-generators",
            "sage-sim",
            "sage-baselines",
            "sage-learn",
            "sage-view",
        ],
    ),
    ("advsage", &["theory_checks"]),
    ("sage-run", &["sage-weights", "sage-baselines", "sage-learn", "theory_checks"]),
    ("sage-bench", &["sage-weights", "sage-view", "sage-run"]),
    ("experiments", &["sage-weights"]),
    ("sage-python", &["sage-weights", "sage-baselines", "theory_checks", "sage-bench", "experiments"]),
    ("sage-python/module", &[]),
];

fn workspace() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn manifest(name: &str) -> String {
    fs::read_to_string(workspace().join(name).join("Cargo.toml")).expect("each crate has a manifest")
}

#[test]
fn each_crate_depends_on_lower_layers_alone() {
    let package = |folder: &'static str| if folder == "weights" { "sage-weights" } else { folder };
    for (at, (name, refused)) in LAYERS.iter().enumerate() {
        let manifest = manifest(name);
        let dependencies = manifest.split("\n[").find_map(|section| section.strip_prefix("dependencies]"));
        for line in dependencies.unwrap_or_default().lines() {
            let found = line.split(['.', '=', ' ']).next().unwrap_or_default();
            let Some(layer) = LAYERS.iter().position(|(folder, _)| package(folder) == found) else {
                continue;
            };
            assert!(layer < at && !refused.contains(&found), "{name} depends on {found}");
        }
    }
    let members = manifest("");
    let members = members.lines().find_map(|line| line.strip_prefix("members = ")).unwrap();
    assert_eq!(
        members.matches('"').count() / 2,
        LAYERS.len() + 1,
        "each crate but `workspace-hack` has a layer"
    );
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

/// The use declarations of a text, and whether each is a re-export.
fn declarations(text: &str) -> impl Iterator<Item = (&str, bool)> {
    text.split(';').filter_map(|statement| {
        let at = statement.rfind("use ")?;
        let before = statement[..at].trim_end();
        let is_word = at == 0 || statement[..at].ends_with(char::is_whitespace);
        let is_public = before.ends_with("pub") || (before.ends_with(')') && before.contains("pub("));
        is_word.then(|| (&statement[at + 4..], is_public))
    })
}

/// The paths in the code of a text apart from its declarations, such as `fault::class`.
fn paths_in_code(text: &str) -> Vec<Module> {
    let code: Vec<&str> = text
        .split(';')
        .map(|statement| {
            let declaration = declarations(statement).next().map_or(0, |(declared, _)| declared.len() + 4);
            &statement[..statement.len() - declaration]
        })
        .collect();
    let is_of_path = |c: char| c.is_alphanumeric() || c == '_' || c == ':';
    let words = code.iter().flat_map(|statement| statement.split(move |c| !is_of_path(c)));
    let paths = words.filter(|word| word.trim_matches(':').contains("::"));
    paths.map(|path| path.split("::").map(str::to_owned).collect()).collect()
}

/// The modules of a crate: their text, and what they re-export.
struct Crate {
    modules: BTreeMap<Module, String>,
    exports: BTreeMap<(Module, String), Module>,
}

impl Crate {
    fn new(modules: BTreeMap<Module, String>) -> Self {
        let mut known = Self { modules, exports: BTreeMap::new() };
        for (module, text) in &known.modules {
            for path in declarations(text).filter(|(_, is_public)| *is_public).flat_map(|(d, _)| paths(d)) {
                if let (Some(target), Some(name)) = (known.absolute(module, &path), path.last()) {
                    known.exports.insert((module.clone(), name.clone()), target);
                }
            }
        }
        known
    }

    /// A path in a module as a path from the root; `None` if it leads into another crate.
    fn absolute(&self, module: &[String], path: &[String]) -> Option<Module> {
        let ups = path.iter().take_while(|name| *name == "super").count();
        let is_child =
            |name: &String| self.modules.contains_key(&[module, std::slice::from_ref(name)].concat());
        match path.first() {
            Some(first) if first == "crate" => Some(path[1..].to_vec()),
            Some(first) if first == "self" => Some([module, &path[1..]].concat()),
            Some(_) if ups > 0 => {
                Some([&module[..module.len() - ups.min(module.len())], &path[ups..]].concat())
            }
            Some(first) if is_child(first) => Some([module, path].concat()),
            _ => None,
        }
    }

    /// The module in which what a path names is defined, whoever exports it again.
    fn home(&self, path: &[String]) -> Module {
        let mut at = Module::new();
        for (k, name) in path.iter().enumerate() {
            let inner = [&at[..], std::slice::from_ref(name)].concat();
            if self.modules.contains_key(&inner) {
                at = inner;
                continue;
            }
            return match self.exports.get(&(at.clone(), name.clone())) {
                Some(target) if *target != inner => self.home(&[&target[..], &path[k + 1..]].concat()),
                _ => at,
            };
        }
        at
    }

    /// The other modules that a module uses: by declarations other than re-exports, and by paths in its code. A parent is a user of its
    /// children like any other module; what a module uses of those around it does not count.
    fn uses(&self, module: &Module, text: &str) -> BTreeSet<Module> {
        let (mut found, mut imported) = (BTreeSet::new(), BTreeMap::new());
        for path in declarations(text).filter(|(_, is_public)| !is_public).flat_map(|(d, _)| paths(d)) {
            let Some(mut target) = self.absolute(module, &path) else { continue };
            if target.last().is_some_and(|name| name == "self") {
                target.pop();
            }
            let home = self.home(&target);
            match target.last() {
                // The module itself is used where its name stands in the code.
                Some(name) if home.last() == Some(name) => drop(imported.insert(name.clone(), home)),
                _ => drop(found.insert(home)),
            }
        }
        for path in paths_in_code(text) {
            let target = match imported.get(&path[0]) {
                Some(of_import) => Some([of_import, &path[1..]].concat()),
                None => self.absolute(module, &path),
            };
            found.extend(target.map(|target| self.home(&target)));
        }
        found.retain(|target| target != module && !module.starts_with(target));
        found
    }

    fn graph(&self) -> BTreeMap<Module, BTreeSet<Module>> {
        self.modules.iter().map(|(module, text)| (module.clone(), self.uses(module, text))).collect()
    }
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
    for (name, _) in LAYERS {
        let graph = Crate::new(modules(&workspace().join(name).join("src"))).graph();
        for module in graph.keys() {
            let found = circle(module, &graph).map(|circle| {
                circle.iter().rev().map(|module| module.join("::")).collect::<Vec<_>>().join(" uses ")
            });
            assert_eq!(found, None, "{name}");
        }
    }
}

/// The circle from a module of an invented crate.
fn circle_in(from: &str, files: &[(&str, &str)]) -> Option<usize> {
    let module =
        |path: &str| path.split("::").filter(|n| !n.is_empty()).map(str::to_owned).collect::<Module>();
    let modules = files.iter().map(|(path, text)| (module(path), (*text).to_owned())).collect();
    circle(&module(from), &Crate::new(modules).graph()).map(|circle| circle.len() - 1)
}

#[test]
fn circles_are_found() {
    let files = [
        ("", ""),
        ("a", "use crate::{b::Thing, c};\nfn g() { c::f() }"),
        ("b", "pub use crate::c::d::Other;\nuse crate::c::d;\nfn g() { d::f() }"),
        ("c", "fn f() {}"),
        ("c::d", "use super::super::a;\nfn f() { a::g() }"),
    ];
    assert_eq!(circle_in("a", &files), Some(3));
    assert_eq!(circle_in("c", &files), None);
    // A parent uses its child, and another file what the parent defines.
    let parent = [
        ("p", "fn f() { child::g() }"),
        ("p::child", "use crate::q;\nfn g() { q::h() }"),
        ("q", "use crate::p::f;"),
    ];
    assert_eq!(circle_in("p", &parent), Some(3));
    // It only exports the child again: who uses that uses the child.
    let exports = [("p", "pub use child::g;"), ("p::child", "use crate::q::h;"), ("q", "use crate::p::g;")];
    assert_eq!(circle_in("p", &exports), None);
    assert_eq!(circle_in("q", &exports), Some(2));
}

#[test]
fn arguments_and_errors_without_a_type_are_of_the_command_alone() {
    for (name, _) in LAYERS.iter().filter(|(name, _)| *name != "experiments") {
        let manifest = manifest(name);
        assert!(!manifest.contains("anyhow"), "{name} depends on anyhow");
        // `advsage` derives the options of generators for the command, which alone turns that on.
        let is_wrong = |line: &str| match name {
            &"advsage" => {
                line.starts_with("clap") && !line.contains("optional") && !line.contains("dep:clap")
            }
            _ => line.starts_with("clap") || line.contains("\"clap\""),
        };
        assert!(!manifest.lines().any(is_wrong), "{name} depends on clap");
    }
}
