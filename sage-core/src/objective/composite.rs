//! An objective: weighted rewards and a feasibility rule, evaluated once a candidate.

use std::sync::Arc;

use serde_json::{Value, json};

use super::{
    Candidate, Context, Evaluation, Feasibility, ObjectiveSpec, PartSpec, Reward, Situation, TermSpec,
    Violation, Weight, is_believable,
    spec::{MAX_WEIGHT, MOST_TERMS},
};
use crate::{Error, registry::Registry};

/// A weighted sum of rewards with a feasibility rule. Fine-tuning, selection and search maximise it.
///
/// From names to the value of `candidate`, a plan that hits the ego in the scene of `ctx`:
///
/// ```
/// # use std::sync::Arc;
/// # use sage_core::{motion::Trajectory, objective::{Context, ContextOptions}, scene::SceneIndex};
/// use sage_core::objective::{Objective, ObjectiveSpec, feasibilities, rewards};
///
/// # let scene = Arc::new(include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/road.rs")));
/// # let ctx = Context::new(&scene, &SceneIndex::new(scene.map.clone()), &ContextOptions::default())?;
/// # let at = |t: f64| [20.0 + 4.0 * t, (4.0 - 2.0 * t).max(0.0)];
/// # let plan = Trajectory::new("plan", (1..=80).map(|step| at(0.1 * f64::from(step))).collect())?;
/// # let candidate = ctx.candidate(plan);
/// let spec = ObjectiveSpec::preset("paper-selection").ok_or("no such preset")?;
/// let objective = Objective::new(&spec, &rewards()?, &feasibilities()?)?;
///
/// // A candidate is evaluated once, and then has a value at every μ: from realism alone to early contact alone.
/// let evaluation = objective.evaluate(&candidate, &ctx);
/// assert!(evaluation.is_attack());
/// assert_eq!(objective.value(&evaluation, 1.0), evaluation.adversarial);
/// assert!(objective.value(&evaluation, 0.0) < 0.0);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone)]
pub struct Objective {
    spec: ObjectiveSpec,
    terms: Vec<Term>,
    rule: Arc<dyn Feasibility>,
}

#[derive(Clone)]
struct Term {
    reward: Arc<dyn Reward>,
    weight: Weight,
    only_feasible: bool,
}

impl Objective {
    /// The objective of a spec.
    ///
    /// *Errors*: [`Error::Unknown`] for a name that is not registered; [`Error::Options`] for options that
    /// a part refuses, for a spec without terms or with more than [`MOST_TERMS`], or for a weight beyond [`MAX_WEIGHT`].
    pub fn new(
        spec: &ObjectiveSpec,
        rewards: &Registry<dyn Reward>,
        rules: &Registry<dyn Feasibility>,
    ) -> Result<Self, Error> {
        let fail = |name, problem| Err(Error::Options { kind: "objective", name, problem });
        if spec.terms.is_empty() {
            return fail("terms", "there are none; expected at least one".to_owned());
        }
        if spec.terms.len() > MOST_TERMS {
            return fail("terms", format!("there are {}; expected at most {MOST_TERMS}", spec.terms.len()));
        }
        if !(0.0..=MAX_WEIGHT).contains(&spec.violation_weight) {
            let found = spec.violation_weight;
            return fail(
                "violation_weight",
                format!("it is {found}; expected a number from 0 to {MAX_WEIGHT:e}"),
            );
        }
        let mut terms = Vec::with_capacity(spec.terms.len());
        for term in &spec.terms {
            if let Some(found) = term.weight.out_of_range() {
                let problem =
                    format!("that of `{}` is {found}; expected a number within ±{MAX_WEIGHT:e}", term.name);
                return fail("weight", problem);
            }
            let reward = rewards.build(&term.name, &Value::Object(term.options.clone()))?;
            terms.push(Term {
                reward: reward.into(),
                weight: term.weight,
                only_feasible: term.only_feasible,
            });
        }
        let PartSpec { name, options } = &spec.feasibility;
        let rule = rules.build(name, &Value::Object(options.clone()))?.into();
        Ok(Self { spec: spec.clone(), terms, rule })
    }

    /// Hashes of the files that its rewards were built from.
    pub fn contents(&self) -> Vec<String> {
        self.terms.iter().filter_map(|term| term.reward.content()).collect()
    }

    /// One objective that measures every term of several objectives once. Its weights are meaningless.
    ///
    /// *Errors*: [`Error::Options`] if they differ in their feasibility rule.
    pub fn union(objectives: &[&Self]) -> Result<Option<Self>, Error> {
        let Some((first, others)) = objectives.split_first() else { return Ok(None) };
        let mut union = (*first).clone();
        for other in others {
            if other.spec.feasibility != first.spec.feasibility {
                let rule = |PartSpec { name, options }: &PartSpec| {
                    let options = if options.is_empty() { String::new() } else { json!(options).to_string() };
                    format!("{name}{options}")
                };
                let [a, b] = [first, other].map(|objective| rule(&objective.spec.feasibility));
                let problem = format!(
                    "objectives that are evaluated together have the rules `{a}` and `{b}`; expected one rule"
                );
                return Err(Error::Options { kind: "objective", name: "feasibility", problem });
            }
            union.spec.believable_first |= other.spec.believable_first;
            for (spec, term) in other.spec.terms.iter().zip(&other.terms) {
                if !union.spec.terms.iter().any(|known| known.measures_as(spec)) {
                    union.spec.terms.push(spec.clone());
                    union.terms.push(term.clone());
                }
            }
        }
        Ok(Some(union))
    }

