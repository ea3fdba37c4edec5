//! Choices by name: the version of the standard and who drives the ego.

use std::{fmt, str::FromStr};

/// Version of ASAM OpenSCENARIO XML.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[allow(non_camel_case_types)] // A point cannot stand in a name.
pub enum Standard {
    /// 1.0.
    V1_0,
    /// 1.1.
    V1_1,
    /// 1.2.
    #[default]
    V1_2,
    /// 1.3.
    V1_3,
}

impl Standard {
    /// All versions.
    pub const ALL: [Self; 4] = [Self::V1_0, Self::V1_1, Self::V1_2, Self::V1_3];

    /// Name such as `1.2`.
    pub fn name(self) -> &'static str {
        match self {
            Self::V1_0 => "1.0",
            Self::V1_1 => "1.1",
            Self::V1_2 => "1.2",
            Self::V1_3 => "1.3",
        }
    }

    /// The number behind the point.
    pub(super) fn minor(self) -> i64 {
        self as i64
    }
}

/// Who drives the ego.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum EgoMode {
    /// The recording.
    #[default]
    Replay,
    /// An external controller: the ego gets a start speed and a route.
    Controller,
}

impl EgoMode {
    /// Both.
    pub const ALL: [Self; 2] = [Self::Replay, Self::Controller];

    /// Name such as `replay`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Replay => "replay",
            Self::Controller => "controller",
        }
    }
}

/// A name that is none of the choices.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("unknown {kind} `{name}`; known: {}", known.join(", "))]
pub struct UnknownName {
    /// What was to be chosen.
    pub kind: &'static str,
    /// The name.
    pub name: String,
    /// The choices.
    pub known: Vec<&'static str>,
}

fn find<T: Copy>(
    kind: &'static str,
    all: &[T],
    name_of: fn(T) -> &'static str,
    name: &str,
) -> Result<T, UnknownName> {
    let found = all.iter().copied().find(|choice| name_of(*choice) == name);
    found.ok_or_else(|| UnknownName {
        kind,
        name: name.to_owned(),
        known: all.iter().map(|choice| name_of(*choice)).collect(),
    })
}

impl FromStr for Standard {
    type Err = UnknownName;

    fn from_str(name: &str) -> Result<Self, UnknownName> {
        find("version of OpenSCENARIO", &Self::ALL, Self::name, name)
    }
}

impl FromStr for EgoMode {
    type Err = UnknownName;

    fn from_str(name: &str) -> Result<Self, UnknownName> {
        find("driver of the ego", &Self::ALL, Self::name, name)
    }
}

impl fmt::Display for Standard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl fmt::Display for EgoMode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_parse_to_what_they_name() {
        for standard in Standard::ALL {
            assert_eq!(standard.to_string().parse(), Ok(standard));
        }
        for ego in EgoMode::ALL {
            assert_eq!(ego.to_string().parse(), Ok(ego));
        }
        let error = "2.0".parse::<Standard>().unwrap_err();
        assert_eq!(error.to_string(), "unknown version of OpenSCENARIO `2.0`; known: 1.0, 1.1, 1.2, 1.3");
    }
}
