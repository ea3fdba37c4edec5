//! Writes a scene into a copy of its source. Unchanged values stay as they are.

use std::path::Path;

use sage_core::scene::{Scene, Track};

use super::{
    columns::{changed_columns, write_columns},
    complete, retimed,
};
use crate::{
    Error,
    pickle::{Document, Id, Node},
    repairs::Decoded,
};

/// Writes a scene into the values of its file, given the scene as it was read. Returns the ids of the changed tracks.
///
/// Unchanged tracks and all other values of the file stay as they are. A changed column keeps its type and shape, so its
/// numbers are rounded to that type. A file at another frame rate keeps its frames unless a track changed, the user chose
/// a part of it, or `ten_hertz` asks for the frames of the scene.
///
/// *Errors*: [`Error::Field`] if the scene has other track ids, track kinds, frames, map or lights than the
/// file. This function cannot write such changes.
pub(crate) fn write_changes<'s>(
    document: &mut Document,
    scene: &'s Scene,
    original: &Decoded,
    ten_hertz: bool,
    path: &Path,
) -> Result<Vec<&'s str>, Error> {
    let refuse = |field: &str, found: &str| Error::Field {
        path: path.to_owned(),
        field: field.to_owned(),
        found: found.to_owned(),
        expected: "what the source file holds".to_owned(),
    };
    let names =
        |scene: &Scene| scene.tracks.iter().map(|t| (t.id.clone(), t.kind.clone())).collect::<Vec<_>>();
    let Decoded { scene: read, frames, is_chosen } = original;
    if names(scene) != names(read) || scene.frames != read.frames {
        return Err(refuse("tracks", "other tracks or another number of frames"));
    }
    if scene.map != read.map || scene.lights != read.lights {
        return Err(refuse("map_features", "another map"));
    }
    let pairs = || scene.tracks.iter().zip(&read.tracks).filter(|(changed, read)| changed != read);
    let ids: Vec<&str> = pairs().map(|(changed, _)| &changed.id[..]).collect();
    match frames {
        Some(frames) if *is_chosen || ten_hertz || !ids.is_empty() => {
            retimed(document, scene, frames);
            complete(document);
        }
        Some(_) => {}
        None => pairs().for_each(|(changed, read)| write_track(document, changed, read)),
    }
    if (scene.ego, scene.adversary) != (read.ego, read.adversary) {
        write_roles(document, scene);
    }
    Ok(ids)
}

/// Writes who the ego and the adversary are, as readers find them.
pub(crate) fn write_roles(document: &mut Document, scene: &Scene) {
    let root = document.root();
    let Some(metadata) = document.get(root, "metadata") else { return };
    let metadata = document.push(document.node(metadata).clone());
    let ids = [Some(scene.ego), scene.adversary].into_iter().flatten().map(|track| &scene.tracks[track].id);
    let ids: Vec<Id> = ids.map(|id| text(document, id)).collect();
    document.set(metadata, "sdc_id", ids[0]);
    let interest = document.push(Node::List(ids));
    document.set(metadata, "objects_of_interest", interest);
    document.set(root, "metadata", metadata);
}

fn text(document: &mut Document, text: &str) -> Id {
    let data = document.push_bytes(text.as_bytes());
    document.push(Node::Str(data))
}

/// Adds a text to the metadata of a file. The dict is copied first, because other values may share it.
pub(crate) fn annotate(document: &mut Document, key: &str, text: &str) {
    let root = document.root();
    let Some(metadata) = document.get(root, "metadata") else { return };
    let metadata = document.push(document.node(metadata).clone());
    let text = self::text(document, text);
    document.set(metadata, key, text);
    document.set(root, "metadata", metadata);
}

/// Writes the changed columns of a track.
fn write_track(document: &mut Document, changed: &Track, original: &Track) {
    let index = || {
        let entries = document.entries(document.get(document.root(), "tracks")?)?;
        entries.iter().rposition(|(k, _)| document.identifier(*k).as_deref() == Some(&changed.id))
    };
    // The source was decoded before, so the track exists.
    if let Some(index) = index() {
        write_columns(document, index, changed.valid.len(), changed_columns(changed, original));
    }
}
