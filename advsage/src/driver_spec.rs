//! A driver as a user names it: a registered policy, a file, a program, or a class of Python, perhaps under a name of the user's.

use std::{fmt, path::PathBuf, str::FromStr};

use sage_core::{objective::PartSpec, registry::Entry as _};
use sage_sim::policy::Takeover;
use serde_json::{Map, Value, json};

use crate::part::{COMMAND, Part, split};

/// Policies that a file describes, written `NAME:FILE`.
const FROM_FILES: [&str; 3] = ["path", "ppo", "td3"];
/// Policy that is a program; it is written `cmd:COMMAND`.
const PROCESS: &str = "process";
/// How a planner that is a class of Python is written, `py:MODULE:CLASS`, and the words that serve it.
const CLASS: &str = "py:";
const SERVE: [&str; 3] = ["python3", "-m", "advsage.serve"];
/// Most files beside a script that are looked at.
const MOST_BESIDE: usize = 1000;

/// A driver by name: `idm`, `td3:FILE`, `cmd:COMMAND`, `py:MODULE:CLASS`, each also as `NAME=…`, which tables then show.
///
/// ```
/// use advsage::DriverSpec;
///
/// let spec: DriverSpec = "mine=cmd:python3 planner.py --fast".parse()?;
/// assert_eq!((spec.name.as_deref(), spec.is_program()), (Some("mine"), true));
/// assert_eq!(spec.command(), Some(["python3", "planner.py", "--fast"].map(str::to_owned).to_vec()));
/// let spec: DriverSpec = "td3:driver.safetensors".parse()?;
/// assert_eq!((spec.file(), spec.part().name.as_str()), (Some("driver.safetensors"), "td3"));
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct DriverSpec {
    /// Name that the user gives it.
    pub name: Option<String>,
    /// What drives.
    pub kind: DriverKind,
    /// Its options, besides what `kind` says.
    pub options: Map<String, Value>,
}

/// What drives.
#[derive(Clone, Debug, PartialEq)]
pub enum DriverKind {
    /// A registered policy.
    Registered(String),
    /// A file that describes a policy: the drive of another planner, or a learnt one.
    File {
        /// The policy that reads it: `path`, `ppo` or `td3`.
        policy: String,
        /// The file.
        file: String,
    },
    /// A program, by its words.
    Command(Vec<String>),
    /// A class of Python, `MODULE:CLASS`, which the package `advsage` serves.
    Class(String),
}

impl DriverSpec {
    /// The driver of a registry entry with its options.
    pub fn of(part: Part) -> Self {
        let Part { name, mut options } = part;
        let of_file = FROM_FILES.contains(&&*name) && options.get("file").is_some_and(Value::is_string);
        let words = options.get("command").filter(|_| name == PROCESS).and_then(Value::as_array);
        let words =
            words.and_then(|words| words.iter().map(|word| Some(word.as_str()?.to_owned())).collect());
        let kind = match (words, of_file) {
            (Some(words), _) => {
                options.remove("command");
                let words: Vec<String> = words;
                match &words[..] {
                    [serve @ .., class] if serve == SERVE => DriverKind::Class(class.clone()),
                    _ => DriverKind::Command(words),
                }
            }
            (None, true) => {
                let file = options.remove("file").and_then(|file| Some(file.as_str()?.to_owned()));
                DriverKind::File { policy: name, file: file.unwrap_or_default() }
            }
            (None, false) => DriverKind::Registered(name),
        };
        Self { name: None, kind, options }
    }

    /// The entry of the registry of policies, with its options.
    pub fn part(&self) -> Part {
        let mut options = self.options.clone();
        for value in options.values_mut().filter(|_| self.is_of_others()) {
            // `{"first":"cmd:./planner"}` is as good as the whole form.
            if let Some(Ok(inner)) = value.as_str().map(str::parse::<Self>) {
                let Part { name, options } = inner.part();
                *value = json!({"name": name, "options": options});
            }
        }
        let name = match &self.kind {
            DriverKind::Registered(name) => name,
            DriverKind::File { policy, file } => {
                options.insert("file".to_owned(), json!(file));
                policy
            }
            DriverKind::Command(_) | DriverKind::Class(_) => {
                options.insert("command".to_owned(), json!(self.command()));
                PROCESS
            }
        };
        Part { name: name.to_owned(), options }
    }

