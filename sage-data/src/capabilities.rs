//! What a scene can be asked: formats and data sets differ in what they record.

use sage_core::scene::{MapKind, Scene};
use serde::Serialize;

use crate::repairs::Repair;

/// What the map and the road users of a scene have. Where something is missing, what needs it is not measured: off road
/// without edges, red lights without lights, speeding without limits.
///
/// ```
/// use sage_data::{Capabilities, procedural};
///
/// let scene = procedural::generate(procedural::Kind::Straight, 1, 0).ok_or("no scene for this seed")?;
/// let has = Capabilities::of(&scene);
/// // Leaving the road can be measured here, running over red cannot.
/// assert!(has.edges && !has.lights);
/// assert!(has.to_string().contains("not recorded: "));
/// # Ok::<(), &str>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Capabilities {
    /// Road edges other than medians.
    pub edges: bool,
    /// Medians.
    pub medians: bool,
    /// Traffic lights.
    pub lights: bool,
    /// A speed limit of any lane.
    pub speed_limits: bool,
    /// Heights, of the map or of road users.
    pub heights: bool,
    /// Sizes of all road users; else some are assumed by their type.
    pub sizes: bool,
}

impl Capabilities {
    /// Those of a scene.
    pub fn of(scene: &Scene) -> Self {
        let map = &scene.map;
        let any = |is: fn(&MapKind) -> bool| map.features.iter().any(|feature| is(&feature.kind));
        let limit = |lane: &sage_core::scene::Lane| lane.speed_limit.is_some();
        let is_high = |point: &[f64; 3]| point[2] != 0.0;
        let tracks = scene.tracks.iter();
        let mut valid = tracks
            .flat_map(|track| track.position.iter().zip(&track.valid).filter(|(_, valid)| **valid))
            .map(|(position, _)| position);
        Self {
            edges: any(MapKind::is_boundary),
            medians: any(|kind| matches!(kind, MapKind::EdgeMedian)),
            lights: !scene.lights.is_empty(),
            speed_limits: map.features.iter().filter_map(|feature| feature.lane.as_deref()).any(limit),
            heights: map.points.iter().any(is_high) || valid.any(is_high),
            sizes: !scene.notes.iter().any(|note| note.repair() == Some(Repair::NoSize)),
        }
    }

    /// Names, and whether the scene has them.
    pub fn by_name(&self) -> [(&'static str, bool); 6] {
        let Self { edges, medians, lights, speed_limits, heights, sizes } = *self;
        [
            ("edges", edges),
            ("medians", medians),
            ("lights", lights),
            ("speed limits", speed_limits),
            ("heights", heights),
            ("sizes", sizes),
        ]
    }
}

impl std::fmt::Display for Capabilities {
    /// Such as `has edges, sizes; not recorded: medians, lights, speed limits, heights`.
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        let names = |is: bool| {
            let all = self.by_name().into_iter().filter(move |(_, has)| *has == is).map(|(name, _)| name);
            all.collect::<Vec<_>>().join(", ")
        };
        let (has, lacks) = (names(true), names(false));
        write!(f, "has {}", if has.is_empty() { "none of what is optional" } else { &has })?;
        if lacks.is_empty() { Ok(()) } else { write!(f, "; not recorded: {lacks}") }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::procedural::{Kind, generate};

    #[test]
    fn a_scene_says_what_it_lacks() {
        let mut scene = generate(Kind::FourWay, 0, 0).unwrap();
        scene.notes.push(Repair::NoSize.note("1 track"));
        let found = Capabilities::of(&scene);
        assert!(found.edges && !found.lights && !found.sizes, "{found:?}");
        assert!(found.to_string().ends_with("not recorded: medians, lights, sizes"), "{found}");
    }
}
