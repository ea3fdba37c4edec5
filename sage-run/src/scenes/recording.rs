//! The recordings of a list, with all that their files hold.

use std::path::PathBuf;

use sage_data::{Format, ReadOptions, Recording, procedural};

use super::{
    NO_SUCH, Scenes,
    entry::{Entry, Origin, kind_of},
};
use crate::{Error, Result};

impl Scenes {
    /// Reads the recording of a scene, with other options than those of the list.
    ///
    /// *Errors*: it cannot be read, or came from a pipe.
    pub fn recording(&self, number: usize, options: &ReadOptions) -> Result<Recording> {
        self.entries[number].recording(options)
    }
}

impl Entry {
    /// Reads or generates the recording of the scene.
    ///
    /// *Errors*: it cannot be read, or came from a pipe.
    fn recording(&self, options: &ReadOptions) -> Result<Recording> {
        match &self.origin {
            Origin::File(file) => Ok(Recording::read_as(file, options)?),
            Origin::InMemory(data) => Err(Error::Refused(format!(
                "`{}` came from a pipe and can be read only once; give a file",
                data.name
            ))),
            Origin::Procedural(number, seed) => {
                let scene = procedural::generate(kind_of(*number), *seed, *number);
                let scene = scene.ok_or_else(|| Error::Refused(NO_SUCH.to_owned()))?;
                let path = PathBuf::from(format!("{}.{}", scene.id, Format::Native.ending()));
                Ok(Recording::from_bytes_as(&path, Recording::procedural(scene).to_native()?, options)?)
            }
        }
    }
}
