//! The drive of somebody's own planner, read from a file: a pose for each frame of the scene.
//!
//! The file is JSON: a list of `[x, y, heading]` for frames 0, 1, … of one scene (metres, radians, world
//! frame), or an object with such a list for each scene's id.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
    sync::Arc,
};

use sage_core::{
    files,
    geometry::MAX_COORDINATE,
    motion::{Pose, check_path},
    registry::Entry,
};
use serde::{Deserialize, Serialize};

use super::{Driver, EgoPolicy, Start, View};
use crate::{Error, world::Control};

/// Largest file that is read, bytes: the drives of 10 000 scenes.
const MAX_DRIVES: u64 = 64 << 20;

/// Drives by the scenes' ids, or one drive.
#[derive(Clone, Debug, PartialEq)]
enum Drives {
    One(Vec<[f64; 3]>),
    ByScene(BTreeMap<String, Vec<[f64; 3]>>),
}

/// Recorded drives of a planner.
#[derive(Clone, Debug, PartialEq)]
pub struct DrivenPath {
    file: PathBuf,
    drives: Drives,
}

impl DrivenPath {
    /// Reads a file of drives.
    ///
    /// *Errors*: a message that names the file, and what is wrong in it.
    pub fn read(file: &Path) -> Result<Self, Error> {
        let fail = |problem: String| Error::Value(format!("`{}`: {problem}", file.display()));
        let text = files::read(file, MAX_DRIVES).map_err(|error| fail(error.to_string()))?;
        let is_list = text.iter().find(|byte| !byte.is_ascii_whitespace()) == Some(&b'[');
        let drives = if is_list {
            serde_json::from_slice(&text).map(Drives::One)
        } else {
            serde_json::from_slice(&text).map(Drives::ByScene)
        };
        let drives = drives.map_err(|error| {
            fail(format!(
                "expected a JSON list of [x, y, heading], or an object with such a list for each scene id: {error}"
            ))
        })?;
        Ok(Self { file: file.to_owned(), drives })
    }

    /// Poses of a scene, frame 0 first, one for each of its frames.
    ///
    /// *Errors*: [`Error::Policy`] if the file has no drive of this scene, one of another length, or one that no
    /// car drives: numbers beyond [`MAX_COORDINATE`], steps beyond [`sage_core::motion::MAX_STEP`].
    pub fn of(&self, scene: &str, frames: usize) -> Result<&[[f64; 3]], Error> {
        let fail = |problem: String| Error::Policy { scene: scene.to_owned(), problem };
        let file = self.file.display();
        let poses = match &self.drives {
            Drives::One(poses) => poses,
            Drives::ByScene(all) => {
                all.get(scene).ok_or_else(|| fail(format!("`{file}` has no drive of this scene")))?
            }
        };
        if poses.len() != frames {
            let found = poses.len();
            return Err(fail(format!(
                "the drive in `{file}` has {found} poses; expected {frames}, one a frame"
            )));
        }
        let is_far = |v: &f64| !(v.abs() <= MAX_COORDINATE);
        if let Some(row) = poses.iter().position(|pose| pose.iter().any(is_far)) {
            let pose = poses[row];
            return Err(fail(format!(
                "row {row} of the drive in `{file}` is {pose:?}; expected numbers within ±{MAX_COORDINATE:e}"
            )));
        }
        check_path(poses.iter().map(|[x, y, _]| [*x, *y]).enumerate())
            .map_err(|problem| fail(format!("row {} of the drive in `{file}` {problem}", problem.frame())))?;
        Ok(poses)
    }
}

/// Way in the first step that no car covers, metres.
const FARTHEST_STEP: f64 = 10.0;

/// The policy `path`.
#[derive(Clone, Debug)]
pub struct PathPolicy(Arc<DrivenPath>);

/// Options of [`PathPolicy`].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PathOptions {
    /// JSON file of poses `[x, y, heading]`, one a frame.
    pub file: PathBuf,
}

impl Entry<dyn EgoPolicy> for PathPolicy {
    const NAME: &'static str = "path";
    const SUMMARY: &'static str = "the drive of another planner, from a file (path:FILE)";
    const SOURCE: &'static str = "this project";
    type Options = PathOptions;

    fn build(options: PathOptions) -> Result<Box<dyn EgoPolicy>, String> {
        if options.file.as_os_str().is_empty() {
            return Err("`file` is empty; write path:FILE".to_owned());
        }
        let drives = DrivenPath::read(&options.file).map_err(|error| error.to_string())?;
        Ok(Box::new(Self(Arc::new(drives))))
    }
}

impl EgoPolicy for PathPolicy {
    fn start(&self, start: &Start) -> Result<Box<dyn Driver>, Error> {
        let poses = self.0.of(start.scene_id(), start.frames())?;
        if let Some([x, y, _]) = poses.get(1) {
            let from = start.first_position();
            let gap = (x - from[0]).hypot(y - from[1]);
            if gap > FARTHEST_STEP {
                return Err(start.error(format!(
                    "the drive in `{}` is {gap:.0} m from the recorded start after one step; it is of another scene",
                    self.0.file.display()
                )));
            }
        }
        Ok(Box::new(PathDriver(poses.into())))
    }
}

#[derive(Clone)]
struct PathDriver(Arc<[[f64; 3]]>);

impl Driver for PathDriver {
    fn control(&mut self, view: &View) -> Result<Control, Error> {
        let frame = (view.step() + 1).min(self.0.len() - 1);
        let [x, y, heading] = self.0[frame];
        Ok(Control::Pose { pose: Pose::new(x, y, heading), velocity: None })
    }

    fn boxed_clone(&self) -> Result<Box<dyn Driver>, Error> {
        Ok(Box::new(self.clone()))
    }
}
