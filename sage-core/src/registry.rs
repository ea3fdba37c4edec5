//! Registries: named parts with summaries, sources and typed options.
//!
//! A registry is a value: a function lists the entries of a kind, a program passes the registry on, and a
//! user's own crate adds entries with [`Registry::with`]. There is no global state.

use serde::{Serialize, de::DeserializeOwned};
use serde_json::Value;

use crate::Error;

/// A part that a registry of `T` can hold: one file per implementation.
///
/// A reward of your own joins those that are shipped, under its name:
///
/// ```
/// # use sage_core::objective::{Situation, rewards};
/// use sage_core::{
///     objective::Reward,
///     registry::{Entry, NoOptions},
/// };
///
/// struct Distance;
/// #
/// # impl Reward for Distance {
/// #     fn score(&self, situation: &Situation) -> Option<f64> {
/// #         Some(situation.encounter.least_distance)
/// #     }
/// # }
///
/// impl Entry<dyn Reward> for Distance {
///     const NAME: &'static str = "distance";
///     const SUMMARY: &'static str = "least distance of the centres, metres";
///     const SOURCE: &'static str = "an example";
///     type Options = NoOptions;
///
///     fn build(_: NoOptions) -> Result<Box<dyn Reward>, String> {
///         Ok(Box::new(Self))
///     }
/// }
///
/// let rewards = rewards()?.with::<Distance>()?;
/// assert!(rewards.build_default("distance").is_ok());
/// assert!(rewards.with::<Distance>().is_err(), "the name is taken");
/// # Ok::<(), sage_core::Error>(())
/// ```
pub trait Entry<T: ?Sized> {
    /// Name on the command line, in configs and in tables.
    const NAME: &'static str;
    /// One-line description.
    const SUMMARY: &'static str;
    /// Origin: paper section, publication or "this project".
    const SOURCE: &'static str;
    /// Its options; mark them `#[serde(default, deny_unknown_fields)]`.
    type Options: Default + Serialize + DeserializeOwned;

    /// Builds the part from its options. An `Err` names the option that is out of range and the expected
    /// range.
    fn build(options: Self::Options) -> Result<Box<T>, String>;
}

/// Options of a part that has none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, serde::Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NoOptions {}

/// A registry's record of one entry.
pub struct Registered<T: ?Sized> {
    /// Name, unique in the registry.
    pub name: &'static str,
    /// One-line summary.
    pub summary: &'static str,
    /// Source.
    pub source: &'static str,
    /// Default options.
    pub defaults: Value,
    /// Whether options that are left out, at any depth, have these defaults, not those of the type.
    is_preset: bool,
    build: fn(&Value) -> Result<Box<T>, String>,
}

/// The registered parts of one kind.
///
/// A registry is a value that is passed on. Parts are built from their names and options:
///
/// ```
/// use sage_core::objective::rewards;
/// use serde_json::json;
///
/// let rewards = rewards()?;
/// let entry = rewards.get("adversarial")?;
/// assert_eq!(entry.summary, "early contact with the ego, else closeness");
/// assert_eq!(entry.defaults, json!({"min_depth": 0.0}));
/// assert!(rewards.build("adversarial", &json!({"min_depth": 0.5})).is_ok());
/// // Misspelt names and options are errors that say what is known.
/// let error = rewards.get("adversial").err().map(|error| error.to_string()).unwrap_or_default();
/// assert!(error.starts_with("unknown reward `adversial`; known: adversarial, "));
/// # Ok::<(), sage_core::Error>(())
/// ```
pub struct Registry<T: ?Sized> {
    kind: &'static str,
    entries: Vec<Registered<T>>,
}

/// What an entry says of itself.
struct About {
    name: &'static str,
    summary: &'static str,
    source: &'static str,
}

impl<T: ?Sized> Registry<T> {
    /// An empty registry of a kind such as "reward".
    pub fn new(kind: &'static str) -> Self {
        Self { kind, entries: Vec::new() }
    }

    /// Adds an entry.
    ///
    /// *Errors*: [`Error::Duplicate`] if its name is taken.
    pub fn with<E: Entry<T>>(self) -> Result<Self, Error> {
        self.push::<E>(
            About { name: E::NAME, summary: E::SUMMARY, source: E::SOURCE },
            &E::Options::default(),
            false,
        )
    }

    /// Adds an entry once more, under another name and with other defaults.
    ///
    /// *Errors*: [`Error::Duplicate`] if the name is taken.
    pub fn with_preset<E: Entry<T>>(
        self,
        name: &'static str,
        summary: &'static str,
        source: &'static str,
        defaults: &E::Options,
    ) -> Result<Self, Error> {
        self.push::<E>(About { name, summary, source }, defaults, true)
    }

    fn push<E: Entry<T>>(
        mut self,
        About { name, summary, source }: About,
        defaults: &E::Options,
        is_preset: bool,
    ) -> Result<Self, Error> {
        if self.entries.iter().any(|e| e.name == name) {
            return Err(Error::Duplicate { kind: self.kind, name: name.to_owned() });
        }
        let defaults = serde_json::to_value(defaults).unwrap_or(Value::Null);
        let build = |options: &Value| {
            let options = <E::Options as serde::Deserialize>::deserialize(options);
            E::build(options.map_err(|error| error.to_string())?)
        };
        self.entries.push(Registered { name, summary, source, defaults, is_preset, build });
        Ok(self)
    }

