//! What a driver did in a test, as the folder of `sage test --out` keeps it.

use std::path::Path;

use anyhow::{Context as _, Result, ensure};
use sage_core::{
    files,
    geometry::OrientedBox,
    motion::{MAX_COORDINATE, NOW, Trajectory},
};
use sage_sim::{
    attack_test::{AttackOutcome, AttackTest},
    episode::LAST_FRAME,
    policy::Shown,
    search::suite::{SuiteTest, is_plain},
    vehicle::Motion,
};
use sage_view::player::{Meeting, shown_part};
use serde::{Deserialize, Serialize};

use super::row::{ResultHead, ResultRow};
use crate::commands::search::found::{check_poses, check_shown};

/// Folder of the drives in that of the results, and of the unchanged scenes.
pub(super) const DRIVES: &str = "drives";
pub(super) const SCENES: &str = "scenes";
/// Results of all tests, as `--json` prints them.
pub(super) const RESULTS: &str = "results.jsonl";
/// Size limits of a drive and of all results, bytes.
const LIMIT: u64 = 1 << 24;
pub(super) const LIMIT_OF_RESULTS: u64 = 1 << 27;

/// A test with the drive of a driver.
#[derive(Serialize, Deserialize)]
pub(super) struct TestRecord {
    #[serde(flatten)]
    pub(super) head: ResultHead,
    /// What happened, in words.
    pub(super) words: String,
    /// What explained the failure that the test was made of.
    pub(super) sentence: Option<String>,
    pub(super) cluster: String,
    /// File of the unchanged scene.
    pub(super) scene: String,
    pub(super) adversary: String,
    pub(super) plan: Trajectory,
    /// The drive; `None` after an error.
    pub(super) drive: Option<RecordedDrive>,
}

/// A drive of the ego.
#[derive(Serialize, Deserialize)]
pub(super) struct RecordedDrive {
    /// Box centre and heading at frames 0 to the first contact.
    pub(super) poses: Vec<[f64; 3]>,
    /// The same without the attack.
    pub(super) unattacked: Vec<[f64; 3]>,
    pub(super) contact: Option<RecordedContact>,
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(super) shown: Vec<Shown>,
}

/// Where the ego meets another.
#[derive(Serialize, Deserialize)]
pub(super) struct RecordedContact {
    frame: usize,
    /// Centre, heading, length and width of both.
    boxes: [[f64; 5]; 2],
}

impl RecordedContact {
    fn of(meeting: &Meeting) -> Self {
        let numbers = |area: &OrientedBox| {
            let [x, y] = area.center;
            let heading = area.axis[1].atan2(area.axis[0]);
            [x, y, heading, 2.0 * area.half_length, 2.0 * area.half_width]
        };
        Self { frame: meeting.frame, boxes: [numbers(&meeting.areas[0]), numbers(&meeting.areas[1])] }
    }

    /// As pages show it.
    pub(super) fn meeting(&self) -> Meeting {
        let area =
            |[x, y, heading, length, width]: [f64; 5]| OrientedBox::new([x, y], heading, length, width);
        Meeting { frame: self.frame, areas: self.boxes.map(area) }
    }
}

impl RecordedDrive {
    /// The drive of a test.
    pub(super) fn of(outcome: &AttackOutcome, test: &AttackTest) -> Self {
        let pose = |motion: &Motion| [motion.position[0], motion.position[1], motion.heading];
        let meeting = outcome.episode.first_contacts().next().map(Meeting::from);
        Self {
            poses: shown_part(&outcome.episode.drive).iter().map(pose).collect(),
            unattacked: shown_part(test.unattacked()).iter().map(pose).collect(),
            contact: meeting.as_ref().map(RecordedContact::of),
            shown: outcome.episode.drive.shown.iter().map(Shown::rounded).collect(),
        }
    }
}

impl TestRecord {
    pub(super) fn new(test: &SuiteTest, row: &ResultRow, drive: Option<RecordedDrive>) -> Self {
        Self {
            head: row.head.clone(),
            words: row.words(),
            sentence: test.found.sentence.clone(),
            cluster: test.found.cluster.clone(),
            scene: test.scene.clone(),
            adversary: test.adversary.clone(),
            plan: test.plan.clone(),
            drive,
        }
    }

    /// Name of its file.
    pub(super) fn file(test: &str) -> String {
        format!("{DRIVES}/{test}.json")
    }

    /// Reads the record of a test from a folder of results, which may come from anywhere.
    ///
    /// *Errors*: it cannot be read, or is not as it was written.
    pub(super) fn read(folder: &Path, test: &str) -> Result<Self> {
        ensure!(is_plain(test), "the test {test:?} has no plain name");
        let path = folder.join(Self::file(test));
        let read = || -> Result<Self> {
            let record: Self = serde_json::from_slice(&files::read(&path, LIMIT)?)?;
            ensure!(is_plain(&record.scene), "`scene` is {:?}; expected a plain name", record.scene);
            if let Some(drive) = &record.drive {
                check_poses("poses", &drive.poses, NOW + 1..=LAST_FRAME + 1)?;
                check_poses("unattacked", &drive.unattacked, 0..=LAST_FRAME + 1)?;
                let numbers = drive.contact.iter().flat_map(|contact| contact.boxes.as_flattened());
                ensure!(
                    numbers.into_iter().all(|x| x.abs() <= MAX_COORDINATE),
                    "`contact` has a number out of range"
                );
                check_shown(&drive.shown)?;
            }
            Ok(record)
        };
        read().with_context(|| format!("`{}`", path.display()))
    }
}
