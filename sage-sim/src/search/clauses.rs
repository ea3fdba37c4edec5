//! What makes a driven plan a failure of the driver: clauses, each on the attacked drive; four by default.

use std::{fmt, str::FromStr};

use serde::{Deserialize, Serialize};

use super::onset::REACTION;

/// Time in which UN R157's driver evaluates a risk before it reacts, seconds.
const EVALUATION: f64 = 0.4;

/// A condition on an attacked drive. Each is asked only of drives that meet the ones before it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Clause {
    /// The verdict of the attack test: the first contact is with the adversary, and not there without the attack.
    Attack,
    /// An overlap of at least 0.5 m, and the attack is believable with this drive as the ego's path.
    Believable,
    /// nuPlan's rule gives the fault to the ego. Unknown is no.
    AtFault,
    /// A search that knows the plan finds an evasive manoeuvre from a state of this drive.
    Avoidable,
    /// A reference driver, which does not know the plan, prevents the contact.
    Preventable,
    /// It is a failure by the other clauses in every variant of the drive: each way of following that the driver offers, and small
    /// changes of the start.
    Holds,
    /// [`Clause::Believable`] by its definition before, which searches may ask: without turns and the time across lanes.
    #[serde(rename = "believable-1")]
    Believable1,
    /// The adversary, a pedestrian or cyclist, is no faster than 5 or 15 km/h.
    Strict,
    /// From what can be seen of the plan to the latest start of an evasive manoeuvre a person has the 0.75 s that UN R157's driver
    /// takes until it brakes ([`crate::search::Evaluated::human_time`]).
    HumanTime,
    /// The same with the 0.4 s before in which that driver evaluates the risk: 1.15 s.
    #[serde(rename = "human-time-r157")]
    HumanTimeR157,
}

impl Clause {
    /// The clauses that make a failure by default, in the order in which they are asked.
    pub const ALL: [Self; 4] = [Self::Attack, Self::Believable, Self::AtFault, Self::Preventable];

    /// Name on the command line and in rows.
    pub fn name(self) -> &'static str {
        match self {
            Self::Attack => "attack",
            Self::Believable => "believable",
            Self::AtFault => "at-fault",
            Self::Avoidable => "avoidable",
            Self::Preventable => "preventable",
            Self::Holds => "holds",
            Self::Believable1 => "believable-1",
            Self::Strict => "strict",
            Self::HumanTime => "human-time",
            Self::HumanTimeR157 => "human-time-r157",
        }
    }

    /// The human time that the clause asks for, seconds; `None` for another clause.
    pub(super) fn asked_time(self) -> Option<f64> {
        match self {
            Self::HumanTime => Some(REACTION),
            Self::HumanTimeR157 => Some(EVALUATION + REACTION),
            _ => None,
        }
    }

    /// The default clause in whose place it is asked.
    fn as_asked(self) -> Self {
        if self == Self::Believable1 { Self::Believable } else { self }
    }
}

impl fmt::Display for Clause {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// The clauses that make a driven plan a failure. `attack` is always one of them.
///
/// ```
/// use sage_sim::search::{Clause, Clauses, Requirement};
///
/// let driven = Clauses { attack: true, believable: Some(true), at_fault: Some(false), ..Clauses::default() };
/// // By default a failure is a believable attack, at fault and preventable; this driver was not at fault.
/// assert_eq!(driven.first_missing(Requirement::default()), Some(Clause::AtFault));
/// assert!(driven.meet("attack,believable".parse()?));
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "Vec<Clause>", into = "Vec<Clause>")]
pub struct Requirement([bool; NAMED.len()]);

/// All clauses that can be named, in the order in which they are asked.
const NAMED: [Clause; 10] = [
    Clause::Attack,
    Clause::Believable1,
    Clause::Believable,
    Clause::Strict,
    Clause::AtFault,
    Clause::Avoidable,
    Clause::Preventable,
    Clause::HumanTime,
    Clause::HumanTimeR157,
    Clause::Holds,
];

impl Default for Requirement {
    /// [`Clause::ALL`].
    fn default() -> Self {
        Self::of(&Clause::ALL)
    }
}

impl Requirement {
    /// What makes a failure by default if the adversary is a pedestrian or cyclist: [`Clause::ALL`] and [`Clause::HumanTime`].
    pub fn of_people() -> Self {
        Self::of(&[&Clause::ALL[..], &[Clause::HumanTime]].concat())
    }

