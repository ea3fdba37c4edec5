//! Registry entries as command-line values: `NAME`, or `NAME{"option": value}`.

use std::{fmt, path::PathBuf, str::FromStr};

use sage_core::{objective::PartSpec, registry::Registry};
use serde_json::{Map, Value};

/// Name and options of a registry entry.
#[derive(Clone, Debug, PartialEq)]
pub struct Part {
    /// Name in its registry.
    pub name: String,
    /// Options that differ from the defaults.
    pub options: Map<String, Value>,
}

impl Part {
    /// Builds the part.
    ///
    /// *Errors*: the name is not registered, or the part refuses the options.
    pub fn build<T: ?Sized>(&self, registry: &Registry<T>) -> crate::Result<Box<T>> {
        Ok(registry.build(&self.name, &Value::Object(self.options.clone()))?)
    }

    /// A part without options.
    pub fn named(name: impl Into<String>) -> Self {
        Self { name: name.into(), options: Map::new() }
    }

    /// The paper's feasibility rule.
    pub fn paper() -> Self {
        Self::named(PartSpec::default().name)
    }

    /// The part as an objective specifies it.
    pub fn spec(&self) -> PartSpec {
        PartSpec { name: self.name.clone(), options: self.options.clone() }
    }
}

impl FromStr for Part {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, options) = text.find('{').map_or((text, "{}"), |at| text.split_at(at));
        let options = serde_json::from_str(options)
            .map_err(|error| format!("`{options}` is not a JSON object of options: {error}"))?;
        Ok(Self { name: name.trim().to_owned(), options })
    }
}

impl fmt::Display for Part {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(&self.name)?;
        if self.options.is_empty() {
            return Ok(());
        }
        write!(f, "{}", Value::Object(self.options.clone()))
    }
}

/// Policies that a file describes, written NAME:FILE.
const FROM_FILES: [&str; 3] = ["path", "ppo", "td3"];
/// Policy that a command describes, and how it is written: cmd:COMMAND.
const PROCESS: &str = "process";
const COMMAND: &str = "cmd:";
/// How a planner that is a class of Python is written, py:MODULE:CLASS, and the words that serve it.
const CLASS: &str = "py:";
const SERVE: [&str; 3] = ["python3", "-m", "advsage.serve"];
/// Most files beside a script that are looked at.
const MOST_BESIDE: usize = 1000;

/// A driving policy: a part, `path:FILE` for the drive of another planner, `ppo:FILE` for a learnt policy,
/// `cmd:COMMAND` for a planner that is a program, or `py:MODULE:CLASS` for one that is a class of Python, served by `advsage`.
#[derive(Clone, Debug, PartialEq)]
pub struct PolicyPart(pub Part);

impl PolicyPart {
    /// The file of a `path` or a learnt policy.
    pub fn file(&self) -> Option<&str> {
        let Self(part) = self;
        part.options.get("file").and_then(Value::as_str).filter(|_| FROM_FILES.contains(&&*part.name))
    }

    /// Whether a file describes it, or one that is in the program: a `path` or a learnt policy.
    pub fn is_of_file(&self) -> bool {
        FROM_FILES.contains(&&*self.0.name)
    }

    /// Program and arguments of a planner that is a program.
    pub fn command(&self) -> Option<Vec<String>> {
        let Self(part) = self;
        let words = part.options.get("command").filter(|_| part.name == PROCESS)?.as_array()?;
        words.iter().map(|word| Some(word.as_str()?.to_owned())).collect()
    }

    /// Module and class of a planner that is a class of Python.
    fn class(&self) -> Option<String> {
        match &self.command()?[..] {
            [words @ .., class] if words == SERVE => Some(class.clone()),
            _ => None,
        }
    }

    /// Whether it starts a program. Only a command line may name one; files that come from elsewhere may not.
    pub fn is_program(&self) -> bool {
        self.0.name == PROCESS
    }

    /// Files that decide how it drives: the one that describes it, or those that its command names.
    pub fn files(&self) -> Vec<PathBuf> {
        let words = self.command().unwrap_or_default();
        let named = words.iter().map(PathBuf::from);
        let class = self.class();
        let module = class.as_deref().and_then(|class| class.rsplit_once(':'));
        let module = module.map(|(module, _)| PathBuf::from(module.replace('.', "/") + ".py"));
        let programs = named.chain(module).filter(|path| path.is_file());
        programs.chain(self.file().map(PathBuf::from)).collect()
    }