    /// The file that describes it.
    pub fn file(&self) -> Option<&str> {
        match &self.kind {
            DriverKind::File { file, .. } => Some(file),
            _ => None,
        }
    }

    /// Whether a file describes it, or one that is in the program: a `path` or a learnt policy.
    pub fn is_of_file(&self) -> bool {
        match &self.kind {
            DriverKind::File { .. } => true,
            DriverKind::Registered(name) => FROM_FILES.contains(&&**name),
            _ => false,
        }
    }

    /// Program and arguments of a planner that is a program.
    pub fn command(&self) -> Option<Vec<String>> {
        match &self.kind {
            DriverKind::Command(words) => Some(words.clone()),
            DriverKind::Class(class) => {
                Some(SERVE.into_iter().chain([&**class]).map(str::to_owned).collect())
            }
            _ => None,
        }
    }

    /// Whether its options are drivers.
    fn is_of_others(&self) -> bool {
        matches!(&self.kind, DriverKind::Registered(name) if name == Takeover::NAME)
    }

    /// The drivers that its options name.
    fn others(&self) -> Vec<Self> {
        let of = |value: &Value| match value {
            Value::String(text) => text.parse().ok(),
            other => serde_json::from_value(other.clone()).ok().map(|PartSpec { name, options }| {
                Self::of(Part { name, options: options.into_iter().collect() })
            }),
        };
        self.options.values().filter(|_| self.is_of_others()).filter_map(of).collect()
    }

    /// Whether a program drives, alone or as one of the drivers or other parts that its options name, however deep. Only a
    /// command line may name one; files that come from elsewhere may not.
    pub fn names_program(&self) -> bool {
        self.is_program() || self.options.values().any(names_program)
    }

    /// Whether it is a program.
    pub fn is_program(&self) -> bool {
        match &self.kind {
            DriverKind::Command(_) | DriverKind::Class(_) => true,
            DriverKind::Registered(name) => name == PROCESS,
            DriverKind::File { .. } => false,
        }
    }

    /// Files that decide how it drives: the one that describes it, or those that its command names.
    pub fn files(&self) -> Vec<PathBuf> {
        let words = self.command().unwrap_or_default();
        let named = words.iter().map(PathBuf::from);
        let module = match &self.kind {
            DriverKind::Class(class) => class.rsplit_once(':'),
            _ => None,
        };
        let module = module.map(|(module, _)| PathBuf::from(module.replace('.', "/") + ".py"));
        let programs = named.chain(module).filter(|path| path.is_file());
        let own = programs.chain(self.file().map(PathBuf::from));
        own.chain(self.others().iter().flat_map(Self::files)).collect()
    }

