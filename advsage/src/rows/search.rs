//! The rows of a search: one a scene, one a failure, and a file of all drives.

use std::{collections::BTreeMap, path::Path};

use sage_core::{
    files,
    motion::Trajectory,
    text::{count, escaped_name},
};
use sage_sim::search::{
    Clause, Clauses, Deviation, Evaluated, Failure, Met, Pool, PoolCounts, Reason, Requirement,
    SearchOptions, SearchResult,
};
use serde::{Deserialize, Serialize};

use super::{
    ROW_LIMIT,
    evaluated::EvaluatedRow,
    plan::{PlanRow, REFINED},
};
use crate::operating_point::RowKey;

/// Name of the row of a scene.
pub fn row_file(scene: &str) -> String {
    format!("{scene}.json")
}

/// Name of the file of all drives of a scene.
pub fn drives_file(scene: &str) -> String {
    format!("{scene}-drives.json")
}

/// Name of the file of the unchanged scene, in the native format.
pub fn unchanged_file(scene: &str) -> String {
    // No ending of a scene: in the folder of the attacked scenes it is none of them.
    format!("{scene}-unchanged.scene")
}

/// Name of a failure, as part of file names; `number` counts from 1.
pub fn failure_name(number: usize) -> String {
    format!("failure{number}")
}

/// Fields that every row begins with.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RowHead {
    /// Hash of the run's identity. The first field, so that it can be checked without reading the row.
    pub run_hash: String,
    /// Name of the input file without its ending.
    pub scene: String,
    /// The driver under test.
    pub ego: String,
    /// Hash of the input file.
    pub source_hash: String,
    /// Seed of the run.
    pub seed: u64,
    /// Track of the adversary.
    pub adversary: String,
}

/// The row of a scene.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct SceneRow {
    /// What every row begins with.
    #[serde(flatten)]
    pub head: RowHead,
    /// All files of the scene but its row.
    pub files: Vec<String>,
    /// What makes a plan a failure.
    pub require: Requirement,
    /// Plans by what became of them, and how many were driven against.
    pub plans: PlanCounts,
    /// Attacked drives.
    pub drives: usize,
    /// Largest number of attacked drives.
    pub budget: usize,
    /// Drives in which the driver gave an error.
    pub errors: usize,
    /// Drives by the clauses that they meet, each with the ones before it.
    pub attacks: usize,
    /// Of these, believable in the attacked drive.
    pub believable: usize,
    /// Of these, with the driver at fault.
    pub at_fault: usize,
    /// The same, in which an evasive manoeuvre exists, knowing the plan.
    pub avoidable: usize,
    /// Drives that meet all required clauses.
    pub failures: usize,
    /// These by the generator of their plans; `refined` for those that the search made.
    pub sources: BTreeMap<String, usize>,
    /// Why there is no failure.
    pub reason: Option<Reason>,
    /// The furthest clause that a drive missed, whatever ended the search.
    pub reached: Option<Reason>,
    /// Drives until the first failure, that one included.
    pub first_failure: Option<usize>,
    /// Step of the first contact of the unattacked drive.
    pub unattacked_contact: Option<i64>,
    /// Share of the recorded route that the unattacked drive makes; none if the route is shorter than 5 m.
    #[serde(default)]
    pub unattacked_completion: Option<f64>,
    /// Whether the unattacked drive leaves the road, which the recording does not; none on a map without edges.
    #[serde(default)]
    pub unattacked_off_road: Option<bool>,
    /// Largest distance of the car from its newest plan in the unattacked drive, metres; none for a driver that shows no plan.
    #[serde(default)]
    pub unattacked_off_plan: Option<f64>,
    /// Box centre and heading of the ego in the unattacked drive at frames 0 to 90, up to its first contact.
    pub unattacked_path: Vec<[f64; 3]>,
    /// The failure with the largest reward.
    pub worst: Option<FoundFailure>,
    /// The failure whose adversary is driven least differently from the recording.
    pub mildest: Option<FoundFailure>,
    /// The likeliest failure.
    pub likeliest: Option<FoundFailure>,
}

/// Plans of a scene.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct PlanCounts {
    #[serde(flatten)]
    counts: PoolCounts,
    /// In the pool.
    in_pool: usize,
}

/// A failure as the row of its scene names it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct FoundFailure {
    /// Its number, 1 the first found.
    number: usize,
    /// File of its row.
    row: String,
    /// Its drive, 1 the first.
    drive: usize,
    /// Where its plan comes from.
    plan: PlanRow,
    /// Seconds from *now* to the contact.
    contact_after: f64,
    contact: Option<Met>,
    clauses: Clauses,
    reward: f64,
    latest_start: Option<f64>,
    /// How its plan differs from the recording of the adversary.
    deviation: Option<Deviation>,
    /// Its probability, as in its row.
    #[serde(default)]
    probability: Option<f64>,
    /// What explains it, in words.
    #[serde(skip_serializing_if = "Option::is_none")]
    sentence: Option<String>,
}