    /// [`PolicyPart::files`], and the files beside those that a command names that have the same ending: what a script
    /// imports is often there.
    pub fn files_and_beside(&self) -> Vec<PathBuf> {
        let mut all = self.files();
        if self.is_program() {
            let beside = |file: &PathBuf| -> Vec<PathBuf> {
                let Some(ending) = file.extension() else { return Vec::new() };
                let folder = file.parent().filter(|folder| !folder.as_os_str().is_empty());
                let entries =
                    std::fs::read_dir(folder.unwrap_or(".".as_ref())).into_iter().flatten().flatten();
                let same = entries.map(|entry| entry.path()).filter(|path| path.extension() == Some(ending));
                let mut same: Vec<PathBuf> = same.filter(|path| path.is_file()).collect();
                same.sort();
                same.truncate(MOST_BESIDE);
                same
            };
            let found: Vec<PathBuf> = all.iter().flat_map(beside).collect();
            all.extend(found);
            all.sort();
            all.dedup();
        }
        all
    }

    /// The policy with all its options, as it can be given again.
    pub fn spelled(&self) -> String {
        let Self(part) = self;
        if self.is_program() { part.to_string() } else { self.to_string() }
    }

    /// The policy with times that a program has to answer (to the first message, to that of a drive, to that of a step),
    /// seconds; other policies as they are.
    #[must_use]
    pub fn with_timeouts(mut self, timeouts: [f64; 3]) -> Self {
        if self.is_program() {
            self.0.options.insert("timeouts".to_owned(), timeouts.to_vec().into());
        }
        self
    }
}

/// Times for the first message of a program, of a drive, and of a step, s.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Timeouts(pub [f64; 3]);

impl FromStr for Timeouts {
    type Err = String;

    /// One number for all, or three: `START,RESET,STEP`.
    fn from_str(text: &str) -> Result<Self, String> {
        let seconds = |word: &str| word.trim().parse::<f64>().ok().filter(|seconds| *seconds > 0.0);
        let numbers: Option<Vec<f64>> = text.split(',').map(seconds).collect();
        match numbers.as_deref() {
            Some([all]) => Ok(Self([*all; 3])),
            Some([start, reset, step]) => Ok(Self([*start, *reset, *step])),
            _ => Err("expected one number of seconds above 0, or three: START,RESET,STEP".to_owned()),
        }
    }
}

impl fmt::Display for PolicyPart {
    /// Times to answer are not shown: they decide no drive.
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        let mut shown = self.0.clone();
        if self.is_program() {
            shown.options.remove("timeouts");
        }
        if let Some(class) = self.class().filter(|_| shown.options.len() == 1) {
            return write!(f, "{CLASS}{class}");
        }
        match (self.file(), self.command()) {
            (Some(file), _) if shown.options.len() == 1 => write!(f, "{}:{file}", shown.name),
            (_, Some(words)) if shown.options.len() == 1 => {
                // A word with a zero byte is no argument of any program, and is shown as JSON.
                match shlex::try_join(words.iter().map(String::as_str)) {
                    Ok(line) => write!(f, "{COMMAND}{line}"),
                    Err(_) => shown.fmt(f),
                }
            }
            _ => shown.fmt(f),
        }
    }
}

impl FromStr for PolicyPart {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if let Some(line) = text.trim_start().strip_prefix(COMMAND) {
            let words = shlex::split(line)
                .ok_or_else(|| format!("`{line}` has a quote without its end, or ends with a backslash"))?;
            let options = Map::from_iter([("command".to_owned(), Value::from(words))]);
            return Ok(Self(Part { name: PROCESS.to_owned(), options }));
        }
        if let Some(class) = text.trim().strip_prefix(CLASS) {
            let is_named =
                class.rsplit_once(':').is_some_and(|(module, class)| !module.is_empty() && !class.is_empty());
            if !is_named || class.contains(char::is_whitespace) {
                return Err(format!("`{text}` names no class; write py:package.module:Class"));
            }
            let words: Vec<&str> = SERVE.into_iter().chain([class]).collect();
            let options = Map::from_iter([("command".to_owned(), Value::from(words))]);
            return Ok(Self(Part { name: PROCESS.to_owned(), options }));
        }
        let found = text.split_once(':').filter(|(name, _)| FROM_FILES.contains(name));
        let Some((name, file)) = found else { return Ok(Self(text.parse()?)) };
        let options = Map::from_iter([("file".to_owned(), Value::from(file))]);
        Ok(Self(Part { name: name.to_owned(), options }))
    }
}

/// Comma-separated parts.
#[derive(Clone, Debug)]
pub struct Parts(pub Vec<Part>);

impl FromStr for Parts {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Ok(Self(split(text).iter().map(|part| part.parse()).collect::<Result<_, _>>()?))
    }
}

