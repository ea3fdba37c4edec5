//! Errors, grouped by how a caller can react.

use std::{error::Error as StdError, io};

/// What this crate returns.
pub type Result<T, E = Error> = std::result::Result<T, E>;

/// An error of this crate, or of a crate below.
///
/// ```
/// use std::path::Path;
///
/// use advsage::{Error, Recording, in_one_line};
///
/// let Err(error) = Recording::read(Path::new("nowhere.pkl")) else { return };
/// // Errors of all crates below become one, and `within` says what was done.
/// let error = Error::from(error).within("scene `7`");
/// assert!(in_one_line(&error).starts_with("scene `7`: cannot read `nowhere.pkl`: "));
/// ```
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A name that nothing has: of weights, of a selection.
    #[error("{0}")]
    Unknown(String),
    /// A value that is out of range, or given twice.
    #[error("{0}")]
    Value(String),
    /// An error within what was done.
    #[error("{what}")]
    Within {
        /// What was done.
        what: String,
        /// The error.
        source: Box<Self>,
    },
    /// A scene, a part or an attack.
    #[error(transparent)]
    Core(#[from] sage_core::Error),
    /// A file of a scene.
    #[error(transparent)]
    Data(#[from] sage_data::Error),
    /// A network or its weights.
    #[error(transparent)]
    Network(#[from] sage_backbones::Error),
    /// A merger or its experts.
    #[error(transparent)]
    Merging(#[from] sage_merging::Error),
    /// A generator.
    #[error(transparent)]
    Generator(#[from] sage_generators::Error),
    /// A driver or a simulation.
    #[error(transparent)]
    Simulation(Box<sage_sim::Error>),
    /// A text that is not the JSON that it should be.
    #[error(transparent)]
    Json(#[from] serde_json::Error),
    /// A file that cannot be read.
    #[error(transparent)]
    Io(#[from] io::Error),
}

impl From<sage_sim::Error> for Error {
    fn from(error: sage_sim::Error) -> Self {
        Self::Simulation(Box::new(error))
    }
}

impl Error {
    /// The same within what was done.
    #[must_use]
    pub fn within(self, what: impl Into<String>) -> Self {
        Self::Within { what: what.into(), source: Box::new(self) }
    }

    /// The error of a crate below, if it is one.
    fn below(&self) -> Option<&(dyn StdError + 'static)> {
        Some(match self {
            Self::Core(error) => error,
            Self::Data(error) => error,
            Self::Network(error) => error,
            Self::Merging(error) => error,
            Self::Generator(error) => error,
            Self::Simulation(error) => &**error,
            Self::Json(error) => error,
            Self::Io(error) => error,
            Self::Unknown(_) | Self::Value(_) | Self::Within { .. } => return None,
        })
    }
}

/// Adds what was done to an error. A missing value becomes one.
pub trait WithContext<T> {
    /// The value, or the error within what was done.
    fn with_context<W: Into<String>>(self, what: impl FnOnce() -> W) -> Result<T>;
}

impl<T, E: Into<Error>> WithContext<T> for Result<T, E> {
    fn with_context<W: Into<String>>(self, what: impl FnOnce() -> W) -> Result<T> {
        self.map_err(|error| error.into().within(what()))
    }
}

impl<T> WithContext<T> for Option<T> {
    fn with_context<W: Into<String>>(self, what: impl FnOnce() -> W) -> Result<T> {
        self.ok_or_else(|| Error::Value(what().into()))
    }
}

/// A cause as an error of a type, also where it is wrapped in an [`Error`].
pub fn as_cause<'e, T: StdError + 'static>(cause: &'e (dyn StdError + 'static)) -> Option<&'e T> {
    // A source in a box has the type of the box.
    let boxed = || cause.downcast_ref::<Box<Error>>().map(|error| &**error);
    let own = cause.downcast_ref::<Error>().or_else(boxed);
    let own_as_cause = own.map(|error| error as &(dyn StdError + 'static));
    let all = [Some(cause), own_as_cause, own.and_then(Error::below)];
    all.into_iter().flatten().find_map(|error| error.downcast_ref())
}

/// True if a cause leaves a scene out, because no attack can be measured in it: the two cars touch *now*, or a person has no place.
pub fn leaves_out(cause: &(dyn StdError + 'static)) -> bool {
    use sage_core::Error as Core;
    matches!(as_cause(cause), Some(Core::ContactNow { .. } | Core::NoPlace { .. }))
}

/// An error with its causes, in one line.
pub fn in_one_line(error: &dyn StdError) -> String {
    let mut line = error.to_string();
    let mut cause = error.source();
    while let Some(error) = cause {
        line += &format!(": {error}");
        cause = error.source();
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn causes_are_found_and_said_once() {
        let cause =
            sage_core::Error::ContactNow { scene: "7".into(), ego: "a".into(), adversary: "b".into() };
        let error = Error::from(cause).within("driver `idm`");
        assert!(!leaves_out(&error));
        let source = error.source().expect("it has a cause");
        assert!(leaves_out(source) && source.source().is_none());
        assert_eq!(in_one_line(&error).matches("contact_now").count(), 1, "{}", in_one_line(&error));
    }
}
