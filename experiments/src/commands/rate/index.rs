//! The page of a rate: its tables, and the scenes ordered by how likely the drivers fail in them.

use std::{fmt::Write as _, path::Path};

use advsage::rows::rate::RateRow;
use anyhow::Result;
use sage_core::text::table::Table;
use sage_run::{output::Folder, terminal::escaped_html as escaped};
use sage_sim::rate::Given;
use sage_view::html_page::link;

/// Name of the page.
pub(super) const FILE: &str = "index.html";

const HEAD: &str = "<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport content=\"width=device-width\"><title>sage rate</title>
<style>body{font:14px/1.4 system-ui,sans-serif;margin:1.5em;color:#222}p{max-width:60em}table{border-collapse:collapse}td,th{border-bottom:1px solid #ddd;padding:3px 10px;text-align:left}div.table{overflow-x:auto}figure{display:inline-block;vertical-align:top;width:34em;max-width:100%;margin:1em 1em 0 0}img{width:100%}figcaption{overflow-wrap:anywhere}@media(max-width:640px){body{margin:.6em}td,th{padding:3px 4px}}</style>
<h1>How likely drivers fail</h1>
<p>The probability of each event, if the adversary moves as an untuned motion prior says from what is recorded up to <i>now</i>. It is no accident rate: nothing is per kilometre, and the scenes are chosen. This traffic does not look out, so it meets drivers more often than people do.</p>
";

/// Writes the page.
///
/// *Errors*: the folder cannot be written to.
pub(super) fn write<'r>(
    folder: &Folder,
    scenes: &Path,
    tables: &[Table],
    rows: impl Iterator<Item = &'r RateRow>,
) -> Result<()> {
    let mut page = HEAD.to_owned();
    for table in tables {
        writeln!(
            page,
            "<h2>{}</h2><div class=table><table><tr>",
            escaped(table.title.trim_end_matches(':'))
        )?;
        let cells = |page: &mut String, tag: &str, cells: &[String]| {
            cells.iter().try_for_each(|cell| write!(page, "<{tag}>{}", escaped(cell)))
        };
        cells(&mut page, "th", &table.heads)?;
        for row in &table.rows {
            page.push_str("<tr>");
            cells(&mut page, "td", row)?;
        }
        page.push_str("</table></div>\n");
    }
    let mut rows: Vec<&RateRow> = rows.collect();
    let failing = |row: &RateRow| row.rate(Given::ALL[0], "failure").map_or(-1.0, |rate| rate.rate);
    // The order of equal rates is that of the scenes.
    rows.sort_by(|a, b| failing(b).total_cmp(&failing(a)));
    writeln!(page, "<h2>Scenes, the likeliest failures first</h2>")?;
    for row in rows {
        figure(&mut page, scenes, row)?;
    }
    page.push_str("</html>\n");
    Ok(folder.write(FILE, page.as_bytes())?)
}

/// The picture of a row, with what it says and how to watch its likeliest failure.
fn figure(page: &mut String, scenes: &Path, row: &RateRow) -> Result<()> {
    let Some(picture) = row.files.first() else { return Ok(()) };
    let file = picture.replace(".svg", ".json");
    writeln!(
        page,
        "<figure><a href=\"{0}\"><img loading=lazy src=\"{0}\" alt=\"\"></a><figcaption>{1} (<a href=\"{2}\">row</a>)",
        link(picture),
        escaped(&row.line()),
        link(&file),
    )?;
    if let Some(likeliest) = &row.likeliest {
        writeln!(
            page,
            "; the likeliest failure has {:.2} %: <code>sage simulate SCENE --ego {} --attack {} --out watch/</code>, with the scene <code>{}</code> of <code>{}</code>",
            100.0 * likeliest.probability,
            escaped(&row.head.ego),
            escaped(&file),
            escaped(&row.head.scene),
            escaped(&scenes.display().to_string()),
        )?;
    }
    page.push_str("</figcaption></figure>\n");
    Ok(())
}
