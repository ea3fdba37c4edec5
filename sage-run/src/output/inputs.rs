//! Files that a command reads, which no output may replace.

use std::{
    ffi::OsStr,
    path::{Path, PathBuf},
};

use advsage::weights;
use sage_data::womd;

use super::{command_line, resolved_folder};
use crate::{Error, Result};

/// Flags whose value is an output, not an input.
const OUTPUTS: [&str; 3] = ["--out", "--junit", "--svg"];
/// Flags whose value may be the name of a part or of a format, as well as a file.
const NAMED: [&str; 8] =
    ["--format", "--to", "--method", "--ego", "--merger", "--selection", "--feasibility", "--order"];
/// Endings of the names of scenes and weights.
const ENDINGS: [&str; 2] = ["pkl", "safetensors"];

/// Files and folders that a command reads, links resolved.
pub struct Inputs(Vec<PathBuf>);

impl Inputs {
    /// All files and folders that the command line of this process names, other than its outputs: as a value, as the
    /// value of a flag, as the file of a policy (`ppo:FILE`), in a list, as an option in JSON, or as the name of weights.
    pub fn of_command_line() -> Self {
        Self::named(without_command(command_line::arguments()).into_iter())
    }

    /// Some files and folders.
    pub fn of<P: AsRef<Path>>(paths: impl IntoIterator<Item = P>) -> Self {
        Self(Vec::new()).and(paths)
    }

    fn named(arguments: impl Iterator<Item = String>) -> Self {
        let mut found = Vec::new();
        let (mut is_output, mut is_named) = (false, false);
        for argument in arguments {
            let (flag, value) = argument
                .split_once('=')
                .map_or((&argument[..], &argument[..]), |(flag, value)| (flag, value));
            // A folder of the name of a part is none of its files.
            let is_name =
                std::mem::take(&mut is_named) || (NAMED.contains(&flag) && flag.len() < argument.len());
            if std::mem::take(&mut is_output) || (is_name && !value.contains(['.', '/', '\\', ':', '{'])) {
                continue;
            }
            is_named = NAMED.contains(&flag) && flag.len() == argument.len();
            if OUTPUTS.contains(&flag) {
                is_output = flag.len() == argument.len();
                continue;
            }
            found.extend(parts(&argument).filter_map(resolved));
            found.extend(weights::folder_of(&argument).and_then(resolved));
        }
        found.sort();
        found.dedup();
        Self(found)
    }

    /// The same with further files and folders.
    pub fn and<P: AsRef<Path>>(mut self, further: impl IntoIterator<Item = P>) -> Self {
        self.0.extend(further.into_iter().filter_map(|path| resolved(path.as_ref())));
        self
    }

    /// Refuses an output file that would replace an input: one that is named, or a scene or weights in a named folder.
    ///
    /// *Errors*: it would.
    pub fn refuse_file(&self, output: &Path) -> Result<()> {
        let Ok(path) = output.canonicalize() else { return Ok(()) };
        let is_read = |input: &PathBuf| {
            let is_kind =
                path.extension().is_some_and(|e| ENDINGS.iter().any(|ending| e == OsStr::new(ending)));
            *input == path || path.starts_with(input) && (is_kind || womd::is_shard(&path))
        };
        if self.0.iter().any(is_read) { Err(is_input(output)) } else { Ok(()) }
    }

    /// Refuses an output folder that is an input or holds one.
    ///
    /// *Errors*: it is or does.
    pub fn refuse_folder(&self, output: &Path) -> Result<()> {
        let root = resolved_folder(output)?;
        match self.0.iter().find(|input| input.starts_with(&root)) {
            Some(input) if *input == root => Err(is_input(output)),
            Some(input) => Err(Error::Refused(format!(
                "`{}` holds `{}`, an input of this command; name another --out",
                output.display(),
                input.strip_prefix(&root).unwrap_or(input).display()
            ))),
            None => Ok(()),
        }
    }
}

fn is_input(output: &Path) -> Error {
    Error::Refused(format!("`{}` is an input of this command; name another --out", output.display()))
}

/// Arguments without the words of the command: a folder may have the name of one. `bench` and `analyse` have a second word,
/// the name of a study or of a command; a study from a file has an ending or a folder.
fn without_command(mut arguments: Vec<String>) -> Vec<String> {
    // This option alone may stand before the command.
    let first = if arguments.first().is_some_and(|argument| argument == "--threads") { 2 } else { 0 };
    let is_word = |argument: &String| !argument.starts_with('-') && !argument.contains(['.', '/', '\\']);
    if let Some(place) = (first..arguments.len()).find(|k| is_word(&arguments[*k])) {
        let command = arguments.remove(place);
        if ["bench", "analyse"].contains(&&*command) && arguments.get(place).is_some_and(is_word) {
            arguments.remove(place);
        }
    }
    arguments
}

