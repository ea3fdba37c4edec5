//! One scene of a list: where it comes from, and how it is read.

use std::{
    path::{Path, PathBuf},
    sync::Arc,
};

use sage_core::scene::SceneData;
use sage_data::{
    ReadOptions, Recording,
    procedural::{self, Kind},
};

use crate::{Error, Result};

/// One scene, and the hash of its content at the first reading.
#[derive(Clone)]
pub(super) struct Entry {
    pub(super) origin: Origin,
    pub(super) content: Option<[u8; 16]>,
    /// Its number in the whole list.
    pub(super) number: usize,
}

/// Source of a scene, used each time the scene is needed.
#[derive(Clone)]
pub(super) enum Origin {
    File(PathBuf),
    /// Number and seed of a procedural scene.
    Procedural(u64, u64),
    /// A scene from a pipe, which can be read only once.
    InMemory(Arc<SceneData>),
}

impl Entry {
    /// Reads or generates the scene; `None` if the number gives no procedural scene.
    pub(super) fn load(&self, options: &ReadOptions) -> Result<Option<Arc<SceneData>>> {
        let data = match &self.origin {
            Origin::File(file) => read(file, options)?,
            Origin::InMemory(data) => return Ok(Some(data.clone())),
            Origin::Procedural(number, seed) => {
                let Some(scene) = procedural::generate(kind_of(*number), *seed, *number) else {
                    return Ok(None);
                };
                SceneData::new(scene.id.clone(), scene)
            }
        };
        if self.content.is_some_and(|content| content != data.scene.content_hash()) {
            return Err(Error::Refused(format!("`{}` changed during the run; start again", data.name)));
        }
        Ok(Some(Arc::new(data)))
    }

    /// Name of the scene.
    pub(super) fn name(&self) -> String {
        match &self.origin {
            Origin::File(file) => file.display().to_string(),
            Origin::InMemory(data) => data.name.clone(),
            Origin::Procedural(number, seed) => format!("{}-{seed}-{number}", kind_of(*number).name()),
        }
    }
}

/// Kind of the procedural scene of a number: the kinds take turns.
pub(super) fn kind_of(number: u64) -> Kind {
    Kind::ALL[(number % Kind::ALL.len() as u64) as usize]
}

pub(super) fn read(file: &Path, options: &ReadOptions) -> Result<SceneData> {
    let name = format!("{}{}", file.display(), options.suffix());
    Ok(SceneData::new(name, Recording::read_as(file, options)?.scene))
}
