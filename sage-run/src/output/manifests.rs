//! What the manifests in a folder say about its run, checked against its files.

use std::{
    collections::{BTreeMap, BTreeSet, HashMap, HashSet},
    path::Path,
};

use advsage::in_one_line;
use rayon::prelude::*;
use sage_data::dataset::Shard;

use super::manifest::{
    Counts, FileRecord, MANIFEST, Manifest, SceneRecord, State, agreed_scenes, shard_files,
};
use crate::Result;

/// A shard whose manifest is there.
#[derive(Clone, Copy, Debug)]
pub struct ShardState {
    /// Which it is.
    pub shard: Shard,
    /// How long it took, seconds.
    pub seconds: f64,
    /// Its number of threads.
    pub threads: usize,
}

/// What is known of a run from its manifests.
#[derive(Debug, Default)]
pub struct Manifests {
    /// Names of all scenes, in their order.
    pub scenes: Vec<String>,
    /// What became of them. A scene without a record was not reached yet, or its files are not as its manifest says.
    pub records: HashMap<String, SceneRecord>,
    /// Shards whose manifests are there.
    pub shards: Vec<ShardState>,
    /// What is wrong with manifests or files, in words.
    pub problems: Vec<String>,
    /// What is wrong with the files of scenes, by scene.
    wrong: BTreeMap<String, String>,
    /// True if a problem is more than a file that is missing, which may only be seen late.
    pub is_contradicted: bool,
    /// True if the manifest of the whole run is there.
    pub is_joined: bool,
}

impl Manifests {
    /// Reads the manifests of the run with a hash, and checks that the files exist with their sizes; with `verify` also
    /// that they have their hashes.
    ///
    /// *Errors*: the folder cannot be listed.
    pub fn read(folder: &Path, run_hash: &str, verify: bool) -> Result<Self> {
        let mut all = Self { scenes: agreed_scenes(folder)?.unwrap_or_default(), ..Self::default() };
        let whole = folder.join(MANIFEST);
        if whole.is_file()
            && let Some(manifest) = all.manifest(&whole, run_hash)
        {
            all.is_joined = true;
            if all.scenes.is_empty() {
                all.scenes = manifest.records.iter().map(|record| record.scene.clone()).collect();
            }
            all.claim(manifest.records, folder, verify);
        }
        for (shard, path) in shard_files(folder)? {
            let Some(manifest) = all.manifest(&path, run_hash) else { continue };
            let own = manifest.head.shard.filter(|own| (own.number, own.of) == (shard.number, shard.of));
            let foreign = manifest.records.iter().find(|record| !shard.holds(&record.scene));
            let wrong = match (own, foreign) {
                (None, _) => "it is the manifest of another shard".to_owned(),
                (_, Some(record)) => format!("scene `{}` is none of this shard", record.scene),
                (Some(own), None) => {
                    all.shards.push(ShardState { shard, seconds: own.seconds, threads: own.threads });
                    all.claim(manifest.records, folder, verify);
                    continue;
                }
            };
            all.is_contradicted = true;
            all.problems.push(format!("`{}`: {wrong}; remove it and run its shard again", path.display()));
        }
        all.conclude();
        Ok(all)
    }

    /// Reads a manifest; `None` if it is of another run, or not as it was written.
    fn manifest(&mut self, path: &Path, run_hash: &str) -> Option<Manifest> {
        match Manifest::read(path) {
            Ok(manifest) if manifest.head.run_hash == run_hash => Some(manifest),
            // Manifests of an earlier run remain after --force.
            Ok(_) => None,
            Err(error) => {
                self.is_contradicted = true;
                let again =
                    if path.ends_with(MANIFEST) { "run the command again" } else { "run its shard again" };
                self.problems.push(format!("{}; remove it and {again}", in_one_line(&error)));
                None
            }
        }
    }