    /// A requirement of some clauses.
    pub fn of(clauses: &[Clause]) -> Self {
        Self(NAMED.map(|clause| clause == Clause::Attack || clauses.contains(&clause)))
    }

    /// Whether it names a clause.
    pub fn holds(self, clause: Clause) -> bool {
        NAMED.iter().zip(self.0).any(|(named, holds)| *named == clause && holds)
    }

    /// The same without [`Clause::Holds`], which is asked of the variants of a drive.
    #[must_use]
    pub fn without_holds(self) -> Self {
        Self::of(&self.clauses().filter(|clause| *clause != Clause::Holds).collect::<Vec<_>>())
    }

    /// Its clauses in their order.
    pub fn clauses(self) -> impl Iterator<Item = Clause> {
        NAMED.into_iter().filter(move |clause| self.holds(*clause))
    }
}

impl TryFrom<Vec<Clause>> for Requirement {
    type Error = String;

    fn try_from(clauses: Vec<Clause>) -> Result<Self, String> {
        if clauses.is_empty() { Err("no clause is named".to_owned()) } else { Ok(Self::of(&clauses)) }
    }
}

impl From<Requirement> for Vec<Clause> {
    fn from(requirement: Requirement) -> Self {
        requirement.clauses().collect()
    }
}

impl FromStr for Requirement {
    type Err = String;

    /// Names of clauses with commas between them.
    fn from_str(text: &str) -> Result<Self, String> {
        let clause = |name: &str| {
            let found = NAMED.into_iter().find(|clause| clause.name() == name);
            found.ok_or_else(|| {
                let known = NAMED.map(Clause::name).join(", ");
                format!("`{name}` is no clause; known: {known}")
            })
        };
        let clauses = text.split(',').map(|name| clause(name.trim())).collect::<Result<Vec<_>, _>>()?;
        Self::try_from(clauses)
    }
}

impl fmt::Display for Requirement {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(&self.clauses().map(Clause::name).collect::<Vec<_>>().join(","))
    }
}

/// Answers to the clauses for one driven plan; `None` for one that was not asked.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Clauses {
    /// [`Clause::Attack`].
    pub attack: bool,
    /// [`Clause::Believable`].
    pub believable: Option<bool>,
    /// [`Clause::AtFault`].
    pub at_fault: Option<bool>,
    /// [`Clause::Avoidable`].
    pub avoidable: Option<bool>,
    /// [`Clause::Preventable`].
    #[serde(default)]
    pub preventable: Option<bool>,
    /// [`Clause::Holds`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub holds: Option<bool>,
    /// [`Clause::Believable1`].
    #[serde(default, rename = "believable-1", skip_serializing_if = "Option::is_none")]
    pub believable_1: Option<bool>,
    /// [`Clause::Strict`].
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub strict: Option<bool>,
    /// [`Clause::HumanTime`].
    #[serde(default, rename = "human-time", skip_serializing_if = "Option::is_none")]
    pub human_time: Option<bool>,
    /// [`Clause::HumanTimeR157`].
    #[serde(default, rename = "human-time-r157", skip_serializing_if = "Option::is_none")]
    pub human_time_r157: Option<bool>,
}

impl Clauses {
    /// Whether a clause was asked and holds.
    pub fn holds(&self, clause: Clause) -> bool {
        match clause {
            Clause::Attack => self.attack,
            Clause::Believable => self.believable == Some(true),
            Clause::AtFault => self.at_fault == Some(true),
            Clause::Avoidable => self.avoidable == Some(true),
            Clause::Preventable => self.preventable == Some(true),
            Clause::Holds => self.holds == Some(true),
            Clause::Believable1 => self.believable_1 == Some(true),
            Clause::Strict => self.strict == Some(true),
            Clause::HumanTime => self.human_time == Some(true),
            Clause::HumanTimeR157 => self.human_time_r157 == Some(true),
        }
    }

    /// Whether a clause and the ones before it hold.
    pub fn reach(&self, clause: Clause) -> bool {
        // `believable` is not asked after `believable-1`.
        let before = Clause::ALL.into_iter().take_while(|c| *c < clause.as_asked());
        before.chain([clause]).all(|c| self.holds(c))
    }

    /// Whether all required clauses hold.
    pub fn meet(&self, requirement: Requirement) -> bool {
        requirement.clauses().all(|clause| self.holds(clause))
    }

