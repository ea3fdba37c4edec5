//! Networks with their weights, by the names that commands take.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use anyhow::{Context as _, Result, bail};
use sage_backbones::{Backbone, Parameters, candle::DType, parameters::Header};
use sage_core::{files, registry::Registry};
use sage_generators::{Aggression, Choice};
use sage_merging::{ExpertFile, Experts};
use serde::{Deserialize, Serialize};

use crate::progress;

/// Weights trained on made scenes, in the binary.
const PROCEDURAL: &[u8] = include_bytes!("../../weights/procedural/prior.safetensors");
/// Experts tuned from them.
const REALISTIC: &[u8] = include_bytes!("../../weights/procedural/realistic.safetensors");
const ADVERSARIAL: &[u8] = include_bytes!("../../weights/procedural/adversarial.safetensors");
/// Their even dial.
const DIAL: &str = include_str!("../../weights/procedural/dial.json");
/// File of the even dial in a folder of weights.
pub(crate) const DIAL_FILE: &str = "dial.json";
/// Largest file of a dial that is read, bytes.
const DIAL_LIMIT: u64 = 16 << 20;
/// Variable of the environment: the folder of weights trained on recorded scenes.
const WEIGHTS_VARIABLE: &str = "SAGE_WEIGHTS";
/// File of a prior in a folder of weights.
pub(crate) const PRIOR: &str = "prior.safetensors";

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
        if !network.wanted().is_empty() {
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
    let (parameters, header, from) = match name {
        "procedural" => {
            let from = PathBuf::from("weights/procedural (in the binary)");
            let (parameters, header) = Parameters::from_bytes(PROCEDURAL, &from)?;
            (parameters, header, from)
        }
        _ => {
            let path = find(name)?;
            let (parameters, header) = Parameters::load(&path)?;
            (parameters, header, path)
        }
    };
    if let Some(expert) = header.notes.get(ExpertFile::EXPERT) {
        bail!("`{}` is the {expert} expert of a prior, no prior; name the folder it lies in", from.display());
    }
    check_type(&parameters, &from)?;
    let network = registry
        .build(&header.backbone, &header.options)
        .with_context(|| format!("`{}` cannot be used", from.display()))?;
    let network = network.with_parameters(parameters, &format!("`{}`", from.display()))?;
    Ok(Loaded { network, header, name: name.to_owned() })
}

/// Refuses weights that the commands do not compute with.
fn check_type(parameters: &Parameters, from: &Path) -> Result<()> {
    match parameters.iter().find(|(_, tensor)| tensor.dtype() != DType::F32) {
        Some((name, tensor)) => bail!(
            "`{}`: tensor `{}` holds {:?}; the commands compute with F32: convert the weights",
            from.display(),
            name.escape_debug(),
            tensor.dtype()
        ),
        None => Ok(()),
    }
}

/// The file of weights of a name.
fn find(name: &str) -> Result<PathBuf> {
    if name == "waymo" {
        return waymo()?.with_context(|| {
            format!(
                "no weights `waymo`: there is no `weights/waymo/{PRIOR}` here, and {WEIGHTS_VARIABLE} names no folder; use --weights procedural, or a folder"
            )
        });
    }
    let path = Path::new(name);
    let file = if path.is_dir() { path.join(PRIOR) } else { path.to_owned() };
    if !file.is_file() {
        bail!(
            "no weights `{name}`: expected `procedural`, `waymo`, a file, or a folder that holds `{PRIOR}`"
        );
    }
    Ok(file)
}

/// Weights trained on recorded scenes, if they are at hand.
///
/// *Errors*: the variable names a folder without them.
fn waymo() -> Result<Option<PathBuf>> {
    let file = |folder: PathBuf| Some(folder.join(PRIOR)).filter(|file| file.is_file());
    match std::env::var_os(WEIGHTS_VARIABLE).filter(|folder| !folder.is_empty()).map(PathBuf::from) {
        Some(folder) => match file(folder.join("waymo")).or_else(|| file(folder.clone())) {
            Some(found) => Ok(Some(found)),
            None => bail!(
                "{WEIGHTS_VARIABLE} is `{}`, which holds neither `waymo/{PRIOR}` nor `{PRIOR}`; correct or unset it",
                folder.display()
            ),
        },
        None => Ok(file(PathBuf::from("weights/waymo"))),
    }
}

