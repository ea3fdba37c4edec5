//! Road users who are left out of a recording.

use std::{borrow::Cow, path::Path};

use sage_core::scene::{Note, Scene};

use super::Recording;
use crate::{Error, metadrive, pickle::Document};

impl Recording {
    /// All values of the MetaDrive source, without road users that were left out; `None` if there is none.
    ///
    /// *Errors*: a native file whose source is damaged.
    pub fn document(&self) -> Result<Option<Cow<'_, Document>>, Error> {
        let document = self.whole_document()?;
        if self.options.without.is_empty() {
            return Ok(document);
        }
        Ok(document.map(|document| {
            let mut document = document.into_owned();
            metadrive::remove_tracks(&mut document, &self.options.without);
            Cow::Owned(document)
        }))
    }
}

/// The scene without some road users, with a note.
///
/// *Errors*: [`Error::Field`] as [`Scene::without`].
pub(super) fn scene(scene: Scene, ids: &[String], path: &Path) -> Result<Scene, Error> {
    let list = ids.join(", ");
    let mut scene = scene.without(ids).map_err(|error| Error::Field {
        path: path.to_owned(),
        field: "(without)".to_owned(),
        found: format!("`{}`: {error}", list.escape_debug()),
        expected: "ids of road users besides the ego".to_owned(),
    })?;
    scene.notes.push(Note::Other(format!("left out as asked: {list}")));
    Ok(scene)
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

    use sage_core::scene::Scene;

    use crate::{ReadOptions, Recording, VariantWriter};

    const FILE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/crossing.pkl");

    fn options(ids: &[&str]) -> ReadOptions {
        ReadOptions { without: ids.iter().map(|id| (*id).to_owned()).collect(), ..ReadOptions::default() }
    }

    fn read(ids: &[&str]) -> Recording {
        Recording::read_as(FILE.as_ref(), &options(ids)).unwrap()
    }

    fn ids(scene: &Scene) -> Vec<&str> {
        scene.tracks.iter().map(|track| &*track.id).collect()
    }

    #[test]
    fn road_users_are_left_out_of_the_scene_and_of_every_file_of_it() {
        let whole = read(&[]);
        let (scene, roles) = (&whole.scene, [whole.scene.ego, whole.scene.adversary.unwrap()]);
        let left_out = (0..scene.tracks.len()).find(|k| !roles.contains(k)).unwrap();
        let id = &*scene.tracks[left_out].id;
        let found = read(&[id]);
        assert_eq!(found.scene.tracks, scene.among(|k| k != left_out).tracks);
        assert_eq!(found.scene.adversary().unwrap().id, scene.adversary().unwrap().id);
        assert!(found.scene.notes.iter().any(|note| note.to_string() == format!("left out as asked: {id}")));

        let again = |name: &str, bytes: Vec<u8>| Recording::from_bytes(name.as_ref(), bytes).unwrap().scene;
        let pickle = again("a.pkl", found.to_pickle().unwrap());
        assert_eq!(pickle.content_hash(), found.scene.content_hash());
        let native = again("a.scene", found.to_native().unwrap());
        assert_eq!(native.content_hash(), found.scene.content_hash());
        let json = again("a.json", found.to_gpudrive().unwrap().json);
        assert_eq!(ids(&json), ids(&found.scene));
        let variant = VariantWriter::new(&found).unwrap();
        let variant = variant.variant(&found.scene, "{}").unwrap();
        let written = variant.encode(crate::Format::Pickle).unwrap().unwrap();
        assert_eq!(again("b.pkl", written).content_hash(), found.scene.content_hash());
    }

    #[test]
    fn another_adversary_is_selected_and_the_ego_stays() {
        let whole = read(&[]);
        let adversary = &*whole.scene.adversary().unwrap().id;
        let found = read(&[adversary]);
        assert!(!ids(&found.scene).contains(&adversary));
        assert_ne!(found.scene.adversary().map_or("", |track| &track.id), adversary);
        let refused = |id: &str| Recording::read_as(FILE.as_ref(), &options(&[id])).unwrap_err().to_string();
        assert!(refused(&whole.scene.ego().id).contains("cannot be left out: it is the ego"));
        assert!(refused("x").contains("no track `x`"), "{}", refused("x"));
    }

    #[test]
    fn a_scene_is_another_one_without_somebody_in_any_order() {
        let hash = |ids: &[&str]| options(ids).source_hash(b"scene");
        assert_eq!(hash(&["1", "2"]), hash(&["2", "1", "2"]));
        assert!(hash(&["1"]) != hash(&[]) && hash(&["1", "2"]) != hash(&["12"]));
    }
}
