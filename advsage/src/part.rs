//! Registry entries as command-line values: `NAME`, or `NAME{"option": value}`.

use std::{fmt, str::FromStr};

use sage_core::{objective::PartSpec, registry::Registry};
use serde::{Deserialize, Deserializer};
use serde_json::{Map, Value};

/// How a driver that is a program begins; it takes the rest of a list.
pub(crate) const COMMAND: &str = "cmd:";

/// Name and options of a registry entry.
///
/// ```
/// use advsage::{Part, Registries};
///
/// let part: Part = r#"sage{"candidates": 64}"#.parse()?;
/// assert_eq!((part.name.as_str(), &part.options["candidates"]), ("sage", &64.into()));
/// assert_eq!(part.to_string(), r#"sage{"candidates":64}"#);
/// // Options are checked when the part is built.
/// assert!(part.build(&Registries::of_attacks()?.generators).is_ok());
/// assert!(r#"sage{"candidates": -1}"#.parse::<Part>()?.build(&Registries::of_attacks()?.generators).is_err());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
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

impl<'de> Deserialize<'de> for Part {
    /// From its text.
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(serde::de::Error::custom)
    }
}

/// Options of a part: JSON, as an object or as its text.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PartOptions(pub Map<String, Value>);

impl FromStr for PartOptions {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        serde_json::from_str(text).map(Self).map_err(|error| format!("it is not a JSON object: {error}"))
    }
}

impl<'de> Deserialize<'de> for PartOptions {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Map::deserialize(deserializer).map(Self)
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

/// Comma-separated parts.
#[derive(Clone, Debug)]
pub struct Parts(pub Vec<Part>);

impl FromStr for Parts {
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
        // A command may stand behind a name: `fiss=cmd:…`.
        let begins = |part: &String| part.trim().is_empty() || part.ends_with('=');
        if depth == 0 && parts.last().is_some_and(begins) && text[at..].starts_with(COMMAND) {
            let name = parts.pop().unwrap_or_default();
            parts.push(format!("{}{}", name.trim_start(), &text[at..]));
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
