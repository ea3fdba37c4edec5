//! Registry entries as command-line values: `NAME`, or `NAME{"option": value}`.

use std::{fmt, str::FromStr};

use anyhow::Result;
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
    pub fn build<T: ?Sized>(&self, registry: &Registry<T>) -> Result<Box<T>> {
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
const FROM_FILES: [&str; 2] = ["path", "td3"];

/// A driving policy: a part, `path:FILE` for the drive of another planner, or `td3:FILE` for a learnt policy.
#[derive(Clone, Debug, PartialEq)]
pub struct PolicyPart(pub Part);

impl PolicyPart {
    /// The file of a `path` or `td3`.
    pub fn file(&self) -> Option<&str> {
        let Self(part) = self;
        part.options.get("file").and_then(Value::as_str).filter(|_| FROM_FILES.contains(&&*part.name))
    }
}

impl fmt::Display for PolicyPart {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self.file() {
            Some(file) if self.0.options.len() == 1 => write!(f, "{}:{file}", self.0.name),
            _ => self.0.fmt(f),
        }
    }
}

impl FromStr for PolicyPart {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
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

/// Comma-separated policies.
#[derive(Clone, Debug)]
pub struct PolicyParts(pub Vec<PolicyPart>);

impl FromStr for PolicyParts {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Ok(Self(split(text).iter().map(|part| part.parse()).collect::<Result<_, _>>()?))
    }
}

/// Splits a list at its commas. Commas within options do not separate; brackets in JSON strings are ignored.
pub fn split(text: &str) -> Vec<String> {
    let (mut depth, mut is_text, mut is_escaped) = (0_usize, false, false);
    let mut parts = vec![String::new()];
    for letter in text.chars() {
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
