//! The shards of a run: they agree on their scenes, end with a manifest each, and are joined.
//!
//! They share nothing but the folder. A shard writes its scenes and its manifest, and a join what belongs to all. So a shard
//! can be run twice, at any time and by any scheduler, and needs no locks. The cost of the end does not grow with the number of
//! shards.

use std::{collections::HashMap, io::ErrorKind};

use advsage::WithContext as _;
use sage_core::files::{self, Existing};
use sage_data::dataset::Shard;

use super::{
    DatasetRun, Extent,
    manifest::{
        FileRecord, MANIFEST, Manifest, SCENES, SHARDS, SceneRecord, ShardRecord, agreed_scenes, difference,
        shard_file, shard_files,
    },
    manifests::{Manifests, ShardState, ranges},
};
use crate::{
    Error, Result,
    progress::{self, count},
};

impl DatasetRun {
    /// Refuses a shard of other scenes than those of the shards before it. A whole run replaces their list, so that
    /// `sage status` knows of scenes that are new.
    ///
    /// *Errors*: they are others; a system error.
    pub fn agree_on_scenes(&self, names: &[&str]) -> Result<()> {
        let path = self.folder.path();
        let agreed = match agreed_scenes(path)? {
            Some(agreed) => Some(agreed),
            None => Manifest::names_of_run(path, &self.hash),
        };
        match (self.extent, agreed.map(|agreed| difference(&agreed, names))) {
            (_, Some(None)) | (Extent::Whole, None) | (Extent::Join, _) => Ok(()),
            (Extent::Whole, Some(Some(_))) => self.write_scenes(names, Existing::Replace),
            (Extent::Shard(_), Some(Some(difference))) => Err(Error::Refused(format!(
                "the scenes are not those with which `{}` was begun: {difference}; give all shards the same scenes",
                path.display()
            ))),
            (Extent::Shard(_), None) => self.write_scenes(names, Existing::Keep),
        }
    }

    /// Writes the list of all scenes. Another shard may have done so meanwhile.
    fn write_scenes(&self, names: &[&str], existing: Existing) -> Result<()> {
        let path = self.folder.inner(SHARDS.as_ref())?.join(SCENES);
        match files::write(&path, &serde_json::to_vec(names)?, existing) {
            Err(error) if error.kind() == ErrorKind::AlreadyExists => self.agree_on_scenes(names),
            outcome => Ok(outcome.with_context(|| format!("cannot write `{}`", path.display()))?),
        }
    }

    /// Names of all scenes, as the shards agree on them.
    ///
    /// *Errors*: they cannot be read.
    pub fn agreed_scenes(&self) -> Result<Vec<String>> {
        let path = self.folder.path();
        let agreed = agreed_scenes(path)?.or_else(|| Manifest::names_of_run(path, &self.hash));
        Ok(agreed.unwrap_or_default())
    }

    /// What became of all scenes, from the manifests of the shards.
    ///
    /// *Errors*: a scene was not reached by any shard, a manifest or its files are not as they should be, or the shards
    /// are of other scenes.
    pub fn joined(&self, names: &[&str]) -> Result<(Vec<SceneRecord>, Vec<ShardState>)> {
        let path = self.folder.path();
        let mut manifests = Manifests::read(path, &self.hash, false)?;
        if let Some(difference) =
            difference(&manifests.scenes, names).filter(|_| !manifests.scenes.is_empty())
        {
            return Err(Error::Refused(format!(
                "the scenes are not those with which `{}` was begun: {difference}",
                path.display()
            )));
        }
        if manifests.scenes.is_empty() {
            return Err(Error::Refused(format!(
                "`{}` has no list of its scenes (`{SHARDS}/{SCENES}`); run any shard again",
                path.display()
            )));
        }
        let missing = manifests.missing().len();
        let kind = if missing > 0 { "error" } else { "warning" };
        manifests.problems.iter().for_each(|problem| progress::say(&format!("{kind}: {problem}")));
        if missing > 0 {
            let shards = manifests.shard_count().map_or(String::new(), |of| {
                format!(", in shards {} of {of}", ranges(&manifests.unfinished_shards(of)))
            });
            let error = Error::Refused(format!(
                "{missing} of {} are missing in `{}`{shards}; `sage status` says how to finish them",
                count(names.len(), "scene"),
                path.display(),
            ));
            // On a network file system they may only be seen late; a damaged manifest stays one.
            return Err(if manifests.is_contradicted { error } else { Error::Retry(Box::new(error)) });
        }
        let records = names.iter().filter_map(|name| manifests.records.remove(*name)).collect();
        Ok((records, manifests.shards))
    }

