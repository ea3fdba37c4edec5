//! Makes tables of `docs/results` again and compares every printed number.
//!
//! ```sh
//! cargo build --release && cargo run --release -p experiments --example remake_tables -- 10 [SEED]
//! cargo run --release -p experiments --example remake_tables -- --update NAME…
//! ```
//! A table, list or paragraph is preceded by `<!-- NAME: HASH -->`: the `--out` of the command on the page that makes it, and the first digits of
//! the hash of its `rows.csv` without times. Numbers are looked for in the lines of the new report that hold the label of their row. Draws so many of them by the seed, runs their commands in the root of the project, and ends with an
//! error if a hash differs, or if a number is not one of those of its row. `--update` runs commands and writes their hashes.

#![allow(clippy::print_stderr)] // A program of its own, read by a person.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    process::{Command, ExitCode, Stdio},
};

use sage_core::seed::Rng;

/// Metrics of rows that no two runs have alike.
const TIMES: [&str; 2] = [",generation,", ",step time,"];
/// Digits of a hash on a page.
const DIGITS: usize = 12;

/// What a page says a command has made.
struct Made {
    page: PathBuf,
    name: String,
    hash: String,
    /// Labels of rows with the numbers beside them.
    rows: Vec<(String, Vec<String>)>,
}

fn main() -> ExitCode {
    let words: Vec<String> = std::env::args().skip(1).collect();
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    match run(&root, &words) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(problem) => {
            eprintln!("error: {problem}");
            ExitCode::from(2)
        }
    }
}

fn run(root: &Path, words: &[String]) -> Result<bool, String> {
    let (is_update, words) = match words.split_first() {
        Some((first, names)) if first == "--update" => (true, names),
        _ => (false, words),
    };
    let mut pages: Vec<PathBuf> = fs::read_dir(root.join("docs/results"))
        .map_err(|error| error.to_string())?
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| path.extension().is_some_and(|ending| ending == "md"))
        .collect();
    pages.sort();
    let mut all: BTreeMap<String, Vec<Made>> = BTreeMap::new();
    for page in pages {
        let text = fs::read_to_string(&page).map_err(|error| error.to_string())?;
        made(&page, &text).into_iter().for_each(|one| all.entry(one.name.clone()).or_default().push(one));
    }
    let names: Vec<String> = if is_update {
        words.to_vec()
    } else {
        let usage = "usage: remake_tables COUNT [SEED], or remake_tables --update NAME…";
        let count = words.first().and_then(|word| word.parse().ok()).ok_or(usage)?;
        let seed = words.get(1).and_then(|word| word.parse().ok()).unwrap_or(1);
        drawn(all.keys().cloned().collect(), count, seed)
    };
    let mut is_same = true;
    for name in &names {
        let tables = all.get(name).ok_or_else(|| format!("no page has a table of `{name}`"))?;
        let problems = remake(root, tables, is_update)?;
        is_same &= problems.is_empty();
        eprintln!("{name}: {}", if problems.is_empty() { "as printed" } else { "DIFFERS" });
        problems.iter().for_each(|problem| eprintln!("  {problem}"));
    }
    Ok(is_same)
}

/// Some names, drawn by a seed.
fn drawn(mut names: Vec<String>, count: usize, seed: u64) -> Vec<String> {
    let mut rng = Rng::new(seed, "pages", "tables");
    let count = count.min(names.len());
    (0..count).map(|_| names.swap_remove(rng.below(names.len()))).collect()
}

/// The tables, lists and paragraphs of a page below their comments.
fn made(page: &Path, text: &str) -> Vec<Made> {
    let mut all: Vec<Made> = Vec::new();
    let mut is_open = false;
    for line in text.lines() {
        if let Some((name, hash)) = comment(line) {
            all.push(Made { page: page.to_owned(), name, hash, rows: Vec::new() });
            is_open = true;
            continue;
        }
        let Some(one) = all.last_mut().filter(|_| is_open) else { continue };
        let cells = line.strip_prefix("| ").and_then(|cells| cells.split_once(" |"));
        let item = line.strip_prefix("- ").and_then(|item| item.split_once(": "));
        match cells.or(item) {
            Some((label, rest)) => one.rows.push((label.trim().replace('`', ""), numbers(rest))),
            // A line of a paragraph has no label, and a blank one ends what was begun.
            None if !line.is_empty() => one.rows.push((String::new(), numbers(line))),
            None => is_open = one.rows.is_empty(),
        }
    }
    all
}

/// Name and hash of a comment.
fn comment(line: &str) -> Option<(String, String)> {
    let inner = line.strip_prefix("<!-- ")?.strip_suffix(" -->")?;
    let (name, hash) = inner.split_once(": ")?;
    Some((name.to_owned(), hash.to_owned()))
}

