//! `sage score`: prints all measures of candidate trajectories.

use std::{io::Write, sync::Arc};

use advsage::Registries;
use anyhow::{Result, anyhow};
use sage_core::{
    motion::{NOW, check_path},
    objective::{Context, ContextOptions, FurtherMeasures, Scorer, Scores, Sizes},
    scene::SceneIndex,
};
use sage_run::{Outcome, terminal};
use sage_sim::avoidable::{Avoidable, Avoidance};
use serde::Serialize;

use crate::{
    candidates,
    cli::{ScoreArgs, SizesArg},
};

#[derive(Serialize)]
struct ScoreRow<'r> {
    name: &'r str,
    #[serde(flatten)]
    scores: Scores,
    #[serde(flatten)]
    avoidable: Option<Avoidable>,
}

pub(crate) fn run(args: &ScoreArgs, registries: &Registries) -> Result<Outcome> {
    let further = FurtherMeasures::of(&registries.rewards, &registries.feasibilities, None)?;
    let scene = candidates::read_scene(
        &args.scene,
        &args.reading.options(),
        args.ego.as_deref(),
        args.adversary.as_deref(),
    )?;
    let candidates = candidates::read(&args.candidates)?;
    let (index, scene) = (SceneIndex::new(scene.map.clone()), Arc::new(scene));
    let options = ContextOptions {
        convention: args.convention.into(),
        sizes: match args.sizes {
            SizesArg::Logged => Sizes::Logged,
            SizesArg::Metadrive => Sizes::MetaDrive { cycle: usize::from(args.class_cycle) },
        },
        ..ContextOptions::default()
    };
    // Built only for candidates without an ego path: a short scene has no logged one.
    let mut logged: Option<Context> = None;
    let mut table =
        Table { out: std::io::stdout().lock(), json: args.json, wide: args.wide, rows: 0, further: &further };
    for candidate in candidates {
        let own;
        let ctx = match (candidate.ego, &mut logged) {
            (None, Some(ctx)) => &*ctx,
            (None, slot) => &*slot.insert(Context::new(&scene, &index, &options)?),
            (Some(ego), Some(ctx)) => {
                own = ctx.with_ego(&ego)?;
                &own
            }
            (ego, None) => {
                own = Context::new(&scene, &index, &ContextOptions { ego, ..options.clone() })?;
                &own
            }
        };
        let prepared = ctx.candidate(candidate.trajectory);
        let start = prepared.start().position;
        check_path([(0, start), (1, prepared.points()[0])]).map_err(|problem| {
            let (file, name) = (args.candidates.display(), &candidate.name);
            anyhow!("`{file}`: candidate `{name}`: point 0 {problem}, the adversary's at frame {NOW}")
        })?;
        let scores = Scorer::with(ctx, &further).scores(&prepared);
        let avoidable = args.avoidable.options().map(|options| Avoidance::new(ctx, options)).transpose()?;
        let avoidable = avoidable.map(|avoidance| avoidance.of(&prepared));
        table.row(&ScoreRow { name: &candidate.name, scores, avoidable })?;
    }
    Ok(Outcome::Done)
}

struct Table<'f, W> {
    out: W,
    json: bool,
    /// True for all columns.
    wide: bool,
    rows: usize,
    further: &'f FurtherMeasures,
}

