//! The promises of `SECURITY.md`, and the tests that hold each: `promises.table`.

use std::path::Path;

use crate::mutants::formats::lines;

#[test]
fn promises_are_those_of_the_page_and_each_has_its_tests() {
    let project = Path::new(env!("CARGO_MANIFEST_DIR")).parent().unwrap();
    let page = std::fs::read_to_string(project.join("SECURITY.md")).unwrap();
    let rows: Vec<&str> = page.lines().filter(|line| line.starts_with("| **")).collect();
    let promises: Vec<[&str; 2]> = lines(include_str!("promises.table")).collect();
    let names: Vec<&str> = promises.iter().map(|[name, _]| *name).collect();
    let told: Vec<&str> = rows.iter().map(|row| row[4..].split("**").next().unwrap()).collect();
    assert_eq!(names, told);
    for ([name, tests], row) in promises.iter().zip(rows) {
        let cell = row.trim_end_matches([' ', '|']).rsplit(" | ").next().unwrap();
        for test in tests.split("; ") {
            let (file, function) =
                test.split_once(":").map_or((test, ""), |(file, start)| (file, start.trim()));
            let short = file.rsplit('/').find(|part| *part != "main.rs").unwrap().trim_end_matches(".rs");
            assert!(cell.contains(short), "{name} does not name `{short}`: {cell}");
            let place = if file.ends_with(".script") {
                format!("experiments/tests/scripts/{file}")
            } else {
                file.to_owned()
            };
            let text = std::fs::read_to_string(project.join(&place))
                .unwrap_or_else(|_| panic!("{name}: no {place}"));
            assert!(text.contains(&format!("fn {function}")) || function.is_empty(), "{name}: no {test}");
        }
    }
}
