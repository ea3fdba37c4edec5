//! Draws a scene from above.

use sage_core::{
    geometry::{Aabb, OrientedBox, Point},
    motion::NOW,
    scene::{Scene, Track},
};

use super::{
    legend, map_layer, palette as color,
    road_users::{self, Role},
    svg::Svg,
    tried::{self, Tried},
    viewport::Viewport,
};

/// Size of the drawn window, pixels.
const WINDOW: [f64; 2] = [900.0, 680.0];
/// Margin around ego, adversary and their trajectories, metres.
const MARGIN: f64 = 12.0;
/// Least width of the window, metres.
const LEAST: f64 = 70.0;

/// A candidate trajectory of the adversary.
pub struct DrawnPath {
    /// Name in the legend.
    pub name: String,
    /// Positions from *now* on.
    pub points: Vec<Point>,
    /// First contact: step, the ego's box, the adversary's box.
    pub contact: Option<(usize, OrientedBox, OrientedBox)>,
}

/// What to draw of a scene.
#[derive(Default)]
pub struct Picture {
    /// Title, usually the scene's name.
    pub title: String,
    /// Frame at which boxes are drawn; *now* if `None`.
    pub frame: Option<usize>,
    /// Candidates of the adversary; without any its logged trajectory is drawn.
    pub candidates: Vec<DrawnPath>,
    /// Plans of a search, in place of candidates.
    pub tried: Vec<Tried>,
    /// The ego's path, if it differs from the logged one.
    pub ego_path: Option<Vec<Point>>,
    /// The last evasive manoeuvre: the ego's positions from its start on, and the time of the start, seconds.
    pub evasion: Option<(f64, Vec<Point>)>,
    /// Boxes with a label, the first is that of the adversary.
    pub marks: Vec<(Vec<OrientedBox>, String)>,
    /// Draw the whole map instead of the surroundings of ego and adversary.
    pub whole_map: bool,
}

