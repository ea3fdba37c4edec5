//! What a result is of, besides the scene.

use std::fmt;

use serde::{Deserialize, Serialize};

use advsage::operating_point::OperatingPointSpec;

/// What a value is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Subject {
    /// A driver in the unchanged scene.
    Drive,
    /// An attack on a driver: it drives again.
    AttackedDrive,
    /// The adversary's selected trajectory against a path of the ego.
    Trajectory,
    /// A policy without selection: expectations over its candidates.
    Policy,
    /// An episode of the published evaluation.
    Episode,
    /// Predictions of recorded vehicles.
    Prediction,
    /// A search for what a driver fails at.
    Search,
    /// How likely a driver fails under a nominal density.
    Rate,
    /// How much it takes until a driver fails: one plan at each λ.
    Threshold,
    /// A plan that was made against one driver, driven by another.
    Transfer,
}

impl Subject {
    /// All of them.
    pub const ALL: [Self; 10] = [
        Self::Drive,
        Self::AttackedDrive,
        Self::Trajectory,
        Self::Policy,
        Self::Episode,
        Self::Prediction,
        Self::Search,
        Self::Rate,
        Self::Threshold,
        Self::Transfer,
    ];

    /// Title of its table in a study that gives none.
    pub fn title(self) -> &'static str {
        match self {
            Self::Drive => "Drives in unchanged scenes:",
            Self::AttackedDrive => "Drives under attack:",
            Self::Trajectory => "Selected trajectories:",
            Self::Policy => "Policies without selection, expectations:",
            Self::Episode => "Episodes:",
            Self::Prediction => "Predictions:",
            Self::Search => "Searches with the driver in the loop:",
            Self::Rate => "How likely drivers fail under a nominal density:",
            Self::Threshold => "Thresholds of lambda:",
            Self::Transfer => "Plans that were made against one driver, driven by another:",
        }
    }

    /// Its name in rows and in studies.
    pub fn name(self) -> &'static str {
        match self {
            Self::Drive => "drive",
            Self::AttackedDrive => "attacked-drive",
            Self::Trajectory => "trajectory",
            Self::Policy => "policy",
            Self::Episode => "episode",
            Self::Prediction => "prediction",
            Self::Search => "search",
            Self::Rate => "rate",
            Self::Threshold => "threshold",
            Self::Transfer => "transfer",
        }
    }
}

impl fmt::Display for Subject {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// What a result is of, besides the scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Key {
    /// What its values are of.
    pub subject: Subject,
    /// What is compared besides generators and operating points: a driver, a merger, weights, a predictor.
    pub arm: String,
    /// Seed of the training of a policy or of experts.
    pub training_seed: Option<u64>,
    /// Update at which a trained policy was stored.
    pub checkpoint: Option<u64>,
    /// Generator with its options; empty without attack.
    pub attack: String,
    /// Operating point; none if nothing depends on one.
    pub point: Option<OperatingPointSpec>,
    /// What is aimed at or varied further, such as the latest start, s.
    pub target: Option<f64>,
    /// Driver that the plan was made against, in a study of transfer, whose arms are the tested drivers; empty in others.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub made_against: String,
    /// Seed of random numbers.
    pub seed: u64,
    /// What the generator knows beyond *now*, or what the driver knows; empty for nothing.
    pub knows: String,
}

impl Key {
    /// A result of an arm without attack.
    pub fn new(subject: Subject, arm: impl Into<String>, seed: u64) -> Self {
        Self {
            subject,
            arm: arm.into(),
            training_seed: None,
            checkpoint: None,
            attack: String::new(),
            point: None,
            target: None,
            made_against: String::new(),
            seed,
            knows: String::new(),
        }
    }

    /// Whether two results are of the same method: they may differ in training seed and checkpoint alone.
    pub fn is_same_method(&self, other: &Self) -> bool {
        let Self {
            subject,
            arm,
            training_seed: _,
            checkpoint: _,
            attack,
            point,
            target,
            made_against,
            seed,
            knows,
        } = self;
        (*subject, arm, attack, point) == (other.subject, &other.arm, &other.attack, &other.point)
            && (target, made_against, seed, knows)
                == (&other.target, &other.made_against, &other.seed, &other.knows)
    }

    /// Attack and operating point in a table.
    pub fn attack_label(&self) -> String {
        let label = self.generator_label();
        match &*self.made_against {
            "" => label,
            path if label.is_empty() => format!("made against {path}"),
            path => format!("{label} made against {path}"),
        }
    }

    /// Attack and operating point, without what the plan was made against.
    pub fn generator_label(&self) -> String {
        let point = self.point.as_ref().map(OperatingPointSpec::label);
        let target = self.target.map(|target| format!("target {target}"));
        let attack = Some(self.attack.clone()).filter(|attack| !attack.is_empty());
        [attack, point, target].into_iter().flatten().collect::<Vec<_>>().join(" ")
    }

    /// Seeds the bootstrap of its estimates.
    pub fn stream(&self) -> String {
        format!("{} {} {}", self.subject, self.arm, self.attack_label())
    }
}