/// Comma-separated policies. One that is a command takes the rest of the text.
#[derive(Clone, Debug)]
pub struct PolicyParts(pub Vec<PolicyPart>);

impl FromStr for PolicyParts {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Ok(Self(split(text).iter().map(|part| part.parse()).collect::<Result<_, _>>()?))
    }
}

/// Splits a list at its commas. Commas within options do not separate, nor those of a command (`cmd:…`), which takes the
/// rest; brackets in JSON strings are ignored.
pub fn split(text: &str) -> Vec<String> {
    let (mut depth, mut is_text, mut is_escaped) = (0_usize, false, false);
    let mut parts = vec![String::new()];
    for (at, letter) in text.char_indices() {
        if parts.last().is_some_and(|part| part.trim().is_empty()) && text[at..].starts_with(COMMAND) {
            parts.pop();
            parts.push(text[at..].to_owned());
            return parts;
        }
        match letter {
            _ if is_escaped => is_escaped = false,
            '\\' if is_text => is_escaped = true,
            '"' => is_text = !is_text,
            _ if is_text => {}
            '{' => depth += 1,
            '}' => depth = depth.saturating_sub(1),
            ',' if depth == 0 => {
                parts.push(String::new());
                continue;
            }
            _ => {}
        }
        if let Some(last) = parts.last_mut() {
            last.push(letter);
        }
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_policy_may_be_a_path() {
        let PolicyPart(part) = "path:drives/a,b.json".parse().unwrap();
        assert_eq!((&*part.name, &part.options["file"]), ("path", &Value::from("drives/a,b.json")));
        let PolicyPart(part) = "td3:run/policy.safetensors".parse().unwrap();
        assert_eq!((&*part.name, &part.options["file"]), ("td3", &Value::from("run/policy.safetensors")));
        assert_eq!("idm".parse::<PolicyPart>().unwrap().0.name, "idm");
    }

    #[test]
    fn a_policy_may_be_a_command() {
        let PolicyParts(all) =
            r#"idm,path:a.json,cmd:python3 "my planner.py" --speed 3,4 --name='a b'"#.parse().unwrap();
        let words = ["python3", "my planner.py", "--speed", "3,4", "--name=a b"].map(str::to_owned).to_vec();
        assert_eq!((all.len(), all[2].command()), (3, Some(words.clone())));
        assert!(all[2].is_program() && !all[1].is_program());
        // It is shown as it can be given again; times to answer are no part of its name.
        let shown = all[2].to_string();
        assert_eq!(shown.parse::<PolicyPart>().unwrap(), all[2]);
        assert_eq!(all[2].clone().with_timeouts([1.0, 2.0, 3.0]).to_string(), shown);
        let long: PolicyPart = r#"process{"command":["a","b c"]}"#.parse().unwrap();
        assert_eq!(long.to_string(), "cmd:a 'b c'");
        assert!("cmd:python3 'x".parse::<PolicyPart>().unwrap_err().contains("without its end"));

        let class: PolicyParts = "py:package.module:Class,idm".parse().unwrap();
        assert_eq!(class.0[0].command().unwrap().join(" "), "python3 -m advsage.serve package.module:Class");
        assert_eq!((class.0[0].to_string(), class.0.len()), ("py:package.module:Class".to_owned(), 2));
        for wrong in ["py:module", "py::Class", "py:module:", "py:a module:Class"] {
            assert!(wrong.parse::<PolicyPart>().unwrap_err().contains("names no class"));
        }
        let PolicyParts(one) = "cmd:a, b".parse().unwrap();
        assert_eq!(one[0].command().unwrap(), ["a,", "b"]);
    }

    #[test]
    fn a_part_is_a_name_with_or_without_options() {
        let part: Part = "linear".parse().unwrap();
        assert_eq!((part.name.as_str(), part.options.len()), ("linear", 0));
        let part: Part = r#"drivable{"height_gap": 2.5}"#.parse().unwrap();
        assert_eq!(part.options["height_gap"], 2.5);
        assert_eq!(part.to_string(), r#"drivable{"height_gap":2.5}"#);
        assert!("drivable{2}".parse::<Part>().unwrap_err().contains("not a JSON object"));
        let Parts(all) = r#"sage{"candidates": 8, "apart": 3.0},rule"#.parse().unwrap();
        assert_eq!([&*all[0].name, &*all[1].name], ["sage", "rule"]);
        assert_eq!(all[0].options["candidates"], 8);
        let Parts(all) = r#"a{"text": "},\"{,"},b"#.parse().unwrap();
        assert_eq!((all.len(), &all[0].options["text"]), (2, &Value::from("},\"{,")));
    }
}
