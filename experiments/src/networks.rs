//! Networks with their weights, by the names that commands take.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use sage_backbones::{
    Backbone,
    parameters::Header,
    weights::{PRIOR_FILE, Weights},
};
use sage_core::registry::Registry;
use sage_generators::{Aggression, FittedDial};
use sage_merging::ExpertSet;

use crate::{progress, selection::Selection};

/// Variable of the environment: the folder of weights trained on recorded scenes.
const WEIGHTS_VARIABLE: &str = "SAGE_WEIGHTS";

/// Before the name of a backbone: its first weights, for a comparison.
const UNTRAINED: &str = "untrained:";

/// A network with what its file says.
pub(crate) struct Loaded {
    pub(crate) network: Box<dyn Backbone>,
    pub(crate) header: Header,
    /// What the user calls it.
    pub(crate) name: String,
}

/// Loads the prior of a name: `procedural`, `waymo`, a folder, a file, a backbone without weights, or
/// `untrained:` and a backbone.
///
/// *Errors*: no such weights, or weights that do not fit their network.
pub(crate) fn load(registry: &Registry<dyn Backbone>, name: &str) -> Result<Loaded> {
    if let Ok(entry) = registry.get(name) {
        let network = registry.build_default(entry.name)?;
        if !network.parameter_specs().is_empty() {
            bail!("`{name}` is a network without weights; name a folder of weights, `procedural` or `waymo`");
        }
        let header = Header { backbone: name.to_owned(), ..Header::default() };
        return Ok(Loaded { network, header, name: name.to_owned() });
    }
    if let Some(backbone) = name.strip_prefix(UNTRAINED) {
        let network = registry.build_default(backbone)?;
        let header = Header {
            backbone: backbone.to_owned(),
            options: network.options().clone(),
            command: "untrained".to_owned(),
            ..Header::default()
        };
        return Ok(Loaded { network, header, name: name.to_owned() });
    }
    let (network, header) = find(name)?.prior(registry)?;
    Ok(Loaded { network, header, name: name.to_owned() })
}

/// The weights of a name.
///
/// *Errors*: none are there.
fn find(name: &str) -> Result<Weights> {
    match name {
        "procedural" => {
            Ok(Weights::Carried { name: "weights/procedural (in the binary)", files: sage_weights::PROCEDURAL })
        }
        "waymo" => waymo()?.map(Weights::File).with_context(|| {
            format!(
                "no weights `waymo`: there is no `weights/waymo/{PRIOR_FILE}` here, and {WEIGHTS_VARIABLE} names no folder; use --weights procedural, or a folder"
            )
        }),
        _ => {
            let weights = Weights::at(Path::new(name));
            if matches!(&weights, Weights::File(file) if !file.is_file()) {
                bail!(
                    "no weights `{name}`: expected `procedural`, `waymo`, a file, or a folder that holds `{PRIOR_FILE}`"
                );
            }
            Ok(weights)
        }
    }
}

/// Weights trained on recorded scenes, if they are at hand.
///
/// *Errors*: the variable names a folder without them.
fn waymo() -> Result<Option<PathBuf>> {
    let file = |folder: PathBuf| Some(folder.join(PRIOR_FILE)).filter(|file| file.is_file());
    match std::env::var_os(WEIGHTS_VARIABLE).filter(|folder| !folder.is_empty()).map(PathBuf::from) {
        Some(folder) => match file(folder.join("waymo")).or_else(|| file(folder.clone())) {
            Some(found) => Ok(Some(found)),
            None => bail!(
                "{WEIGHTS_VARIABLE} is `{}`, which holds neither `waymo/{PRIOR_FILE}` nor `{PRIOR_FILE}`; correct or unset it",
                folder.display()
            ),
        },
        None => Ok(file(PathBuf::from("weights/waymo"))),
    }
}

/// Weights for a scene where the user names none: `waymo` for a recording if they are at hand.
///
/// *Errors*: a variable that names no weights.
pub(crate) fn default_for(is_procedural: bool) -> Result<&'static str> {
    Ok(if waymo()?.is_some() && !is_procedural { "waymo" } else { "procedural" })
}

/// Loads a prior with its experts: `procedural`, `waymo`, or a folder that `sage finetune` made.
///
/// *Errors*: as [`load`]; experts that are not there or do not fit the prior.
pub(crate) fn load_experts(registry: &Registry<dyn Backbone>, name: &str) -> Result<ExpertSet> {
    let loaded = ExpertSet::load(&find(name)?, registry);
    let (experts, header) = loaded.with_context(|| format!("weights `{name}`"))?;
    say_weights(name, experts.prior().name(), &header);
    Ok(experts)
}

/// The dial of some experts under a selection, as λ and μ by aggression.
///
/// *Errors*: none was fitted, or it was for other experts.
pub(crate) fn load_dial(
    name: &str,
    experts: &ExpertSet,
    selection: &Selection,
    merger: &str,
) -> Result<Aggression> {
    let dial = FittedDial::load(&find(name)?, experts, &selection.name, selection.objective.spec())?;
    if dial.merger != merger {
        progress::say(&format!(
            "warning: the dial was fitted for the merger `{}`; under `{merger}` it may not be even",
            dial.merger
        ));
    }
    Ok(dial.mu)
}

/// Says on stderr which weights are used.
pub(crate) fn announce(loaded: &Loaded) {
    say_weights(&loaded.name, loaded.network.name(), &loaded.header);
}

fn say_weights(name: &str, network: &str, header: &Header) {
    let terms = header.license.split('.').next().unwrap_or_default();
    let terms = if terms.is_empty() { String::new() } else { format!("; {}", terms.to_lowercase()) };
    progress::say(&format!("note: weights `{name}` (network {network}{terms})"));
}
