//! Colours that differ in print and for colour-blind readers: blue and orange, also of different
//! lightness. Time runs from light to dark.

/// Ground beside the road.
pub(super) const GROUND: &str = "#eceae3";
/// Road surface.
pub(super) const ASPHALT: &str = "#d3d7dc";
/// Surface of bike lanes.
pub(super) const BIKE_LANE: &str = "#c3dccd";
/// Driveways.
pub(super) const DRIVEWAY: &str = "#ddd3c0";
/// White paint, crosswalks.
pub(super) const WHITE_PAINT: &str = "#ffffff";
/// Yellow paint.
pub(super) const YELLOW_PAINT: &str = "#d9a300";
/// Boundaries of the road.
pub(super) const EDGE: &str = "#4d4d4d";
/// Sidewalks: areas beside the road.
pub(super) const SIDEWALK: &str = "#cbb9a4";
/// Medians.
pub(super) const MEDIAN: &str = "#8a6d4b";
/// Direction of lanes.
pub(super) const CHEVRON: &str = "#a9b1bb";
/// Text and outlines.
pub(super) const INK: &str = "#222222";
/// The car under test.
pub(super) const EGO: &str = "#0072b2";
/// The adversary.
pub(super) const ADVERSARY: &str = "#d55e00";
/// Other vehicles.
pub(super) const VEHICLE: &str = "#9aa2ac";
/// Pedestrians.
pub(super) const PEDESTRIAN: &str = "#cc79a7";
/// Cyclists.
pub(super) const CYCLIST: &str = "#009e73";
/// Cones, barriers and the rest.
pub(super) const OTHER: &str = "#e6c229";
/// Contact of two cars.
pub(super) const CONTACT: &str = "#f0e442";

/// Plans of a search that touch nobody.
pub(super) const OTHER_PLAN: &str = "#7d8894";
/// Attacks that miss a clause, and hits that a person would not believe.
pub(super) const ALMOST: &str = "#e69f00";
/// Plans at which the driver fails.
pub(super) const FAILURE: &str = "#a50f15";

/// The ego's evasive manoeuvre.
pub(super) const EVASION: &str = "#007a52";

/// Colours from *now* to the end of the future.
pub(super) struct Ramp {
    stops: [[u8; 3]; 3],
}

/// Time along the ego's trajectory.
pub(super) const EGO_TIME: Ramp = Ramp { stops: [[158, 202, 225], [33, 113, 181], [6, 34, 80]] };
/// Time along the adversary's trajectory.
pub(super) const ADVERSARY_TIME: Ramp = Ramp { stops: [[253, 190, 120], [217, 72, 1], [90, 25, 4]] };

impl Ramp {
    /// Colour at a share of the time, 0 to 1.
    pub(super) fn at(&self, share: f64) -> String {
        let position = share.clamp(0.0, 1.0) * 2.0;
        let low = (position.floor() as usize).min(1);
        let part = position - low as f64;
        let mix = |k: usize| {
            let (a, b) = (f64::from(self.stops[low][k]), f64::from(self.stops[low + 1][k]));
            (a + (b - a) * part).round() as u8
        };
        format!("#{:02x}{:02x}{:02x}", mix(0), mix(1), mix(2))
    }
}
