//! `sage draw`: draws a scene and candidates of its adversary from above.

use std::sync::Arc;

use anyhow::Result;
use sage_core::{
    objective::{Context, ContextOptions},
    scene::{Scene, SceneIndex},
};
use sage_run::{Outcome, input, output::OutputFile};
use sage_view::drawing::{self, DrawnPath, Picture, drawn_path};

use crate::{candidates, candidates::NamedCandidate, cli::DrawArgs};

pub(crate) fn run(args: &DrawArgs) -> Result<Outcome> {
    let out = OutputFile::claim(&args.out, args.force)?;
    let scene = candidates::read_scene(
        &args.scene,
        &args.reading.options(),
        args.ego.as_deref(),
        args.adversary.as_deref(),
    )?;
    if let Some(frame) = args.frame.filter(|frame| *frame >= scene.frames) {
        anyhow::bail!("`{}` has no frame {frame}; its last is {}", args.scene.display(), scene.frames - 1);
    }
    let scene = Arc::new(scene);
    let mut candidates = args.candidates.as_deref().map(candidates::read).transpose()?.unwrap_or_default();
    // The legend names the first few; a refined plan is the last.
    candidates.sort_by_key(|candidate| !candidate.name.ends_with(candidates::SELECTED));
    let title = input::scene_name(&args.scene)?;
    let picture = Picture {
        title,
        frame: args.frame,
        candidates: drawn(&scene, candidates)?,
        whole_map: args.whole_map,
        ..Picture::default()
    };
    out.write(drawing::draw(&scene, &picture).as_bytes())?;
    Ok(Outcome::Done)
}

/// Candidates with their first contact with the ego.
fn drawn(scene: &Arc<Scene>, candidates: Vec<NamedCandidate>) -> Result<Vec<DrawnPath>> {
    let index = SceneIndex::new(scene.map.clone());
    let draw = |named: NamedCandidate| {
        let options = ContextOptions { ego: named.ego, ..ContextOptions::default() };
        let ctx = Context::new(scene, &index, &options)?;
        Ok(drawn_path(named.name, &ctx, named.trajectory))
    };
    candidates.into_iter().map(draw).collect()
}
