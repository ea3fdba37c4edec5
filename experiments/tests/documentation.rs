//! The pages of the project: their links lead somewhere, and what they show is what the code has.
//!
//! `cargo test -p experiments --test documentation web -- --nocapture` prints all links to the web.

#![allow(clippy::unwrap_used, clippy::print_stdout)] // A failed unwrap is a failed test.

mod program;

use std::{
    collections::{BTreeMap, BTreeSet, HashSet},
    fs,
    path::{Path, PathBuf},
    process::Command,
};

use program::*;

fn project() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap().to_owned()
}

/// Relative name of a file, for messages.
fn name(path: &Path) -> String {
    path.strip_prefix(project()).unwrap().display().to_string()
}

fn read(path: &str) -> String {
    fs::read_to_string(project().join(path)).unwrap()
}

/// All files with one of these endings, outside build outputs.
fn files(endings: &[&str]) -> Vec<PathBuf> {
    let mut found = Vec::new();
    collect(&project(), endings, &mut found);
    found.sort();
    found
}

fn collect(folder: &Path, endings: &[&str], found: &mut Vec<PathBuf>) {
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let name = path.file_name().unwrap().to_str().unwrap();
        if name.starts_with('.') || name == "target" {
            continue;
        }
        if path.is_dir() {
            collect(&path, endings, found);
        } else if endings.iter().any(|ending| name.ends_with(ending)) {
            found.push(path);
        }
    }
}

/// The text without what stands in fences and in code.
fn prose(text: &str) -> String {
    let mut is_code = false;
    let lines = text.lines().filter(|line| {
        let is_fence = line.trim_start().starts_with("```");
        is_code ^= is_fence;
        !is_code && !is_fence
    });
    let lines: Vec<String> =
        lines.map(|line| line.split('`').step_by(2).collect::<Vec<_>>().join("x")).collect();
    lines.join("\n")
}

/// Targets of `[words](target)`.
fn links(text: &str) -> Vec<String> {
    let after = text.split("](").skip(1);
    after.filter_map(|rest| Some(rest.split_once(')')?.0.to_owned())).collect()
}

/// Contents of the fences of a language, without the indentation of a list.
fn fences(text: &str, language: &str) -> Vec<String> {
    let mut found: Vec<String> = Vec::new();
    let mut within = None;
    for line in text.lines() {
        let (start, rest) = line.split_at(line.len() - line.trim_start().len());
        match (rest.strip_prefix("```"), within) {
            (Some(_), Some(_)) => within = None,
            (Some(word), None) => {
                within = Some((start, word == language));
                found.extend((word == language).then(String::new));
            }
            (None, Some((start, true))) => {
                let block = found.last_mut().unwrap();
                block.push_str(line.strip_prefix(start).unwrap_or(rest));
                block.push('\n');
            }
            _ => {}
        }
    }
    found
}

/// Anchors of the headings of a page, as GitHub makes them.
fn anchors(text: &str) -> HashSet<String> {
    let mut is_code = false;
    let mut found = HashSet::new();
    for line in text.lines() {
        is_code ^= line.trim_start().starts_with("```");
        if let Some((name, _)) = line.strip_prefix("<a id=\"").and_then(|rest| rest.split_once('"')) {
            found.insert(name.to_owned());
        }
        let Some(heading) = line.strip_prefix('#').filter(|_| !is_code) else { continue };
        let words = heading.trim_start_matches('#').trim().to_lowercase();
        let kept = words.chars().filter(|c| c.is_alphanumeric() || " -_".contains(*c));
        let anchor: String = kept.map(|c| if c == ' ' { '-' } else { c }).collect();
        let again = (1..).map(|k| format!("{anchor}-{k}"));
        let free = std::iter::once(anchor.clone()).chain(again).find(|name| !found.contains(name));
        found.extend(free);
    }
    found
}

