//! How often plans of a nominal density meet recorded egos, beside how often recorded adversaries did.

use advsage::{
    rate::{Density, Meetings},
    selection::Selection,
};
use anyhow::Result;
use sage_bench::estimate::Samples;
use sage_core::{
    generator::Observation,
    metric::Aggregate,
    motion::{HORIZON, NOW, Trajectory},
    objective::{Candidate, Context, ContextOptions, Criticality, Situation},
    scene::SceneData,
};
use sage_run::{progress::Progress, scenes::Scenes};
use sage_sim::rate::Nominal;

/// Post-encroachment time below which a meeting is a near miss, seconds.
const NEAR: f64 = 1.0;
/// Whose meetings are counted.
const WHOSE: [&str; 3] = ["recorded", "density", "density that looks out"];

/// Of each scene with a feasible plan: shares of the recorded adversary, of the density, and of the density that looks out. `rule`
/// says which plans are feasible.
pub(super) fn meetings(density: &Density, rule: &Selection, scenes: &Scenes) -> Result<Vec<Meetings>> {
    let mut progress = Progress::new("met", scenes.len());
    let all = scenes.map(|data| of_scene(density, rule, data), || progress.step())?;
    progress.finish(&format!("{} scenes", all.len()));
    let all: Vec<[Met; 3]> = all.into_iter().flatten().collect();
    let of = |(k, whose): (usize, &&str)| {
        let share = |of: fn(&Met) -> f64, name: &str| {
            let samples = Samples::of(all.iter().map(|scene| Some(of(&scene[k]))));
            let mean = samples.estimate(Aggregate::Mean, &format!("{whose} {name}"))?;
            Some([mean.value, mean.low, mean.high])
        };
        Some(Meetings {
            scenes: scenes.describe(),
            whose: (*whose).to_owned(),
            adversaries: all.len(),
            contact: share(|met| met.contact, "contact")?,
            near_miss: share(|met| met.near_miss, "near miss")?,
        })
    };
    Ok(WHOSE.iter().enumerate().filter_map(of).collect())
}

/// Shares of plans that meet the recorded ego.
#[derive(Clone, Copy, Default)]
struct Met {
    contact: f64,
    /// Contacts included.
    near_miss: f64,
}

impl Met {
    fn of(plan: &Candidate, recorded: &Context) -> Self {
        let situation = Situation::new(plan, recorded.ego(), recorded);
        let is_near = Criticality::of(&situation).post_encroachment_time.is_some_and(|time| time < NEAR);
        let [contact, near_miss] =
            [situation.encounter.contact.is_some(), is_near].map(|is| f64::from(u8::from(is)));
        Self { contact, near_miss }
    }
}

/// `None` without a feasible plan, or where frames of the adversary are missing.
fn of_scene(density: &Density, rule: &Selection, data: &SceneData) -> Result<Option<[Met; 3]>> {
    let recorded = Context::new(&data.scene, &data.index, &ContextOptions::default())?;
    let adversary = recorded.adversary();
    if !(NOW + 1..=NOW + HORIZON).all(|frame| adversary.valid.get(frame) == Some(&true)) {
        return Ok(None);
    }
    let points = (NOW + 1..=NOW + HORIZON).map(|frame| adversary.point(frame)).collect();
    let log = recorded.candidate(Trajectory::new("recording of the adversary", points)?);
    let now = Observation::of(&data.scene, &data.index)?;
    let nominal = Nominal::new(&recorded, rule.objective.rule(), density.plans(&now, &recorded)?);
    let forecast = density.forecast(&now, &recorded)?;
    let (mut sums, mut masses) = ([Met::default(); 2], [0.0; 2]);
    for plan in &nominal.plans {
        let candidate = recorded.candidate(plan.proposal.trajectory.clone());
        let met = Met::of(&candidate, &recorded);
        let weights = [plan.probability, plan.probability * forecast.log_factor(&candidate).exp()];
        for ((sum, mass), weight) in sums.iter_mut().zip(&mut masses).zip(weights) {
            sum.contact += weight * met.contact;
            sum.near_miss += weight * met.near_miss;
            *mass += weight;
        }
    }
    if !masses.iter().all(|mass| *mass > 0.0) {
        return Ok(None);
    }
    let [plain, aware] = [0, 1]
        .map(|k| Met { contact: sums[k].contact / masses[k], near_miss: sums[k].near_miss / masses[k] });
    Ok(Some([Met::of(&log, &recorded), plain, aware]))
}