    /// [`DriverSpec::files`], and the files beside those that a command names that have the same ending: what a script
    /// imports is often there.
    pub fn files_and_beside(&self) -> Vec<PathBuf> {
        let mut all = self.files();
        if self.names_program() {
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

    /// The driver with all its options, as it can be given again.
    pub fn spelled(&self) -> String {
        let spelled = if self.is_program() { self.part().to_string() } else { self.without_name() };
        self.name.as_ref().map_or(spelled.clone(), |name| format!("{name}={spelled}"))
    }

    /// The driver with times that a program has to answer (to the first message, to that of a drive, to that of a step),
    /// seconds; other drivers as they are.
    #[must_use]
    pub fn with_timeouts(mut self, timeouts: [f64; 3]) -> Self {
        if self.is_program() {
            self.options.insert("timeouts".to_owned(), json!(timeouts));
        }
        self
    }

    /// What distinguishes it from others in the record of a run: its name, if it has one, and what drives.
    pub fn for_identity(&self) -> String {
        let unnamed = self.without_name();
        self.name.as_ref().map_or(unnamed.clone(), |name| format!("{name}={unnamed}"))
    }

    /// What drives, in the shortest spelling, whatever the user calls it. Times to answer are not shown: they decide no drive.
    pub fn without_name(&self) -> String {
        let mut shown = self.clone();
        if self.is_program() {
            shown.options.remove("timeouts");
        }
        if !shown.options.is_empty() {
            return shown.part().to_string();
        }
        match &self.kind {
            DriverKind::File { policy, file } => format!("{policy}:{file}"),
            DriverKind::Class(class) => format!("{CLASS}{class}"),
            // A word with a zero byte is no argument of any program, and is shown as JSON.
            DriverKind::Command(words) => match shlex::try_join(words.iter().map(String::as_str)) {
                Ok(line) => format!("{COMMAND}{line}"),
                Err(_) => shown.part().to_string(),
            },
            DriverKind::Registered(name) => name.clone(),
        }
    }
}

impl fmt::Display for DriverSpec {
    /// Its name, or what drives.
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match &self.name {
            Some(name) => f.write_str(name),
            None => f.write_str(&self.without_name()),
        }
    }
}

impl FromStr for DriverSpec {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (name, text) = named(text);
        let of = |kind| Ok(Self { name: name.map(str::to_owned), kind, options: Map::new() });
        if let Some(line) = text.trim_start().strip_prefix(COMMAND) {
            let words = shlex::split(line)
                .ok_or_else(|| format!("`{line}` has a quote without its end, or ends with a backslash"))?;
            return of(DriverKind::Command(words));
        }
        if let Some(class) = text.trim().strip_prefix(CLASS) {
            let is_named =
                class.rsplit_once(':').is_some_and(|(module, class)| !module.is_empty() && !class.is_empty());
            if !is_named || class.contains(char::is_whitespace) {
                return Err(format!("`{text}` names no class; write py:package.module:Class"));
            }
            return of(DriverKind::Class(class.to_owned()));
        }
        if let Some((policy, file)) = text.split_once(':').filter(|(name, _)| FROM_FILES.contains(name)) {
            return of(DriverKind::File { policy: policy.to_owned(), file: file.to_owned() });
        }
        let part: Part = text.parse()?;
        Ok(Self { name: name.map(str::to_owned), ..Self::of(part) })
    }
}

/// Whether a value names a program.
fn names_program(value: &Value) -> bool {
    match value {
        Value::String(text) => [COMMAND, CLASS].iter().any(|start| text.trim_start().starts_with(start)),
        Value::Array(all) => all.iter().any(names_program),
        Value::Object(fields) => {
            fields.get("name").is_some_and(|name| name == PROCESS) || fields.values().any(names_program)
        }
        _ => false,
    }
}

/// The name that a user gives a driver, as in `fiss=cmd:…`, and the rest.
fn named(text: &str) -> (Option<&str>, &str) {
    let is_plain = |name: &str| {
        !name.is_empty() && name.chars().all(|c| c.is_alphanumeric() || ['_', '-', '.'].contains(&c))
    };
    match text.split_once('=') {
        Some((name, rest)) if is_plain(name.trim()) => (Some(name.trim()), rest),
        _ => (None, text),
    }
}

/// Comma-separated drivers. One that is a command takes the rest of the text.
#[derive(Clone, Debug)]
pub struct DriverSpecs(pub Vec<DriverSpec>);

impl FromStr for DriverSpecs {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Ok(Self(split(text).iter().map(|part| part.parse()).collect::<Result<_, _>>()?))
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_policy_may_be_a_path() {
        for (text, name, file) in [
            ("path:drives/a,b.json", "path", "drives/a,b.json"),
            ("td3:run/policy.safetensors", "td3", "run/policy.safetensors"),
        ] {
            let spec: DriverSpec = text.parse().unwrap();
            let part = spec.part();
            assert_eq!(
                (&*part.name, &part.options["file"], spec.file()),
                (name, &Value::from(file), Some(file))
            );
            assert_eq!((spec.to_string(), DriverSpec::of(part)), (text.to_owned(), spec));
        }
        assert_eq!("idm".parse::<DriverSpec>().unwrap().part(), Part::named("idm"));
    }

