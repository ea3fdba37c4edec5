//! Loads networks and weights by the names that commands accept.

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

/// Environment variable that names the folder of weights trained on recorded scenes.
const WEIGHTS_VARIABLE: &str = "SAGE_WEIGHTS";

/// Weights that every command uses unless others are named: free, in the binary, and the same from any folder.
pub(crate) const DEFAULT: &str = "procedural";
/// Weights trained on recorded scenes.
const WAYMO: &str = "waymo";
/// The same prior with experts of the paper's objectives.
const WAYMO_PAPER: &str = "waymo-paper";
/// Names of the weights that this project ships.
const SHIPPED: [&str; 3] = [DEFAULT, WAYMO, WAYMO_PAPER];
/// Prefix of a backbone's name that selects its initial weights, as a baseline.
const UNTRAINED: &str = "untrained:";

/// A network with the header of its file.
pub(crate) struct Loaded {
    pub(crate) network: Box<dyn Backbone>,
    pub(crate) header: Header,
    /// Name that the user gave.
    pub(crate) name: String,
}

/// Loads a prior by name: `procedural`, `waymo`, a folder, a file, a backbone without weights, or
/// `untrained:` and a backbone.
///
/// *Errors*: there are no such weights, or they do not match their network.
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
    let weights = find(name)?;
    let (network, header) = weights.prior(registry)?;
    note_missing_hash(name, &header, &[]);
    Ok(Loaded { network, header, name: name.to_owned() })
}

/// Finds weights by name.
///
/// *Errors*: there are no such weights.
fn find(name: &str) -> Result<Weights> {
    match name {
        DEFAULT => {
            Ok(Weights::Carried { name: "weights/procedural (in the binary)", files: sage_weights::PROCEDURAL })
        }
        WAYMO | WAYMO_PAPER => recorded(name)?.map(Weights::File).with_context(|| {
            format!(
                "no weights `{name}`: there is no `weights/{name}/{PRIOR_FILE}` in this folder, and {WEIGHTS_VARIABLE} is not set or holds none; use --weights procedural, or a folder"
            )
        }),
        _ => {
            let weights = Weights::at(Path::new(name));
            if matches!(&weights, Weights::File(file) if !file.is_file()) {
                bail!(
                    "no weights `{name}`: expected `procedural`, `waymo`, `waymo-paper`, a file, or a folder that holds `{PRIOR_FILE}`"
                );
            }
            Ok(weights)
        }
    }
}

/// File of weights trained on recorded scenes, if it is available. The environment variable names a folder of
/// several weights, or that of `waymo`.
///
/// *Errors*: the environment variable names a folder without weights.
fn recorded(name: &str) -> Result<Option<PathBuf>> {
    let file = |folder: PathBuf| Some(folder.join(PRIOR_FILE)).filter(|file| file.is_file());
    let Some(folder) = std::env::var_os(WEIGHTS_VARIABLE).filter(|folder| !folder.is_empty()) else {
        return Ok(file(Path::new("weights").join(name)));
    };
    let folder = PathBuf::from(folder);
    let [own, waymo] = [name, WAYMO].map(|name| file(folder.join(name)));
    match (own, waymo.or_else(|| file(folder.clone()))) {
        (Some(found), _) => Ok(Some(found)),
        (None, Some(found)) => Ok(Some(found).filter(|_| name == WAYMO)),
        (None, None) => bail!(
            "{WEIGHTS_VARIABLE} is `{}`, which holds neither `{WAYMO}/{PRIOR_FILE}` nor `{PRIOR_FILE}`; correct or unset it",
            folder.display()
        ),
    }
}

/// Folder of the weights with a name, if there is one.
pub(crate) fn folder_of(name: &str) -> Option<PathBuf> {
    let file = if [WAYMO, WAYMO_PAPER].contains(&name) { recorded(name).ok()? } else { None };
    file.and_then(|file| Some(file.parent()?.to_owned()))
}

/// Loads a prior with its experts: `procedural`, `waymo`, or a folder that `sage finetune` wrote.
///
/// *Errors*: as [`load`]; an expert is missing or does not match the prior.
pub(crate) fn load_experts(registry: &Registry<dyn Backbone>, name: &str) -> Result<ExpertSet> {
    let (experts, header) = find_experts(registry, name)?;
    announce_experts(name, &experts, &header);
    Ok(experts)
}

/// As [`load_experts`], without a message.
///
/// *Errors*: as [`load_experts`].
pub(crate) fn find_experts(registry: &Registry<dyn Backbone>, name: &str) -> Result<(ExpertSet, Header)> {
    let found = ExpertSet::load(&find(name)?, registry).with_context(|| format!("weights `{name}`"));
    let (experts, header) = found?;
    note_missing_hash(name, &header, experts.files_without_hash());
    Ok((experts, header))
}

/// Prints once on stderr if files hold no hash of their content. Nothing is said of shipped weights.
fn note_missing_hash(name: &str, prior: &Header, experts: &[PathBuf]) {
    if SHIPPED.contains(&name) || prior.is_hashed && experts.is_empty() {
        return;
    }
    let which = experts.first().filter(|_| prior.is_hashed);
    let which = which.map_or_else(|| "the prior".to_owned(), |path| format!("`{}`", path.display()));
    progress::say_once(&format!(
        "note: weights `{name}`: {which} holds no hash of its content, so damage would not be noticed; files of this version hold one"
    ));
}

/// The prior of some weights without its experts.
///
/// *Errors*: as [`load`].
pub(crate) fn find_prior(registry: &Registry<dyn Backbone>, name: &str) -> Result<(ExpertSet, Header)> {
    let (prior, header) = find(name)?.prior(registry).with_context(|| format!("weights `{name}`"))?;
    note_missing_hash(name, &header, &[]);
    Ok((ExpertSet::of_prior(prior.into()), header))
}

/// Prints on stderr which experts are used.
pub(crate) fn announce_experts(name: &str, experts: &ExpertSet, header: &Header) {
    say_weights(name, experts.prior().name(), header);
}

/// Loads the dial that was fitted for a set of experts and a selection, without a message.
///
/// *Errors*: no dial was fitted, or it was fitted for other experts.
pub(crate) fn find_dial(name: &str, experts: &ExpertSet, selection: &Selection) -> Result<FittedDial> {
    Ok(FittedDial::load(&find(name)?, experts, &selection.name, selection.objective.spec())?)
}

/// Loads the dial that was fitted for a set of experts and a selection. It maps aggression to λ and μ.
///
/// *Errors*: no dial was fitted, or it was fitted for other experts.
pub(crate) fn load_dial(
    name: &str,
    experts: &ExpertSet,
    selection: &Selection,
    merger: &str,
) -> Result<Aggression> {
    let dial = find_dial(name, experts, selection)?;
    if dial.merger != merger {
        progress::say(&format!(
            "warning: the dial was fitted for the merger `{}`; with `{merger}` the attack rate may not rise linearly",
            dial.merger
        ));
    }
    Ok(dial.mu)
}

/// Prints on stderr which weights are used.
pub(crate) fn announce(loaded: &Loaded) {
    say_weights(&loaded.name, loaded.network.name(), &loaded.header);
}

fn say_weights(name: &str, network: &str, header: &Header) {
    let terms = header.license.split('.').next().unwrap_or_default();
    let terms = if terms.is_empty() { String::new() } else { format!("; {}", terms.to_lowercase()) };
    progress::say(&format!("note: weights `{name}` (network {network}{terms})"));
}