    /// Index of each of its terms in a [`Objective::union`]; `None` if a term is missing there.
    pub fn term_indices_in(&self, union: &Self) -> Option<Vec<usize>> {
        let position = |term: &TermSpec| union.spec.terms.iter().position(|known| known.measures_as(term));
        self.spec.terms.iter().map(position).collect()
    }

    /// The spec it was built from.
    pub fn spec(&self) -> &ObjectiveSpec {
        &self.spec
    }

    /// The feasibility rule.
    pub fn rule(&self) -> &dyn Feasibility {
        &*self.rule
    }

    /// Whether a term needs the negative log-likelihood of candidates under the prior.
    pub fn needs_prior(&self) -> bool {
        self.terms.iter().any(|term| term.reward.needs_prior())
    }

    /// Evaluates a candidate.
    pub fn evaluate(&self, candidate: &Candidate, ctx: &Context) -> Evaluation {
        let violations = self.rule.violations(candidate, ctx);
        let is_feasible = violations.is_empty();
        let situations = situations(candidate, ctx);
        let value = |term: &Term| {
            if term.only_feasible && !is_feasible { None } else { term.mean(&situations) }
        };
        let terms = self.terms.iter().map(value).collect();
        self.evaluation(terms, violations, &situations[0])
    }

    /// The evaluation of a candidate, if it is feasible and its value at a weight μ above another one. It ends as soon as an upper
    /// bound of the value is not: the rule is asked after the fast terms, and one slow term after the other.
    pub fn evaluate_above(
        &self,
        least: f64,
        candidate: &Candidate,
        ctx: &Context,
        mu: f64,
    ) -> Option<Evaluation> {
        let situations = situations(candidate, ctx);
        let mut terms = self.best_terms(&situations, mu);
        let is_above = |terms: &[Option<f64>]| self.value_of(terms, 0.0, mu) > least;
        if !is_above(&terms) || !self.rule.is_feasible(candidate, ctx) {
            return None;
        }
        for (number, term) in self.terms.iter().enumerate() {
            if term.reward.slow_range().is_some() {
                terms[number] = term.mean(&situations);
                if !is_above(&terms) {
                    return None;
                }
            }
        }
        Some(self.evaluation(terms, Vec::new(), &situations[0]))
    }

    fn evaluation(
        &self,
        terms: Vec<Option<f64>>,
        violations: Vec<Violation>,
        situation: &Situation,
    ) -> Evaluation {
        let contact = situation.encounter.contact;
        let is_asked = self.spec.believable_first && violations.is_empty() && contact.is_some();
        Evaluation {
            is_believable: is_asked && is_believable(situation),
            terms,
            contact,
            adversarial: situation.encounter.reward(situation.ctx.convention()),
            violations,
        }
    }

    /// Value of an evaluated candidate at a weight μ: the weighted sum of the measured terms, minus the
    /// costs of violations if the objective weighs them.
    pub fn value(&self, evaluation: &Evaluation, mu: f64) -> f64 {
        self.value_of(&evaluation.terms, evaluation.cost(), mu)
    }

    /// The value from the values of the terms and the cost of violations.
    pub fn value_of(&self, terms: &[Option<f64>], cost: f64, mu: f64) -> f64 {
        let measured = self.terms.iter().zip(terms).filter_map(|(term, value)| Some((term, (*value)?)));
        let value = measured.fold(0.0, |sum, (term, value)| sum + term.weight.at(mu) * value);
        value - self.spec.violation_weight * cost
    }

    /// Upper bound of a candidate's value at a weight μ: slow terms at their best value, no violation.
    pub fn value_at_most(&self, candidate: &Candidate, ctx: &Context, mu: f64) -> f64 {
        self.value_of(&self.best_terms(&situations(candidate, ctx), mu), 0.0, mu)
    }

    /// The values of the terms, slow ones at their best.
    fn best_terms(&self, situations: &[Situation], mu: f64) -> Vec<Option<f64>> {
        // A slow term that cannot be measured adds nothing.
        let best = |term: &Term| {
            let Some([least, most]) = term.reward.slow_range() else { return term.mean(situations) };
            let weight = term.weight.at(mu);
            let best = if weight > 0.0 { most } else { least };
            (weight * best > 0.0).then_some(best)
        };
        self.terms.iter().map(best).collect()
    }
}

fn situations<'a>(candidate: &'a Candidate, ctx: &'a Context) -> Vec<Situation<'a>> {
    ctx.egos().iter().map(|ego| Situation::new(candidate, ego, ctx)).collect()
}

impl Term {
    /// A value that is not finite counts as not measured, because it cannot be compared.
    fn score(&self, situation: &Situation) -> Option<f64> {
        self.reward.score(situation).filter(|value| value.is_finite())
    }

    /// Weighted mean over those of the ego's paths for which it can be measured.
    fn mean(&self, situations: &[Situation]) -> Option<f64> {
        if situations.len() == 1 || !self.reward.depends_on_ego() {
            return self.score(&situations[0]);
        }
        let (mut sum, mut total) = (0.0, 0.0);
        for situation in situations {
            if let Some(value) = self.score(situation) {
                sum += situation.ego.weight() * value;
                total += situation.ego.weight();
            }
        }
        (total > 0.0).then(|| sum / total)
    }
}
