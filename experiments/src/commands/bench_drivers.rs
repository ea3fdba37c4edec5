//! `sage bench drivers`: driving policies in unchanged scenes, paired by scene.

use std::fmt::Write as _;

use anyhow::{Result, bail};
use sage_backbones::training::SceneData;
use sage_core::{
    seed::Rng,
    statistics::{self, Estimate},
};
use sage_sim::{
    SimScene,
    drive::{Simulation, drive},
    fault::{FaultClass, classify},
    policy::{EgoPolicy, Privilege},
};
use serde_json::json;

use crate::{
    Outcome, Registries,
    cli::DriversArgs,
    ego::Ego,
    output::{self, Folder},
    part::PolicyParts,
    progress::{self, Progress},
    scenes::Scenes,
};

/// Resamples of an interval.
const RESAMPLES: usize = 2000;
/// Scenes with a shorter logged drive have no completion, metres.
const SHORTEST_LOG: f64 = 5.0;

/// A drive of one policy in one scene.
struct Row {
    scene: String,
    steps: usize,
    /// First contacts: step, track and class.
    contacts: Vec<(usize, String, FaultClass)>,
    off_road: Option<usize>,
    /// Progress by the progress of the log; `None` if that is too short.
    completion: Option<f64>,
}

impl Row {
    /// Whether the ego is at fault in its first contact. Later ones are consequences of the first.
    fn is_at_fault(&self) -> bool {
        let first = self.contacts.first().map(|(step, ..)| *step);
        let at_first = self.contacts.iter().filter(|(step, ..)| Some(*step) == first);
        at_first.into_iter().any(|(_, _, class)| class.is_at_fault() == Some(true))
    }

    /// Whether the car touches a road edge before any contact.
    fn is_off_road(&self) -> bool {
        let first = self.contacts.first().map_or(usize::MAX, |(step, ..)| *step);
        self.off_road.is_some_and(|step| step < first)
    }
}

