//! Runs a script in a temporary folder of its own.

use std::{
    collections::BTreeMap,
    fmt::Write as _,
    fs,
    path::{Path, PathBuf},
    process::{Command, Output, Stdio},
};

use sage_core::files::OutputLock;

use crate::{mutants::formats::unescaped, prepare, program::redacted};

/// Longest line of a message, characters: 2000 and the note of what is left out.
const LONGEST_LINE: usize = 2100;
/// Seconds that a command may take.
const SECONDS: &str = "180";

/// A script that is run.
struct Script<'s> {
    name: &'s str,
    root: PathBuf,
    /// Where commands run.
    folder: PathBuf,
    transcript: String,
    /// Standard output and error of the last command, and the standard output of the one before it.
    said: [String; 2],
    before: String,
    locks: Vec<OutputLock>,
    /// What does not hold.
    wrong: Vec<String>,
}

/// Runs a script. Returns its transcript and what does not hold; `None` if a program that it needs is not built.
pub fn run(text: &str, name: &str) -> Option<(String, Vec<String>)> {
    let root = tempfile::tempdir().unwrap();
    let folder = root.path().canonicalize().unwrap();
    let mut script = Script {
        name,
        root: folder.clone(),
        folder,
        transcript: String::new(),
        said: Default::default(),
        before: String::new(),
        locks: Vec::new(),
        wrong: Vec::new(),
    };
    let defective = Path::new(env!("CARGO_BIN_EXE_sage")).with_file_name("examples").join("defective");
    if text.contains("\nneeds defective\n") && !defective.exists() {
        eprintln!("left out: `{}` is built by `cargo test --workspace` alone", defective.display());
        return None;
    }
    let is_step = |line: &&str| !line.trim().is_empty() && !line.starts_with("needs ");
    text.lines().filter(is_step).for_each(|line| script.line(line));
    Some((script.transcript, script.wrong))
}

/// Words of a line. One in single quotes may hold spaces; `\n` and `\x1b` are escapes.
fn words(line: &str) -> Vec<String> {
    let mut words: Vec<String> = Vec::new();
    let mut is_open = false;
    for part in line.split(' ') {
        if is_open {
            let word = words.last_mut().expect("a word is open");
            *word += " ";
            *word += part;
        } else if !part.is_empty() {
            words.push(part.to_owned());
        }
        is_open ^= part.matches('\'').count() % 2 == 1;
    }
    words.iter().map(|word| String::from_utf8(unescaped(&word.replace('\'', ""))).unwrap()).collect()
}

