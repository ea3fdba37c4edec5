//! The row of one drive: its JSON file and its printed line.

use std::path::Path;

use sage_core::{
    files,
    generator::Extension,
    motion::Trajectory,
    objective::{Reason, verdict},
    scene::{Scene, SceneIndex, recording_off_road},
    text::escaped_name,
};
use sage_sim::{
    avoidable::Avoidable,
    episode::{End, Episode, Verdict},
    fault::FaultClass,
};
use serde::{Deserialize, Serialize};

use super::{
    GeneratedBy, ROW_LIMIT,
    contact::{ContactRow, step},
};

/// One drive, as its file records it. Steps count from frame 10, *now*, which is step 0.
#[derive(Serialize, Deserialize)]
pub struct DriveRow {
    /// Hash of the run's identity. The first field, so that it can be checked without reading the row.
    pub run_hash: String,
    /// Name of the input file without its ending.
    pub scene: String,
    /// Driver and its options.
    pub ego: String,
    /// Track of the adversary.
    pub adversary: Option<String>,
    /// Generator and operating point as in a row of `sage generate`; `method` and `lambda` are null without.
    #[serde(flatten)]
    pub generated: Option<GeneratedBy>,
    /// Number of steps after *now* that are recorded, at most 80: the drive ends there.
    pub horizon: usize,
    /// Number of steps from frame 0 to the end.
    pub steps: usize,
    /// First step at which 95 % of the logged route are driven.
    pub arrived: Option<i64>,
    /// First step on a road edge that is not touched since the start; null if there is none.
    pub off_road: Option<i64>,
    /// Whether the ego's recording leaves the road too: tables then do not count it.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub off_road_as_recorded: bool,
    /// Whether the map has road edges: without them `off_road` is not measured.
    pub off_road_measured: bool,
    /// Why it ended.
    pub end: RowEnd,
    /// Progress along the logged route by its length; null if that is below 5 m.
    pub completion: Option<f64>,
    /// Contacts, the first one first.
    pub contacts: Vec<ContactRow>,
    /// x, y, heading and speed at each frame from 0 on: metres, radians, m/s.
    pub trajectory: Vec<[f64; 4]>,
    /// The attack; null without.
    pub attack: Option<DriveAttack>,
    /// Hash of the input file.
    pub source_hash: String,
    /// Seed of the run.
    pub seed: u64,
}

/// Why a drive ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum RowEnd {
    /// At the first contact.
    Contact,
    /// At the end of the recording.
    Horizon,
}

/// The attack of a drive.
#[derive(Serialize, Deserialize)]
pub struct DriveAttack {
    /// The adversary's plan, frames 11 to 90.
    pub trajectory: Trajectory,
    /// Whether the plan is feasible by the paper's rule.
    pub feasible: bool,
    /// Step at which the plan would meet the drive without the attack, which it was planned against.
    pub planned_contact: Option<usize>,
    /// Whether the attack is believable in the attacked drive; null if it does not work.
    pub believable: Option<bool>,
    /// Why not.
    pub unbelievable: Vec<Reason>,
    /// Whether the driver falls for it.
    pub verdict: Verdict,
    /// What the generator adds, as a field of its own. Readers do not need it.
    #[serde(flatten, skip_deserializing)]
    pub extension: Option<Extension>,
    /// Step of the first contact without the attack.
    pub unattacked_contact: Option<i64>,
    /// Whether the attacked drive has an evasive manoeuvre.
    #[serde(flatten)]
    pub avoidable: Avoidable,
}

/// A contact in words. `adversary` is the track of the adversary.
fn words(contact: &ContactRow, adversary: Option<&str>) -> String {
    let ContactRow { step, with, impact_speed, side_hit, class, .. } = contact;
    let who = if Some(&**with) == adversary { "the adversary".to_owned() } else { format!("`{with}`") };
    let fault = fault(*class);
    let side = side_hit.name();
    format!(
        "contact with {who} {} at the ego's {side}, impact {impact_speed:.1} m/s; {fault}: {}",
        time(*step),
        class.words()
    )
}

fn fault(class: FaultClass) -> &'static str {
    match class.is_at_fault() {
        _ if class == FaultClass::Appeared => "nobody at fault",
        Some(true) => "ego at fault",
        Some(false) => "ego not at fault",
        None => "fault unknown",
    }
}

/// A step in words.
fn time(step: i64) -> String {
    match 0.1 * step as f64 {
        seconds if step > 0 => format!("after {seconds:.1} s"),
        _ if step == 0 => "now".to_owned(),
        seconds => format!("{:.1} s before now", -seconds),
    }
}

/// Whether an attack works, in words.
pub struct VerdictInWords {
    /// Whether it works.
    pub is_attack: bool,
    /// The same, and why not.
    pub words: String,
}

/// What identifies a row and describes its attack.
pub struct RowHead<'a> {
    /// Hash of the run's identity.
    pub run_hash: &'a str,
    /// Name of the input file without its ending.
    pub scene: &'a str,
    /// Driver and its options.
    pub ego: &'a str,
    /// How it was generated.
    pub generated: Option<GeneratedBy>,
    /// Hash of the input file.
    pub source_hash: &'a str,
    /// Seed of the run.
    pub seed: u64,
}

