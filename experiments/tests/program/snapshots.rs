//! Text for snapshots: what a user reads, without what differs between runs and machines.
//!
//! `INSTA_UPDATE=always cargo test --workspace --test NAME` writes the snapshots in files anew, and `cargo insta review`
//! those in the source. Read the difference before a commit.

use std::{fmt::Display, path::Path};

use super::{run, sage, stdout};

/// Text with placeholders for what differs between runs and machines:
/// - `[folder]`: a temporary folder.
/// - `[sage]`: the folder of the project.
/// - `[time]`: the time at the end of a line, in brackets.
/// - `[number]`: the number of a process.
/// - `[version]`: the version of the program.
/// - `[hash]`: a hash of 16 digits, as those of weights that a test trains.
pub fn redacted(text: &str) -> String {
    let project = Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the crate lies in the project");
    let resolved = std::env::temp_dir().canonicalize().expect("a folder for temporary files");
    let mut text = text.to_owned();
    for folder in [resolved, std::env::temp_dir()] {
        let start = folder.join(".tmp").display().to_string();
        text = masked(&text, &start, |c| c.is_ascii_alphanumeric(), "[folder]");
    }
    let text = text
        .replace(concat!(env!("CARGO_MANIFEST_DIR"), "/.."), "[sage]")
        .replace(&project.display().to_string(), "[sage]")
        .replace(concat!("sage ", env!("CARGO_PKG_VERSION")), "sage [version]");
    let text = masked(&text, "(process ", |c| c.is_ascii_digit(), "(process [number]");
    let text: String = text.split_inclusive('\n').map(without_time).collect();
    text.split_inclusive(|c: char| !c.is_ascii_alphanumeric()).map(without_hash).collect()
}

/// Text with a placeholder for each `start` with the characters after it.
pub fn masked(text: &str, start: &str, is_of_it: fn(char) -> bool, stand_in: &str) -> String {
    let mut parts = text.split(start);
    let first = parts.next().unwrap_or_default().to_owned();
    parts.fold(first, |all, part| all + stand_in + part.trim_start_matches(is_of_it))
}

/// A line without its time, `5 scenes (1.2 s)`, or without those of a table, `| idm | 0.021 ms |`.
fn without_time(line: &str) -> String {
    if line.trim_end().ends_with(" ms |") {
        let is_time =
            |cell: &&str| cell.trim().strip_suffix(" ms").is_none_or(|ms| ms.parse::<f64>().is_err());
        return line.split('|').filter(is_time).collect::<Vec<_>>().join("|").replacen('\n', " [time]\n", 1);
    }
    let line_end =
        [" s)", " ms)", " ms a step)"].into_iter().find_map(|unit| line.trim_end().strip_suffix(unit));
    let time = || {
        let (said, time) = line_end?.rsplit_once('(')?;
        time.parse::<f64>().is_ok().then(|| format!("{said}([time])\n"))
    };
    time().unwrap_or_else(|| line.to_owned())
}

/// Lines in alphabetical order, where scenes in parallel are told of as they end.
pub fn sorted(text: &str) -> String {
    let mut lines: Vec<&str> = text.lines().collect();
    lines.sort_unstable();
    lines.join("\n")
}

/// A word without the hash that it is: 16 hexadecimal digits, then the character that ends the word.
fn without_hash(word: &str) -> String {
    let (hash, end) = word.split_at_checked(16).unwrap_or((word, ""));
    let is_hash = hash.len() == 16 && hash.bytes().all(|byte| byte.is_ascii_hexdigit());
    if is_hash && end.chars().count() <= 1 { format!("[hash]{end}") } else { word.to_owned() }
}

/// What is said to each input, a line `input -> message` each. Further lines of a message are indented.
pub fn messages<I: Display, M: AsRef<str>>(cases: impl IntoIterator<Item = (I, M)>) -> String {
    let line = |(input, message): (I, M)| {
        let message = message.as_ref().trim_end().replace('\n', "\n    ").replace("\n    \n", "\n\n");
        redacted(&format!("{input} -> {message}\n"))
    };
    cases.into_iter().map(line).collect()
}

/// Lines that a program with parts of its own prints for a command and `sage` does not.
pub fn added(program: &Path, command: &[&str]) -> String {
    let (own, shipped) = (run(program, command), sage(command));
    let shipped: Vec<&str> = stdout(&shipped).lines().collect();
    stdout(&own).lines().filter(|line| !shipped.contains(line)).collect::<Vec<_>>().join("\n")
}
