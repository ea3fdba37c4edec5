//! `sage inspect`: summarises scenes in order, one row each; files are read in parallel.

use std::{
    collections::BTreeMap,
    io::Write,
    path::{Path, PathBuf},
};

use anyhow::Result;
use sage_core::scene::Scene;
use sage_data::{
    checks::{Duplicates, Summary},
    folder,
    stream::{Inputs, Item, map_in_order},
    womd::is_record_path,
};
use sage_run::{Outcome, progress, terminal};
use serde_json::json;

use crate::cli::InspectArgs;

/// Summary of a scene after reading.
struct SceneRow {
    summary: Summary,
    tracks: Vec<String>,
}

pub(crate) fn run(args: &InspectArgs) -> Result<Outcome> {
    let inputs = Inputs::under(&args.paths)?;
    let options = args.reading.options();
    let read = |item: Item| {
        let (name, shard) = (scene_name(&item) + &options.suffix(), item.shard().map(Path::to_owned));
        let row = item.read_and(&options, |recording| {
            let tracks = if args.tracks { list_tracks(&recording.scene) } else { Vec::new() };
            Ok(SceneRow { summary: Summary::of(&name, &recording.scene), tracks })
        });
        Found { name, shard, row }
    };
    let mut report = Report {
        out: std::io::stdout().lock(),
        json: args.json,
        wide: args.wide,
        single: inputs.count() == Some(1),
        shard: None,
        total: Total::default(),
    };
    report.header()?;
    map_in_order(inputs.items(), Item::size, read, |found| report.row(found))?;
    report.finish()
}

/// A scene with the name of its row.
struct Found {
    name: String,
    /// The shard of a record.
    shard: Option<PathBuf>,
    row: Result<SceneRow, sage_data::Error>,
}

/// Name of a scene: its file's, without the ending, or a record's as `SHARD#3`.
fn scene_name(item: &Item) -> String {
    let path = item.path();
    let is_record = item.shard().is_some() || is_record_path(path);
    let whole = || path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned();
    match path.to_str() {
        Some("-") => "stdin".to_owned(),
        _ if is_record => whole(),
        _ => folder::scene_name(path).unwrap_or_else(|_| whole()),
    }
}

fn list_tracks(scene: &Scene) -> Vec<String> {
    let row = |(k, track): (usize, &sage_core::scene::Track)| {
        let role = match k {
            k if k == scene.ego => "ego",
            k if Some(k) == scene.adversary => "adversary",
            _ => "",
        };
        let valid = track.count_valid(0..scene.frames);
        format!(
            "    {:<36} {:<12} {valid:>4} valid frames  {role}",
            track.id.escape_debug().to_string(),
            track.kind.name().escape_debug().to_string()
        )
    };
    scene.tracks.iter().enumerate().map(row).collect()
}

#[derive(Default)]
struct Total {
    scenes: usize,
    failed: usize,
    /// Records after a broken one.
    tracks: usize,
    points: usize,
    warnings: BTreeMap<&'static str, usize>,
    duplicates: Duplicates,
}

struct Report<W> {
    out: W,
    json: bool,
    /// True for all columns.
    wide: bool,
    /// True for one scene: each warning is then printed in full.
    single: bool,
    /// Shard of the last printed record.
    shard: Option<PathBuf>,
    total: Total,
}

impl<W: Write> Report<W> {
    fn header(&mut self) -> Result<()> {
        if self.json {
            return Ok(());
        }
        let head = if self.wide {
            wide_cells(&[
                "scene",
                "id",
                "frames",
                "vehicles",
                "peds",
                "cycl",
                "other",
                "features",
                "points",
                "lights",
                "ego",
                "adversary",
                "past",
                "future",
            ])
        } else {
            cells(&["scene", "frames", "vehicles", "others", "ego", "adversary", "future"])
        };
        Ok(writeln!(self.out, "{head}  warnings")?)
    }

