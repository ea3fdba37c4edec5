//! How an adversary of some kind is planned for, and what makes a failure against it.

use sage_core::{
    objective::{Feasibility, PersonFeasibility},
    registry::Entry,
};
use sage_generators::{GeneratorKind, Person};
use sage_sim::search::{Clause, Requirement};
use serde_json::Value;

use crate::{AdversarySpec, Error, Result, named_generator::GeneratorSpec, part::Part};

impl AdversarySpec {
    /// The generator for this adversary: people move by `person`, under the rule of the same name, and know no experts. `require` is what
    /// a search asks for.
    ///
    /// *Errors*: something that people do not depend on.
    pub fn generator(&self, spec: GeneratorSpec, require: Option<Requirement>) -> Result<GeneratorSpec> {
        let Some(kind) = self.kind else { return Ok(spec) };
        let is = |part: &Option<Part>, name: &str| part.as_ref().is_none_or(|part| part.name == name);
        let (method, rule) =
            (<Person as Entry<dyn GeneratorKind>>::NAME, <PersonFeasibility as Entry<dyn Feasibility>>::NAME);
        // SAGE is what a command takes by default.
        let is_person = is(&spec.method, method) || spec.method == Some(Part::named("sage"));
        let given = [
            ("lambda", spec.points.lambda.is_some()),
            ("mu", spec.points.mu.is_some()),
            ("aggression", spec.points.aggression.is_some()),
            ("mix", !spec.points.mix.is_empty()),
            ("merger", spec.merger.name != "linear"),
            ("weights", spec.weights.is_some()),
            ("selection", spec.selection != "natural"),
            ("method", !is_person),
            ("feasibility", !is(&spec.feasibility, rule)),
        ];
        if let Some((name, _)) = given.into_iter().find(|(_, is_given)| *is_given) {
            return Err(Error::Value(format!(
                "{name} does not apply to a {} as the adversary: its plans come from `person`, within human limits, and no network \
                 proposes them; leave it out",
                kind.name()
            )));
        }
        let mut part = spec.method.filter(|part| part.name == method).unwrap_or_else(|| Part::named(method));
        if require.is_some_and(|require| require.holds(Clause::Strict)) {
            part.options.insert("strict".to_owned(), Value::Bool(true));
        }
        Ok(GeneratorSpec { method: Some(part), feasibility: Some(Part::named(rule)), ..spec })
    }

    /// What makes a failure, if the user does not say.
    pub fn requirement(&self) -> Requirement {
        if self.kind.is_some() { Requirement::of_people() } else { Requirement::default() }
    }
}