/// Weights for a scene where the user names none: `waymo` for a recording if they are at hand.
///
/// *Errors*: a variable that names no weights.
pub(crate) fn default_for(is_made: bool) -> Result<&'static str> {
    Ok(if waymo()?.is_some() && !is_made { "waymo" } else { "procedural" })
}

/// Loads a prior with its experts: `procedural`, `waymo`, or a folder that `sage finetune` made.
///
/// *Errors*: as [`load`]; experts that are not there or do not fit the prior.
pub(crate) fn load_experts(registry: &Registry<dyn Backbone>, name: &str) -> Result<Experts> {
    let loaded = load(registry, name)?;
    announce(&loaded);
    let file = |expert: &str, embedded: &[u8]| -> Result<ExpertFile> {
        let name_of_file = format!("{expert}.safetensors");
        if name == "procedural" {
            let path = PathBuf::from(name_of_file);
            let (parameters, header) = Parameters::from_bytes(embedded, &path)?;
            return Ok(ExpertFile { path, parameters, header });
        }
        let path = find(name)?.with_file_name(name_of_file);
        if !path.is_file() {
            bail!("`{}` is not there: `sage finetune` makes experts of a prior", path.display());
        }
        Ok(ExpertFile::load(path)?)
    };
    let (realistic, adversarial) = (file("realistic", REALISTIC)?, file("adversarial", ADVERSARIAL)?);
    Experts::of_files(loaded.network, realistic, adversarial).with_context(|| format!("weights `{name}`"))
}

/// The even dial of some experts under a choice.
///
/// *Errors*: none was fitted, or it was for other experts.
pub(crate) fn load_dial(name: &str, experts: &Experts, choice: Choice) -> Result<Aggression> {
    let remedy = "`sage calibrate` fits one";
    let (text, from) = if name == "procedural" {
        (DIAL.to_owned(), "weights/procedural (in the binary)".to_owned())
    } else {
        let path = find(name)?.with_file_name(DIAL_FILE);
        let text = files::read_text(&path, DIAL_LIMIT)
            .with_context(|| format!("no dial `{}`: {remedy}", path.display()))?;
        (text, path.display().to_string())
    };
    let dials: Dials = serde_json::from_str(&text).with_context(|| format!("`{from}`"))?;
    let dial = dials.by_choice.into_iter().find(|(known, _)| *known == choice.name());
    let (_, fitted) =
        dial.with_context(|| format!("`{from}` has no dial for --choice {}: {remedy}", choice.name()))?;
    if fitted.experts != hashes(experts)? {
        bail!("the dial in `{from}` was fitted for other experts: {remedy}");
    }
    Ok(fitted.mu)
}

/// What tells experts from others.
pub(crate) fn hashes(experts: &Experts) -> Result<[String; 2]> {
    Ok([experts.realistic().hash()?, experts.adversarial().hash()?])
}

/// What `dial.json` holds.
#[derive(Debug, Default, Serialize, Deserialize)]
pub(crate) struct Dials {
    /// A dial a choice.
    #[serde(flatten)]
    pub(crate) by_choice: BTreeMap<String, FittedDial>,
}

/// A dial with what it was fitted on.
#[derive(Debug, Serialize, Deserialize)]
pub(crate) struct FittedDial {
    /// μ at evenly spaced aggressions.
    pub(crate) mu: Aggression,
    /// Hashes of the realistic and the adversarial expert.
    pub(crate) experts: [String; 2],
    /// Attack rate there on the scenes it was fitted on.
    pub(crate) attack: Vec<f64>,
    /// The scenes.
    pub(crate) data: String,
    /// The command.
    pub(crate) command: String,
}

/// Says on stderr which weights are used.
pub(crate) fn announce(loaded: &Loaded) {
    let Loaded { network, header, name } = loaded;
    let terms = header.license.split('.').next().unwrap_or_default();
    let terms = if terms.is_empty() { String::new() } else { format!("; {}", terms.to_lowercase()) };
    progress::say(&format!("note: weights `{name}` (network {}{terms})", network.name()));
}
