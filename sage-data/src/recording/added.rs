//! Road users who are added to a recording.

use sage_core::scene::{AdversaryOrigin, Note, PROVENANCE, Track};
use serde_json::{Map, Value};

use super::{Recording, Source};
use crate::{Error, metadrive};

impl Recording {
    /// The recording with road users who stand where they are *now* at all frames, of which the first is the adversary. `provenance`
    /// says by what, as JSON; it gets the field `added` with their ids, by which readers know that they were not recorded.
    ///
    /// *Errors*: a native file whose source is damaged.
    pub fn with_added(&self, tracks: Vec<Track>, mut provenance: Map<String, Value>) -> Result<Self, Error> {
        let ids: Vec<&str> = tracks.iter().map(|track| &*track.id).collect();
        provenance.insert(metadrive::ADDED.to_owned(), ids.into());
        let provenance = Value::Object(provenance).to_string();
        let mut scene = self.scene.clone();
        (scene.adversary, scene.adversary_origin) = (Some(scene.tracks.len()), AdversaryOrigin::User);
        let source = match self.document()? {
            None => {
                scene.notes.retain(|note| !matches!(note, Note::Provenance(_)));
                scene.notes.push(Note::Provenance(provenance));
                scene.tracks.extend(tracks);
                Source::Procedural
            }
            Some(document) => {
                let mut document = document.into_owned();
                metadrive::add_standing(&mut document, &tracks);
                scene.tracks.extend(tracks);
                metadrive::write_roles(&mut document, &scene);
                metadrive::annotate(&mut document, PROVENANCE, &provenance);
                Source::Pickle(document)
            }
        };
        Ok(Self { scene, source, path: self.path.clone(), options: self.options.clone() })
    }
}
