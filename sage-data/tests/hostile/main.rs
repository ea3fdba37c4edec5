//! Broken and hostile scene files of every format: each is a line of a table or a number of a random mutation. An error names
//! the file, the field and the value, nothing panics, and no file takes much memory or time.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

#[path = "../mutants/mod.rs"]
mod mutants;
#[path = "../real/mod.rs"]
mod real;
#[cfg(feature = "argoverse2")]
mod scenarios;
mod shards;

use std::{
    alloc::System,
    path::Path,
    sync::{Mutex, MutexGuard, PoisonError},
    time::Instant,
};

use mutants::{
    Format, Mutant,
    formats::lines,
    programs::{self, Program},
    tables::changed,
};
use sage_data::{Recording, pickle::Document};

/// An allocation beyond the limit fails, which ends the test.
#[global_allocator]
static ALLOCATOR: cap::Cap<System> = cap::Cap::new(System, LIMIT);
/// Limit where nothing is read.
const LIMIT: usize = 1 << 30;
/// Limit of the memory that a file takes beside five times its size, bytes.
const MEMORY: usize = 64 << 20;
/// Limit of the time that a file takes, seconds.
const SECONDS: f64 = 5.0;

/// The right to count memory: the limit holds for all threads.
fn turn() -> MutexGuard<'static, ()> {
    static TURN: Mutex<()> = Mutex::new(());
    TURN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The result of reading a file of a size in limited memory and time.
fn limited<T>(size: usize, read: impl FnOnce() -> T) -> T {
    ALLOCATOR.set_limit(ALLOCATOR.allocated() + MEMORY + 5 * size).unwrap();
    let start = Instant::now();
    let read = read();
    ALLOCATOR.set_limit(LIMIT).unwrap();
    assert!(start.elapsed().as_secs_f64() < SECONDS, "{:?}", start.elapsed());
    read
}

/// The error of a file, which is a short line.
fn error_of(path: &str, bytes: &[u8]) -> Option<String> {
    let error =
        limited(bytes.len(), || Recording::from_bytes(Path::new(path), bytes.to_vec()).err())?.to_string();
    let is_plain = error.len() < 900 && !error.chars().any(char::is_control);
    assert!(is_plain && error.starts_with(&format!("`{path}")), "{error}");
    Some(error)
}

/// What differs from a row of a table, whose error holds words with `;` between them; none if the file is read.
fn difference(row: &str, words: &str, error: Option<String>) -> Option<String> {
    let holds = match &error {
        None => words.is_empty(),
        Some(error) => !words.is_empty() && words.split(';').all(|word| error.contains(word)),
    };
    (!holds).then(|| {
        format!("{row}: `{words}` is expected, and it says: {}", error.unwrap_or("it is read".into()))
    })
}

/// Compares the rows of a table with what is read.
fn assert_table(rows: impl IntoIterator<Item = (String, &'static str, Option<String>)>) {
    let wrong: Vec<String> =
        rows.into_iter().filter_map(|(row, words, error)| difference(&row, words, error)).collect();
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

fn format(name: &str) -> Format {
    mutants::formats::all().into_iter().find(|format| format.name == name).unwrap()
}

/// The rows of a table of places and values.
fn assert_values(format: &str, table: &'static str) {
    let format = self::format(format);
    let base = &format.bases[format.bases.len() - 1];
    assert_table(lines(table).map(|[place, value, words]| {
        (format!("{place} {value}"), words, error_of(format.path, &changed(base, place, value)))
    }));
}

#[test]
fn values_that_no_scene_has_are_named() {
    let _turn = turn();
    assert_values("json", include_str!("json.table"));
    assert_values("native", include_str!("native.table"));
}

#[test]
fn programs_are_refused_or_values() {
    let _turn = turn();
    assert_table(programs::all().map(|Program { name, bytes, words }| {
        let size = bytes.len() + (32 << 20);
        (
            name.to_owned(),
            words,
            limited(size, || mutants::consume(Path::new("some.pkl"), &bytes)).err().map(|e| e.to_string()),
        )
    }));
    for (module, name) in programs::hostile_globals() {
        for code in [format!("c{module}\n{name}\n."), format!("c{module}\n{name}\n)R.")] {
            for start in [&b"\x80\x04"[..], b"\x80\x02", b"\x80\x04N0"] {
                let error =
                    Document::parse([start, code.as_bytes()].concat()).map(drop).unwrap_err().to_string();
                assert!(error.contains("is not allowed"), "{module} {name}: {error}");
            }
        }
    }
}

/// Random damage, and that both results occur, or it would be too one-sided. `SAGE_MUTANTS` asks for another number of files.
fn damage(format: &Format, count: u64) {
    damage_as(format, count, |mutant| format.read(mutant).0);
}

/// The same for files that `is_scene` reads.
fn damage_as(format: &Format, count: u64, is_scene: impl Fn(&Mutant) -> bool) {
    let _turn = turn();
    let count = std::env::var("SAGE_MUTANTS").map_or(count, |text| text.parse().unwrap());
    let mut scenes = 0;
    for number in 0..count {
        let mutant = format.mutant(number);
        scenes += u64::from(limited(mutant.bytes.len() + (128 << 20), || is_scene(&mutant)));
    }
    let refused = count - scenes;
    assert!(
        scenes > count / 50 && refused > count / 4,
        "{}: {scenes} scenes, {refused} refused",
        format.name
    );
}

#[test]
fn random_damage_is_refused_or_read() {
    for format in mutants::formats::all() {
        damage(&format, 2000);
    }
}

/// Whole files that are cut anywhere are no scenes.
#[test]
fn cut_files_are_refused() {
    let _turn = turn();
    for (name, words) in [("pickle", ""), ("native", ""), ("json", "EOF"), ("record", "truncated")] {
        let format = format(name);
        let whole = &format.bases[0];
        for cut in (whole.len() / 40..whole.len()).step_by(whole.len() / 40) {
            let error =
                error_of(format.path, &whole[..cut]).unwrap_or_else(|| panic!("{name} cut at {cut} is read"));
            assert!(error.contains(words), "{name} cut at {cut}: {error}");
        }
    }
}