    /// Kind of the entries.
    pub fn kind(&self) -> &'static str {
        self.kind
    }

    /// All entries in the order of their registration.
    pub fn entries(&self) -> &[Registered<T>] {
        &self.entries
    }

    /// The entry of a name.
    ///
    /// *Errors*: [`Error::Unknown`], which lists the known names.
    pub fn get(&self, name: &str) -> Result<&Registered<T>, Error> {
        self.entries.iter().find(|e| e.name == name).ok_or_else(|| Error::Unknown {
            kind: self.kind,
            name: name.to_owned(),
            known: self.entries.iter().map(|e| e.name.to_owned()).collect(),
        })
    }

    /// Builds the entry of a name from options; keys left out keep their defaults.
    ///
    /// *Errors*: [`Error::Unknown`] for the name, [`Error::Options`] for a misspelt key or a value
    /// out of range.
    pub fn build(&self, name: &str, options: &Value) -> Result<Box<T>, Error> {
        let entry = self.get(name)?;
        if !options.is_object() {
            let problem = format!("`{options}` is not a JSON object of options by name");
            return Err(Error::Options { kind: self.kind, name: entry.name, problem });
        }
        let built = if entry.is_preset {
            (entry.build)(&with_defaults(&entry.defaults, options))
        } else {
            (entry.build)(options)
        };
        built.map_err(|problem| Error::Options { kind: self.kind, name: entry.name, problem })
    }

    /// Builds the entry of a name with its default options.
    pub fn build_default(&self, name: &str) -> Result<Box<T>, Error> {
        let defaults = &self.get(name)?.defaults;
        self.build(name, defaults)
    }
}

/// Options over their defaults, object by object.
fn with_defaults(defaults: &Value, given: &Value) -> Value {
    let (Value::Object(defaults), Value::Object(given)) = (defaults, given) else { return given.clone() };
    let mut all = defaults.clone();
    for (name, value) in given {
        let value = defaults.get(name).map_or_else(|| value.clone(), |default| with_defaults(default, value));
        all.insert(name.clone(), value);
    }
    Value::Object(all)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    trait Shape {
        fn area(&self) -> f64;
    }
    struct Square(f64);
    impl Shape for Square {
        fn area(&self) -> f64 {
            self.0 * self.0
        }
    }
    #[derive(Serialize, Deserialize)]
    #[serde(default, deny_unknown_fields)]
    struct SquareOptions {
        side: f64,
    }
    impl Default for SquareOptions {
        fn default() -> Self {
            Self { side: 2.0 }
        }
    }
    impl Entry<dyn Shape> for Square {
        const NAME: &'static str = "square";
        const SUMMARY: &'static str = "four equal sides";
        const SOURCE: &'static str = "Euclid";
        type Options = SquareOptions;
        fn build(options: SquareOptions) -> Result<Box<dyn Shape>, String> {
            if options.side > 0.0 {
                Ok(Box::new(Self(options.side)))
            } else {
                Err("`side` must be positive".into())
            }
        }
    }

    fn shapes() -> Registry<dyn Shape> {
        Registry::new("shape").with::<Square>().unwrap()
    }

    #[test]
    fn entries_are_built_by_name_with_defaults_for_what_is_left_out() {
        assert_eq!(shapes().build_default("square").unwrap().area(), 4.0);
        assert_eq!(shapes().build("square", &serde_json::json!({"side": 3.0})).unwrap().area(), 9.0);
        assert_eq!(shapes().build("square", &serde_json::json!({})).unwrap().area(), 4.0);
    }

    #[test]
    fn a_preset_is_the_same_part_with_other_defaults() {
        let large = SquareOptions { side: 9.0 };
        let shapes = shapes().with_preset::<Square>("large", "a large square", "Euclid", &large).unwrap();
        assert_eq!(shapes.build_default("large").unwrap().area(), 81.0);
        assert_eq!(shapes.build("large", &serde_json::json!({"side": 3.0})).unwrap().area(), 9.0);
        assert_eq!(shapes.get("large").unwrap().defaults, serde_json::json!({"side": 9.0}));
        let negative = shapes.build("large", &serde_json::json!({"side": -1.0})).err().unwrap().to_string();
        assert_eq!(negative, "options of shape `large`: `side` must be positive");
        assert!(matches!(
            shapes.with_preset::<Square>("square", "again", "Euclid", &large),
            Err(Error::Duplicate { .. })
        ));
    }

    #[test]
    fn options_of_a_preset_keep_its_defaults_at_any_depth() {
        use serde_json::json;
        let defaults = json!({"model": {"gap": 1.0, "speed": {"max": 10.0, "min": 0.0}}, "limits": [-3.0, 1.0], "lane": {}});
        let given = json!({"model": {"speed": {"min": 2.0}}, "limits": [-1.0], "lane": null, "new": 1});
        let all = json!({"model": {"gap": 1.0, "speed": {"max": 10.0, "min": 2.0}}, "limits": [-1.0], "lane": null, "new": 1});
        assert_eq!(with_defaults(&defaults, &given), all);
    }

    #[test]
    fn errors_name_what_is_known() {
        let error = shapes().get("circle").err().unwrap();
        assert_eq!(error.to_string(), "unknown shape `circle`; known: square");
        let misspelt = shapes().build("square", &serde_json::json!({"sied": 3.0})).err().unwrap().to_string();
        assert!(misspelt.contains("`sied`") && misspelt.contains("`side`"), "{misspelt}");
        let range = shapes().build("square", &serde_json::json!({"side": -1.0})).err().unwrap().to_string();
        assert_eq!(range, "options of shape `square`: `side` must be positive");
        assert!(matches!(shapes().with::<Square>(), Err(Error::Duplicate { .. })));
    }
}
