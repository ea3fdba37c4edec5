//! A self-contained HTML page that lists results as cards: thumbnails, filters, bars, and links to the pages of scenes.

pub mod car;
pub mod road;

use serde::Serialize;
use serde_json::Result;

use crate::html_page::{self, PageParts};
use road::RoadLine;

const PAGE: &str = include_str!("listing/page.html");
const STYLE: &str = include_str!("listing/style.css");
const SCRIPTS: [&str; 5] = [
    include_str!("listing/data.js"),
    include_str!("listing/thumbnails.js"),
    include_str!("player/burst.js"),
    include_str!("listing/variants.js"),
    include_str!("listing/list.js"),
];

/// A scene on the page.
#[derive(Serialize)]
pub struct ListedScene<'a> {
    /// Name of the scene.
    pub name: &'a str,
    /// Lines of its map around what the thumbnails show.
    pub road: Vec<RoadLine>,
}

/// The page. `fields` is the script that says what its items hold; the data has `title`, `subtitle`, `scenes` and `items`.
///
/// *Errors*: data that JSON cannot hold.
pub fn page(title: &str, fields: &str, data: &impl Serialize) -> Result<String> {
    let [shared @ .., list] = SCRIPTS;
    let script = [&shared[..], &[fields, list]].concat().join("\n");
    let data = html_page::embedded(data)?;
    html_page::assembled(PageParts { body: PAGE, style: STYLE, script: &script, title, data: &data })
}