impl Script<'_> {
    fn check(&mut self, holds: bool, problem: String) {
        if !holds {
            self.wrong.push(problem);
        }
    }

    fn line(&mut self, line: &str) {
        let what = format!("{}: {line}", self.name);
        if let Some(title) = line.strip_prefix("# ") {
            let _ = writeln!(self.transcript, "# {title}");
            return;
        }
        let words = words(line);
        let (verb, rest): (&str, Vec<&str>) = (&words[0], words[1..].iter().map(String::as_str).collect());
        let root = self.root.clone();
        let at = |name: &str| root.join(name);
        let read = |name: &str| fs::read_to_string(at(name)).unwrap_or_default();
        match verb.strip_prefix('$') {
            Some(code) => {
                let keeps_all = code.ends_with('=');
                return self.command(code.trim_end_matches('=').parse().unwrap(), keeps_all, rest, line);
            }
            None if verb == "cd" => self.folder = at(rest[0]),
            None => {}
        }
        match (verb, &rest[..]) {
            ("cd", _) => {}
            ("absent", [name]) => self.check(at(name).symlink_metadata().is_err(), what),
            ("there", [name]) => self.check(at(name).is_file(), what),
            ("has", [name, text]) => self.check(read(name).contains(text), what),
            ("lacks", [name, text]) => self.check(!read(name).contains(text), what),
            ("said", [text]) => {
                let said = self.said.concat();
                self.check(said.contains(text), format!("{what}: {said}"));
            }
            ("same", []) => self.check(self.said[0] == self.before, what),
            ("show", []) => {
                let said = crate::program::sorted(&self.said[1]);
                self.tell(&said);
            }
            ("list", [name]) => {
                let names: Vec<String> = crate::hostile::snapshot(&at(name)).into_keys().collect();
                self.tell(&names.join("\n"));
            }
            ("lock", [name]) if at(name).is_dir() => {
                self.locks.push(OutputLock::folder(&at(name), "somebody else").unwrap());
            }
            ("lock", [name]) => self.locks.push(OutputLock::file(&at(name), "somebody else").unwrap()),
            ("unlock", []) => self.locks.clear(),
            ("equal", [a, b, endings @ ..]) => {
                let files = |name| {
                    let mut files = crate::hostile::snapshot(&at(name));
                    files.retain(|name, _| {
                        name != "run.json" && endings.iter().all(|ending| name.ends_with(ending))
                    });
                    files
                };
                self.check(files(a) == files(b), what);
            }
            _ => prepare::file(&self.root, verb, &rest).unwrap_or_else(|problem| panic!("{what}: {problem}")),
        }
    }

    /// Adds what was said to the transcript.
    fn tell(&mut self, said: &str) {
        let root = self.root.display().to_string();
        let said = redacted(&said.replace(&format!("{root}/"), "").replace(&root, "."));
        let said = crate::program::masked(&said, "at byte ", |c| c.is_ascii_digit(), "at byte [place]");
        for line in said.lines() {
            let _ = writeln!(self.transcript, "    {line}");
        }
    }

    /// Runs a command, which must end with a code, and checks what holds for every command:
    /// it does not panic, it ends in time, it leaves no lock and no unfinished file, its lines are short and do not control the
    /// terminal, and it changes nothing but what is below its output; no file that was there if it was refused.
    fn command(&mut self, code: i32, keeps_all: bool, mut arguments: Vec<&str>, line: &str) {
        let what = format!("{}: {line}", self.name);
        let input =
            arguments.iter().position(|word| *word == "<").map(|at| arguments.split_off(at)[1].to_owned());
        let before = listing(&self.root);
        let output = self.output(&arguments, input.as_deref());
        let found = output.status.code();
        self.before = std::mem::take(&mut self.said[0]);
        self.said = [output.stdout, output.stderr].map(|said| String::from_utf8(said).expect("text"));
        let said = self.said.concat();
        let is_control = |c: char| (c.is_control() && c != '\n') || ('\u{202a}'..='\u{202e}').contains(&c);
        let is_short = self.said[1].lines().all(|line| line.chars().count() <= LONGEST_LINE);
        let is_defect = said.contains("panicked at") || (code < 3 && said.contains("defect of this program"));
        let is_well = found == Some(code) && !is_defect && is_short && !said.contains(is_control);
        self.check(is_well, format!("{what}: it ends with {found:?}: {said:?}"));
        self.check_files(&before, &arguments, if keeps_all { 1 } else { code }, &what);
        let _ = writeln!(self.transcript, "{line}");
        // Scenes in parallel are told of as they end, and trainings tell of their progress.
        let is_told = |line: &&str| code < 3 || line.starts_with("error:");
        let mut told: Vec<&str> = self.said[1].lines().filter(is_told).filter(|_| code != 0).collect();
        if code > 2 {
            told.sort_unstable();
        }
        let told = told.join("\n");
        self.tell(&told);
    }

    fn output(&self, arguments: &[&str], input: Option<&str>) -> Output {
        let mut program = PathBuf::from(env!("CARGO_BIN_EXE_sage"));
        let mut words = arguments.iter().copied().peekable();
        let mut command = Command::new("timeout");
        command.arg(SECONDS).env_remove("SAGE_WEIGHTS");
        while let Some(variable) =
            words.next_if(|word| word.starts_with("SAGE_") || word.starts_with("TMPDIR="))
        {
            let (name, value) = variable.split_once('=').unwrap();
            command.env(name, self.root.join(value));
        }
        if words.next_if_eq(&"defective").is_some() {
            program = program.with_file_name("examples").join("defective");
        }
        command.arg(program).args(words).current_dir(&self.folder).stdin(Stdio::null());
        if let Some(name) = input {
            // A pipe, and no file on standard input.
            let bytes = fs::read(self.root.join(name)).unwrap();
            command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::piped());
            let mut run = command.spawn().unwrap();
            let mut pipe = run.stdin.take().unwrap();
            let writer = std::thread::spawn(move || drop(std::io::Write::write_all(&mut pipe, &bytes)));
            let output = run.wait_with_output().unwrap();
            writer.join().unwrap();
            return output;
        }
        command.output().unwrap()
    }

    /// What is below the output may change, if the command was not refused.
    fn check_files(&mut self, before: &Listing, arguments: &[&str], code: i32, what: &str) {
        let after = listing(&self.root);
        let outs = arguments.iter().skip_while(|word| !["--out", "--report"].contains(*word)).skip(1).take(1);
        let mut outs: Vec<PathBuf> = outs.map(|out| plain(&self.folder.join(out))).collect();
        // The folder that shards are joined in.
        outs.extend(
            arguments.iter().skip_while(|word| **word != "join").skip(1).map(|out| self.folder.join(out)),
        );
        let is_output = |name: &PathBuf| outs.iter().any(|out| name.starts_with(out));
        let is_lost = |(name, content): &(&PathBuf, &Vec<u8>)| {
            let may_change = is_output(name) && (code == 0 || code > 2);
            !may_change && after.get(*name) != Some(content)
        };
        let is_unfit = |name: &&PathBuf| {
            let is_passing = name.file_name().is_some_and(OutputLock::is_passing);
            !before.contains_key(*name) && (!is_output(name) || is_passing)
        };
        let lost = before.iter().find(is_lost).map(|(name, _)| name);
        let wrong: Vec<&PathBuf> = lost.into_iter().chain(after.keys().filter(is_unfit)).collect();
        self.check(wrong.is_empty(), format!("{what}: these changed or are new: {wrong:?}"));
    }
}

/// Every file and link below a folder, with its content or target.
type Listing = BTreeMap<PathBuf, Vec<u8>>;

fn listing(root: &Path) -> Listing {
    let mut found = BTreeMap::new();
    let mut open = vec![root.to_owned()];
    while let Some(folder) = open.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let kind = path.symlink_metadata().unwrap();
            let content = match kind.file_type() {
                kind if kind.is_symlink() => {
                    fs::read_link(&path).unwrap().into_os_string().into_encoded_bytes()
                }
                kind if kind.is_dir() => {
                    open.push(path);
                    continue;
                }
                // The content of a large file is holes.
                kind_of if kind_of.is_file() && kind.len() < 1 << 30 => fs::read(&path).unwrap(),
                _ => Vec::new(),
            };
            found.insert(path, content);
        }
    }
    found
}

/// A path without `.` and `..`.
fn plain(path: &Path) -> PathBuf {
    let mut plain = PathBuf::new();
    for part in path.components() {
        match part {
            std::path::Component::ParentDir => drop(plain.pop()),
            std::path::Component::CurDir => {}
            other => plain.push(other),
        }
    }
    plain
}
