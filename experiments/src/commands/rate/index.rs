//! The page of a rate: its tables, and the scenes ordered by how likely the drivers fail in them.

use std::fmt::Write as _;

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
<p>The probability of each event, if the adversary moves as an untuned motion prior says from what is recorded up to <i>now</i>. It is no accident rate: nothing is per kilometre, and the scenes are chosen.</p>
";
const BLIND: &str = "<p>This traffic does not look out, so it meets drivers more often than people do.</p>\n";
const AWARE: &str =
    "<p>The adversary looks out once, <i>now</i>: it never sees what the driver does then.</p>\n";

/// Writes the page.
///
/// *Errors*: the folder cannot be written to.
pub(super) fn write<'r>(
    folder: &Folder,
    (given, is_aware): (Given, bool),
    tables: &[Table],
    rows: impl Iterator<Item = &'r RateRow>,
) -> Result<()> {
    let mut page = HEAD.to_owned() + if is_aware { AWARE } else { BLIND };
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
    let failing = |row: &RateRow| row.rate(given, "failure").map_or(-1.0, |rate| rate.rate);
    // The order of equal rates is that of the scenes.
    rows.sort_by(|a, b| failing(b).total_cmp(&failing(a)));
    writeln!(page, "<h2>Scenes, the likeliest failures first</h2>")?;
    for row in rows {
        figure(&mut page, row)?;
    }
    page.push_str("</html>\n");
    Ok(folder.write(FILE, page.as_bytes())?)
}

/// The picture of a row, with what it says and where its likeliest failure is played.
fn figure(page: &mut String, row: &RateRow) -> Result<()> {
    let Some(picture) = row.files.first() else { return Ok(()) };
    let file = picture.replace(".svg", ".json");
    let played = row.files.iter().find(|file| file.ends_with(".html"));
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
            "; the <a href=\"{}\">likeliest failure</a> has {:.2} %",
            link(played.unwrap_or(&file)),
            100.0 * likeliest.probability,
        )?;
    }
    page.push_str("</figcaption></figure>\n");
    Ok(())
}
