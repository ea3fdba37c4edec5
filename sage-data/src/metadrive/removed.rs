//! Road users who are left out of the values of a file.

use super::{annotate, complete};
use crate::pickle::{Document, Id, Node};

/// Key of the metadata of a file without some road users of its recording: their ids, as a list in JSON.
const LEFT_OUT: &str = "sage_left_out";

/// Removes tracks, with what the metadata says of them, and notes their ids.
pub(crate) fn remove_tracks(document: &mut Document, ids: &[String]) {
    let root = document.root();
    remove(document, root, "tracks", ids);
    if let Some(metadata) = document.get(root, "metadata") {
        let metadata = document.shallow_copy(metadata);
        document.set(root, "metadata", metadata);
        for key in ["objects_of_interest", "tracks_to_predict"] {
            remove(document, metadata, key, ids);
        }
    }
    complete(document);
    annotate(document, LEFT_OUT, &serde_json::Value::from(ids).to_string());
}

/// Replaces a dict or list of a dict by a copy without some ids, which other values may share.
fn remove(document: &mut Document, dict: Id, key: &str, ids: &[String]) {
    let Some(found) = document.get(dict, key) else { return };
    let stays = |id: Id| document.identifier(id).is_none_or(|id| !ids.iter().any(|other| *other == *id));
    let mut node = document.node(found).clone();
    match &mut node {
        Node::Dict(entries) | Node::DefaultDict { entries, .. } => entries.retain(|(id, _)| stays(*id)),
        Node::List(items) | Node::Tuple(items) => items.retain(|id| stays(*id)),
        _ => return,
    }
    let left = document.push(node);
    document.set(dict, key, left);
}
