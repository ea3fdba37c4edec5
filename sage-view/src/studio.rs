//! The page of `sage studio`: the player with settings beside it, whose scenes and drives come from a server.

mod thumbnail;

use sage_core::{
    geometry::{Aabb, Point},
    motion::NOW,
    scene::Scene,
    text::escaped_name,
};
use sage_sim::episode::LAST_FRAME;
use serde::Serialize;
use serde_json::Result;

use crate::{
    html_page::{self, PageParts},
    player::{EncodedBody, EncodedPanel, PAGE, PLAYER, Panel, STYLE, encoded, encoded_track, is_in, map},
};

pub use thumbnail::thumbnail;

/// Reach of the map around ego and adversary, and the largest error of its lines, metres.
const REACH: f64 = 150.0;
const ERROR: f64 = 0.1;

const SETTINGS: &str = include_str!("studio/settings.html");
const SETTINGS_STYLE: &str = include_str!("studio/settings.css");
const SCRIPT: &str = concat!(
    include_str!("studio/server.js"),
    include_str!("studio/scenes.js"),
    include_str!("studio/map.js"),
    include_str!("studio/finding.js"),
    include_str!("studio/link.js"),
    include_str!("studio/settings.js"),
);

/// A scene without drives.
#[derive(Serialize)]
pub struct ShownScene<'a> {
    title: &'a str,
    subtitle: &'a str,
    now: usize,
    frames: usize,
    columns: usize,
    /// Where the page counts from, metres in the scene's frame.
    origin: Point,
    map: Vec<map::EncodedFeature>,
    /// All road users but the ego that come near.
    traffic: Vec<EncodedBody>,
    /// Ids of `traffic`.
    ids: Vec<&'a str>,
    paths: [(); 0],
    panels: [(); 0],
}

impl<'a> ShownScene<'a> {
    /// The scene around its ego.
    pub fn of(scene: &'a Scene, title: &'a str) -> Self {
        let ego = scene.ego();
        let origin = ego.point(0);
        let driven = Aabb::of((0..ego.valid.len()).filter(|k| ego.is_valid(*k)).map(|k| ego.point(k)));
        let area = Aabb { min: driven.min.map(|x| x - REACH), max: driven.max.map(|x| x + REACH) };
        let others =
            scene.tracks.iter().enumerate().filter(|(k, track)| *k != scene.ego && is_in(track, &area));
        let (ids, traffic) =
            others.filter_map(|(_, track)| Some((&*track.id, encoded_track(track, origin)?))).unzip();
        Self {
            title,
            subtitle: "",
            now: NOW,
            frames: LAST_FRAME + 1,
            columns: 2,
            origin,
            map: map::encoded(scene, &area, ERROR, origin),
            traffic,
            ids,
            paths: [],
            panels: [],
        }
    }
}

/// Drives of a scene that the page has.
#[derive(Serialize)]
pub struct ShownDrives<'a> {
    panels: Vec<EncodedPanel<'a>>,
}

impl<'a> ShownDrives<'a> {
    /// The drives.
    pub fn of(scene: &Scene, panels: &'a [Panel<'a>]) -> Self {
        let origin = scene.ego().point(0);
        Self { panels: panels.iter().map(|panel| encoded(panel, scene, origin)).collect() }
    }
}

/// The page, which holds no scene: it asks for all. `nonce` is that of the header `Content-Security-Policy` it is served with.
///
/// *Errors*: a template without the places for title and data.
pub fn page(title: &str, nonce: &str) -> Result<String> {
    let body = PAGE.replacen("<body>", SETTINGS, 1) + "</div>\n";
    let (style, script) = ([STYLE, SETTINGS_STYLE].concat(), [PLAYER, SCRIPT].concat());
    let title = &*escaped_name(title);
    let page =
        html_page::assembled(PageParts { body: &body, style: &style, script: &script, title, data: "null" })?;
    // Other pages may ask nobody.
    let page = page.replacen("default-src 'none';", "default-src 'none'; connect-src 'self';", 1);
    let page = page.replacen("<style>", &format!("<style nonce=\"{nonce}\">"), 1);
    Ok(page.replacen("\n<script>", &format!("\n<script nonce=\"{nonce}\">"), 1))
}

#[cfg(test)]
mod tests {
    #[test]
    fn the_page_has_one_style_and_one_script_with_the_nonce() {
        let page = super::page("<b>", "n0").unwrap();
        assert_eq!(page.matches("nonce=\"n0\"").count(), 2);
        assert_eq!((page.matches("<style").count(), page.matches("<script").count()), (1, 2));
        assert!(page.contains("connect-src 'self'") && !page.contains("<b>"));
    }
}