impl DriveRow {
    /// The row of an episode.
    pub fn new(head: RowHead, episode: &Episode, scene: &Scene, attack: Option<DriveAttack>) -> Self {
        let state = |motion: &sage_sim::vehicle::Motion| {
            let [x, y] = motion.position;
            [x, y, motion.heading, motion.speed()]
        };
        Self {
            run_hash: head.run_hash.to_owned(),
            scene: head.scene.to_owned(),
            ego: head.ego.to_owned(),
            adversary: scene.adversary.map(|k| scene.tracks[k].id.clone()),
            generated: head.generated,
            horizon: scene.horizon(),
            steps: episode.steps(),
            arrived: episode.arrived.map(step),
            off_road: episode.drive.off_road.step().map(step),
            off_road_as_recorded: episode.drive.off_road.step().is_some()
                && recording_off_road(scene, &SceneIndex::new(scene.map.clone())).is_some(),
            off_road_measured: episode.drive.off_road.is_measured(),
            end: match episode.end {
                End::Contact => RowEnd::Contact,
                End::Horizon => RowEnd::Horizon,
            },
            completion: episode.completion,
            contacts: episode.contacts.iter().map(|contact| ContactRow::of(contact, scene)).collect(),
            trajectory: episode.drive.motions.iter().map(state).collect(),
            attack,
            source_hash: head.source_hash.to_owned(),
            seed: head.seed,
        }
    }

    /// Reads a row; `None` if the file is missing or incomplete.
    pub fn read(path: &Path) -> Option<Self> {
        serde_json::from_slice(&files::read(path, ROW_LIMIT).ok()?).ok()
    }

    /// Whether the attack works, and why not; `None` without an attack.
    pub fn verdict(&self) -> Option<VerdictInWords> {
        let attack = self.attack.as_ref()?;
        if attack.verdict.attack {
            return Some(VerdictInWords { is_attack: true, words: "attack".to_owned() });
        }
        let first = self.contacts.first();
        let reason = match (first, attack.unattacked_contact) {
            (None, _) => String::new(),
            (Some(contact), _) if Some(&contact.with) != self.adversary.as_ref() => {
                " (not with the adversary)".to_owned()
            }
            (Some(contact), _) if contact.step <= 0 => " (before the attack begins)".to_owned(),
            _ if !attack.feasible => " (the plan is not feasible)".to_owned(),
            (_, Some(step)) => format!(" (without it there is a contact {})", time(step)),
            (_, None) => String::new(),
        };
        Some(VerdictInWords { is_attack: false, words: format!("no attack{reason}") })
    }

    /// Whether the attack works and how the drive ended, in words.
    pub fn ending(&self) -> String {
        let route = self.completion.map(|c| format!("{:.0} % of the route", 100.0 * c));
        let off_road = match self.off_road {
            _ if !self.off_road_measured => Some("off road not measured (the map has no edges)".to_owned()),
            step => step.map(|step| format!("off the road {}{}", time(step), self.as_recorded())),
        };
        let contact = match (self.end, self.contacts.first()) {
            (RowEnd::Contact, Some(contact)) => words(contact, self.adversary.as_deref()),
            _ => "no contact".to_owned(),
        };
        let verdict = self.verdict().map(|verdict| verdict.words);
        [verdict, Some(contact), off_road, route].into_iter().flatten().collect::<Vec<_>>().join("; ")
    }

    /// That the recording leaves the road too, in words.
    fn as_recorded(&self) -> &'static str {
        if self.off_road_as_recorded { ", as the recording does" } else { "" }
    }

    /// The plan of the attack in words; empty without an attack.
    pub fn note(&self) -> String {
        let Some(attack) = &self.attack else { return String::new() };
        let planned = match (attack.planned_contact, attack.feasible) {
            (None, _) => "the plan would not touch the ego",
            (Some(_), false) => "the plan would hit the ego, but is not feasible",
            (Some(_), true) => "the plan would hit the ego",
        };
        let believable = verdict(attack.believable, &attack.unbelievable)
            .map_or(String::new(), |words| format!(" In the attacked drive it is {words}."));
        let evasion = match (attack.avoidable.avoidable, attack.avoidable.latest_start) {
            (Some(true), Some(time)) => {
                format!(
                    " An evasive manoeuvre, knowing the plan, could begin up to {time:.1} s before the contact."
                )
            }
            (Some(false), _) => " No evasive manoeuvre was found.".to_owned(),
            _ => String::new(),
        };
        let before = attack.unattacked_contact.map_or(String::new(), |step| {
            format!(" Without the attack this driver has a contact {}.", time(step))
        });
        format!("Beside this driver's drive without the attack, {planned}.{believable}{evasion}{before}")
    }

    /// The printed line; `variant` names attack and operating point.
    pub fn line(&self, variant: &str) -> String {
        let names = [&self.scene, &self.ego, variant].map(escaped_name).join(" ");
        let contact = match (self.end, self.contacts.first()) {
            (RowEnd::Contact, Some(contact)) => {
                let is_adversary = Some(&contact.with) == self.adversary.as_ref();
                let who = if is_adversary { String::new() } else { format!(" with `{}`", contact.with) };
                let why = match contact.class {
                    FaultClass::Appeared => format!(" ({})", contact.class.words()),
                    _ => String::new(),
                };
                format!("contact{who} {}, {}{why}", time(contact.step), fault(contact.class))
            }
            _ => "no contact".to_owned(),
        };
        let off_road = self.off_road.filter(|_| self.off_road_measured);
        let off_road = off_road.map(|step| format!("off the road {}{}", time(step), self.as_recorded()));
        let verdict = self.verdict().map(|verdict| verdict.words);
        let all = [verdict, Some(contact), off_road].into_iter().flatten().collect::<Vec<_>>().join("; ");
        format!("{}: {}", names.trim_end(), escaped_name(&all))
    }
}