/// A probability in words.
fn percent(probability: f64) -> String {
    match 100.0 * probability {
        // Below what is printed, but not 0.
        small if small > 0.0 && small < 0.01 => "below 0.01 %".to_owned(),
        0.0 => "0 %".to_owned(),
        percent => format!("{percent:.2} %"),
    }
}

/// A failure of a driver in words, if it is explained.
pub(super) fn sentence(ego: &str, evaluated: &Evaluated, failure: &Failure) -> Option<String> {
    let after = evaluated.contact.as_ref()?.step as f64 / 10.0;
    Some(failure.explanation.as_ref()?.sentence(ego, after, failure.deviation.as_ref()))
}

/// The file of all drives of a scene.
#[derive(Serialize)]
pub struct DrivesFile<'r> {
    /// What every row begins with.
    #[serde(flatten)]
    pub head: &'r RowHead,
    /// In their order.
    pub drives: Vec<DrivenRow<'r>>,
}

/// One attacked drive.
#[derive(Serialize)]
pub struct DrivenRow<'r> {
    /// Where its plan comes from.
    pub plan: PlanRow,
    /// What the attacked drive was found to be.
    #[serde(flatten)]
    pub evaluated: EvaluatedRow,
    /// Seconds before the contact at which an evasive manoeuvre could still begin.
    pub latest_start: Option<f64>,
    /// The error of the driver.
    pub error: Option<&'r str>,
    /// The adversary's plan.
    pub trajectory: &'r Trajectory,
}

