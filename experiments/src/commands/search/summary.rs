//! What a search found over all scenes.

use std::collections::BTreeMap;

use advsage::rows::search::SceneRow;
use sage_core::statistics::wilson;
use sage_run::progress::count;
use sage_sim::search::{Reason, Requirement};
use serde_json::{Map, Value, json};

/// Counts over the scenes that are done.
pub(super) struct Summary {
    require: Requirement,
    scenes: usize,
    drives: usize,
    errors: usize,
    /// Scenes with an attack, a believable one, one at fault, a failure.
    with: [usize; 4],
    /// Scenes with a failure of a source of plans.
    sources: BTreeMap<String, usize>,
    /// Scenes without a failure by reason.
    reasons: BTreeMap<Reason, usize>,
    /// Those that the budget ended, by what the best drive missed.
    reached: BTreeMap<Reason, usize>,
    /// Scenes with a contact without any attack.
    contacts_without_attack: usize,
    /// Scenes in which the driver leaves the road without any attack.
    off_road_without_attack: usize,
    /// Scenes in which the car is beside its plan without any attack, and the largest distance, metres.
    off_plan: (usize, f64),
    /// Sum of the shares of the routes that are driven without an attack, and their number.
    completion: (f64, usize),
}

/// Distance from its plan that is warned of, metres.
const OFF_PLAN: f64 = 0.5;

/// A driver that makes less of its routes without an attack hardly drives.
pub(in crate::commands) const HARDLY: f64 = 0.5;

/// Names of [`Summary::with`].
const NAMES: [&str; 4] = ["attack", "believable", "at_fault", "failure"];

impl Summary {
    pub(super) fn of(rows: impl Iterator<Item = SceneRow>, require: Requirement) -> Self {
        let (reasons, reached) = (BTreeMap::new(), BTreeMap::new());
        let sources = BTreeMap::new();
        let mut all = Self {
            require,
            scenes: 0,
            drives: 0,
            errors: 0,
            with: [0; 4],
            sources,
            reasons,
            reached,
            contacts_without_attack: 0,
            off_road_without_attack: 0,
            off_plan: (0, 0.0),
            completion: (0.0, 0),
        };
        for row in rows {
            all.scenes += 1;
            all.drives += row.drives;
            all.errors += row.errors;
            all.contacts_without_attack += usize::from(row.unattacked_contact.is_some());
            all.off_road_without_attack += usize::from(row.unattacked_off_road == Some(true));
            if let Some(off) = row.unattacked_off_plan.filter(|off| *off > OFF_PLAN) {
                all.off_plan = (all.off_plan.0 + 1, all.off_plan.1.max(off));
            }
            if let Some(completion) = row.unattacked_completion {
                all.completion.0 += completion;
                all.completion.1 += 1;
            }
            let found = [row.attacks, row.believable, row.at_fault, row.failures];
            for (scenes, found) in all.with.iter_mut().zip(found) {
                *scenes += usize::from(found > 0);
            }
            for source in row.sources.into_keys() {
                *all.sources.entry(source).or_default() += 1;
            }
            if let Some(reason) = row.reason {
                *all.reasons.entry(reason).or_default() += 1;
                if let Some(reached) = row.reached.filter(|_| reason == Reason::Budget) {
                    *all.reached.entry(reached).or_default() += 1;
                }
            }
        }
        all
    }

    /// The counts for the record of the run.
    pub(super) fn json(&self) -> [(String, Value); 6] {
        let with: Map<String, Value> =
            NAMES.iter().zip(self.with).map(|(name, scenes)| ((*name).to_owned(), json!(scenes))).collect();
        [
            ("drives", json!(self.drives)),
            ("errors", json!(self.errors)),
            ("reasons", json!(self.reasons)),
            ("reached", json!(self.reached)),
            ("scenes_with", Value::Object(with)),
            ("scenes_by_source", json!(self.sources)),
        ]
        .map(|(name, value)| (name.to_owned(), value))
    }

    /// The counts in words.
    pub(super) fn text(&self) -> String {
        let [.., failures] = self.with;
        let share = |scenes: usize| match wilson(scenes, self.scenes) {
            Some(share) => {
                format!("{:.1} % [{:.1}, {:.1}]", 100.0 * share.value, 100.0 * share.low, 100.0 * share.high)
            }
            None => "none".to_owned(),
        };
        let mut lines = vec![format!(
            "{} of {} with a failure ({}): {}; {}{}",
            failures,
            count(self.scenes, "scene"),
            self.require,
            share(failures),
            count(self.drives, "drive"),
            if self.errors > 0 {
                format!(", {} of them with an error of the driver", self.errors)
            } else {
                String::new()
            },
        )];
        if self.sources.len() > 1 {
            let of = self.sources.iter().map(|(name, scenes)| format!("{name} in {scenes}"));
            lines.push(format!("  failures by plans of {}", of.collect::<Vec<_>>().join(", ")));
        }
        for (reason, scenes) in &self.reasons {
            lines.push(format!("  {}: {}", count(*scenes, "scene"), reason.words()));
            for (reached, scenes) in self.reached.iter().filter(|_| *reason == Reason::Budget) {
                lines.push(format!("    {scenes} of them so far: {}", reached.words()));
            }
        }
        let within = |scenes: usize| format!("{scenes} of {}", count(self.scenes, "scene"));
        if self.contacts_without_attack > 0 {
            let scenes = within(self.contacts_without_attack);
            lines.push(format!(
                "  in {scenes} this driver has a contact without any attack: `sage simulate` shows it"
            ));
        }
        if self.off_road_without_attack > 0 {
            let scenes = within(self.off_road_without_attack);
            lines.push(format!(
                "warning: in {scenes} this driver leaves the road without any attack, which is no failure of a search: `sage simulate` shows it"
            ));
        }
        if let (scenes @ 1.., most) = self.off_plan {
            lines.push(format!(
                "warning: in {} without any attack the car is more than {OFF_PLAN} m beside its newest plan (up to {most:.1} m): plan from where the car is, or answer with \"follow\": \"exact\"",
                within(scenes)
            ));
        }
        let (sum, scenes) = self.completion;
        if scenes > 0 && sum / (scenes as f64) < HARDLY {
            let percent = 100.0 * sum / scenes as f64;
            lines.push(format!("warning: without an attack this driver makes {percent:.0} % of its routes in the mean; whoever hardly drives is at fault in little, so a search finds little"));
        }
        lines.join("\n")
    }
}