    fn row(&mut self, found: Found) -> Result<()> {
        let Found { name, shard, row } = found;
        let SceneRow { mut summary, tracks } = match row {
            Ok(row) => row,
            Err(error) => {
                self.total.failed += 1;
                let error = format!("{:#}", anyhow::Error::from(error));
                progress::say(&format!("error: {error}"));
                if self.json {
                    let row = json!({ "scene": name, "error": error });
                    terminal::json_line(&mut self.out, &row)?;
                }
                return Ok(());
            }
        };
        self.total.duplicates.note(&mut summary);
        self.total.scenes += 1;
        self.total.tracks += summary.tracks.values().sum::<usize>();
        self.total.points += summary.map_points;
        for warning in &summary.warnings {
            *self.total.warnings.entry(warning.kind).or_default() += 1;
        }
        if self.json {
            return Ok(terminal::json_line(&mut self.out, &summary)?);
        }
        // The name of a shard has no room in a column, so it stands above its records.
        let mut label = terminal::escaped_name(&summary.scene);
        if let Some(shard) = shard {
            if self.shard.as_ref() != Some(&shard) {
                writeln!(self.out, "{}:", terminal::escaped_name(&shard.to_string_lossy()))?;
                self.shard = Some(shard);
            }
            label = label.rsplit_once('#').map_or(label.clone(), |(_, number)| format!("#{number}"));
        }
        let kind = |name: &str| summary.tracks.get(name).copied().unwrap_or(0);
        let (vehicles, peds, cyclists) = (kind("VEHICLE"), kind("PEDESTRIAN"), kind("CYCLIST"));
        let other = summary.tracks.values().sum::<usize>() - vehicles - peds - cyclists;
        let kinds: Vec<&str> = summary.warnings.iter().map(|w| w.kind).collect();
        let [ego, adversary] = [&summary.ego, summary.adversary.as_deref().unwrap_or("none")].map(shortened);
        let future = format!("{}/{}", summary.adversary_future, summary.horizon);
        let text = |number: usize| number.to_string();
        let row = if self.wide {
            let past = format!("{}/11", summary.adversary_history);
            let counts = [peds, cyclists, other, summary.map_features, summary.map_points, summary.lights];
            let counts = counts.map(text);
            let [peds, cyclists, other, features, points, lights] = counts.each_ref().map(|count| &**count);
            let id = summary.id.escape_debug().to_string();
            let (frames, vehicles) = (text(summary.frames), text(vehicles));
            wide_cells(&[
                &label, &id, &frames, &vehicles, peds, cyclists, other, features, points, lights, &ego,
                &adversary, &past, &future,
            ])
        } else {
            let others = text(peds + cyclists + other);
            cells(&[&label, &text(summary.frames), &text(vehicles), &others, &ego, &adversary, &future])
        };
        let kinds = kinds.join(", ");
        let row = if self.wide { format!("{row}  {kinds}") } else { terminal::with_remark(&row, &kinds) };
        writeln!(self.out, "{}", row.trim_end())?;
        for line in tracks {
            writeln!(self.out, "{line}")?;
        }
        if self.single {
            writeln!(self.out, "    {}", summary.capabilities)?;
            for warning in &summary.warnings {
                writeln!(self.out, "    {}", terminal::escaped_name(&warning.to_string()))?;
            }
        }
        Ok(())
    }

    fn finish(mut self) -> Result<Outcome> {
        let Total { scenes, failed, tracks, points, warnings, .. } = &self.total;
        let count = |n: usize, one: &str| if n == 1 { format!("1 {one}") } else { format!("{n} {one}s") };
        let mut sum =
            [count(*scenes, "scene"), count(*tracks, "track"), count(*points, "map point")].join(", ");
        if *failed > 0 {
            sum += &format!(", {} not read", count(*failed, "file"));
        }
        if !warnings.is_empty() {
            let words: Vec<String> = warnings.iter().map(|(kind, n)| format!("{n} {kind}")).collect();
            sum += &format!("; warnings: {}", words.join(", "));
        }
        if self.json {
            progress::say(&sum);
        } else {
            writeln!(self.out, "{sum}")?;
        }
        Ok(if *failed > 0 { Outcome::BadScenes } else { Outcome::Done })
    }
}

/// The columns that fit a terminal.
fn cells(all: &[&str; 7]) -> String {
    let [scene, frames, vehicles, others, ego, adversary, future] = all;
    format!("{scene:<18} {frames:>6} {vehicles:>8} {others:>6}  {ego:<10} {adversary:<10} {future:>6}")
}

/// All columns.
fn wide_cells(all: &[&str; 14]) -> String {
    let [
        scene,
        id,
        frames,
        vehicles,
        peds,
        cyclists,
        other,
        features,
        points,
        lights,
        ego,
        adversary,
        past,
        future,
    ] = all;
    format!(
        "{scene:<14} {id:<18} {frames:>6} {vehicles:>8} {peds:>5} {cyclists:>5} {other:>5} {features:>8} {points:>7} {lights:>6}  {ego:<10} {adversary:<10} {past:>5} {future:>6}"
    )
}

/// Shortens an id to its column and escapes control characters.
fn shortened(id: &str) -> String {
    let id = id.escape_debug().to_string();
    if id.chars().count() <= 10 { id } else { format!("{}…", id.chars().take(9).collect::<String>()) }
}