impl SceneRow {
    /// The row of a search; `source` finds the source of a plan.
    pub fn new<'k>(
        head: RowHead,
        options: &SearchOptions,
        pool: &Pool,
        result: &SearchResult,
        source: impl Fn(usize) -> Option<&'k RowKey>,
    ) -> Self {
        let found = |failure: &Failure| {
            let evaluated = &result.driven[failure.drive];
            let number =
                result.failures.iter().position(|other| other.drive == failure.drive).unwrap_or(0) + 1;
            FoundFailure {
                number,
                row: row_file(&format!("{}-{}", head.scene, failure_name(number))),
                drive: failure.drive + 1,
                plan: PlanRow::new(pool, evaluated.plan, source(pool.plans[evaluated.plan].source)),
                contact_after: evaluated.contact.as_ref().map_or(0.0, |met| met.step as f64 / 10.0),
                contact: evaluated.contact.clone(),
                clauses: evaluated.clauses,
                reward: evaluated.reward,
                latest_start: evaluated.latest_start,
                deviation: failure.deviation,
                probability: failure.probability,
                sentence: sentence(&head.ego, evaluated, failure),
            }
        };
        let mut sources = BTreeMap::new();
        for failure in &result.failures {
            let plan = &pool.plans[result.driven[failure.drive].plan];
            let name = match plan.refined_from {
                Some(_) => REFINED.to_owned(),
                None => source(plan.source).map(|key| key.part().name.clone()).unwrap_or_default(),
            };
            *sources.entry(name).or_default() += 1;
        }
        Self {
            files: Vec::new(),
            require: options.require,
            plans: PlanCounts { counts: pool.counts, in_pool: pool.plans.len() },
            drives: result.driven.len(),
            budget: options.budget,
            errors: result.driven.iter().filter(|evaluated| evaluated.error.is_some()).count(),
            attacks: result.count(Clause::Attack),
            believable: result.count(Clause::Believable),
            at_fault: result.count(Clause::AtFault),
            avoidable: result.count(Clause::Avoidable),
            failures: result.failures.len(),
            sources,
            reason: result.reason,
            reached: result.reached,
            first_failure: result.failures.first().map(|failure| failure.drive + 1),
            unattacked_contact: None,
            unattacked_completion: None,
            unattacked_off_road: None,
            unattacked_off_plan: None,
            unattacked_path: Vec::new(),
            worst: result.worst().map(found),
            mildest: result.mildest(pool).map(found),
            likeliest: result.likeliest(pool).map(found),
            head,
        }
    }

    /// The scene.
    pub fn scene(&self) -> &str {
        &self.head.scene
    }

    /// Track of the adversary.
    pub fn adversary(&self) -> &str {
        &self.head.adversary
    }

    /// The driver under test.
    pub fn ego(&self) -> &str {
        &self.head.ego
    }

    /// Why there is no failure, in words; after an exhausted budget, what the drives so far have missed.
    pub fn reason_words(&self) -> &'static str {
        let reason =
            if self.reason == Some(Reason::Budget) { self.reached.or(self.reason) } else { self.reason };
        reason.map_or("", Reason::words)
    }

    /// That the driver has a contact without any attack, and when.
    pub fn contact_without_attack(&self) -> Option<String> {
        let step = self.unattacked_contact?;
        Some(match step as f64 / 10.0 {
            before if before < 0.0 => format!("without attack: contact {:.1} s before now", -before),
            after => format!("without attack: contact after {after:.1} s"),
        })
    }

    /// Box centre and heading of the ego in the unattacked drive.
    pub fn unattacked_path(&self) -> &[[f64; 3]] {
        &self.unattacked_path
    }

    /// Whether a search with a budget would find nothing else: it had as many drives, or ended before its own budget.
    pub fn covers(&self, budget: usize) -> bool {
        self.budget >= budget || self.drives < self.budget
    }

    /// Number of failures.
    pub fn failures(&self) -> usize {
        self.failures
    }

    /// Number of the worst failure, 1 the first found.
    pub fn worst(&self) -> Option<usize> {
        self.worst.as_ref().map(|failure| failure.number)
    }

    /// Number of the mildest failure.
    pub fn mildest(&self) -> Option<usize> {
        self.mildest.as_ref().map(|failure| failure.number)
    }

    /// Number of the likeliest failure.
    pub fn likeliest(&self) -> Option<usize> {
        self.likeliest.as_ref().map(|failure| failure.number)
    }

    /// What came of the search, in words.
    pub fn words(&self) -> String {
        let [scene, ego, adversary] =
            [&self.head.scene, &self.head.ego, &self.head.adversary].map(|name| escaped_name(name));
        let result = match self.failures {
            0 => format!("no failure: {}", self.reason_words()),
            1 => "1 failure".to_owned(),
            some => format!("{some} failures"),
        };
        let plans = &self.plans;
        let sage_sim::search::PoolCounts { proposed, infeasible, merged, beyond } = plans.counts;
        let left_out = [(infeasible, "not feasible"), (merged, "like another"), (beyond, "too many")];
        let left_out: Vec<String> = left_out
            .iter()
            .filter(|(count, _)| *count > 0)
            .map(|(count, why)| format!("{count} {why}"))
            .collect();
        let left_out =
            if left_out.is_empty() { String::new() } else { format!(" ({})", left_out.join(", ")) };
        let mut text = format!(
            "scene `{scene}`, driver `{ego}`, adversary `{adversary}`: {result}\n  {proposed} plans proposed, {} in the pool{left_out}\n  {}: {}, {} of them believable, {} with the driver at fault, {}\n",
            plans.in_pool,
            count(self.drives, "drive"),
            count(self.attacks, "attack"),
            self.believable,
            self.at_fault,
            count(self.failures, "failure")
        );
        let not_prevented = self.at_fault.saturating_sub(self.failures);
        if not_prevented > 0 && self.require == Requirement::default() {
            text += &format!(
                "  {not_prevented} of those at fault are no failures: no reference driver prevents the contact\n"
            );
        }
        if self.errors > 0 {
            text += &format!("  {} in which the driver gave an error\n", count(self.errors, "drive"));
        }
        if let Some(contact) = self.contact_without_attack() {
            text += &format!("  {contact}\n");
        }
        if self.unattacked_off_road == Some(true) {
            text += "  without attack: the driver leaves the road\n";
        }
        if let Some(reached) = self.reached.filter(|_| self.failures == 0 && self.reason != self.reached) {
            text += &format!("  the furthest that an attack came: {}\n", reached.words());
        }
        text
    }

    /// Reads a row; `None` if the file is missing or incomplete.
    pub fn read(path: &Path) -> Option<Self> {
        serde_json::from_slice(&files::read(path, ROW_LIMIT).ok()?).ok()
    }

    /// The printed line; `seconds` is the time of the search, `None` if an earlier run finished it.
    pub fn line(&self, seconds: Option<f64>) -> String {
        let drives = count(self.drives, "drive");
        let found = match (self.failures, self.reason) {
            (0, Some(Reason::Budget)) => {
                let reached = self.reached.map_or("", Reason::words);
                format!("no failure in {drives}, budget used up: {reached}")
            }
            (0, reason) => format!("no failure in {drives}: {}", reason.map_or("", Reason::words)),
            (failures, _) => {
                let failures = count(failures, "failure");
                let first = self.first_failure.unwrap_or_default();
                let words = |failure: &Option<FoundFailure>| {
                    failure.as_ref().map_or(String::new(), |failure| {
                        let probability = failure
                            .probability
                            .map_or(String::new(), |p| format!(", probability {}", percent(p)));
                        format!("{} after {:.1} s{probability}", failure.plan.words(), failure.contact_after)
                    })
                };
                let [worst, mildest] = [words(&self.worst), words(&self.mildest)];
                format!(
                    "{failures} in {drives}, the first in drive {first}; worst: {worst}; mildest: {mildest}"
                )
            }
        };
        let errors = match self.errors {
            0 => String::new(),
            errors => format!("; {} with an error of the driver", count(errors, "drive")),
        };
        let time = seconds.map_or("finished before".to_owned(), |s| format!("{:.0} ms", 1e3 * s));
        let before = self.contact_without_attack().map_or(String::new(), |contact| format!("; {contact}"));
        let sentence = self.mildest.as_ref().and_then(|failure| failure.sentence.as_ref());
        let sentence = sentence.map_or(String::new(), |words| format!("\n  {}", escaped_name(words)));
        format!("{}: {found}{errors}{before} ({time}){sentence}", escaped_name(&self.head.scene))
    }
}