impl<W: Write> Table<'_, W> {
    fn row(&mut self, row: &ScoreRow) -> Result<()> {
        if self.json {
            return Ok(terminal::json_line(&mut self.out, row)?);
        }
        if self.rows == 0 {
            let head = if self.wide { self.wide_head(row) } else { narrow_head(row) };
            writeln!(self.out, "{head}  violations")?;
        }
        self.rows += 1;
        let violations = violations(&row.scores);
        let line = if self.wide {
            format!("{}  {violations}", self.wide_cells(row))
        } else {
            terminal::with_remark(&narrow_cells(row), &violations)
        };
        Ok(writeln!(self.out, "{}", line.trim_end())?)
    }

    fn wide_head(&self, row: &ScoreRow) -> String {
        let mut head = format!(
            "{:<22} {:>6} {:>4} {:>7} {:>7} {:>4} {:>5} {:>8} {:>8} {:>10} {:>5} {:>5} {:>6} {:>6} {:>5} {:>6} {:>6} {:>6}",
            "candidate",
            "R_adv",
            "hit",
            "P_kin",
            "P_beh",
            "line",
            "crash",
            "feasible",
            "drivable",
            "believable",
            "TTC",
            "PET",
            "decel",
            "impact",
            "side",
            "wd_v",
            "wd_a",
            "wd_yaw"
        );
        for name in self.further.rewards().chain(self.further.rules()) {
            head += &format!(" {name:>width$}", width = column(name));
        }
        if row.avoidable.is_some() {
            head += " avoidable latest brake steer";
        }
        head
    }

    fn wide_cells(&self, row: &ScoreRow) -> String {
        let s = &row.scores;
        let mut further = String::new();
        for name in self.further.rewards() {
            let value = number(s.rewards.get(name).copied().flatten(), 3);
            further += &format!(" {value:>width$}", width = column(name));
        }
        for name in self.further.rules() {
            let satisfied = yes(s.rules.get(name).is_none_or(Vec::is_empty));
            further += &format!(" {satisfied:>width$}", width = column(name));
        }
        if let Some(a) = &row.avoidable {
            let [latest, brake, steer] =
                [a.latest_start, a.latest_brake, a.latest_steer].map(|time| number(time, 1));
            let avoidable = a.avoidable.map_or("-", yes);
            further += &format!(" {avoidable:>9} {latest:>6} {brake:>5} {steer:>5}");
        }
        format!(
            "{:<22} {:>6.3} {:>4} {:>7.3} {:>7.3} {:>4} {:>5.0} {:>8} {:>8} {:>10} {:>5} {:>5} {:>6} {:>6} {:>5} {:>6} {:>6} {:>6}{further}",
            row.name.escape_debug().to_string(),
            s.adversarial_reward,
            s.collision_step.map_or("-".to_owned(), |step| step.to_string()),
            s.kinematic_penalty,
            s.behavior_penalty,
            number(s.cross_line, 0),
            s.crash_object,
            yes(s.feasible),
            yes(s.feasible_drivable),
            s.believable.map_or("-", yes),
            number(s.criticality.time_to_collision, 2),
            number(s.criticality.post_encroachment_time, 1),
            number(s.criticality.required_deceleration, 1),
            number(s.criticality.impact_speed, 1),
            s.criticality.side_hit.map_or("-", |side| side.name()),
            number(s.distances.wd_speed, 2),
            number(s.distances.wd_acceleration, 2),
            number(s.distances.wd_yaw_rate, 3),
        )
    }
}

/// Heads of the columns that fit a terminal.
fn narrow_head(row: &ScoreRow) -> String {
    let avoidable = if row.avoidable.is_some() { " latest" } else { "" };
    format!(
        "{:<24} {:>6} {:>5} {:>7} {:>7} {:>8} {:>10}{avoidable}",
        "candidate", "R_adv", "hit", "P_kin", "P_beh", "feasible", "believable"
    )
}

/// The columns that fit a terminal.
fn narrow_cells(row: &ScoreRow) -> String {
    let s = &row.scores;
    let latest = row.avoidable.as_ref().map(|avoidable| format!(" {:>6}", number(avoidable.latest_start, 1)));
    format!(
        "{:<24} {:>6.3} {:>5} {:>7.3} {:>7.3} {:>8} {:>10}{}",
        row.name.escape_debug().to_string(),
        s.adversarial_reward,
        s.collision_step.map_or("-".to_owned(), |step| format!("{:.1} s", step as f64 / 10.0)),
        s.kinematic_penalty,
        s.behavior_penalty,
        yes(s.feasible),
        s.believable.map_or("-", yes),
        latest.unwrap_or_default()
    )
}

/// All violations of a candidate, each once.
fn violations(s: &Scores) -> String {
    let of_paper = s.violations.iter().filter(|violation| !s.violations_drivable.contains(violation));
    let all = s.violations_drivable.iter().chain(of_paper).chain(s.rules.values().flatten());
    let words: Vec<String> =
        all.map(|v| format!("{} {} at step {}", v.words(), v.with.escape_debug(), v.step)).collect();
    words.join("; ")
}

fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or("-".to_owned(), |value| format!("{value:.digits$}"))
}

fn yes(is: bool) -> &'static str {
    if is { "yes" } else { "no" }
}

/// Column width of a further measure.
fn column(name: &str) -> usize {
    name.len().max(6)
}