/// Draws a scene as SVG.
///
/// An attack on the recorded ego as a picture:
///
/// ```
/// use std::sync::Arc;
///
/// use sage_core::{
///     objective::{Context, ContextOptions},
///     scene::SceneIndex,
/// };
/// use sage_data::procedural::{Kind, attacks, generate};
/// use sage_view::drawing::{Picture, draw, drawn_path};
///
/// let scene = Arc::new(generate(Kind::FourWay, 1, 0).ok_or("no scene for this seed")?);
/// let ctx = Context::new(&scene, &SceneIndex::new(scene.map.clone()), &ContextOptions::default())?;
/// let paths = attacks(&scene).into_iter().take(2).map(|(name, plan)| drawn_path(name, &ctx, plan));
/// let picture = Picture { title: "<crossing>".to_owned(), candidates: paths.collect(), ..Picture::default() };
/// let svg = draw(&scene, &picture);
/// // Names are text, whatever they hold.
/// assert!(svg.starts_with("<svg") && svg.contains("&lt;crossing&gt;"));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn draw(scene: &Scene, picture: &Picture) -> String {
    let frame = picture.frame.unwrap_or(NOW).min(scene.frames - 1);
    let adversary = scene.adversary.map(|k| &scene.tracks[k]);
    let ego_path = picture.ego_path.clone().unwrap_or_else(|| road_users::logged_trajectory(scene.ego()));
    let adversary_log = adversary.map(road_users::logged_trajectory).unwrap_or_default();
    let mut area = road_users::bounds(&ego_path);
    let evasion = picture.evasion.iter().map(|(_, points)| points);
    let plans = picture.candidates.iter().map(|c| &c.points).chain(picture.tried.iter().map(|t| &t.points));
    for points in plans.chain([&adversary_log]).chain(evasion) {
        area = area.union(&road_users::bounds(points));
    }
    for track in [Some(scene.ego()), adversary].into_iter().flatten().filter(|t| t.is_valid(frame)) {
        area = area.union(&track.oriented_box(frame).aabb());
    }
    if picture.whole_map || area == Aabb::EMPTY {
        area = area.union(&Aabb::of(scene.map.points.iter().map(|p| [p[0], p[1]])));
    }
    if area == Aabb::EMPTY {
        area = Aabb::around([0.0, 0.0], LEAST);
    }
    let viewport = Viewport::on(&area, MARGIN, LEAST, WINDOW);

    let mut svg = Svg::default();
    svg.raw(&format!(
        r#"<defs><clipPath id="window"><rect width="{}" height="{}"/></clipPath>{}</defs>"#,
        viewport.width,
        viewport.height,
        map_layer::patterns(viewport.scale)
    ));
    svg.raw(r##"<rect width="100%" height="100%" fill="#fff"/>"##);
    svg.open(r#"clip-path="url(#window)""#);
    svg.rect([0.0, 0.0], [viewport.width, viewport.height], &format!(r#"fill="{}""#, color::GROUND));
    let map = map_layer::draw(&mut svg, &viewport, scene, frame);
    let users = road_users::background(&mut svg, &viewport, scene, frame);
    tried::draw(&mut svg, &viewport, &picture.tried);
    road_users::trajectory(&mut svg, &viewport, &ego_path, Role::Ego);
    if picture.candidates.is_empty() && picture.tried.is_empty() {
        road_users::trajectory(&mut svg, &viewport, &adversary_log, Role::Adversary);
    }
    if let Some((_, points)) = &picture.evasion {
        road_users::evasion(&mut svg, &viewport, points);
    }
    for candidate in &picture.candidates {
        road_users::trajectory(&mut svg, &viewport, &candidate.points, Role::Adversary);
    }
    let role = |svg: &mut Svg, track: &Track, role: Role| {
        if track.is_valid(frame) && role == Role::Adversary && track.kind.is_person() {
            road_users::person(svg, &viewport, &track.kind, &track.oriented_box(frame));
        } else if track.is_valid(frame) {
            road_users::role(svg, &viewport, &track.oriented_box(frame), role);
        }
    };
    if let Some(track) = adversary {
        role(&mut svg, track, Role::Adversary);
    }
    role(&mut svg, scene.ego(), Role::Ego);
    for (_, ego, adversary) in picture.candidates.iter().filter_map(|c| c.contact.as_ref()) {
        road_users::contact(&mut svg, &viewport, [ego, adversary]);
    }
    for (boxes, label) in &picture.marks {
        road_users::mark(&mut svg, &viewport, boxes, label);
    }
    for (number, candidate) in picture.candidates.iter().enumerate() {
        if let Some(end) = candidate.points.last() {
            road_users::glyph(&mut svg, viewport.pixel(*end), number);
        }
    }
    svg.close();
    svg.rect(
        [0.0, 0.0],
        [viewport.width, viewport.height],
        r##"fill="none" stroke="#999" stroke-width="1""##,
    );

    let names: Vec<(String, Option<usize>)> =
        picture.candidates.iter().map(|c| (c.name.clone(), c.contact.map(|(step, ..)| step))).collect();
    let content = legend::Content {
        title: &picture.title,
        subtitle: &format!("{}, frame {frame} ({:+.1} s)", scene.id, (frame as f64 - NOW as f64) / 10.0),
        ego: &scene.ego().id,
        adversary: adversary.map(|track| (&track.id[..], &track.kind)),
        candidates: &names,
        tried: &picture.tried,
        evasion: picture.evasion.as_ref().map(|(start, _)| *start),
        has_contact: picture.candidates.iter().any(|c| c.contact.is_some()),
        map: &map,
        users: &users,
    };
    let height = legend::draw(&mut svg, &viewport, viewport.width + 16.0, &content);
    svg.finish([viewport.width + legend::WIDTH + 30.0, height], &format!("Scene {}", picture.title))
}
