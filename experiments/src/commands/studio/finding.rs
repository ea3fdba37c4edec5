//! Failures of a driver: those that a search finds, and whether a drive is one.

use std::ops::ControlFlow;

use advsage::{
    named_generator::GeneratorSpec,
    operating_point::RowKey,
    rows::{
        GeneratedBy,
        failure::{FailureOf, FailureRow},
        search::{RowHead, SceneRow},
    },
};
use anyhow::{Context as _, Result};
use sage_core::{generator::Proposal, text::count};
use sage_sim::search::{
    Explained, Hooks, Order, Pool, Reason, Requirement, SearchOptions, SearchResult, search,
};
use serde_json::{Value, json};

use super::{
    choice::{Choice, FoundChoice},
    locked::locked,
    method::STEPS,
    workshop::{FoundFailures, Ready, Workshop},
};

/// Name of the reference driver of UN R157.
const R157: &str = "r157";

/// What becomes of a plan.
pub(super) struct PlanVerdict {
    /// The failure; `None` if it is none.
    pub(super) failure: Option<FailureRow>,
    /// The same in words.
    pub(super) words: String,
}

/// What was found so far, for the page.
fn shown(found: &[FailureRow]) -> Vec<Value> {
    let of = |row: &FailureRow| {
        let after = row.evaluated.contact.as_ref().map_or(0.0, |met| met.step as f64 / 10.0);
        let (plan, drive) = (row.plan.words(), row.drive);
        json!({"text": format!("contact after {after:.1} s; drive {drive}, plan of {plan}"), "words": row.sentence})
    };
    found.iter().map(of).collect()
}

