//! The scenes of environments: loaded ones, and files that are read when an episode needs them.

use std::{
    path::PathBuf,
    sync::{Arc, Mutex, PoisonError},
};

use advsage::in_one_line;
use pyo3::{prelude::*, types::PyIterator};
use sage_core::scene::SceneData;
use sage_data::ReadOptions;
use sage_sim::{
    Error, SimScene,
    batch::{Recent, SceneSource},
};

use crate::{items::Item, loading::Reading};

/// A scene of the list.
enum Listed {
    Loaded(Arc<SceneData>, Mutex<Option<Arc<SimScene>>>),
    File(PathBuf),
}

/// Counts of scenes.
#[derive(Clone, Copy)]
pub(crate) struct Counts {
    /// Number of the first one in the infos.
    pub(crate) first: usize,
    pub(crate) all: usize,
    /// Environments among which they are divided.
    pub(crate) workers: usize,
    /// Scenes in memory at most.
    pub(crate) in_memory: usize,
}

/// A list of scenes, of which files stay in memory for a while.
pub(crate) struct ListedScenes {
    all: Vec<Listed>,
    counts: Counts,
    read: Mutex<Recent<usize, Arc<SimScene>>>,
}

impl ListedScenes {
    /// The scenes of an iterator, of which at most `in_memory` files are in memory at once. They are divided among `workers`
    /// environments. `first` is the number of the first one in the infos.
    ///
    /// *Errors*: something that is neither a scene nor a path.
    pub(crate) fn new(
        scenes: &Bound<'_, PyIterator>,
        in_memory: usize,
        workers: usize,
        first: usize,
    ) -> PyResult<Self> {
        let all = scenes.clone().map(|scene| {
            Ok(match Item::of(&scene?)? {
                Item::Scene(_, shared) => Listed::Loaded(shared.0, Mutex::default()),
                Item::Path(path) => Listed::File(path),
            })
        });
        let all = all.collect::<PyResult<Vec<_>>>()?;
        let files = all.iter().filter(|listed| matches!(listed, Listed::File(_))).count();
        let most = all.len() - files + files.min(in_memory);
        let counts = Counts { first, all: all.len(), workers, in_memory: most };
        Ok(Self { all, counts, read: Mutex::new(Recent::new(in_memory)) })
    }

    /// Name of a scene: that of its file without the ending.
    pub(crate) fn name(&self, number: usize) -> String {
        match &self.all[number] {
            Listed::Loaded(data, _) => data.name.clone(),
            Listed::File(path) => path.file_stem().unwrap_or(path.as_os_str()).to_string_lossy().into_owned(),
        }
    }

    /// Names of all scenes.
    pub(crate) fn names(&self) -> Vec<String> {
        (0..self.all.len()).map(|number| self.name(number)).collect()
    }

    /// Their counts.
    pub(crate) fn counts(&self) -> Counts {
        self.counts
    }

    /// Prepares a scene.
    ///
    /// *Errors*: it cannot be read or simulated, as the readers say it.
    pub(crate) fn check(&self, number: usize) -> sage_run::Result<()> {
        if number < self.all.len() {
            self.prepared(number)?;
        }
        Ok(())
    }

    fn prepared(&self, number: usize) -> sage_run::Result<Arc<SimScene>> {
        match &self.all[number] {
            Listed::Loaded(data, kept) => {
                let mut kept = kept.lock().unwrap_or_else(PoisonError::into_inner);
                if let Some(scene) = &*kept {
                    return Ok(scene.clone());
                }
                Ok(kept.insert(SimScene::new(data.scene.clone(), data.index.clone())?).clone())
            }
            Listed::File(path) => {
                let known = self.read.lock().unwrap_or_else(PoisonError::into_inner).get(&number).cloned();
                if let Some(scene) = known {
                    return Ok(scene);
                }
                // The rest of the file is of no use here, and half of the memory.
                let reading = Reading { options: ReadOptions::default(), keep_source: false };
                let data = reading.read(path)?.data;
                let scene = SimScene::new(data.scene.clone(), data.index.clone())?;
                self.read.lock().unwrap_or_else(PoisonError::into_inner).put(number, scene.clone());
                Ok(scene)
            }
        }
    }
}

impl SceneSource for ListedScenes {
    fn count(&self) -> usize {
        self.all.len()
    }

    fn scene(&self, number: usize) -> Result<Arc<SimScene>, Error> {
        self.prepared(number).map_err(|error| match error {
            sage_run::Error::Facade(advsage::Error::Simulation(error)) => *error,
            error => Error::Scene { scene: self.name(number), problem: in_one_line(&error) },
        })
    }
}
