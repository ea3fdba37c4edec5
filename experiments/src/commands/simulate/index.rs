//! The page that lists all scenes of a run.

use std::fmt::Write as _;

use advsage::rows::drive::DriveRow;
use anyhow::Result;
use sage_run::{output::Folder, progress::count, scene_queue::Input, terminal::escaped_html as escaped};
use sage_view::html_page::link;

use super::{Job, scene::page_file};

/// Name of the page.
pub(super) const FILE: &str = "index.html";

const HEAD: &str = "<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport content=\"width=device-width\"><title>sage simulate</title>
<style>body{font:14px/1.4 system-ui,sans-serif;margin:1.5em;color:#222}table{border-collapse:collapse}td,th{border-bottom:1px solid #ddd;padding:3px 10px;overflow-wrap:anywhere;text-align:left;vertical-align:top}th{position:sticky;top:0;background:#fff;white-space:nowrap}.hit{color:#b00020;font-weight:600}@media(max-width:640px){body{margin:.6em}td,th{padding:3px 4px}}</style>
<h1>Drives</h1>
";

/// Writes the page, if there is more than one scene. A scene without results has failed.
///
/// *Errors*: the folder cannot be written to.
pub(super) fn write(folder: &Folder, simulation: &Job, inputs: &[Input], run_hash: &str) -> Result<()> {
    if inputs.len() < 2 {
        return Ok(());
    }
    let (mut drives, mut hits, mut table) = (0, 0, String::new());
    let has_attack = inputs.iter().any(|input| simulation.files(&input.scene).any(|(_, v, _)| !v.is_empty()));
    for input in inputs {
        let mut is_first = true;
        for (ego, variant, file) in simulation.files(&input.scene) {
            let row = DriveRow::read(&folder.path().join(&file)).filter(|row| row.run_hash == run_hash);
            let Some(row) = row else { continue };
            let name = if std::mem::take(&mut is_first) {
                format!("<a href=\"{}\">{}</a>", link(&page_file(&input.scene)), escaped(&input.scene))
            } else {
                String::new()
            };
            let is_hit = row.verdict().map_or(!row.contacts.is_empty(), |verdict| verdict.is_attack);
            (drives, hits) = (drives + 1, hits + usize::from(is_hit));
            let class = if is_hit { " class=hit" } else { "" };
            let (ego, ending) = (escaped(&simulation.egos[ego].label), escaped(&row.ending()));
            let attack = if has_attack { format!("<td>{}", escaped(variant)) } else { String::new() };
            writeln!(table, "<tr><td>{name}<td>{ego}{attack}<td{class}>{ending}</tr>")?;
        }
        if is_first {
            let attack = if has_attack { "<td>" } else { "" };
            writeln!(table, "<tr><td>{}<td>{attack}<td>failed</tr>", escaped(&input.scene))?;
        }
    }
    let (of, what) = (count(drives, "drive"), if has_attack { "an attack" } else { "a contact" });
    let head = if has_attack { "<th>attack" } else { "" };
    let page = format!(
        "{HEAD}<p>{}; {} of {of} with {what}</p>\n<table><tr><th>scene<th>driver{head}<th>result</tr>\n{table}</table></html>\n",
        escaped(&simulation.subtitle),
        hits
    );
    Ok(folder.write(FILE, page.as_bytes())?)
}
