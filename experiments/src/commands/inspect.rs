//! `sage inspect`: summarises scenes in order, one row each; files are read in parallel.

use std::{
    collections::BTreeMap,
    io::Write,
    path::{Path, PathBuf},
};

use anyhow::Result;
use sage_core::scene::Scene;
use sage_data::{
    Recording,
    checks::{Duplicates, Summary},
    folder,
};
use serde_json::json;

use crate::{Outcome, cli::InspectArgs, input, progress, terminal};

/// Summary of a scene after reading.
struct Row {
    summary: Summary,
    tracks: Vec<String>,
}

pub(crate) fn run(args: &InspectArgs) -> Result<Outcome> {
    let mut files: Vec<PathBuf> = Vec::new();
    for path in &args.paths {
        files.extend(folder::scene_files(path)?);
    }
    let read = |path: &Path| {
        let recording = Recording::read(path)?;
        Ok::<Row, sage_data::Error>(Row {
            summary: Summary::of(&scene_name(path), &recording.scene),
            tracks: if args.tracks { list_tracks(&recording.scene) } else { Vec::new() },
        })
    };
    let mut report = Report {
        out: std::io::stdout().lock(),
        json: args.json,
        single: files.len() == 1,
        total: Total::default(),
    };
    report.header()?;
    folder::in_order(&files, read, |path, row| report.row(path, row))?;
    report.finish()
}

/// Name of a scene: its file's, without the ending.
fn scene_name(path: &Path) -> String {
    let path = input::scene_name(path);
    path.file_stem().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
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
    tracks: usize,
    points: usize,
    warnings: BTreeMap<&'static str, usize>,
    duplicates: Duplicates,
}

struct Report<W> {
    out: W,
    json: bool,
    /// True for one scene: each warning is then printed in full.
    single: bool,
    total: Total,
}

impl<W: Write> Report<W> {
    fn header(&mut self) -> Result<()> {
        if !self.json {
            writeln!(
                self.out,
                "{:<14} {:<18} {:>6} {:>8} {:>5} {:>5} {:>5} {:>8} {:>7} {:>6}  {:<10} {:<10} {:>5} {:>6}  warnings",
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
                "future"
            )?;
        }
        Ok(())
    }

    fn row(&mut self, path: &Path, row: Result<Row, sage_data::Error>) -> Result<()> {
        let Row { mut summary, tracks } = match row {
            Ok(row) => row,
            Err(error) => {
                self.total.failed += 1;
                let error = format!("{:#}", anyhow::Error::from(error));
                progress::say(&format!("error: {error}"));
                if self.json {
                    let row = json!({ "scene": scene_name(path), "error": error });
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
        let kind = |name: &str| summary.tracks.get(name).copied().unwrap_or(0);
        let (vehicles, peds, cyclists) = (kind("VEHICLE"), kind("PEDESTRIAN"), kind("CYCLIST"));
        let other = summary.tracks.values().sum::<usize>() - vehicles - peds - cyclists;
        let kinds: Vec<&str> = summary.warnings.iter().map(|w| w.kind).collect();
        writeln!(
            self.out,
            "{:<14} {:<18} {:>6} {:>8} {:>5} {:>5} {:>5} {:>8} {:>7} {:>6}  {:<10} {:<10} {:>5} {:>6}  {}",
            terminal::escaped_name(&summary.scene),
            summary.id.escape_debug().to_string(),
            summary.frames,
            vehicles,
            peds,
            cyclists,
            other,
            summary.map_features,
            summary.map_points,
            summary.lights,
            shortened(&summary.ego),
            shortened(summary.adversary.as_deref().unwrap_or("none")),
            format!("{}/11", summary.adversary_history),
            format!("{}/80", summary.adversary_future),
            kinds.join(", ")
        )?;
        for line in tracks {
            writeln!(self.out, "{line}")?;
        }
        if self.single {
            for warning in &summary.warnings {
                writeln!(self.out, "    {}", warning.to_string().escape_debug())?;
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
        Ok(if *failed > 0 { Outcome::Partial } else { Outcome::Done })
    }
}

/// Shortens an id to its column and escapes control characters.
fn shortened(id: &str) -> String {
    let id = id.escape_debug().to_string();
    if id.chars().count() <= 10 { id } else { format!("{}…", id.chars().take(9).collect::<String>()) }
}
