//! Sizes of the boxes of ego and adversary.

use crate::{
    motion::NOW,
    scene::{Scene, Track, TrackKind},
};

/// Source of the sizes of ego and adversary. Other agents always have their logged sizes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Sizes {
    /// The logged size at *now*.
    #[default]
    Logged,
    /// The vehicle models of the simulator behind the published figures.
    MetaDrive {
        /// Start of the cycle of classes, 0 to 5. The simulator draws it for each scene by a chain of seeds that cannot be
        /// reproduced, so it is an option (`--class-cycle`).
        cycle: usize,
    },
}

/// Length and width of the simulator's model of the ego, metres.
const EGO: [f64; 2] = [4.515, 1.852];
const SMALL: [f64; 2] = [4.3, 1.7];
const MEDIUM: [f64; 2] = [4.6, 1.85];
const LARGE: [f64; 2] = [4.87, 2.046];
const EXTRA_LARGE: [f64; 2] = [5.74, 2.3];

impl Sizes {
    /// (length, width) of ego and adversary, metres.
    pub(super) fn of(self, scene: &Scene, adversary: usize) -> ([f64; 2], [f64; 2]) {
        match self {
            Self::Logged => (logged(scene.ego()), logged(&scene.tracks[adversary])),
            Self::MetaDrive { cycle } => (EGO, metadrive_class(scene, adversary, cycle)),
        }
    }
}

/// Size at *now*, or at the nearest valid frame.
fn logged(track: &Track) -> [f64; 2] {
    let nearest = (0..track.valid.len()).filter(|&f| track.is_valid(f)).min_by_key(|f| f.abs_diff(NOW));
    let [length, width, _] = track.size[nearest.unwrap_or(0)];
    [length, width]
}

/// Class size that the simulator assigns to a vehicle. It creates the cars of frame 0 in the order of the
/// file. Short cars are small. The others alternate: one cycle of classes for those up to 5.5 m, one for
/// longer ones. A car that the simulator does not create (parked, or not valid at frame 0) has the ego's
/// size in the published code.
fn metadrive_class(scene: &Scene, adversary: usize, cycle: usize) -> [f64; 2] {
    let created = |k: usize| {
        let track = &scene.tracks[k];
        k != scene.ego && track.kind == TrackKind::Vehicle && track.is_valid(0) && !track.is_parked()
    };
    if !created(adversary) {
        return EGO;
    }
    let length = |k: usize| scene.tracks[k].size[0][0];
    let earlier =
        |group: fn(f64) -> bool| cycle + (0..adversary).filter(|&k| created(k) && group(length(k))).count();
    match length(adversary) {
        l if l <= 4.0 => SMALL,
        l if l <= 5.5 => [MEDIUM, LARGE, SMALL][earlier(|l| l > 4.0 && l <= 5.5) % 3],
        _ => [LARGE, EXTRA_LARGE][earlier(|l| l > 5.5) % 2],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{AdversaryOrigin, Map};

    /// A scene of moving cars of these lengths after a first one, the ego.
    fn scene(lengths: &[f64]) -> Scene {
        let car = |(k, length): (usize, &f64)| Track {
            id: k.to_string(),
            kind: TrackKind::Vehicle,
            position: (0..20).map(|f| [f64::from(f), k as f64 * 5.0, 0.0]).collect(),
            heading: vec![0.0; 20],
            velocity: vec![[10.0, 0.0]; 20],
            size: vec![[*length, 2.0, 1.5]; 20],
            valid: vec![true; 20],
        };
        Scene {
            id: "sizes".into(),
            frames: 20,
            timestamps: vec![],
            tracks: [4.6].iter().chain(lengths).enumerate().map(car).collect(),
            map: Map::default().into(),
            lights: vec![],
            ego: 0,
            adversary: None,
            adversary_origin: AdversaryOrigin::None,
            notes: vec![],
            held: vec![],
        }
    }

    #[test]
    fn classes_follow_length_and_cycle_within_their_group() {
        let scene = scene(&[4.0, 4.1, 5.5, 4.8, 5.6, 12.0, 4.5]);
        let class = |k| metadrive_class(&scene, k, 0);
        assert_eq!(class(1), SMALL);
        assert_eq!([class(2), class(3), class(4), class(7)], [MEDIUM, LARGE, SMALL, MEDIUM]);
        assert_eq!([class(5), class(6)], [LARGE, EXTRA_LARGE]);
        assert_eq!([metadrive_class(&scene, 2, 1), metadrive_class(&scene, 5, 1)], [LARGE, EXTRA_LARGE]);
        assert_eq!(Sizes::MetaDrive { cycle: 2 }.of(&scene, 2), (EGO, SMALL));
    }

    #[test]
    fn cars_that_the_simulator_does_not_create_have_the_egos_size_and_do_not_advance_the_cycle() {
        let mut scene = scene(&[4.5, 4.5, 4.5]);
        scene.tracks[1].position = vec![[0.0, 5.0, 0.0]; 20];
        scene.tracks[2].valid[0] = false;
        assert_eq!([1, 2, 3].map(|k| metadrive_class(&scene, k, 0)), [EGO, EGO, MEDIUM]);
    }

    #[test]
    fn logged_sizes_are_those_of_the_valid_frame_nearest_to_now() {
        let mut scene = scene(&[4.5]);
        scene.tracks[1].size[9] = [4.7, 2.1, 1.5];
        scene.tracks[1].valid[10] = false;
        assert_eq!(Sizes::Logged.of(&scene, 1), ([4.6, 2.0], [4.7, 2.1]));
    }
}