/// Counted properties of a drive.
type Property = (&'static str, fn(&Row) -> bool);

const PROPERTIES: [Property; 3] = [
    ("contact", |row| !row.contacts.is_empty()),
    ("at-fault contact", Row::is_at_fault),
    ("off the road", Row::is_off_road),
];

pub(crate) fn run(args: &DriversArgs, registries: &Registries) -> Result<Outcome> {
    let PolicyParts(parts) = &args.policies;
    let egos = Ego::all(parts, registries)?;
    let names: Vec<String> = egos.iter().map(|ego| ego.label.clone()).collect();
    let out = Folder::make(&args.folder.out, args.folder.force)?;
    let scenes = Scenes::of(&args.paths, &args.split, args.procedural, args.seed)?;
    let mut progress = Progress::new("driven", scenes.len());
    let drives = scenes.map(|data| Ok(drives(data, &egos, args.seed)), || progress.step())?;
    progress.finish(&format!("{} policies in {}", names.len(), progress::count(drives.len(), "scene")));
    let mut rows: Vec<Vec<Row>> = names.iter().map(|_| Vec::new()).collect();
    let mut failed = 0;
    for drive in drives {
        match drive {
            Ok(drive) => drive.into_iter().zip(&mut rows).for_each(|(row, rows)| rows.push(row)),
            Err(error) => {
                failed += 1;
                progress::say(&format!("error: {error:#}"));
            }
        }
    }
    if rows.iter().all(Vec::is_empty) {
        bail!("no scene could be driven");
    }
    let privileges: Vec<Privilege> = egos.iter().map(|ego| ego.policy.privilege()).collect();
    let markdown = table(&names, &privileges, &rows)? + &pairs(&names, &rows, args.seed)?;
    out.write("drivers.md", markdown.as_bytes())?;
    out.write("scenes.csv", csv(&names, &rows)?.as_bytes())?;
    let record = json!({
        "command": output::command(), "policies": names, "scenes": rows[0].len(), "failed": failed,
        "data": scenes.names().len(), "seed": args.seed, "version": env!("CARGO_PKG_VERSION"),
    });
    out.write("run.json", format!("{record:#}\n").as_bytes())?;
    output::print(&markdown)?;
    progress::say(&format!("drivers.md, scenes.csv and run.json are in `{}`", args.folder.out.display()));
    Ok(if failed > 0 { Outcome::Partial } else { Outcome::Done })
}

/// Drives of all policies in one scene.
///
/// *Errors*: the scene cannot be driven by one of them.
fn drives(data: &SceneData, egos: &[Ego], seed: u64) -> Result<Vec<Row>> {
    let scene = SimScene::new(data.scene.clone(), data.index.clone())?;
    let log = scene.route().length();
    let drive_one = |policy: &dyn EgoPolicy| {
        let mut simulation = Simulation::new(&scene, &std::sync::Arc::default(), None, policy, seed)?;
        let drive = drive(&mut simulation)?;
        let car = simulation.world().car();
        let contacts = drive.contacts.iter().map(|contact| {
            let track = scene.scene().tracks[contact.other.track].id.clone();
            (contact.step, track, classify(contact, car, &data.index))
        });
        Ok(Row {
            scene: data.name.clone(),
            steps: drive.motions.len() - 1,
            contacts: contacts.collect(),
            off_road: drive.off_road,
            completion: (log >= SHORTEST_LOG).then(|| drive.progress / log),
        })
    };
    egos.iter().map(|ego| drive_one(&*ego.policy)).collect()
}

fn table(names: &[String], privileges: &[Privilege], rows: &[Vec<Row>]) -> Result<String> {
    let mut out = "Driving policies in unchanged scenes, all logged agents replayed.\n\n".to_owned();
    let heads = PROPERTIES.map(|(name, _)| format!("{name} %"));
    writeln!(out, "| policy | knows | N | {} | median completion |", heads.join(" | "))?;
    writeln!(out, "| --- | --- | --- | --- | --- | --- | --- |")?;
    for ((name, privilege), rows) in names.iter().zip(privileges).zip(rows) {
        let shares = PROPERTIES.map(|(_, holds)| {
            let count = rows.iter().filter(|row| holds(row)).count();
            statistics::wilson(count, rows.len()).map_or("-".to_owned(), |e| {
                format!("{:.1} [{:.1}, {:.1}]", 100.0 * e.value, 100.0 * e.low, 100.0 * e.high)
            })
        });
        let completions: Vec<f64> = rows.iter().filter_map(|row| row.completion).collect();
        let completion = statistics::median(&completions).map_or("-".to_owned(), |c| format!("{c:.2}"));
        writeln!(out, "| {name} | {privilege} | {} | {} | {completion} |", rows.len(), shares.join(" | "))?;
    }
    out += "\nIntervals: 95 %, Wilson. An *at-fault contact* is one that nuPlan's rule gives to the ego; \
        only the first contact of a drive counts, and one on a map without lanes that its rule 5 would decide does not. *Off the road*: a road edge is touched before any contact. \
        *Completion* is progress along the logged route by that of the log, which may be below or above 1.\n";
    Ok(out)
}

/// Differences of all pairs of policies, over the common scenes.
fn pairs(names: &[String], rows: &[Vec<Row>], seed: u64) -> Result<String> {
    let mut out = String::new();
    if names.len() < 2 {
        return Ok(out);
    }
    let heads = PROPERTIES.map(|(name, _)| format!("{name}, points"));
    writeln!(out, "\nPaired by scene, first policy minus second:\n\n| policies | {} |", heads.join(" | "))?;
    writeln!(out, "| --- | --- | --- | --- |")?;
    for first in 0..names.len() {
        for second in first + 1..names.len() {
            let cells = PROPERTIES.map(|(name, holds)| {
                let value = |row: &Row| f64::from(u8::from(holds(row)));
                let pairs = rows[first].iter().zip(&rows[second]);
                let differences: Vec<f64> = pairs.map(|(a, b)| 100.0 * (value(a) - value(b))).collect();
                let mut rng = Rng::new(seed, &format!("{} {}", names[first], names[second]), name);
                statistics::bootstrap_mean(&differences, RESAMPLES, &mut rng)
                    .as_ref()
                    .map_or("-".to_owned(), points)
            });
            writeln!(out, "| {} − {} | {} |", names[first], names[second], cells.join(" | "))?;
        }
    }
    out += "\nIntervals: 95 %, bootstrap over scenes.\n";
    Ok(out)
}

fn points(e: &Estimate) -> String {
    format!("{:+.1} [{:+.1}, {:+.1}]", e.value, e.low, e.high)
}

fn csv(names: &[String], rows: &[Vec<Row>]) -> Result<String> {
    let mut out = "policy,scene,steps,contacts,at_fault,off_road_step,completion\n".to_owned();
    let quoted = |text: &str| format!("\"{}\"", text.replace('"', "\"\""));
    for (name, rows) in names.iter().zip(rows) {
        for row in rows {
            let contacts = row.contacts.iter().map(|(step, track, class)| {
                let class = serde_json::to_value(class).unwrap_or_default();
                format!("{step}:{track}:{}", class.as_str().unwrap_or("?"))
            });
            let contacts: Vec<String> = contacts.collect();
            let number = |value: Option<String>| value.unwrap_or_default();
            writeln!(
                out,
                "{},{},{},{},{},{},{}",
                quoted(name),
                quoted(&row.scene),
                row.steps,
                quoted(&contacts.join(" ")),
                row.is_at_fault(),
                number(row.off_road.map(|step| step.to_string())),
                number(row.completion.map(|c| c.to_string())),
            )?;
        }
    }
    Ok(out)
}
