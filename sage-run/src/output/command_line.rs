//! The command line as output files record it, and the identity of the program.

use std::{path::Path, sync::OnceLock};

/// Flags that do not change the result of a command, and whether a value follows each. Output files record
/// the command without them, so that equal results are equal bytes.
const WITHOUT_EFFECT: [(&str, bool); 7] = [
    ("--threads", true),
    ("--out", true),
    ("--force", false),
    ("--json", false),
    ("--quiet", false),
    ("--no-pages", false),
    ("--shard", true),
];

/// Arguments of the run that this process joins.
static JOINED: OnceLock<Vec<String>> = OnceLock::new();

/// Identity of the program, if it is another one than the executable of this process.
static PROGRAM: OnceLock<String> = OnceLock::new();

/// Names the file that identifies the program, where the executable of this process does not: a module of an interpreter.
pub fn identify_by(file: &Path) {
    let _ = PROGRAM.set(program_of(file));
}

/// Lets this process write what a run with other arguments would write.
pub fn stand_for(arguments: Vec<String>) {
    let _ = JOINED.set(arguments);
}

/// Arguments of the run: those of this process, or of the run that it joins.
pub(super) fn arguments() -> Vec<String> {
    let own =
        || std::env::args_os().skip(1).map(|argument| argument.to_string_lossy().into_owned()).collect();
    JOINED.get().cloned().unwrap_or_else(own)
}

/// The same with the flags that change what is printed and drawn, which the other parts of a run keep.
pub(super) fn full_command() -> String {
    recorded_without(&ELSEWHERE, arguments().into_iter())
}

/// The command line of the run, without the path of the program and without flags that do not change the result.
pub fn command() -> String {
    recorded(arguments().into_iter())
}

/// The same without a flag that takes a value, for a run that may be continued with another value.
pub fn command_without(flag: &str) -> String {
    let flags: Vec<(&str, bool)> = WITHOUT_EFFECT.into_iter().chain([(flag, true)]).collect();
    recorded_without(&flags, arguments().into_iter())
}

/// Flags of [`WITHOUT_EFFECT`] that each part of a run gives anew.
const ELSEWHERE: [(&str, bool); 4] =
    [("--threads", true), ("--out", true), ("--force", false), ("--shard", true)];

fn recorded(arguments: impl Iterator<Item = String>) -> String {
    recorded_without(&WITHOUT_EFFECT, arguments)
}

fn recorded_without(flags: &[(&str, bool)], arguments: impl Iterator<Item = String>) -> String {
    let mut words = vec!["sage".to_owned()];
    let mut is_value = false;
    for argument in arguments {
        if std::mem::take(&mut is_value) {
            continue;
        }
        let (flag, value) = argument.split_once('=').map_or((&argument[..], None), |(f, v)| (f, Some(v)));
        match flags.iter().find(|(name, _)| *name == flag) {
            Some((_, takes_value)) => is_value = *takes_value && value.is_none(),
            None => words.push(quoted(argument)),
        }
    }
    words.join(" ")
}

/// A recorded command with further options: at its end, or after its name if `--` ends the others.
pub fn command_with(command: &str, options: &str) -> String {
    if !command.contains(" -- ") {
        return format!("{command} {options}");
    }
    let mut words = command.splitn(3, ' ');
    let [program, name, rest] = std::array::from_fn(|_| words.next().unwrap_or_default());
    format!("{program} {name} {options} {rest}").trim_end().to_owned()
}

/// A word as a shell reads it.
///
/// ```
/// use sage_run::output::quoted;
///
/// assert_eq!(quoted("scenes/crossing.pkl".to_owned()), "scenes/crossing.pkl");
/// assert_eq!(quoted("it's here".to_owned()), r"'it'\''s here'");
/// ```
pub fn quoted(argument: String) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./,:=+".contains(c);
    if !argument.is_empty() && argument.chars().all(plain) {
        argument
    } else {
        format!("'{}'", argument.replace('\'', r"'\''"))
    }
}

/// Identity of this build of the program. Only the same build resumes a run.
pub fn program() -> String {
    let own = || program_of(&std::env::current_exe().unwrap_or_default());
    PROGRAM.get().cloned().unwrap_or_else(own)
}

fn program_of(file: &Path) -> String {
    let hash = || -> std::io::Result<String> {
        let mut hasher = blake3::Hasher::new();
        hasher.update_reader(std::fs::File::open(file)?)?;
        Ok(hasher.finalize().to_hex()[..16].to_owned())
    };
    hash().unwrap_or_else(|_| env!("CARGO_PKG_VERSION").to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(text: &str) -> String {
        recorded(text.split(' ').map(str::to_owned))
    }

    #[test]
    fn only_flags_that_change_the_result_are_recorded() {
        let plain = "sage generate scenes/ --lambda 1";
        assert_eq!(of("generate scenes/ --lambda 1"), plain);
        for flag in [
            "--force",
            "--out x",
            "--out=x",
            "--threads 2",
            "--threads=2",
            "--json",
            "--quiet",
            "--no-pages",
            "--shard 1/2",
        ] {
            assert_eq!(of(&format!("generate scenes/ {flag} --lambda 1")), plain);
        }
        assert_eq!(recorded(["list".to_owned(), "a b'c".to_owned()].into_iter()), r"sage list 'a b'\''c'");
    }
}