    /// The first required clause that does not hold.
    pub fn first_missing(&self, requirement: Requirement) -> Option<Clause> {
        requirement.clauses().find(|clause| !self.holds(*clause))
    }
}

/// Why a search found no failure in a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Reason {
    /// The driver, or the scene, gave an error in every drive.
    Error,
    /// No plan keeps to the road and clear of the others.
    NoFeasiblePlan,
    /// The driver had no contact in any attacked drive.
    NeverHit,
    /// Contacts, but there would be one without the attack too, or the first is with another road user.
    ContactWithoutAttack,
    /// Attacks, but none that a person would believe.
    NotBelievable,
    /// Believable attacks, but by people who are faster than `strict` allows.
    NotStrict,
    /// Believable attacks, but none in which the driver is at fault.
    NotAtFault,
    /// No evasive manoeuvre was found in any of the attacks that meet the other clauses.
    NotShownAvoidable,
    /// No reference driver prevents the contact in any of the attacks that meet the other clauses.
    NotPreventable,
    /// The same, but the human time of none is long enough.
    NoHumanTime,
    /// Failures by the other clauses, but none in every variant of the drive.
    NotInEveryVariant,
    /// The budget ended before the plans did.
    Budget,
}

impl Reason {
    /// All reasons.
    pub const ALL: [Self; 12] = [
        Self::Error,
        Self::NoFeasiblePlan,
        Self::NeverHit,
        Self::ContactWithoutAttack,
        Self::NotBelievable,
        Self::NotStrict,
        Self::NotAtFault,
        Self::NotShownAvoidable,
        Self::NotPreventable,
        Self::NoHumanTime,
        Self::NotInEveryVariant,
        Self::Budget,
    ];

    /// The reason of an attack that misses a clause.
    pub fn missing(clause: Clause) -> Self {
        match clause {
            Clause::Attack => Self::ContactWithoutAttack,
            Clause::Believable | Clause::Believable1 => Self::NotBelievable,
            Clause::AtFault => Self::NotAtFault,
            Clause::Avoidable => Self::NotShownAvoidable,
            Clause::Preventable => Self::NotPreventable,
            Clause::Holds => Self::NotInEveryVariant,
            Clause::Strict => Self::NotStrict,
            Clause::HumanTime | Clause::HumanTimeR157 => Self::NoHumanTime,
        }
    }

    /// The reason in words.
    pub fn words(self) -> &'static str {
        match self {
            Self::Error => "the driver gave an error in every drive",
            Self::NoFeasiblePlan => "no plan of the adversary is feasible",
            Self::NeverHit => "no contact in any attacked drive",
            Self::ContactWithoutAttack => "contacts come without the attack too, or are with others first",
            Self::NotBelievable => "no attack is believable",
            Self::NotAtFault => "no believable attack at fault",
            Self::NotShownAvoidable => "no evasive manoeuvre was found",
            Self::NotPreventable => "no reference driver prevents the contact",
            Self::NotStrict => "no attack within the strict speeds of people",
            Self::NoHumanTime => "no contact has enough human time",
            Self::NotInEveryVariant => "no failure holds in every variant of the drive",
            Self::Budget => "the budget ended before the plans did",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_requirement_is_read_and_printed_and_always_has_the_attack() {
        let requirement: Requirement = "at-fault, believable".parse().unwrap();
        assert_eq!(requirement.to_string(), "attack,believable,at-fault");
        assert_eq!(Requirement::default().to_string(), "attack,believable,at-fault,preventable");
        let text = serde_json::to_string(&requirement).unwrap();
        assert_eq!(serde_json::from_str::<Requirement>(&text).unwrap(), requirement);
        let error = "solid".parse::<Requirement>().unwrap_err();
        assert_eq!(
            error,
            "`solid` is no clause; known: attack, believable-1, believable, strict, at-fault, avoidable, preventable, human-time, human-time-r157, holds"
        );
    }

    #[test]
    fn clauses_that_were_not_asked_do_not_hold() {
        let clauses = Clauses { attack: true, believable: Some(true), ..Clauses::default() };
        assert!(clauses.meet(Requirement::of(&[Clause::Believable])));
        assert_eq!(clauses.first_missing(Requirement::default()), Some(Clause::AtFault));
        assert_eq!(clauses.first_missing(Requirement::of(&[Clause::Attack])), None);
        assert!(clauses.reach(Clause::Believable), "`believable-1` was not asked");
        assert!(!clauses.reach(Clause::Believable1) && !clauses.reach(Clause::AtFault));
    }
}
