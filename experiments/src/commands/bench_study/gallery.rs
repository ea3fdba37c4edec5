//! Pictures of the attacks of a study, and an HTML page that shows them with its tables.

use std::fmt::Write as _;

use anyhow::{Context as _, Result};
use sage_bench::{
    plan::Plan,
    report::Report,
    rows::{Results, Subject},
    table::Table,
};
use sage_core::{
    objective::{Context, ContextOptions, Scorer, verdict},
    scene::SceneData,
};

use super::ChosenScenes;
use crate::{
    drawing::{self, Picture, drawn_path},
    output::{self, Folder},
    terminal::escaped_html as escaped,
};
use sage_bench::runner::SceneSource as _;

/// Pictures of believable attacks, and of failed ones.
const SHOWN: usize = 3;
const STYLE: &str = "body{font:15px sans-serif;margin:2em}table{border-collapse:collapse;font-size:12px;display:block;overflow-x:auto}td,th{border:1px solid #ccc;padding:2px 6px;white-space:nowrap}.row{display:flex;flex-wrap:wrap;gap:1em}figure{margin:0}img{width:560px;border:1px solid #ddd}";

/// Writes the strongest believable attacks of each method as SVG, some that failed, and `index.html` with the tables and
/// the pictures. The page opens from disk. Pictures are of the recorded ego.
///
/// *Errors*: the folder cannot be written to; a scene can no longer be read.
pub(super) fn write(
    folder: &Folder,
    plan: &Plan,
    scenes: &ChosenScenes,
    results: &Results,
    report: &Report,
) -> Result<()> {
    let mut cards = String::new();
    for (k, method) in results.methods(Subject::Trajectory).into_iter().enumerate() {
        let label = results.keys[method].attack_label();
        writeln!(cards, "<h2>{}</h2><div class=row>", escaped(&label))?;
        for (which, scene) in cases(results, method)? {
            let name = &results.scenes[scene];
            let number =
                scenes.names().iter().position(|known| known == name).context("the scene was measured")?;
            let Some(data) = scenes.load(number)? else { continue };
            let Some((svg, caption)) = picture(plan, method, &data, name, &label)? else { continue };
            let file = format!("{k:02}-{which}.svg");
            folder.write(&file, svg.as_bytes())?;
            writeln!(
                cards,
                "<figure><a href=\"{file}\"><img src=\"{file}\" loading=lazy></a><figcaption>{which}: {}, {}</figcaption></figure>",
                escaped(name),
                escaped(&caption),
            )?;
        }
        writeln!(cards, "</div>")?;
    }
    let title = escaped(&format!("sage bench {}", plan.study.study));
    let tables: String = report.tables.iter().map(html).collect();
    let page = format!(
        "<!doctype html><meta charset=utf-8><title>{title}</title>\n<style>{STYLE}</style>\n<h1>{title}</h1>\n<p><code>{}</code></p>\n{tables}<p>{}</p>{cards}",
        escaped(&output::command()),
        escaped(&report.notes),
    );
    folder.write("index.html", page.as_bytes())
}

/// The strongest believable attacks, and of the other scenes those closest to one: first attacks that are not
/// believable, then trajectories without contact.
fn cases(results: &Results, method: usize) -> Result<Vec<(String, usize)>> {
    let metric = |name: &str| {
        let number = results.metric(Subject::Trajectory, name);
        number.with_context(|| format!("pictures need the metric `{name}`"))
    };
    let [believable, contact, strength] =
        [metric("believable")?, metric("attack, feasible or not")?, metric("R_adv")?];
    let value = |scene: usize, metric: usize| {
        let cell = results.cells[scene].iter().find(|cell| cell.key == method);
        cell.and_then(|cell| *cell.values.get(metric)?)
    };
    let measured = (0..results.scenes.len()).filter(|scene| value(*scene, strength).is_some());
    let (mut attacks, mut failed): (Vec<usize>, Vec<usize>) =
        measured.partition(|scene| value(*scene, believable) == Some(1.0));
    let number = |scene: usize, metric: usize| value(scene, metric).unwrap_or(f64::NEG_INFINITY);
    attacks.sort_by(|a, b| number(*b, strength).total_cmp(&number(*a, strength)));
    failed.sort_by(|a, b| {
        let by = |metric| number(*b, metric).total_cmp(&number(*a, metric));
        by(contact).then(by(strength))
    });
    let first = |name: &str, scenes: Vec<usize>| {
        let named = scenes.into_iter().take(SHOWN).enumerate();
        named.map(|(k, scene)| (format!("{name}-{}", k + 1), scene)).collect::<Vec<_>>()
    };
    Ok([first("strongest", attacks), first("failed", failed)].concat())
}

/// The picture of an attack, and its verdict with the reasons.
fn picture(
    plan: &Plan,
    method: usize,
    data: &SceneData,
    name: &str,
    label: &str,
) -> Result<Option<(String, String)>> {
    let Some(attack) = plan.attack(method, data)? else { return Ok(None) };
    let ctx = Context::new(&data.scene, &data.index, &ContextOptions::default())?;
    let trajectory = attack.trajectory().clone();
    let scores = Scorer::new(&ctx).scores(&ctx.candidate(trajectory.clone()));
    let words = verdict(scores.believable, &scores.unbelievable).unwrap_or_else(|| "no contact".to_owned());
    let note = attack.note.as_ref().map_or(String::new(), |note| format!("; {note}"));
    let caption = format!("{words}, R_adv {:.2}{note}", scores.adversarial_reward);
    let drawn = drawn_path(label.to_owned(), &ctx, trajectory);
    let picture = Picture { title: name.to_owned(), candidates: vec![drawn], ..Picture::default() };
    Ok(Some((drawing::draw(&data.scene, &picture), caption)))
}

/// A table as HTML.
fn html(table: &Table) -> String {
    let row = |cells: &[String], tag: &str| {
        let cells: String = cells.iter().map(|cell| format!("<{tag}>{}</{tag}>", escaped(cell))).collect();
        format!("<tr>{cells}</tr>\n")
    };
    let rows: String = table.rows.iter().map(|cells| row(cells, "td")).collect();
    format!("<p>{}</p>\n<table>\n{}{rows}</table>\n", escaped(&table.title), row(&table.heads, "th"))
}