    #[test]
    fn a_driver_of_drivers_may_have_a_program() {
        let short: DriverSpec = r#"takeover{"first":"cmd:./planner 1","then":"pdm"}"#.parse().unwrap();
        let long = r#"takeover{"first":{"name":"process","options":{"command":["./planner","1"]}},"then":{"name":"pdm"}}"#;
        let long: DriverSpec = long.parse().unwrap();
        assert_eq!(short.part().options["first"], long.part().options["first"]);
        assert_eq!(short.part().options["then"]["name"], "pdm");
        assert!(short.names_program() && long.names_program() && !short.is_program());
        let deep = r#"other{"of":[{"parts":{"name":"process"}}]}"#;
        assert!(deep.parse::<DriverSpec>().unwrap().names_program());
        let calm: DriverSpec = r#"takeover{"first":{"name":"idm"}}"#.parse().unwrap();
        assert!(!calm.names_program() && calm.files().is_empty());
        let of_file: DriverSpec = r#"takeover{"first":"td3:a.safetensors"}"#.parse().unwrap();
        assert_eq!(of_file.files(), [PathBuf::from("a.safetensors")]);
    }

    #[test]
    fn a_policy_may_be_a_command() {
        let DriverSpecs(all) =
            r#"idm,path:a.json,cmd:python3 "my planner.py" --speed 3,4 --name='a b'"#.parse().unwrap();
        let words = ["python3", "my planner.py", "--speed", "3,4", "--name=a b"].map(str::to_owned).to_vec();
        assert_eq!((all.len(), all[2].command()), (3, Some(words.clone())));
        assert!(all[2].is_program() && !all[1].is_program());
        // It is shown as it can be given again; times to answer are no part of its name.
        let shown = all[2].to_string();
        assert_eq!(shown.parse::<DriverSpec>().unwrap(), all[2]);
        assert_eq!(all[2].clone().with_timeouts([1.0, 2.0, 3.0]).to_string(), shown);
        let long: DriverSpec = r#"process{"command":["a","b c"]}"#.parse().unwrap();
        assert_eq!(long.to_string(), "cmd:a 'b c'");
        assert!("cmd:python3 'x".parse::<DriverSpec>().unwrap_err().contains("without its end"));

        let class: DriverSpecs = "py:package.module:Class,idm".parse().unwrap();
        assert_eq!(class.0[0].command().unwrap().join(" "), "python3 -m advsage.serve package.module:Class");
        assert_eq!((class.0[0].to_string(), class.0.len()), ("py:package.module:Class".to_owned(), 2));
        for wrong in ["py:module", "py::Class", "py:module:", "py:a module:Class"] {
            assert!(wrong.parse::<DriverSpec>().unwrap_err().contains("names no class"));
        }
        let DriverSpecs(one) = "cmd:a, b".parse().unwrap();
        assert_eq!(one[0].command().unwrap(), ["a,", "b"]);
    }

    #[test]
    fn a_driver_may_have_a_name_of_its_own() {
        let DriverSpecs(all) =
            "plain=idm{\"speed\": 4},fiss=cmd:python3 planner.py --k=1, 2".parse().unwrap();
        assert_eq!(all.iter().map(ToString::to_string).collect::<Vec<_>>(), ["plain", "fiss"]);
        assert_eq!(all[1].without_name(), "cmd:python3 planner.py '--k=1,' 2");
        for one in &all {
            assert_eq!(one.spelled().parse::<DriverSpec>().unwrap(), *one);
        }
        let path: DriverSpec = "path:a=b.json".parse().unwrap();
        assert_eq!((path.name.clone(), path.file()), (None, Some("a=b.json")));
    }
}
