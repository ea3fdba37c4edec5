//! Sizes of road users that a file gives none for.

use sage_core::scene::TrackKind;

/// Length, width and height that are assumed for a type of a file, in upper or lower case, metres: as [`default_size`], and
/// for types that are of one kind but differ in size.
pub fn size_of_type(name: &str) -> [f64; 3] {
    match &name.to_ascii_uppercase()[..] {
        "BUS" | "SCHOOL_BUS" => [12.0, 2.6, 3.2],
        "MOTORCYCLIST" | "MOTORCYCLE" => [2.2, 0.9, 1.6],
        "RIDERLESS_BICYCLE" => [1.75, 0.6, 1.1],
        _ => default_size(&TrackKind::from_name(name)),
    }
}

/// Length, width and height that are assumed for a kind, metres. MetaDrive writes cones and barriers without a size;
/// theirs are those of its bodies, for the rest common ones.
pub fn default_size(kind: &TrackKind) -> [f64; 3] {
    match kind {
        TrackKind::Vehicle => [4.6, 1.9, 1.6],
        TrackKind::Pedestrian => [0.7, 0.7, 1.75],
        TrackKind::Cyclist => [1.75, 0.6, 1.75],
        TrackKind::Other(name) => match &name[..] {
            "TRAFFIC_CONE" => [0.4, 0.4, 2.0],
            // Its long side lies across its heading.
            "TRAFFIC_BARRIER" => [0.3, 2.0, 2.0],
            _ => [1.0, 1.0, 1.0],
        },
    }
}
