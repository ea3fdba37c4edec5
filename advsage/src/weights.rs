//! Networks and weights by the names that users give.

use std::path::{Path, PathBuf};

use sage_backbones::{
    Backbone,
    parameters::Header,
    weights::{PRIOR_FILE, Weights},
};
use sage_core::registry::Registry;
use sage_merging::ExpertSet;

use crate::{Error, Result, WithContext as _};

/// Environment variable that names the folder of weights trained on recorded scenes.
pub const WEIGHTS_VARIABLE: &str = "SAGE_WEIGHTS";

/// Weights that are used unless others are named: free, in the program, and the same from any folder.
pub const DEFAULT: &str = "procedural";
/// Weights trained on recorded scenes.
const WAYMO: &str = "waymo";
/// The same prior with experts of the paper's objectives.
const WAYMO_PAPER: &str = "waymo-paper";
/// The same prior with experts tuned with the paper's hyper-parameters.
const WAYMO_LITERAL: &str = "waymo-literal";
/// Names of the weights that this project ships.
pub const SHIPPED: [&str; 4] = [DEFAULT, WAYMO, WAYMO_PAPER, WAYMO_LITERAL];
/// Prefix of a backbone's name that selects its initial weights, as a baseline.
const UNTRAINED: &str = "untrained:";

/// A network with the header of its file.
pub struct NamedNetwork {
    /// Name that the user gave.
    pub name: String,
    /// The network.
    pub network: Box<dyn Backbone>,
    /// Header of its file.
    pub header: Header,
}

impl NamedNetwork {
    /// Loads a prior by name: `procedural`, `waymo`, a folder, a file, a backbone without weights, or
    /// `untrained:` and a backbone.
    ///
    /// *Errors*: there are no such weights, or they do not match their network.
    pub fn load(registry: &Registry<dyn Backbone>, name: &str) -> Result<Self> {
        let (network, header) = if let Ok(entry) = registry.get(name) {
            let network = registry.build_default(entry.name)?;
            if !network.parameter_specs().is_empty() {
                return Err(Error::Value(format!(
                    "`{name}` is a network without weights; name a folder of weights, `procedural` or `waymo`"
                )));
            }
            (network, Header { backbone: name.to_owned(), ..Header::default() })
        } else if let Some(backbone) = name.strip_prefix(UNTRAINED) {
            let network = registry.build_default(backbone)?;
            let header = Header {
                backbone: backbone.to_owned(),
                options: network.options().clone(),
                command: "untrained".to_owned(),
                ..Header::default()
            };
            (network, header)
        } else {
            let (network, header) = find(name)?.prior(registry)?;
            return Ok(Self { name: name.to_owned(), network, header });
        };
        Ok(Self { name: name.to_owned(), network, header })
    }

    /// Which weights these are, in one line.
    pub fn description(&self) -> String {
        described(&self.name, self.network.name(), &self.header)
    }
}

/// A prior with its experts.
///
/// ```
/// use advsage::{Registries, weights::NamedExperts};
///
/// // Weights that are in the program: experts for λ = 0 and λ = 1, and one that keeps the traffic rules.
/// let shipped = NamedExperts::load(&Registries::of_attacks()?.backbones, "procedural")?;
/// assert_eq!(shipped.experts.names(), ["realistic", "adversarial", "lawful"]);
/// # Ok::<(), advsage::Error>(())
/// ```
pub struct NamedExperts {
    /// Name that the user gave.
    pub name: String,
    /// The prior and its experts.
    pub experts: ExpertSet,
    /// Header of the prior's file.
    pub header: Header,
}

impl NamedExperts {
    /// Loads a prior with its experts: `procedural`, `waymo`, or a folder that `sage finetune` wrote.
    ///
    /// *Errors*: as [`NamedNetwork::load`]; an expert is missing or does not match the prior.
    pub fn load(registry: &Registry<dyn Backbone>, name: &str) -> Result<Self> {
        let found = ExpertSet::load(&find(name)?, registry);
        let (experts, header) = found.with_context(|| format!("weights `{name}`"))?;
        Ok(Self { name: name.to_owned(), experts, header })
    }

    /// The prior of some weights without its experts.
    ///
    /// *Errors*: as [`NamedNetwork::load`].
    fn load_prior(registry: &Registry<dyn Backbone>, name: &str) -> Result<Self> {
        let source = find(name)?;
        let (prior, header) = source.prior(registry).with_context(|| format!("weights `{name}`"))?;
        let experts = ExpertSet::of_prior(prior.into()).from_source(source);
        Ok(Self { name: name.to_owned(), experts, header })
    }

    /// What a generator needs of the weights that a user names, or of [`DEFAULT`]; its experts only if λ mixes them.
    ///
    /// *Errors*: as [`Self::load`].
    pub(crate) fn load_for(
        registry: &Registry<dyn Backbone>,
        name: Option<&str>,
        needs_experts: bool,
    ) -> Result<Self> {
        let load = if needs_experts { Self::load } else { Self::load_prior };
        load(registry, name.unwrap_or(DEFAULT))
    }

    /// Which weights these are, in one line.
    pub fn description(&self) -> String {
        described(&self.name, self.experts.prior().name(), &self.header)
    }
}

/// Finds weights by name.
///
/// *Errors*: there are no such weights.
pub(crate) fn find(name: &str) -> Result<Weights> {
    match name {
        DEFAULT => {
            Ok(Weights::Carried { name: "weights/procedural (in the binary)", files: &sage_weights::PROCEDURAL })
        }
        WAYMO | WAYMO_PAPER | WAYMO_LITERAL => recorded(name)?.map(Weights::File).ok_or_else(|| {
            Error::Unknown(format!(
                "no weights `{name}`: there is no `weights/{name}/{PRIOR_FILE}` in this folder, and {WEIGHTS_VARIABLE} is not set or holds none; use the weights `procedural`, or a folder"
            ))
        }),
        _ => {
            let weights = Weights::at(Path::new(name));
            if matches!(&weights, Weights::File(file) if !file.is_file()) {
                return Err(Error::Unknown(format!(
                    "no weights `{name}`: expected {}, a file, or a folder that holds `{PRIOR_FILE}`",
                    SHIPPED.map(|name| format!("`{name}`")).join(", ")
                )));
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
        (None, None) => Err(Error::Unknown(format!(
            "{WEIGHTS_VARIABLE} is `{}`, which holds neither `{WAYMO}/{PRIOR_FILE}` nor `{PRIOR_FILE}`; correct or unset it",
            folder.display()
        ))),
    }
}

/// Folder of the weights with a name, if there is one.
pub fn folder_of(name: &str) -> Option<PathBuf> {
    let file = if [WAYMO, WAYMO_PAPER, WAYMO_LITERAL].contains(&name) { recorded(name).ok()? } else { None };
    file.and_then(|file| Some(file.parent()?.to_owned()))
}

fn described(name: &str, network: &str, header: &Header) -> String {
    // The first sentence; `MIT OR Apache-2.0` is none.
    let terms = match header.license.split_once(". ") {
        Some((first, _)) => format!("; {}", first.to_lowercase()),
        None if header.license.is_empty() => String::new(),
        None => format!("; {}", header.license),
    };
    format!("weights `{name}` (network {network}{terms})")
}