    /// Ends a shard: writes its manifest, and nothing that depends on other shards. A shard of a joined run writes none if
    /// the manifest of the run says the same.
    ///
    /// *Errors*: a system error.
    pub fn finish_shard(&self, shard: Shard, records: &[SceneRecord]) -> Result<()> {
        let path = self.folder.path();
        if shard_files(path)?.is_empty() && self.is_in_manifest(records) {
            progress::say(&format!(
                "note: `{}` is joined already, and shard {shard} is in it",
                path.display()
            ));
            return self.remove_shards();
        }
        self.folder.inner(SHARDS.as_ref())?;
        let Shard { number, of } = shard;
        let manifest = path.join(shard_file(shard));
        // Earlier tries that wrote a manifest count too.
        let before = Manifest::read(&manifest).ok().filter(|before| before.head.run_hash == self.hash);
        let before = before.and_then(|before| before.head.shard).map_or(0.0, |shard| shard.seconds);
        let seconds = before + self.clock.elapsed().as_secs_f64();
        let own = ShardRecord { number, of, seconds, threads: rayon::current_num_threads() };
        Manifest::write(&manifest, &self.hash, Some(own), records)?;
        progress::say(&format!(
            "note: this is shard {shard}; `sage join {}` completes the folder when all shards are done",
            path.display()
        ));
        Ok(())
    }

    /// Files of the scenes that an earlier run of this part finished, by scene, as its manifest says.
    pub fn known_files(&self) -> HashMap<String, Vec<FileRecord>> {
        let own = match self.extent {
            Extent::Shard(shard) => Some(shard_file(shard)),
            Extent::Whole | Extent::Join => None,
        };
        let manifests = [Some(MANIFEST.to_owned()), own].into_iter().flatten();
        let read = manifests.filter_map(|name| Manifest::read(&self.folder.path().join(name)).ok());
        let of_run = read.filter(|manifest| manifest.head.run_hash == self.hash);
        let records = of_run.flat_map(|manifest| manifest.records);
        records.map(|record| (record.scene, record.files)).collect()
    }

    /// True if the manifest of the whole run holds some records.
    fn is_in_manifest(&self, records: &[SceneRecord]) -> bool {
        let Ok(whole) = Manifest::read(&self.folder.path().join(MANIFEST)) else { return false };
        let known: HashMap<&str, &SceneRecord> =
            whole.records.iter().map(|record| (&*record.scene, record)).collect();
        let is_known =
            |record: &SceneRecord| known.get(&*record.scene).is_some_and(|known| **known == *record);
        whole.head.run_hash == self.hash && records.iter().all(is_known)
    }

    /// Removes the manifests of shards and the list of their scenes.
    ///
    /// *Errors*: a system error.
    pub fn remove_shards(&self) -> Result<()> {
        let path = self.folder.path();
        if !path.join(SHARDS).is_dir() {
            return Ok(());
        }
        self.folder.inner(SHARDS.as_ref())?;
        let name = |file: &std::path::Path| {
            format!("{SHARDS}/{}", file.file_name().unwrap_or_default().to_string_lossy())
        };
        let manifests = shard_files(path)?.into_iter().map(|(_, file)| name(&file));
        manifests.chain([format!("{SHARDS}/{SCENES}")]).try_for_each(|name| self.folder.remove(&name))?;
        // Scenes may lie in a folder of this name.
        let _ = std::fs::remove_dir(path.join(SHARDS));
        Ok(())
    }
}
