//! `sage score`: everything that is measured of candidate trajectories.

use std::{
    io::{Read, Write},
    path::Path,
};

use anyhow::{Context as _, Result, bail};
use sage_core::{
    geometry::Point,
    motion::{HORIZON, Trajectory},
    objective::{Context, ContextOptions, EgoPath, Scorer, Scores, Sizes},
    scene::{AdversaryOrigin, Scene, SceneIndex},
};
use sage_data::Recording;
use serde::{Deserialize, Serialize};

use crate::{
    Outcome,
    cli::{ScoreArgs, SizesArg},
};

/// One candidate of the file.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Request {
    name: String,
    trajectory: Vec<Point>,
    ego: Option<Vec<Vec<f64>>>,
}

#[derive(Serialize)]
struct Row<'r> {
    name: &'r str,
    #[serde(flatten)]
    scores: Scores,
}

pub(crate) fn run(args: &ScoreArgs) -> Result<Outcome> {
    let scene = Recording::read(&args.scene)?.scene;
    let scene = scene
        .with_roles(args.ego.as_deref(), args.adversary.as_deref())
        .with_context(|| format!("`{}`", args.scene.display()))?;
    let requests = read_requests(&args.candidates)?;
    announce(&scene)?;
    let index = SceneIndex::new(scene.map.clone());
    let options = ContextOptions {
        convention: args.convention.into(),
        sizes: match args.sizes {
            SizesArg::Logged => Sizes::Logged,
            SizesArg::Metadrive => Sizes::MetaDrive { cycle: usize::from(args.class_cycle) },
        },
        ..ContextOptions::default()
    };
    // Built when the first candidate asks for it: a short scene has no logged ego path to offer.
    let mut logged: Option<Context> = None;
    let mut table = Table { out: std::io::stdout().lock(), json: args.json, rows: 0 };
    for (k, request) in requests.into_iter().enumerate() {
        let what = format!("`{}`: candidate {k} `{}`", args.candidates.display(), request.name);
        let trajectory = Trajectory::new(&format!("{what}: `trajectory`"), request.trajectory)?;
        let own;
        let ctx = match request.ego {
            Some(path) => {
                let ego = Some(ego_path(&what, &path)?);
                own = Context::new(&scene, &index, &ContextOptions { ego, ..options.clone() })?;
                &own
            }
            None => match &mut logged {
                Some(ctx) => &*ctx,
                slot => &*slot.insert(Context::new(&scene, &index, &options)?),
            },
        };
        let scores = Scorer::new(ctx)?.scores(&ctx.candidate(trajectory));
        table.row(&Row { name: &request.name, scores })?;
    }
    Ok(Outcome::Done)
}

/// Says on stderr who is who where the file does not.
fn announce(scene: &Scene) -> Result<()> {
    let adversary = scene.adversary()?;
    if scene.adversary_origin == AdversaryOrigin::Conflict {
        eprintln!(
            "note: the file names no single adversary; took `{}`, whose path conflicts most with the ego's",
            adversary.id
        );
    }
    if !adversary.is_valid(sage_core::motion::NOW) {
        eprintln!(
            "note: adversary `{}` is not seen at frame 10; its pose there is extrapolated from each candidate",
            adversary.id
        );
    }
    Ok(())
}

fn read_requests(path: &Path) -> Result<Vec<Request>> {
    /// Largest file of candidates, bytes: tens of thousands of trajectories.
    const LIMIT: u64 = 256 << 20;
    let name = path.display();
    let mut text = String::new();
    let read = match path.to_str() {
        Some("-") => std::io::stdin().take(LIMIT + 1).read_to_string(&mut text),
        _ => std::fs::File::open(path).and_then(|file| file.take(LIMIT + 1).read_to_string(&mut text)),
    };
    read.with_context(|| format!("cannot read `{name}`"))?;
    if text.len() as u64 > LIMIT {
        bail!("`{name}` holds more than {LIMIT} bytes; score it in parts");
    }
    serde_json::from_str(&text).with_context(|| {
        format!(r#"`{name}` is not a JSON list of {{"name", "trajectory": [[x, y] × {HORIZON}], "ego": optional}}"#)
    })
}

/// An ego path of positions, or of positions with headings; all rows of one sort.
fn ego_path(what: &str, rows: &[Vec<f64>]) -> Result<EgoPath> {
    let with_heading = rows.first().is_some_and(|row| row.len() == 3);
    let width = if with_heading { 3 } else { 2 };
    for (k, row) in rows.iter().enumerate() {
        if row.len() != width {
            bail!(
                "{what}: `ego` row {k} has {} numbers; expected [x, y] in every row, or [x, y, heading] in every row",
                row.len()
            );
        }
        if with_heading && row[2].abs() > 1e6 {
            bail!("{what}: `ego` row {k} has heading {}; expected radians", row[2]);
        }
    }
    let positions = rows.iter().map(|row| [row[0], row[1]]).collect();
    Ok(EgoPath {
        positions: Trajectory::new(&format!("{what}: `ego`"), positions)?,
        headings: with_heading.then(|| rows.iter().map(|row| row[2]).collect()),
    })
}

struct Table<W> {
    out: W,
    json: bool,
    rows: usize,
}

impl<W: Write> Table<W> {
    fn row(&mut self, row: &Row) -> Result<()> {
        if self.json {
            serde_json::to_writer(&mut self.out, row)?;
            writeln!(self.out)?;
            return Ok(());
        }
        if self.rows == 0 {
            writeln!(
                self.out,
                "{:<22} {:>6} {:>4} {:>7} {:>7} {:>4} {:>5} {:>8} {:>6} {:>5} {:>5} {:>6} {:>6} {:>5} {:>6} {:>6} {:>6}  broken rules",
                "candidate",
                "R_adv",
                "hit",
                "P_kin",
                "P_beh",
                "line",
                "crash",
                "feasible",
                "strict",
                "TTC",
                "PET",
                "decel",
                "impact",
                "side",
                "wd_v",
                "wd_a",
                "wd_yaw"
            )?;
        }
        self.rows += 1;
        let s = &row.scores;
        let number = |x: Option<f64>, digits: usize| x.map_or("-".to_owned(), |x| format!("{x:.digits$}"));
        let yes = |x: bool| if x { "yes" } else { "no" };
        let reasons: Vec<String> = s
            .reasons_strict
            .iter()
            .chain(s.reasons.iter().filter(|r| !s.reasons_strict.contains(r)))
            .map(|r| format!("{} {} at step {}", r.rule.words(), r.with, r.step))
            .collect();
        let line = format!(
            "{:<22} {:>6.3} {:>4} {:>7.3} {:>7.3} {:>4.0} {:>5.0} {:>8} {:>6} {:>5} {:>5} {:>6} {:>6} {:>5} {:>6} {:>6} {:>6}  {}",
            row.name,
            s.adversarial_reward,
            s.collision_step.map_or("-".to_owned(), |step| step.to_string()),
            s.kinematic_penalty,
            s.behavior_penalty,
            s.cross_line,
            s.crash_object,
            yes(s.feasible),
            yes(s.feasible_strict),
            number(s.criticality.time_to_collision, 2),
            number(s.criticality.post_encroachment_time, 1),
            number(s.criticality.required_deceleration, 1),
            number(s.criticality.impact_speed, 1),
            s.criticality.side_hit.map_or("-", |side| side.name()),
            number(s.distances.wd_speed, 2),
            number(s.distances.wd_acceleration, 2),
            number(s.distances.wd_yaw_rate, 3),
            reasons.join("; ")
        );
        writeln!(self.out, "{}", line.trim_end())?;
        Ok(())
    }
}
