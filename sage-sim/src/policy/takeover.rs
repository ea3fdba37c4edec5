//! One policy drives up to *now*, then another that has watched: how a reference driver prevents a contact
//! ([`mod@crate::reference`]), as a driver to look at.

use sage_core::{motion::NOW, objective::PartSpec, registry::Entry};
use serde::{Deserialize, Serialize};

use super::{Driver, EgoPolicy, Knowledge, Shown, Start, View, policies};
use crate::{Error, observation::ObservationKind, world::Control};

/// The policy `takeover`.
pub struct Takeover {
    first: Box<dyn EgoPolicy>,
    then: Box<dyn EgoPolicy>,
}

/// Options of [`Takeover`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TakeoverOptions {
    /// The policy that drives up to *now*.
    pub first: PartSpec,
    /// The policy that drives from *now* on.
    pub then: PartSpec,
}

impl Default for TakeoverOptions {
    fn default() -> Self {
        Self { first: PartSpec::named("idm"), then: PartSpec::named("r157") }
    }
}

impl Entry<dyn EgoPolicy> for Takeover {
    const NAME: &'static str = "takeover";
    const SUMMARY: &'static str =
        "one policy up to now, then another that has watched: what a reference driver does";
    const SOURCE: &'static str = "this project";
    type Options = TakeoverOptions;

    fn build(options: TakeoverOptions) -> Result<Box<dyn EgoPolicy>, String> {
        let build = |field: &str, part: &PartSpec| -> Result<Box<dyn EgoPolicy>, String> {
            if part.name == Self::NAME {
                return Err(format!("`{field}` is `{}` itself; expected another policy", Self::NAME));
            }
            let all = policies().map_err(|error| error.to_string())?;
            all.build(&part.name, &part.options.clone().into()).map_err(|error| format!("`{field}`: {error}"))
        };
        let [first, then] = [build("first", &options.first)?, build("then", &options.then)?];
        if first.observes() != then.observes() {
            return Err("`first` and `then` are made for different observations".to_owned());
        }
        Ok(Box::new(Self { first, then }))
    }
}

impl EgoPolicy for Takeover {
    fn knows(&self) -> Knowledge {
        match (self.first.knows(), self.then.knows()) {
            (Knowledge::Everything, _) | (_, Knowledge::Everything) => Knowledge::Everything,
            (Knowledge::OwnLog, _) | (_, Knowledge::OwnLog) => Knowledge::OwnLog,
            _ => Knowledge::None,
        }
    }

    fn observes(&self) -> ObservationKind {
        self.then.observes()
    }

    fn start(&self, start: &Start) -> Result<Box<dyn Driver>, Error> {
        let [first, then] = [self.first.start(start)?, self.then.start(start)?];
        Ok(Box::new(TakeoverDriver { first, then, step: 0 }))
    }
}

struct TakeoverDriver {
    first: Box<dyn Driver>,
    then: Box<dyn Driver>,
    step: usize,
}

impl Driver for TakeoverDriver {
    fn control(&mut self, view: &View) -> Result<Control, Error> {
        let is_first = self.step < NOW;
        self.step += 1;
        let first = if is_first { Some(self.first.control(view)?) } else { None };
        let then = self.then.control(view)?;
        Ok(first.unwrap_or(then))
    }

    fn shown(&mut self) -> Option<Shown> {
        if self.step <= NOW { self.first.shown() } else { self.then.shown() }
    }

    fn end(&mut self, view: &View) -> Result<(), Error> {
        self.first.end(view)?;
        self.then.end(view)
    }

    fn boxed_clone(&self) -> Result<Box<dyn Driver>, Error> {
        let [first, then] = [self.first.boxed_clone()?, self.then.boxed_clone()?];
        Ok(Box::new(Self { first, then, step: self.step }))
    }
}
