//! Pictures of an open-loop run, and an HTML page that shows them.

use std::{collections::HashSet, fmt::Write as _, path::Path};

use anyhow::Result;
use sage_core::{
    objective::{CollisionType, Context, ContextOptions, verdict},
    scene::SceneData,
};

use super::{
    open_loop::{SceneRow, is_believable},
    open_loop_report::{Table, seconds},
};
use crate::{
    drawing::{self, Picture, drawn_path},
    output::{self, Folder},
    scenes::Scenes,
    terminal::escaped_html as escaped,
};

/// Writes the strongest believable attacks of each generator and operating point as SVG, some that failed, and
/// `index.html` with the tables of the run, the pictures and the reasons. The page opens from disk. `table` is
/// of the recorded ego; without it there are no pictures.
///
/// *Errors*: the folder cannot be written to.
pub(crate) fn write(folder: &Folder, scenes: &Scenes, table: Option<&Table>, markdown: &str) -> Result<()> {
    let rows = table.map_or(&[][..], |table| &table.rows);
    let cases: Vec<_> = rows.iter().map(|(.., rows)| cases(rows)).collect();
    let shown: HashSet<&str> = cases.iter().flatten().map(|(_, row)| &row.scene[..]).collect();
    let scenes = scenes.by_name(&shown);
    let mut cards = String::new();
    for (k, (key, _, rows)) in rows.iter().enumerate() {
        let method = &key.label();
        writeln!(cards, "<h2>{}</h2>", escaped(method))?;
        writeln!(
            cards,
            "<p>{:.1} ms a scene (median, while all threads process scenes)</p><div class=row>",
            1e3 * seconds(rows)
        )?;
        for (which, row) in &cases[k] {
            let Some(data) = scenes.get(&row.scene) else { continue };
            let name = format!("{k:02}-{which}.svg");
            folder.write(&name, picture(data, method, row)?.as_bytes())?;
            writeln!(
                cards,
                "<figure><a href=\"{name}\"><img src=\"{name}\" loading=lazy></a><figcaption>{which}: {}, {}</figcaption></figure>",
                escaped(stem(&row.scene)),
                escaped(&caption(row)),
            )?;
        }
        writeln!(cards, "</div>")?;
    }
    let page = format!(
        "<!doctype html><meta charset=utf-8><title>sage bench open-loop</title>\n<style>{STYLE}</style>\n<h1>sage bench open-loop</h1>\n<p><code>{}</code></p>\n{}{cards}",
        escaped(&output::command()),
        html_tables(markdown)?,
    );
    folder.write("index.html", page.as_bytes())
}

/// Pictures of believable attacks, and of failed ones.
const SHOWN: usize = 3;
const STYLE: &str = "body{font:15px sans-serif;margin:2em}table{border-collapse:collapse;font-size:12px;display:block;overflow-x:auto}td,th{border:1px solid #ccc;padding:2px 6px;white-space:nowrap}.row{display:flex;flex-wrap:wrap;gap:1em}figure{margin:0}img{width:560px;border:1px solid #ddd}";

/// The strongest believable attacks, and of the other rows those closest to one: first attacks that are not
/// believable, then trajectories without contact.
fn cases(rows: &[SceneRow]) -> Vec<(String, &SceneRow)> {
    let (mut attacks, mut failed): (Vec<&SceneRow>, Vec<&SceneRow>) =
        rows.iter().partition(|row| is_believable(row));
    let strength = |row: &SceneRow| row.paper.adversarial_reward;
    attacks.sort_by(|a, b| strength(b).total_cmp(&strength(a)));
    failed
        .sort_by(|a, b| b.paper.collision.cmp(&a.paper.collision).then(strength(b).total_cmp(&strength(a))));
    first("strongest", attacks).into_iter().chain(first("failed", failed)).collect()
}

/// The first rows under names with a number.
fn first<'r>(name: &str, rows: Vec<&'r SceneRow>) -> Vec<(String, &'r SceneRow)> {
    rows.into_iter().take(SHOWN).enumerate().map(|(k, row)| (format!("{name}-{}", k + 1), row)).collect()
}

/// What a row shows: the verdict with its reasons, and the kind and strength of a believable attack.
fn caption(row: &SceneRow) -> String {
    let kind = row.collision_type.map_or("contact", CollisionType::name);
    let verdict = verdict(row.paper.believable, &row.paper.unbelievable);
    let verdict = verdict.unwrap_or_else(|| "no contact".to_owned());
    let strength = if is_believable(row) {
        format!(", {kind}, R_adv {:.2}", row.paper.adversarial_reward)
    } else {
        String::new()
    };
    let note = row.note.as_ref().map_or(String::new(), |note| format!("; {note}"));
    format!("{verdict}{strength}{note}")
}

fn picture(data: &SceneData, method: &str, row: &SceneRow) -> Result<String> {
    let ctx = Context::new(&data.scene, &data.index, &ContextOptions::default())?;
    let drawn = drawn_path(method.to_owned(), &ctx, row.trajectory.clone());
    let title = stem(&row.scene).to_owned();
    Ok(drawing::draw(&data.scene, &Picture { title, candidates: vec![drawn], ..Picture::default() }))
}

fn stem(scene: &str) -> &str {
    Path::new(scene).file_stem().and_then(|stem| stem.to_str()).unwrap_or(scene)
}

/// The tables and lines of a report as HTML.
fn html_tables(markdown: &str) -> Result<String> {
    let mut out = String::new();
    let mut inside = false;
    for line in markdown.lines() {
        let is_row = line.starts_with('|');
        if is_row != inside {
            writeln!(out, "{}", if is_row { "<table>" } else { "</table>" })?;
            inside = is_row;
        }
        if is_row && !line.starts_with("| ---") {
            let cells =
                line.trim_matches('|').split('|').map(|cell| format!("<td>{}</td>", escaped(cell.trim())));
            writeln!(out, "<tr>{}</tr>", cells.collect::<String>())?;
        } else if !is_row && !line.is_empty() {
            writeln!(out, "<p>{}</p>", escaped(line))?;
        }
    }
    if inside {
        writeln!(out, "</table>")?;
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_becomes_html_and_names_cannot_break_out_of_it() {
        let html = html_tables("Text <b>\n\n| a | b |\n| --- | --- |\n| <x> | 2 |\n").unwrap();
        assert!(html.contains("<p>Text &lt;b&gt;</p>") && html.contains("<td>&lt;x&gt;</td><td>2</td>"));
        assert_eq!((html.matches("<table>").count(), html.matches("</table>").count()), (1, 1));
    }
}
