//! What the page says of one failure.

use advsage::rows::{
    failure::FailureRow,
    search::{SceneRow, failure_name},
};
use anyhow::{Context as _, Result};
use sage_core::geometry::{Aabb, Point};
use sage_sim::{
    fault::FaultClass,
    search::{Features, circumstances::Party},
};
use sage_view::listing::car::{Car, path, shown_area};
use serde::Serialize;

use crate::commands::search::found::{FailureScene, without_folders};

/// Time that people need from the first sign of danger, seconds.
const SHORT_FOR_PEOPLE: f64 = 0.75;

/// A failure on the page.
#[derive(Serialize)]
pub(super) struct Entry {
    /// Number of its scene.
    scene: usize,
    page: String,
    pub(super) name: String,
    /// Whether it is the mildest or the worst one of its scene.
    pub(super) role: Option<&'static str>,
    driver: String,
    pub(super) cluster: String,
    collision: &'static str,
    ego_does: &'static str,
    adversary_does: &'static str,
    road: &'static str,
    fault: FaultClass,
    at_fault: Option<bool>,
    pub(super) plan: String,
    pub(super) lambda: Option<f64>,
    latest_start: Option<f64>,
    human_time: Option<f64>,
    /// The reference driver that prevents the contact.
    prevented_by: Option<String>,
    /// Those that were asked before and do not.
    not_prevented_by: Vec<String>,
    /// That the driver has a contact without any attack.
    without_attack: Option<String>,
    /// Largest difference of its accelerations from the recording, m/s².
    difference: Option<f64>,
    /// Probability, %, that the adversary moves so up to the contact, under the nominal density.
    probability: Option<f64>,
    /// What explains it, in words.
    pub(super) sentence: Option<String>,
    /// What is wrong with the braking, and how many others it takes.
    braking: Option<&'static str>,
    needs: Option<&'static str>,
    adversary_from: &'static str,
    /// What the adversary does against lights and lines.
    violation: &'static str,
    right_of_way: &'static str,
    contact_after: f64,
    impact: f64,
    reward: f64,
    ego: Car,
    adversary: Car,
}

impl Entry {
    /// Describes a failure. Also gives the area that its thumbnail shows, metres.
    ///
    /// *Errors*: the row is not as a search writes it.
    pub(super) fn new(
        scene: &FailureScene,
        row: &SceneRow,
        number: usize,
        failure: &FailureRow,
        page: &str,
    ) -> Result<(Self, Aabb)> {
        let name = failure_name(number);
        let driven = scene.driven(failure).with_context(|| name.clone())?;
        let features = driven.features(failure).with_context(|| name.clone())?;
        let Features { collision, ego, adversary, road, .. } = features;
        let circumstances = driven.circumstances(failure).with_context(|| name.clone())?;
        let person = failure.evaluated.person;
        let met = failure.evaluated.contact.as_ref().with_context(|| format!("{name} has no `contact`"))?;
        let step = usize::try_from(met.step).unwrap_or_default();
        let [own, other] = driven.boxes_at(step).with_context(|| name.clone())?;
        let tracks = (scene.scene().ego(), scene.scene().adversary()?);
        let positions: Vec<Point> = failure.ego_path.iter().map(|[x, y, _]| [*x, *y]).collect();
        let paths = [path(tracks.0, &positions, step), path(tracks.1, failure.trajectory.points(), step)];
        let area = shown_area(&paths);
        let [ego_path, adversary_path] = &paths;
        let plan = failure.plan.method.split('{').next().unwrap_or_default().to_owned();
        let lambda = failure.plan.lambda.filter(|_| plan != "random");
        let entry = Self {
            scene: 0,
            page: format!("{page}#{name}"),
            name,
            role: match Some(number) {
                this if this == row.mildest() => Some("mildest"),
                this if this == row.worst() => Some("worst"),
                _ => None,
            },
            driver: without_folders(&failure.head.ego),
            cluster: features.cluster(),
            collision: collision.name(),
            ego_does: ego.words(),
            adversary_does: if person.is_some() { "crosses" } else { adversary.words() },
            road: road.words(),
            fault: met.class,
            at_fault: met.class.is_at_fault(),
            plan,
            lambda,
            latest_start: failure.avoidable.latest_start,
            human_time: failure.evaluated.human_time,
            prevented_by: failure.prevented_by().map(str::to_owned),
            not_prevented_by: failure.not_prevented_by().map(str::to_owned).collect(),
            without_attack: row.contact_without_attack(),
            difference: failure.deviation.map(|deviation| deviation.acceleration),
            probability: failure.probability.map(|probability| 100.0 * probability),
            sentence: failure.sentence.clone(),
            braking: failure.explanation.as_ref().map(|explanation| explanation.braking.class()),
            needs: failure.explanation.as_ref().map(|explanation| explanation.needed.words()),
            adversary_from: match (&circumstances, person) {
                (Some(known), _) => known.adversary_from.words(),
                (None, Some(met)) if met.contact.from_left => "the left",
                (None, _) => "the right",
            },
            violation: circumstances.map_or("neither", |known| known.violation()),
            right_of_way: circumstances.and_then(|known| known.right_of_way).map_or("unknown", Party::words),
            contact_after: met.step as f64 / 10.0,
            impact: met.impact_speed,
            reward: failure.evaluated.reward,
            ego: Car::new(&own, ego_path),
            adversary: Car::new(&other, adversary_path),
        };
        Ok((entry, area))
    }

    /// The same of the scene with a number.
    pub(super) fn of_scene(self, scene: usize) -> Self {
        Self { scene, ..self }
    }

    /// What happened, in one line.
    pub(super) fn words(&self) -> String {
        let fault = match self.at_fault {
            Some(true) => format!("ego at fault by nuPlan's rule ({})", self.fault.words()),
            Some(false) => "ego not at fault".to_owned(),
            None => "fault unknown".to_owned(),
        };
        let prevented = self.prevented_by.as_ref().map(|name| format!("{name} prevents it"));
        let not = Some(self.not_prevented_by.join(", ")).filter(|names| !names.is_empty()).map(|names| {
            format!("{names} {}", if self.not_prevented_by.len() == 1 { "does not" } else { "do not" })
        });
        let asked: Vec<String> = [prevented, not].into_iter().flatten().collect();
        let asked = if asked.is_empty() { String::new() } else { format!("; {}", asked.join(", ")) };
        let from = format!(", comes from {}", self.adversary_from);
        let violation =
            if self.violation == "neither" { String::new() } else { format!(", {}", self.violation) };
        let right_of_way = match self.right_of_way {
            "unknown" => String::new(),
            party => format!("; right of way: {party}"),
        };
        let evasion = self.latest_start.map_or(String::new(), |time| {
            format!("; an evasive manoeuvre, knowing the plan, could begin as late as {time:.1} s before the contact")
        });
        let human = self.human_time.map_or(String::new(), |time| {
            let short = if time < SHORT_FOR_PEOPLE { ", less than people need (0.75 s)" } else { "" };
            format!("; human time {time:.1} s{short}")
        });
        let likely =
            self.probability.map_or(String::new(), |percent| format!("; probability {percent:.2} %"));
        let without = self.without_attack.as_ref().map_or(String::new(), |contact| format!("; {contact}"));
        format!(
            "{}; contact after {:.1} s at {:.1} m/s, {fault}; adversary {}{from}{violation}{right_of_way}{asked}{evasion}{human}{likely}{without}",
            self.cluster, self.contact_after, self.impact, self.adversary_does
        )
    }
}