#[test]
fn links_within_the_project_lead_to_files_and_headings() {
    let all = files(&[".md"]);
    assert!(all.len() > 25, "{} pages", all.len());
    let mut broken = Vec::new();
    for page in &all {
        let text = fs::read_to_string(page).unwrap();
        for link in links(&prose(&text)) {
            if link.starts_with("http") || link.starts_with("mailto:") {
                continue;
            }
            let (file, anchor) = link.split_once('#').unwrap_or((&link, ""));
            let target = if file.is_empty() { page.clone() } else { page.parent().unwrap().join(file) };
            let is_there = target.exists();
            let has_anchor = anchor.is_empty()
                || target.extension().is_none_or(|ending| ending != "md")
                || fs::read_to_string(&target).is_ok_and(|text| anchors(&text).contains(anchor));
            if !is_there || !has_anchor {
                broken.push(format!("{}: {link}", name(page)));
            }
        }
    }
    assert!(broken.is_empty(), "broken links:\n{}", broken.join("\n"));
}

#[test]
fn the_front_page_is_short() {
    let readme = fs::read_to_string(project().join("README.md")).unwrap();
    assert!(readme.lines().count() <= 120, "{} lines", readme.lines().count());
}

#[test]
fn headings_become_anchors_as_on_github() {
    let text = "# A `b`: c, d\n```\n# code\n```\n## The paper's protocol\n## x\n## x\n";
    let expected = ["a-b-c-d", "the-papers-protocol", "x", "x-1"].map(str::to_owned);
    assert_eq!(anchors(text), HashSet::from(expected));
    assert_eq!(links(&prose("[a](b.md#c), `[no](code.md)`\n```\n[no](fence)\n```\n")), ["b.md#c"]);
}

#[test]
fn pages_that_code_names_exist() {
    let mut broken = Vec::new();
    let mut count = 0;
    for file in files(&[".rs", ".py", ".toml", ".yaml"]) {
        // Comments go on in the next line.
        let text = fs::read_to_string(&file).unwrap();
        let text =
            text.replace("///", "").replace("//!", "").split_whitespace().collect::<Vec<_>>().join(" ");
        for rest in text.split("docs/").skip(1) {
            let Some((page, after)) = rest.split_once(".md") else { continue };
            if !page.chars().all(|c| c.is_ascii_alphanumeric() || "-_/".contains(c)) {
                continue;
            }
            count += 1;
            let page = format!("docs/{page}.md");
            let Ok(found) = fs::read_to_string(project().join(&page)) else {
                broken.push(format!("{}: {page}", name(&file)));
                continue;
            };
            let section = after.strip_prefix("`, section '").and_then(|rest| rest.split_once('\''));
            let has_section =
                |heading| found.lines().any(|line| line.trim_start_matches('#').trim() == heading);
            if let Some((heading, _)) = section.filter(|(heading, _)| !has_section(*heading)) {
                broken.push(format!("{}: {page}, section '{heading}'", name(&file)));
            }
            let anchor =
                after.strip_prefix('#').map(|rest| rest.split(|c: char| !c.is_alphanumeric() && c != '-'));
            if let Some(anchor) =
                anchor.and_then(|mut parts| parts.next()).filter(|a| !anchors(&found).contains(*a))
            {
                broken.push(format!("{}: {page}#{anchor}", name(&file)));
            }
        }
    }
    assert!(count > 15, "{count} names of pages");
    assert!(broken.is_empty(), "broken names of pages:\n{}", broken.join("\n"));
}

#[test]
fn web_links_are_whole_and_safe_addresses() {
    let mut all: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for file in files(&[".md", ".cff"]) {
        let text = fs::read_to_string(&file).unwrap();
        for start in ["https://", "http://"] {
            for rest in text.split(start).skip(1) {
                let end =
                    rest.find(|c: char| c.is_whitespace() || ")>\"`'".contains(c)).unwrap_or(rest.len());
                let link = format!("{start}{}", rest[..end].trim_end_matches(['.', ',', ';', ':']));
                all.entry(link).or_default().insert(name(&file));
            }
        }
    }
    for (link, places) in &all {
        println!("{link}  {}", places.iter().map(String::as_str).collect::<Vec<_>>().join(", "));
    }
    assert!(all.len() > 5, "{} links", all.len());
    let is_whole = |link: &str| link.strip_prefix("https://").is_some_and(|rest| rest.contains('.'));
    // A placeholder of the template.
    let bad: Vec<&String> =
        all.keys().filter(|link| !is_whole(link) && !link.starts_with("https://HOST/")).collect();
    assert!(bad.is_empty(), "{bad:?}");
}

