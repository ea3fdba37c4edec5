//! Sizes of road users that a file gives none for.

use sage_core::scene::TrackKind;

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
