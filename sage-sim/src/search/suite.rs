//! A suite: failures kept as tests, which say tomorrow whether a driver got better.
//!
//! A test is an unchanged scene and a plan of the adversary. [`super::passing`] says when a driver passes. The version says by
//! which definitions failures were found.
//!
//! A suite may come from anywhere: it holds values and names of files inside its own folder, and nothing in it
//! names a program.

use std::collections::HashSet;

use sage_core::{motion::Trajectory, objective::PartSpec};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::{Clauses, Met, Requirement};
use crate::{Error, avoidable::AvoidanceOptions, fault::FaultRule};

/// Version of the format and of the definitions.
pub const VERSION: u32 = 2;
/// Largest number of tests.
pub const MOST_TESTS: usize = 20_000;
/// File of a suite.
pub const FILE: &str = "suite.json";
/// Folder of the unchanged scenes in that of the suite.
pub const SCENES: &str = "scenes";
/// Longest name of a test or a scene file, bytes.
const LONGEST_NAME: usize = 200;

/// Failures kept as tests.
///
/// ```
/// use sage_sim::search::suite::Suite;
///
/// let mut suite: Suite = serde_json::from_str(
///     r#"{"suite": 2, "require": ["attack", "at-fault"], "feasibility": {"name": "drivable"}, "avoidable": {},
///         "references": ["r157"], "fault": "careful", "tests": []}"#,
/// )?;
/// suite.check()?;
/// // A suite may come from anywhere: it names policies and files inside its folder, and nothing that is run.
/// suite.references = vec!["../driver.sh".to_owned()];
/// assert!(suite.check().is_err());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Suite {
    /// Version of the format.
    pub suite: u32,
    /// What makes a plan a failure.
    pub require: Requirement,
    /// The rule by which plans are feasible.
    pub feasibility: PartSpec,
    /// The search for an evasive manoeuvre.
    pub avoidable: AvoidanceOptions,
    /// Names of the reference drivers, in the order in which they are asked.
    pub references: Vec<String>,
    /// The rule that says who is at fault.
    pub fault: FaultRule,
    /// The tests.
    pub tests: Vec<SuiteTest>,
}

/// A test of a suite.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SuiteTest {
    /// Its name, unique in the suite.
    pub name: String,
    /// File of the unchanged scene, in the folder [`SCENES`].
    pub scene: String,
    /// Hash of that file.
    pub scene_hash: String,
    /// Track of the adversary.
    pub adversary: String,
    /// Seed of the drives.
    pub seed: u64,
    /// Hash of the plan.
    pub plan_hash: String,
    /// The plan of the adversary.
    pub plan: Trajectory,
    /// How it was found.
    pub found: Found,
}

/// How a failure was found: words, and nothing that is run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Found {
    /// The driver that failed.
    pub ego: String,
    /// Where its plan came from.
    pub plan: Map<String, Value>,
    /// Its contact.
    pub contact: Option<Met>,
    /// Its clauses.
    pub clauses: Clauses,
    /// Name of its cluster: type of the collision, what the driver does, its speed at the contact.
    pub cluster: String,
    /// What explains it, in words, if the search has explained it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sentence: Option<String>,
}

/// Hash of a plan.
pub fn plan_hash(plan: &Trajectory) -> String {
    let numbers = plan.points().as_flattened().iter().flat_map(|x| x.to_le_bytes());
    blake3::hash(&numbers.collect::<Vec<u8>>()).to_hex().to_string()
}

impl Suite {
    /// Checks what a suite says of itself: version, number and names of tests, and the hashes of the plans.
    ///
    /// *Errors*: what is wrong, with the test.
    pub fn check(&self) -> Result<(), Error> {
        if self.suite != VERSION {
            return Err(Error::Value(format!(
                "its version is {}; this program reads version {VERSION}: make a suite of a new search",
                self.suite
            )));
        }
        if self.tests.len() > MOST_TESTS {
            return Err(Error::Value(format!(
                "it has {} tests; expected at most {MOST_TESTS}",
                self.tests.len()
            )));
        }
        self.avoidable.check()?;
        if let Some(name) = self.references.iter().find(|name| !is_plain(name)) {
            let shown: String = name.chars().take(40).collect();
            return Err(Error::Value(format!("`references` holds {shown:?}; expected names of policies")));
        }
        let mut names = HashSet::new();
        for (number, test) in self.tests.iter().enumerate() {
            let of_test = |problem: String| Err(Error::Value(format!("test {}: {problem}", number + 1)));
            for (what, name) in [("name", &test.name), ("scene", &test.scene)] {
                if !is_plain(name) {
                    let shown: String = name.chars().take(40).collect();
                    return of_test(format!("`{what}` is {shown:?}; expected a plain name"));
                }
            }
            if !names.insert(&test.name) {
                return of_test(format!("the name `{}` is taken", test.name));
            }
            if plan_hash(&test.plan) != test.plan_hash {
                return of_test(format!(
                    "the plan of `{}` is not the one that the suite was made with",
                    test.name
                ));
            }
        }
        Ok(())
    }
}

