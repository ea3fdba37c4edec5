//! The training curves: a table of parts of the training, and a picture.

use anyhow::Result;
use sage_bench::{
    chart::line::{self, Line},
    csv_text::of_table,
    estimate,
};
use sage_core::{statistics::Estimate, text::table::Table};
use sage_run::output::Folder;

use super::training::{Ended, Losses};

/// File of the table.
pub(super) const TABLE: &str = "curves.csv";
/// File of the picture.
pub(super) const PICTURE: &str = "success.svg";
const HEADS: [&str; 8] =
    ["decision", "scenes", "goal_reached", "contact", "distance", "reward", "critic_loss", "mean_abs_q"];
/// Parts of a training that are compared: the last with the first.
const FIFTHS: u64 = 5;

/// One part of the training: the scenes that began in it.
struct Part {
    decision: u64,
    ended: Vec<Ended>,
    losses: Losses,
}

fn parts(ended: &[Ended], losses: &[Losses]) -> Vec<Part> {
    let mut before = 0;
    let part = |losses: &Losses| {
        let (from, to) = (before, losses.decision);
        before = to;
        let ended = ended.iter().filter(|one| from < one.began && one.began <= to).cloned().collect();
        Part { decision: to, ended, losses: *losses }
    };
    losses.iter().map(part).collect()
}

/// Writes table and picture.
///
/// *Errors*: the folder cannot be written to.
pub(super) fn write(ended: &[Ended], losses: &[Losses], folder: &Folder) -> Result<()> {
    let mut table = Table::new("", &HEADS);
    let [mut goal, mut contact] = [Vec::new(), Vec::new()];
    for part in parts(ended, losses) {
        let count = part.ended.len();
        let mean = |of: &dyn Fn(&Ended) -> f64| part.ended.iter().map(of).sum::<f64>() / count as f64;
        let shares =
            [mean(&|one| f64::from(u8::from(one.is_done))), mean(&|one| f64::from(u8::from(one.is_hit)))];
        let Losses { critic, mean_abs_q, .. } = part.losses;
        let cells = [
            count as f64,
            shares[0],
            shares[1],
            mean(&|one| one.distance),
            mean(&|one| one.reward),
            critic,
            mean_abs_q,
        ];
        table.row(
            part.decision.to_string(),
            cells.map(|x| if x.is_finite() { x.to_string() } else { String::new() }),
        );
        if count > 0 {
            for (line, share) in [&mut goal, &mut contact].into_iter().zip(shares) {
                line.push([part.decision as f64, 100.0 * share]);
            }
        }
    }
    folder.write(TABLE, of_table(&table).as_bytes())?;
    let lines: Vec<Line> = vec![("goal reached".to_owned(), goal), ("contact".to_owned(), contact)];
    let picture = line::draw(["decision", "share of scenes, %"], lines)?;
    Ok(folder.write(PICTURE, picture.as_bytes())?)
}

/// Shares of scenes that reached the goal in the first and in the last fifth of the training, and their difference; intervals
/// over scenes, each with all its ends.
pub(super) fn success(ended: &[Ended], decisions: u64, scenes: usize) -> [Option<Estimate>; 3] {
    let mut counts = vec![[[0.0; 2]; 2]; scenes];
    for one in ended {
        let fifth = (one.began.saturating_sub(1) * FIFTHS / decisions.max(1)).min(FIFTHS - 1);
        let part = match fifth {
            0 => 0,
            fifth if fifth == FIFTHS - 1 => 1,
            _ => continue,
        };
        let [ends, successes] = &mut counts[one.scene][part];
        *ends += 1.0;
        *successes += f64::from(u8::from(one.is_done));
    }
    let share = |drawn: &[usize], part: usize| {
        let sum = |k: usize| drawn.iter().map(|scene| counts[*scene][part][k]).sum::<f64>();
        sum(1) / sum(0).max(1.0)
    };
    [
        estimate::of_scenes(scenes, "first fifth", |drawn| share(drawn, 0)),
        estimate::of_scenes(scenes, "last fifth", |drawn| share(drawn, 1)),
        estimate::of_scenes(scenes, "last less first fifth", |drawn| share(drawn, 1) - share(drawn, 0)),
    ]
}
