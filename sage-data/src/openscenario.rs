//! A scene as an ASAM OpenSCENARIO XML file that replays it, in the versions 1.0 to 1.3.
//!
//! Each road user appears, follows its recorded positions and headings, and leaves at the recorded frames.
//! The simulation time of a frame is a tenth of its number, in seconds. Traffic lights change as recorded.
//!
//! - Positions are those of the scene less an origin of whole metres near the ego ([`origin_of`]). The map
//!   ([`RoadNetwork`]) has the same origin.
//! - The reference point of a road user is the centre of its box on the ground, not the rear axle: recordings
//!   know no axles.
//! - Each road user has one size: the median over its frames; that at *now* for the ego and the adversary.
//! - A gap of up to 10 frames in a recording is left to the player's interpolation. In a longer one the road
//!   user leaves and appears again.
//! - A road user that stays in one position and heading has no trajectory, even if its recorded height varies
//!   by up to 0.1 m.
//! - With [`EgoMode::Controller`] the ego gets a start speed, a route and an external controller. The others
//!   replay and do not react to it.
//!
//! A file is a function of the scene, the options and the provenance alone.
//!
//! ```
//! use sage_data::{openscenario::{Export, Options, Provenance}, procedural::{Kind, generate}};
//!
//! let scene = generate(Kind::FourWay, 1, 0).ok_or("no scene with this seed and number")?;
//! let export = Export::new(&scene, Options::default());
//! let scenario = export.scenario(&scene, &Provenance::default().with("source", "four-way.pkl"));
//! assert!(scenario.contains(&export.network().file_name()));
//! # Ok::<(), &str>(())
//! ```

mod actions;
mod entities;
mod header;
mod lights;
mod names;
mod presence;
mod provenance;
mod standard;
mod storyboard;

use sage_core::scene::{Scene, Track};

use crate::{opendrive::RoadNetwork, xml::Xml};
use names::entity_names;
pub use provenance::{License, Provenance};
pub use standard::{EgoMode, Standard, UnknownName};

/// Bytes of a vertex of a trajectory, for the capacity of the text.
const VERTEX: usize = 140;
/// Bytes of a road user besides its vertices.
const ENTITY: usize = 3000;

/// Choices for a scenario file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Options {
    /// Version of the standard.
    pub standard: Standard,
    /// Who drives the ego.
    pub ego: EgoMode,
    /// Licence of the scene, which both files state.
    pub license: Option<License>,
}

/// The files of one scene and its variants: the map is made once.
#[derive(Clone, Debug)]
pub struct Export {
    network: RoadNetwork,
    options: Options,
    notes: Vec<String>,
}

impl Export {
    /// Makes the map of a scene.
    pub fn new(scene: &Scene, options: Options) -> Self {
        let license = options.license.as_ref().map(|license| license.notice.as_str());
        let network = RoadNetwork::of(scene, origin_of(scene), license);
        let absent = scene.tracks.iter().filter(|track| !track.valid.contains(&true));
        let mut notes: Vec<String> =
            absent.map(|track| format!("track `{}`: left out, it has no valid frame", track.id)).collect();
        if options.ego == EgoMode::Controller && !scene.ego().is_valid(0) {
            notes.push("the ego appears after the start and is handed over then".to_owned());
        }
        Self { network, options, notes }
    }

    /// The map, to be written beside the scenarios as [`RoadNetwork::file_name`].
    pub fn network(&self) -> &RoadNetwork {
        &self.network
    }

    /// What the files lack of the scene, in words.
    pub fn notes(&self) -> impl Iterator<Item = &str> {
        self.network.notes.iter().chain(&self.notes).map(String::as_str)
    }

    /// The scenario of a variant of the scene, which has the same map, lights and ego.
    pub fn scenario(&self, variant: &Scene, provenance: &Provenance) -> String {
        write(variant, &self.network, &self.options, provenance)
    }
}

/// Origin of a scene's files: the first valid position of the ego, rounded down to whole metres.
///
/// Players that compute in 32-bit floats lose millimetres at coordinates of ten kilometres. OpenDRIVE's own offset is not used,
/// because players differ in whether they add it.
pub fn origin_of(scene: &Scene) -> [f64; 3] {
    let ego = scene.ego();
    let first = ego.valid.iter().position(|valid| *valid);
    first.map_or([0.0; 3], |frame| ego.position[frame].map(f64::floor))
}

/// The scenario file of a scene that takes place on a road network.
pub fn write(scene: &Scene, network: &RoadNetwork, options: &Options, provenance: &Provenance) -> String {
    let frames: usize = scene.tracks.iter().map(|track| track.count_valid(0..scene.frames)).sum();
    let mut xml = Xml::with_capacity(8192 + VERTEX * frames + ENTITY * scene.tracks.len());
    let names = entity_names(scene);
    let tracks = scene.tracks.iter().zip(&names).enumerate();
    let entities: Vec<Entity> = tracks
        .filter(|(_, (track, _))| track.valid.contains(&true))
        .map(|(index, (track, name))| Entity {
            name,
            track,
            is_ego: index == scene.ego,
            is_adversary: scene.adversary == Some(index),
        })
        .collect();
    let scenario = Scenario { scene, network, options, provenance, entities };
    xml.element("OpenSCENARIO", |xml| {
        scenario.write_header(xml);
        xml.element("CatalogLocations", |_| {});
        xml.nested(&["RoadNetwork", "LogicFile"], |xml| {
            xml.text("filepath", &network.file_name());
        });
        scenario.write_entities(xml);
        scenario.write_storyboard(xml);
    });
    xml.finish()
}

/// A scenario on its way into a file.
struct Scenario<'s> {
    scene: &'s Scene,
    network: &'s RoadNetwork,
    options: &'s Options,
    provenance: &'s Provenance,
    /// The tracks with a valid frame.
    entities: Vec<Entity<'s>>,
}

impl Scenario<'_> {
    fn standard(&self) -> Standard {
        self.options.standard
    }

    /// Whether the recording does not drive this road user.
    fn is_controlled(&self, entity: &Entity) -> bool {
        entity.is_ego && self.options.ego == EgoMode::Controller
    }
}

/// A road user in a scenario.
struct Entity<'s> {
    name: &'s str,
    track: &'s Track,
    is_ego: bool,
    is_adversary: bool,
}