/// The numbers of a text with a decimal point, a minus sign as `-`.
fn numbers(text: &str) -> Vec<String> {
    let text = text.replace('−', "-");
    let is_part = |c: char| c.is_ascii_digit() || c == '.' || c == '-';
    let words = text.split(|c| !is_part(c)).map(|word| word.trim_end_matches(['.', '-']));
    words.filter(|word| word.contains('.') && word.parse::<f64>().is_ok()).map(str::to_owned).collect()
}

/// Runs the command of some tables. Returns what differs.
fn remake(root: &Path, tables: &[Made], is_update: bool) -> Result<Vec<String>, String> {
    let Some(first) = tables.first() else { return Ok(Vec::new()) };
    let text = fs::read_to_string(&first.page).map_err(|error| error.to_string())?;
    let words = command(&text, &first.name)
        .ok_or_else(|| format!("`{}` has no command with --out {}", first.page.display(), first.name))?;
    let folder = tempfile::tempdir().map_err(|error| error.to_string())?;
    let out = folder.path().join("out");
    let own = std::env::current_exe().unwrap_or_default();
    let program = own.ancestors().nth(2).unwrap_or(&own).join("sage");
    let shown = out.display().to_string();
    let place = words.iter().position(|word| word == "--out").map(|at| at + 1);
    let words = words.iter().enumerate().map(|(k, word)| if Some(k) == place { &shown } else { word });
    let done =
        Command::new(program).args(words).arg("--wide").current_dir(root).stdout(Stdio::null()).output();
    let done = done.map_err(|error| error.to_string())?;
    if !done.status.success() {
        return Ok(vec![String::from_utf8_lossy(&done.stderr).into_owned()]);
    }
    let read = |name: &str| fs::read_to_string(out.join(name)).map_err(|error| format!("{name}: {error}"));
    let rows = read("rows.csv")?;
    let same_again = rows.split_inclusive('\n').filter(|row| !TIMES.iter().any(|time| row.contains(time)));
    let hash = blake3::hash(same_again.collect::<String>().as_bytes()).to_hex()[..DIGITS].to_owned();
    let (table, estimates) = (read("table.md")?, read("estimates.csv")?);
    let mut problems = Vec::new();
    for one in tables {
        if one.hash != hash && is_update {
            let text = fs::read_to_string(&one.page).map_err(|error| error.to_string())?;
            let [before, after] = [&one.hash, &hash].map(|hash| format!("<!-- {}: {hash} -->", one.name));
            fs::write(&one.page, text.replace(&before, &after)).map_err(|error| error.to_string())?;
        } else if one.hash != hash {
            problems.push(format!("rows {hash}, on the page {}", one.hash));
        }
        for (label, printed) in &one.rows {
            let lines = || table.lines().chain(estimates.lines());
            // A label such as `waymo, K = 6` is that of the row `waymo`; one that no row has says something of all.
            let label = label.split(',').next().unwrap_or_default();
            let label = if lines().any(|line| line.contains(label)) { label } else { "" };
            let of_row = || lines().filter(|line| line.contains(label));
            let known: Vec<f64> =
                of_row().flat_map(numbers).filter_map(|number| number.parse().ok()).collect();
            problems.extend(printed.iter().filter(|number| !is_known(number, &known)).map(|number| {
                format!("{label}: {number} is none of the {} numbers of its rows", known.len())
            }));
        }
    }
    Ok(problems)
}

/// Whether a printed number is one of some, as it is or in percent, rounded; a page may give the opposite of a difference.
fn is_known(printed: &str, known: &[f64]) -> bool {
    let decimals = printed.split_once('.').map_or(0, |(_, decimals)| decimals.len());
    let Ok(value) = printed.parse::<f64>() else { return false };
    let half = 0.5001 * 10f64.powi(-(decimals as i32));
    known.iter().any(|known| {
        [1.0, 100.0, 0.01].iter().any(|scale| ((scale * known).abs() - value.abs()).abs() <= half)
    })
}

/// The words after `sage` of the command of a page that writes to a folder.
fn command(text: &str, name: &str) -> Option<Vec<String>> {
    let joined = text.replace("\\\n", " ");
    let plain = joined.replace('`', "\n");
    let lines = joined.lines().chain(plain.lines());
    let commands = lines.filter_map(|line| line.trim_start().strip_prefix("sage "));
    commands.filter_map(shlex::split).find(|words| {
        let at = words.iter().position(|word| word == "--out");
        at.and_then(|at| words.get(at + 1)).is_some_and(|out| out == name)
    })
}