#[test]
fn no_compiled_python_is_in_the_repository() {
    // Without git, or in an archive, nothing is listed.
    let listed = Command::new("git").arg("ls-files").current_dir(project()).output();
    let listed =
        listed.map(|output| String::from_utf8_lossy(&output.stdout).into_owned()).unwrap_or_default();
    let compiled: Vec<&str> =
        listed.lines().filter(|path| path.ends_with(".pyc") || path.contains("__pycache__")).collect();
    assert!(compiled.is_empty(), "{compiled:?}");
}

/// Crates whose names a source uses.
fn crates_of(source: &str) -> BTreeSet<&str> {
    let uses = source.lines().filter_map(|line| line.strip_prefix("use "));
    let names = uses.map(|rest| rest.split([':', ';']).next().unwrap());
    names.filter(|name| !["std", "crate", "super"].contains(name)).chain(["experiments"]).collect()
}

/// `Cargo.toml` of the template, with the crates that a source uses, and with `root` as the path to `sage`.
fn manifest(source: &str, root: &str) -> String {
    let template = read("examples/own-crate/Cargo.toml").replace("../..", root);
    let (start, rest) = template.split_once("[dependencies]\n").unwrap();
    let (dependencies, end) = rest.split_once("\n\n").unwrap();
    let serde = dependencies.lines().find(|line| line.starts_with("serde =")).unwrap();
    let line = |name: &str| match name {
        "serde" => serde.to_owned(),
        "serde_json" => "serde_json = \"1\"".to_owned(),
        _ => {
            let name = name.replace("sage_", "sage-");
            format!(r#"{name} = {{ path = "{root}/{name}" }}"#)
        }
    };
    let lines: Vec<String> = crates_of(source).into_iter().map(line).collect();
    format!("{start}[dependencies]\n{}\n\n{end}", lines.join("\n"))
}

fn template_sources() -> String {
    let sources =
        files(&[".rs"]).into_iter().filter(|path| path.starts_with(project().join("examples/own-crate")));
    sources.map(|path| fs::read_to_string(path).unwrap()).collect()
}

#[test]
fn the_template_depends_on_the_crates_that_it_uses() {
    assert_eq!(read("examples/own-crate/Cargo.toml"), manifest(&template_sources(), "../.."));
}

/// The help text of a command with all options.
fn whole_help(words: &[&str]) -> String {
    let all = sage(&[words, &["--help-all"]].concat());
    let help = if all.status.success() { all } else { sage(&[words, &["--help"]].concat()) };
    stdout(&help).to_owned()
}

#[test]
fn the_page_about_own_parts_shows_the_manifest_and_code_that_compile() {
    let text = read("docs/extending.md");
    assert_eq!(fences(&text, "toml"), [manifest(&template_sources(), "/path/to/sage")]);
    let blocks = fences(&text, "rust");
    assert_eq!(blocks.len(), 1);
    assert!(blocks[0].starts_with("fn main() -> ExitCode {\n    experiments::run"));
    let template_main = read("examples/own-crate/src/main.rs");
    assert!(template_main.contains(&blocks[0]));
    let template = template_sources();
    let (before, _) = text.split_once("\n## What all parts share").unwrap();
    let mut shown = BTreeSet::new();
    for row in text.lines().filter(|line| line.starts_with("| [")) {
        let cells: Vec<Vec<&str>> =
            row.split('|').map(|cell| cell.split('`').skip(1).step_by(2).collect()).collect();
        let [_, _, traits, example, registry, uses, _] = &cells[..] else { panic!("{row}") };
        let file = example[0];
        let source = if file.starts_with("own_") {
            read(&format!("experiments/examples/{file}"))
        } else {
            read(&format!("examples/own-crate/src/{file}")) + &template_main
        };
        for name in traits {
            let is_there =
                source.contains(&format!("impl {name} for ")) || source.contains(&format!("-> {name}<"));
            assert!(is_there, "{file}: no `{name}`");
        }
        let registry = registry[0];
        assert!(
            source.contains(&format!("        registries.{registry} = registries.{registry}.with")),
            "{file}: no line for `{registry}`"
        );
        for name in crates_of(&source).difference(&crates_of(&template)) {
            let name = name.replace("sage_", "sage-");
            assert!(before.contains(&format!("`{name}`")), "{file}: the page does not name `{name}`");
        }
        for command in uses {
            let (flags, words): (Vec<&str>, Vec<&str>) =
                command.split(' ').partition(|word| word.starts_with("--"));
            let help = whole_help(&words);
            for flag in flags {
                assert!(help.contains(&format!("{flag} ")), "`{command}`: no option `{flag}`");
            }
        }
        shown.insert(file.to_owned());
    }
    let examples = files(&[".rs"]).into_iter().filter(|path| name(path).contains("examples/own_"));
    let missing: Vec<String> = examples
        .map(|path| path.file_name().unwrap().to_str().unwrap().to_owned())
        .filter(|file| file != "own_study.rs" && !shown.contains(file))
        .collect();
    assert!(missing.is_empty() && shown.len() >= 10, "{missing:?} {shown:?}");
}

#[test]
fn the_map_of_the_scenario_has_the_name_that_the_guide_shows() {
    let folder = tempfile::tempdir().unwrap();
    let [scenes, practice, scenario] =
        ["scenes", "practice", "scenario"].map(|name| folder.path().join(name));
    stdout(&sage(&["scenes", "--kind", "four-way", "--seed", "4", "--count", "1", "--out", text(&scenes)]));
    stdout(&sage(&["convert", text(&scenes), "--to", "womd", "--out", text(&practice)]));
    let scene = format!("{}#0", text(&practice.join("scenes.tfrecord-00000-of-00001")));
    let generate =
        ["generate", &scene, "--aggression", "1", "--format", "openscenario", "--out", text(&scenario)];
    stdout(&sage(&[&generate[..], &WEIGHTS].concat()));
    let page = read("docs/scenes.md");
    let names = fs::read_dir(&scenario).unwrap().map(|file| file.unwrap().file_name().into_string().unwrap());
    for file in names.filter(|name| name.ends_with(".xosc") || name.ends_with(".xodr")) {
        // The hash in the name of a map has its last bits from the processor.
        let shown = if file.ends_with(".xodr") { "map-" } else { &*file };
        assert!(page.contains(&format!("`{shown}")), "the page has no `{shown}`");
    }
}

/// Texts in code on a page, without fences.
fn code_spans(text: &str) -> Vec<String> {
    let mut is_fenced = false;
    let lines = text.lines().filter(|line| {
        let is_fence = line.trim_start().starts_with("```");
        is_fenced ^= is_fence;
        !is_fenced && !is_fence
    });
    let spans =
        lines.flat_map(|line| line.split('`').skip(1).step_by(2).map(str::to_owned).collect::<Vec<_>>());
    spans.collect()
}

#[test]
fn what_the_page_on_the_paper_names_exists() {
    let page = read("docs/benchmarks.md");
    let spans = code_spans(page.split_once("\n## The paper, item by item").unwrap().1);
    let commands = whole_help(&[]);
    let studies = stdout(&sage(&["bench", "list"])).to_owned();
    let sources: String =
        files(&[".yaml", ".rs"]).iter().map(|file| fs::read_to_string(file).unwrap()).collect();
    let (mut seen, mut named) = (BTreeSet::new(), 0);
    for span in &spans {
        if let Some(words) = span.strip_prefix("sage ") {
            let words: Vec<&str> = words.split_whitespace().collect();
            assert!(commands.contains(&format!("\n  {} ", words[0])), "`{span}`: no such command");
            let parts: &[&str] =
                if ["bench", "analyse"].contains(&words[0]) { &words[..2] } else { &words[..1] };
            if words[0] == "bench" {
                assert!(studies.contains(&format!("{} ", words[1])), "`{span}`: no such study");
            }
            let flags = words.iter().filter(|word| word.starts_with("--"));
            let flags: Vec<&str> = flags.copied().collect();
            if !flags.is_empty() {
                let help = whole_help(parts);
                for flag in flags {
                    assert!(help.contains(&format!("{flag} ")), "`{span}`: no option `{flag}`");
                }
            }
            seen.insert(words[0]);
            named += 1;
        } else if span.contains('/') && span.contains('.') && !span.contains(' ') {
            assert!(project().join(span).is_file(), "`{span}`: no such file");
            named += 1;
        } else if span.ends_with(".svg") {
            let column = span.trim_end_matches(".svg").split('-').next().unwrap_or_default();
            let is_made = sources.contains(span.as_str()) || sources.contains(&format!("\"{column}-{{"));
            assert!(is_made, "`{span}`: no such picture");
        }
    }
    assert!(named > 30 && seen.len() > 8, "{named} {seen:?}");
}