/// Whether a name is that of one file in a folder: letters, digits and `._-#`, no dot or hyphen first.
pub fn is_plain(name: &str) -> bool {
    let is_plain = |c: char| c.is_alphanumeric() || "._-#@+ ".contains(c);
    !name.is_empty()
        && name.len() <= LONGEST_NAME
        && !name.starts_with(['.', '-', ' '])
        && name.chars().all(is_plain)
}

#[cfg(test)]
mod tests {
    use sage_core::motion::HORIZON;

    use super::*;

    fn suite() -> Suite {
        let plan = Trajectory::new("plan", (0..HORIZON).map(|k| [k as f64, 0.5]).collect()).unwrap();
        let test = SuiteTest {
            name: "13-failure1".to_owned(),
            scene: "13.safetensors".to_owned(),
            scene_hash: "0".repeat(64),
            adversary: "7".to_owned(),
            seed: 0,
            plan_hash: plan_hash(&plan),
            plan,
            found: Found {
                ego: "idm".to_owned(),
                plan: Map::new(),
                contact: None,
                clauses: Clauses::default(),
                cluster: "cut-in, ego brakes, 5 to 10 m/s".to_owned(),
                sentence: Some("idm fails.".to_owned()),
            },
        };
        Suite {
            suite: VERSION,
            require: Requirement::default(),
            feasibility: PartSpec::default(),
            avoidable: AvoidanceOptions::default(),
            references: vec!["r157".to_owned()],
            fault: FaultRule::Careful,
            tests: vec![test],
        }
    }

    #[test]
    fn a_suite_is_read_as_it_was_written() {
        let text = serde_json::to_string(&suite()).unwrap();
        let read: Suite = serde_json::from_str(&text).unwrap();
        assert_eq!(read, suite());
        read.check().unwrap();
    }

    #[test]
    fn names_that_lead_out_changed_plans_and_other_versions_are_refused() {
        let error = |change: &dyn Fn(&mut Suite)| {
            let mut changed = suite();
            change(&mut changed);
            changed.check().unwrap_err().to_string()
        };
        for name in
            ["../13.safetensors", "/etc/passwd", "a/b", "", ".hidden", "-x", "a\nb", "<script>", "a\\b"]
        {
            assert!(error(&|suite| suite.tests[0].scene = name.to_owned()).contains("`scene`"), "{name}");
            assert!(error(&|suite| suite.tests[0].name = name.to_owned()).contains("`name`"), "{name}");
        }
        assert!(error(&|suite| suite.tests[0].name = "x".repeat(300)).contains("expected a plain name"));
        assert!(error(&|suite| suite.tests.push(suite.tests[0].clone())).contains("is taken"));
        assert!(error(&|suite| suite.suite = 3).contains("version"));
        let many = |suite: &mut Suite| suite.tests = vec![suite.tests[0].clone(); MOST_TESTS + 1];
        assert!(error(&many).contains("it has 20001 tests; expected at most 20000"));
        let moved = |suite: &mut Suite| {
            let points = suite.tests[0].plan.points().iter().map(|[x, y]| [x + 1e-9, *y]).collect();
            suite.tests[0].plan = Trajectory::new("plan", points).unwrap();
        };
        assert!(error(&moved).contains("is not the one"));
        // A driver is words: no field for a command.
        let mut text = serde_json::to_value(suite()).unwrap();
        text["tests"][0]["command"] = "sh".into();
        assert!(serde_json::from_value::<Suite>(text).is_err());
    }
}
