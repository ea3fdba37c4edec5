//! `simulate --check-planner`: whether a planner drives the same each time.

use std::sync::Arc;

use advsage::{Registries, driver_spec::DriverSpec, ego::Ego};
use anyhow::{Result, ensure};
use sage_core::scene::SceneIndex;
use sage_data::Recording;
use sage_run::{
    progress::{self, count},
    scene_queue::Input,
};
use sage_sim::{
    SimScene,
    drive::{Drive, Simulation, drive},
};

use crate::cli::SimulateArgs;

/// Scenes that are driven.
const SCENES: usize = 10;

/// Drives ten scenes three times: by one process, by the same in the opposite order, and by another process in that
/// order. All drives of a scene must be the same, bit for bit.
///
/// *Errors*: they are not; no planner is named, or one fails.
pub(super) fn check(
    args: &SimulateArgs,
    planners: &[DriverSpec],
    registries: &Registries,
    inputs: &[Input],
) -> Result<()> {
    ensure!(!planners.is_empty(), "--check-planner needs a planner that is a program: --ego 'cmd:COMMAND'");
    let readable = inputs.iter().filter_map(|input| {
        let scene = Arc::new(Recording::read_as(&input.file, &args.reading.options()).ok()?.scene);
        let index = SceneIndex::new(scene.map.clone());
        SimScene::new(scene, index).ok()
    });
    let scenes: Vec<Arc<SimScene>> = readable.take(SCENES).collect();
    ensure!(!scenes.is_empty(), "no scene can be driven, so the planner cannot be checked");
    for part in planners {
        let seed = args.options.generator.seed;
        let all = |ego: &Ego, is_reversed: bool| -> Result<Vec<Drive>> {
            let one = |scene: &Arc<SimScene>| -> Result<Drive> {
                Ok(drive(&mut Simulation::new(scene, &Arc::default(), None, &*ego.policy, seed)?)?)
            };
            if is_reversed {
                let mut drives = scenes.iter().rev().map(one).collect::<Result<Vec<_>>>()?;
                drives.reverse();
                Ok(drives)
            } else {
                scenes.iter().map(one).collect()
            }
        };
        let first = Ego::new(part, registries)?;
        let expected = all(&first, false)?;
        let again = all(&first, true)?;
        drop(first);
        let other = all(&Ego::new(part, registries)?, true)?;
        for (found, how) in [(&again, "in another order"), (&other, "in another process")] {
            let differing: Vec<String> = scenes
                .iter()
                .zip(expected.iter().zip(found))
                .filter_map(|(scene, (a, b))| Some((scene, first_difference(a, b)?)))
                .map(|(scene, step)| format!("`{}` from step {step} on", scene.scene().id))
                .collect();
            ensure!(
                differing.is_empty(),
                "the planner `{part}` drives differently {how}: {} of {}: {}; what it answers depends on more than the messages since `reset`: a state that is kept, a clock, or random numbers without the seed",
                differing.len(),
                count(scenes.len(), "scene"),
                differing.join(", ")
            );
        }
        progress::say(&format!(
            "the planner `{part}` drives {} the same in any order and in another process",
            count(scenes.len(), "scene")
        ));
    }
    Ok(())
}

/// The first step at which two drives are not the same.
fn first_difference(a: &Drive, b: &Drive) -> Option<usize> {
    let differs = (0..a.motions.len().max(b.motions.len())).find(|k| a.motions.get(*k) != b.motions.get(*k));
    differs.or_else(|| (a.contacts != b.contacts).then(|| a.motions.len() - 1))
}