    /// Adds what a manifest says of its scenes, as far as their files are there. What is done stays done.
    fn claim(&mut self, records: Vec<SceneRecord>, folder: &Path, verify: bool) {
        let rank = |state: State| match state {
            State::Done => 0,
            State::LeftOut => 1,
            State::Bad => 2,
            State::Retry => 3,
        };
        let check = |record: SceneRecord| {
            let problem = wrong_file(folder, &record, verify);
            (record, problem)
        };
        let checked: Vec<(SceneRecord, Option<String>)> = records.into_par_iter().map(check).collect();
        for (record, problem) in checked {
            match (problem, self.records.get(&record.scene)) {
                (Some(problem), _) => drop(self.wrong.insert(record.scene, problem)),
                (None, Some(known)) if rank(known.state) < rank(record.state) => {}
                (None, _) => drop(self.records.insert(record.scene.clone(), record)),
            }
        }
    }

    /// Drops what is said of scenes that are none of the run, and names the scenes whose files are not as a manifest says.
    fn conclude(&mut self) {
        let scenes: HashSet<&String> = self.scenes.iter().collect();
        self.records.retain(|name, _| scenes.contains(name));
        for (scene, problem) in std::mem::take(&mut self.wrong) {
            if !self.records.contains_key(&scene) {
                self.is_contradicted |= !problem.ends_with(MISSING);
                self.problems.push(format!("scene `{scene}`: {problem}; run its shard again"));
            }
        }
    }

    /// Numbers of the scenes by what became of them; scenes without a record are not counted.
    pub fn counts(&self) -> Counts {
        Counts::of(self.records.values())
    }

    /// Names of the scenes that were not reached, in their order.
    pub fn missing(&self) -> Vec<&str> {
        let is_missing = |name: &&String| !self.records.contains_key(*name);
        self.scenes.iter().filter(is_missing).map(String::as_str).collect()
    }

    /// Number of shards of the run: that of most manifests, of equal ones the largest.
    pub fn shard_count(&self) -> Option<u32> {
        let mut counts: BTreeMap<u32, usize> = BTreeMap::new();
        self.shards.iter().for_each(|state| *counts.entry(state.shard.of).or_default() += 1);
        counts.into_iter().max_by_key(|(of, count)| (*count, *of)).map(|(of, _)| of)
    }

    /// Numbers of the shards of `of` that hold scenes which were not reached, or which another try may finish.
    pub fn unfinished_shards(&self, of: u32) -> BTreeSet<u32> {
        let is_open =
            |name: &&String| self.records.get(*name).is_none_or(|record| record.state == State::Retry);
        self.scenes.iter().filter(is_open).map(|name| Shard::of_scene(name, of).number).collect()
    }
}

/// End of the problem of a file that is not there.
const MISSING: &str = "is missing";

/// What is wrong with the files of a scene; `None` if they are as its record says.
fn wrong_file(folder: &Path, record: &SceneRecord, verify: bool) -> Option<String> {
    for file in &record.files {
        let name = &file.name;
        // A manifest may come from anywhere.
        if Path::new(name).components().any(|part| !matches!(part, std::path::Component::Normal(_))) {
            return Some(format!("its manifest names `{name}`, which leads out of the folder"));
        }
        let path = folder.join(name);
        match std::fs::symlink_metadata(&path) {
            Ok(found) if found.is_file() && found.len() == file.bytes => {}
            Ok(found) => return Some(format!("`{name}` has {} bytes and not {}", found.len(), file.bytes)),
            Err(_) => return Some(format!("`{name}` {MISSING}")),
        }
        if verify {
            match FileRecord::of(folder, name) {
                Ok(found) if found == *file => {}
                Ok(_) => return Some(format!("the content of `{name}` is not what its manifest says")),
                Err(error) => return Some(in_one_line(&error)),
            }
        }
    }
    None
}

/// Numbers in ranges, as `1,4-6`.
pub fn ranges(numbers: &BTreeSet<u32>) -> String {
    let mut all: Vec<[u32; 2]> = Vec::new();
    for number in numbers {
        match all.last_mut() {
            Some([_, last]) if *last + 1 == *number => *last = *number,
            _ => all.push([*number; 2]),
        }
    }
    let range = |[first, last]: [u32; 2]| {
        if first == last { first.to_string() } else { format!("{first}-{last}") }
    };
    all.into_iter().map(range).collect::<Vec<_>>().join(",")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_written_as_ranges() {
        assert_eq!(ranges(&[1, 2, 3, 5, 8, 9].into()), "1-3,5,8-9");
        assert_eq!(ranges(&BTreeSet::new()), "");
    }
}
