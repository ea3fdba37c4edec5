//! The protocol of work on one scene: read it, find what an earlier run finished, decode it, work on it; leave it out if it cannot be measured.

use std::path::Path;

use advsage::{in_one_line, leaves_out};
use sage_data::{ReadOptions, Recording};

use super::{Failure, Input, Line, SceneReport, is_row_of};
use crate::{Error, Result, WorkError, causes, output::DatasetRun};

/// A row of a scene that an earlier run wrote.
pub struct FoundRow {
    /// Hash of the file that it is of.
    pub source_hash: String,
    /// Its printed line.
    pub line: String,
    /// The files that it names.
    pub files: Vec<String>,
}

/// What a run does with each of its scenes. A row is written after the files that it names: a scene whose rows and files exist is finished.
pub trait SceneJob: Sync {
    /// An error of the work on a scene.
    type Error: WorkError;

    /// How scenes are read.
    fn reading(&self) -> ReadOptions;

    /// Files of the rows of a scene, in their order.
    fn rows(&self, scene: &str) -> Vec<String>;

    /// Reads a row of the run by its number in a scene; `None` if it is incomplete.
    fn found(&self, number: usize, path: &Path) -> Option<FoundRow>;

    /// Files of a finished scene that no row names, such as pages.
    fn pages(&self, _scene: &str) -> Vec<String> {
        Vec::new()
    }

    /// Works on a scene and writes its files.
    ///
    /// *Errors*: what is wrong with the scene. One in which the two cars touch *now* is left out.
    fn work(
        &self,
        run: &DatasetRun,
        scene: &SceneFile,
        recording: Recording,
    ) -> Result<SceneReport, Self::Error>;

    /// Writes what says that a scene is left out. Returns its lines.
    ///
    /// *Errors*: it cannot be written.
    fn leave_out(
        &self,
        _run: &DatasetRun,
        _scene: &SceneFile,
        _reason: &str,
    ) -> Result<Vec<Line>, Self::Error> {
        Ok(Vec::new())
    }
}

/// A scene that a job works on.
pub struct SceneFile<'i> {
    /// The file, and the name of its outputs.
    pub input: &'i Input,
    /// Hash of what is read of the file.
    pub hash: String,
}

/// Does a job in a scene, unless its files exist.
///
/// *Errors*: [`Failure`].
pub fn work_on<J: SceneJob>(
    job: &J,
    run: &DatasetRun,
    input: &Input,
) -> Result<SceneReport, Failure<J::Error>> {
    let reading = job.reading();
    let bytes = sage_data::read_bytes(&input.file).map_err(Error::from)?;
    let scene = SceneFile { input, hash: reading.source_hash(&bytes)[..16].to_owned() };
    if let Some(found) = finished(job, run, &scene)? {
        return Ok(found);
    }
    let recording = Recording::from_bytes_as(&input.file, bytes, &reading).map_err(Error::from)?;
    job.work(run, &scene, recording).map_err(|error| {
        if !causes(error.as_ref()).any(leaves_out) {
            return Failure::Scene(error);
        }
        let reason = in_one_line(error.as_ref());
        match job.leave_out(run, &scene, &reason) {
            Ok(lines) => Failure::LeftOut { reason, lines },
            Err(error) => Failure::Scene(error),
        }
    })
}

/// The lines of a scene whose files all exist; `None` if any is missing.
///
/// *Errors*: the rows are of another input file with the same name.
fn finished(job: &impl SceneJob, run: &DatasetRun, scene: &SceneFile) -> Result<Option<SceneReport>> {
    let folder = run.folder().path();
    let name = &scene.input.scene;
    // No file of a scene is empty.
    let exists =
        |file: &String| std::fs::metadata(folder.join(file)).is_ok_and(|f| f.is_file() && f.len() > 0);
    let (mut lines, mut files) = (Vec::new(), Vec::new());
    for (number, file) in job.rows(name).into_iter().enumerate() {
        let path = folder.join(&file);
        // A row of another run remains after --force with fewer scenes or shards.
        let row = if is_row_of(&path, run.hash()) { job.found(number, &path) } else { None };
        let Some(row) = row else { return Ok(None) };
        if row.source_hash != scene.hash {
            return Err(Error::Refused(format!(
                "`{}` is of another `{}`; remove it to do the scene again, or name another --out",
                path.display(),
                scene.input.file.display()
            )));
        }
        if !row.files.iter().all(exists) {
            return Ok(None);
        }
        lines.push(Line { text: row.line, row: file, seconds: None, step_ms: None });
        files.extend(row.files);
    }
    Ok(job.pages(name).iter().all(exists).then(|| SceneReport::found(lines, files)))
}