/// Parts of an argument that may be paths: itself, and what separators of lists, flags, policies and JSON leave.
fn parts(argument: &str) -> impl Iterator<Item = &str> {
    let after = |separator: char| argument.split_once(separator).map(|(_, rest)| rest);
    let rests = [Some(argument), after('='), after(':')].into_iter().flatten();
    let in_lists = argument.split(',').map(|part| part.split_once(':').map_or(part, |(_, rest)| rest));
    let in_json = argument.split('"').skip(1).step_by(2);
    let in_commands = after(':').unwrap_or_default().split_whitespace();
    rests.chain(in_lists).chain(in_json).chain(in_commands)
}

/// Where a file or a folder is, links resolved; for a record such as `SHARD#3` its shard.
fn resolved(path: impl AsRef<Path>) -> Option<PathBuf> {
    let path = path.as_ref();
    let found = if path.as_os_str().is_empty() { None } else { path.canonicalize().ok() };
    found.or_else(|| womd::shard_of(path)?.canonicalize().ok())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_of_a_command_line_are_found_wherever_they_stand() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str| {
            let path = folder.path().join(name);
            std::fs::write(&path, "x").unwrap();
            path.canonicalize().unwrap()
        };
        let all = ["scene.pkl", "a.safetensors", "b,c.json", "weights", "splits.json", "d.json"].map(file);
        let at = |name: &str| folder.path().join(name).display().to_string();
        let arguments = [
            "generate".to_owned(),
            at("scene.pkl"),
            "--ego".to_owned(),
            format!("idm,td3:{},path:none", at("a.safetensors")),
            "--ego".to_owned(),
            format!("path:{}", at("b,c.json")),
            format!("--splits={}", at("splits.json")),
            "--run".to_owned(),
            format!("name={}", at("weights")),
            format!(r#"path{{"file": "{}"}}"#, at("d.json")),
            "--out".to_owned(),
            file("out").display().to_string(),
            format!("--junit={}", file("report").display()),
        ];
        let Inputs(mut found) = Inputs::named(arguments.into_iter());
        let mut expected = all.to_vec();
        expected.sort();
        found.sort();
        assert_eq!(found, expected);
    }

    #[test]
    fn a_folder_with_the_name_of_a_part_or_a_format_is_no_input() {
        // Tests run in the folder of the crate.
        let source = Path::new("src").canonicalize().unwrap();
        let named = |words: &str| Inputs::named(words.split(' ').map(str::to_owned)).0;
        for words in ["--format src", "--format=src", "--method src,rule", "--ego src"] {
            assert_eq!(named(words), Vec::<PathBuf>::new(), "{words}");
        }
        for words in ["src", "--format rows src", "--selection ./src", "--weights src", "--ego td3:src"] {
            assert_eq!(named(words), std::slice::from_ref(&source), "{words}");
        }
    }

    #[test]
    fn the_words_of_a_command_are_no_files() {
        let left = |line: &str| without_command(line.split(' ').map(str::to_owned).collect()).join(" ");
        assert_eq!(left("suite failures --out suite"), "failures --out suite");
        assert_eq!(left("--threads 2 search scenes --ego idm"), "--threads 2 scenes --ego idm");
        assert_eq!(left("--threads=2 search search"), "--threads=2 search");
        assert_eq!(left("bench transfer transfer --out transfer"), "transfer --out transfer");
        assert_eq!(left("bench own.yaml scenes"), "own.yaml scenes");
        assert_eq!(left("bench --scene-seed 3"), "--scene-seed 3");
    }

    #[test]
    fn outputs_that_would_replace_an_input_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir(at("weights")).unwrap();
        for name in ["weights/prior.safetensors", "weights/dial.json", "scene.pkl"] {
            std::fs::write(at(name), "x").unwrap();
        }
        let inputs = Inputs(Vec::new()).and([at("weights"), at("scene.pkl"), at("none")]);
        assert!(inputs.refuse_file(&at("scene.pkl")).is_err());
        assert!(inputs.refuse_file(&at("weights/prior.safetensors")).is_err());
        assert!(inputs.refuse_file(&at("weights/dial.json")).is_ok());
        assert!(inputs.refuse_file(&at("weights/new.safetensors")).is_ok());
        assert!(inputs.refuse_folder(&at("weights")).is_err());
        assert!(inputs.refuse_folder(folder.path()).is_err());
        assert!(inputs.refuse_folder(&at("weights/out")).is_ok());
        assert!(inputs.refuse_folder(&at("out")).is_ok());
    }

    #[cfg(unix)]
    #[test]
    fn links_to_inputs_are_inputs() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        std::fs::create_dir(at("real")).unwrap();
        std::os::unix::fs::symlink(at("real"), at("link")).unwrap();
        assert!(Inputs(Vec::new()).and([at("link")]).refuse_folder(&at("real")).is_err());
        assert!(Inputs(Vec::new()).and([at("real")]).refuse_folder(&at("link")).is_err());
    }
}