impl Workshop<'_> {
    /// Searches the scene of a choice for failures of its first driver, as `sage search` does. After each drive `tell` gets what was
    /// found so far; its error ends the search, and what was found stays.
    ///
    /// *Errors*: as [`Workshop::ready`]; those of the generators and of `tell`.
    pub(super) fn search(&self, choice: &Choice, tell: &dyn Fn(Value) -> Result<()>) -> Result<Value> {
        choice.check()?;
        let ready = self.ready(choice, choice.drivers[0])?;
        let options =
            SearchOptions { budget: self.budget, explain: Explained::Mildest, ..SearchOptions::default() };
        let (head, merger) = (self.head(choice, &ready)?, GeneratorSpec::default().merger);
        let (number, search) = (self.method(choice)?.search, self.search_of(choice)?);
        let row = |pool: &Pool, result: &SearchResult, number: usize| {
            let found = FailureOf { pool, result, number };
            let key = search.plans.source(pool.plans[found.evaluated().plan].source);
            let of_key = |key: &RowKey| GeneratedBy::at(&key.part(), &merger, key.point.as_ref());
            FailureRow::new(&head, found, key.map(of_key), key)
        };
        let keep = |rows: &[FailureRow]| {
            *locked(&ready.found) = FoundFailures { search: number, rows: rows.to_vec() };
        };
        let (mut rows, mut stopped) = (Vec::new(), None);
        keep(&rows);
        let watch = |pool: &Pool, result: &SearchResult| {
            if rows.len() < result.failures.len() {
                rows.extend((rows.len()..result.failures.len()).map(|number| row(pool, result, number)));
                keep(&rows);
            }
            match tell(json!({"drives": result.driven.len(), "found": shown(&rows)})) {
                Ok(()) => ControlFlow::Continue(()),
                Err(error) => {
                    stopped = Some(error);
                    ControlFlow::Break(())
                }
            }
        };
        let watch = Some(Box::new(watch) as _);
        let (pool, result) = search.search_watched(&ready.driver, &options, self.seed, watch)?;
        if let Some(error) = stopped {
            return Err(error);
        }
        // The sentence of the mildest and the probabilities are known at the end.
        let rows: Vec<FailureRow> =
            (0..result.failures.len()).map(|number| row(&pool, &result, number)).collect();
        keep(&rows);
        let source = |number| search.plans.source(number);
        let summary = SceneRow::new(head.clone(), &options, &pool, &result, source);
        let drives = count(result.driven.len(), "drive");
        let words = match result.failures.len() {
            0 => format!("no failure in {drives}: {}", summary.reason_words()),
            some => format!("{} in {drives}", count(some, "failure")),
        };
        Ok(json!({"drives": result.driven.len(), "found": shown(&rows), "words": words}))
    }

    /// A failure that the newest search of the first driver found.
    ///
    /// *Errors*: there is none of this number.
    pub(super) fn found(&self, choice: &Choice, found: &FoundChoice) -> Result<FailureRow> {
        let searched = Choice { without: found.without.clone(), ..choice.clone() };
        let ready = self.ready(&searched, choice.drivers[0])?;
        let search = self.method(choice)?.search;
        let newest = locked(&ready.found);
        let row = newest.rows.get(found.number).filter(|_| newest.search == search).cloned();
        row.with_context(|| format!("no search here has a failure {}; search again", found.number + 1))
    }

    /// What becomes of the plan of a choice, for each of its drivers. `check` is asked between the stages whether anybody still waits.
    ///
    /// *Errors*: as [`Workshop::verdict`]; those of `check`.
    pub(super) fn explain(&self, choice: &Choice, check: &dyn Fn() -> Result<()>) -> Result<Value> {
        choice.check()?;
        let mut words = Vec::new();
        for &driver in &choice.drivers {
            check()?;
            let verdict = self.verdict(choice, driver)?;
            let is_failure = verdict.failure.is_some();
            words.push(
                json!({"driver": self.drivers[driver].label, "text": verdict.words, "failure": is_failure}),
            );
        }
        Ok(json!({"words": words}))
    }

    /// Whether the plan of a choice is a failure of a driver: a search among this plan alone, which explains what it finds.
    ///
    /// *Errors*: as [`Workshop::ready`] and [`Workshop::attack`]; those of the driver.
    pub(super) fn verdict(&self, choice: &Choice, driver: usize) -> Result<PlanVerdict> {
        let ready = self.ready(choice, driver)?;
        let (pool, result) = self.tried(choice, &ready, Explained::All)?;
        if result.failures.is_empty() {
            return Ok(PlanVerdict { failure: None, words: self.no_failure(&ready, &pool, &result)? });
        }
        let head = self.head(choice, &ready)?;
        let of = FailureOf { pool: &pool, result: &result, number: 0 };
        let row = match &choice.found {
            // A search knows where its plans come from.
            Some(found) => {
                let known = self.found(choice, found)?;
                let row = FailureRow::new(&head, of, known.generated, None);
                FailureRow { plan: known.plan, probability: known.probability, ..row }
            }
            None => {
                let (generator, number) = self.generator(choice)?;
                let generated = generator.generated_by(&generator.points[number]);
                FailureRow::new(&head, of, Some(generated), generator.built.keys.get(number))
            }
        };
        let sentence = row.sentence.as_deref().unwrap_or_default();
        let not: Vec<&str> = row.not_prevented_by().collect();
        let words = format!("A failure. {} {sentence}", prevention(row.prevented_by(), &not));
        Ok(PlanVerdict { failure: Some(row), words })
    }

    /// The search among the plan of a choice alone.
    fn tried(&self, choice: &Choice, ready: &Ready, explain: Explained) -> Result<(Pool, SearchResult)> {
        let attack = self.attack(choice, ready)?;
        let (test, ctx) = (&ready.driver.test, &ready.driver.ctx);
        let trajectory = test.path_of(&attack)?.trajectory;
        let plan = Proposal { trajectory, ..attack.candidates[attack.chosen].clone() };
        let rule = self.search_of(choice)?.rule.objective.rule();
        let mut pool = Pool::new(ctx, rule, vec![vec![plan]], 1);
        let options =
            SearchOptions { budget: 1, order: Order::Pool, refine: 0.0, explain, ..SearchOptions::default() };
        let result = search(test, ctx, rule, &mut pool, &options, self.seed, Hooks::default())?;
        Ok((pool, result))
    }

    /// Tries all places of the slider of a choice on its first driver: `tell` gets each place with what becomes of the drive, the places
    /// next to the chosen one first.
    ///
    /// *Errors*: as [`Workshop::verdict`]; those of `tell`.
    pub(super) fn sweep(&self, choice: &Choice, tell: &dyn Fn(Value) -> Result<()>) -> Result<Value> {
        choice.check()?;
        let ready = self.ready(choice, choice.drivers[0])?;
        let mut steps: Vec<usize> = (0..STEPS).collect();
        steps.sort_by_key(|step| step.abs_diff(choice.step));
        for step in steps {
            let place = Choice { step, goal: None, found: None, ..choice.clone() };
            let (_, result) = self.tried(&place, &ready, Explained::None)?;
            let driven = result.driven.first();
            let becomes = match driven {
                Some(_) if !result.failures.is_empty() => "failure",
                Some(driven) if driven.clauses.attack => "attack",
                Some(driven) if driven.contact.is_some() => "contact",
                Some(driven) if driven.error.is_some() => "error",
                _ => "nothing",
            };
            tell(json!({"step": step, "becomes": becomes}))?;
        }
        Ok(json!({}))
    }

    /// Why a plan is no failure.
    fn no_failure(&self, ready: &Ready, pool: &Pool, result: &SearchResult) -> Result<String> {
        let Some(driven) = result.driven.first() else {
            return Ok("No failure: the plan is not feasible.".to_owned());
        };
        let why = match driven.missing(Requirement::default()) {
            Some(Reason::NeverHit) => "there is no contact",
            Some(Reason::ContactWithoutAttack) => {
                "the contact comes without the attack too, or is with another"
            }
            Some(Reason::NotBelievable) => "the attack is not believable",
            Some(Reason::NotAtFault) => "the driver is not at fault",
            Some(Reason::NotPreventable) => "no reference driver prevents the contact",
            Some(Reason::Error) => "the driver gave an error",
            _ => "it misses a condition",
        };
        let mut words = format!("No failure: {why}.");
        if driven.clauses.attack {
            let plan = pool.plans[driven.plan].candidate.trajectory();
            // They were asked if nothing else is missing.
            let answers = match driven.references.is_empty() {
                true => ready.driver.test.watching()?.prevention(plan)?.answers,
                false => driven.references.clone(),
            };
            let by = answers.iter().find(|answer| answer.prevents == Some(true));
            let not = answers.iter().filter(|answer| answer.prevents != Some(true));
            let not: Vec<&str> = not.map(|answer| &*answer.reference).collect();
            words += &format!(" {}", prevention(by.map(|answer| &*answer.reference), &not));
        }
        Ok(words)
    }

    fn head(&self, choice: &Choice, ready: &Ready) -> Result<RowHead> {
        Ok(RowHead {
            run_hash: String::new(),
            scene: self.labels[choice.scene].clone(),
            ego: self.drivers[ready.number()].label.clone(),
            source_hash: String::new(),
            seed: self.seed,
            adversary: ready.scene().adversary()?.id.clone(),
        })
    }
}

/// Which reference driver would have prevented a contact, in words; `not` were asked before.
fn prevention(by: Option<&str>, not: &[&str]) -> String {
    const MODEL: &str = "The driver of UN R157";
    match by {
        Some(R157) => format!("{MODEL} would have prevented the contact."),
        Some(by) if not.contains(&R157) => {
            format!("{MODEL} would not have prevented the contact; `{by}` would.")
        }
        Some(by) => format!("`{by}` would have prevented the contact."),
        None => {
            format!("None of the reference drivers ({}) would have prevented the contact.", not.join(", "))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::prevention;

    #[test]
    fn the_driver_of_the_regulation_is_named_first() {
        assert!(prevention(Some("r157"), &[]).starts_with("The driver of UN R157 would have"));
        assert!(
            prevention(Some("idm"), &["r157"])
                .ends_with("would not have prevented the contact; `idm` would.")
        );
        assert!(prevention(Some("idm"), &[]).starts_with("`idm` would"));
        assert!(prevention(None, &["r157", "idm"]).contains("(r157, idm)"));
    }
}
