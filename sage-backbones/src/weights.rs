//! Sources of weights (a folder, a file, or files embedded in a program), and the network built from them.

use std::path::{Path, PathBuf};

use candle_core::DType;
use sage_core::{files, registry::Registry};

use crate::{Error, Parameters, backbone::Backbone, parameters::Header};

/// File of a prior in a folder of weights.
pub const PRIOR_FILE: &str = "prior.safetensors";
/// Note in a header: which expert of a prior the file is.
pub const EXPERT_NOTE: &str = "expert";

/// A source of weights: a prior and the files beside it.
///
/// A prior in a folder of weights, written and loaded again:
///
/// ```
/// use sage_backbones::{
///     backbones,
///     parameters::Header,
///     weights::{PRIOR_FILE, Weights},
/// };
/// use serde_json::json;
///
/// let network = backbones()?.build("densetnt", &json!({"hidden": 8}))?;
/// let header =
///     Header { backbone: network.name().to_owned(), options: network.options().clone(), ..Header::default() };
/// let folder = tempfile::tempdir()?;
/// network.parameters().save(&header, &folder.path().join(PRIOR_FILE))?;
///
/// // The header of the file says which network its tensors belong to.
/// let (prior, _) = Weights::at(folder.path()).prior(&backbones()?)?;
/// assert_eq!(prior.name(), "densetnt");
/// assert_eq!(prior.parameters().hash()?, network.parameters().hash()?);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub enum Weights {
    /// The file of a prior; its folder holds the other files.
    File(PathBuf),
    /// Files embedded in a program.
    Carried {
        /// Name of the source in messages.
        name: &'static str,
        /// Names and contents.
        files: &'static [(&'static str, &'static [u8])],
    },
}

impl Weights {
    /// A folder that holds [`PRIOR_FILE`], or the file of a prior.
    pub fn at(path: &Path) -> Self {
        Self::File(if path.is_dir() { path.join(PRIOR_FILE) } else { path.to_owned() })
    }

    /// Path of a file beside the prior. For embedded files it is used in messages only.
    pub fn path(&self, name: &str) -> PathBuf {
        match self {
            Self::File(prior) => prior.with_file_name(name),
            Self::Carried { name: source, .. } => Path::new(source).join(name),
        }
    }

    /// Whether a name is that of the prior's file.
    pub fn is_prior(&self, name: &str) -> bool {
        match self {
            Self::File(prior) => prior.file_name().is_some_and(|own| own == name),
            Self::Carried { .. } => name == PRIOR_FILE,
        }
    }

    /// Whether a file of this name exists beside the prior.
    pub fn has(&self, name: &str) -> bool {
        match self {
            Self::File(_) => self.path(name).is_file(),
            Self::Carried { files, .. } => files.iter().any(|(known, _)| *known == name),
        }
    }

    /// Names of the files that hold tensors, sorted.
    pub fn tensor_files(&self) -> Vec<String> {
        let mut names: Vec<String> = match self {
            Self::Carried { files, .. } => files.iter().map(|(name, _)| (*name).to_owned()).collect(),
            Self::File(prior) => {
                let folder = prior.parent().filter(|folder| !folder.as_os_str().is_empty());
                let entries = std::fs::read_dir(folder.unwrap_or(Path::new("."))).into_iter().flatten();
                entries.flatten().filter_map(|entry| entry.file_name().into_string().ok()).collect()
            }
        };
        names.retain(|name| name.ends_with(".safetensors"));
        names.sort();
        names
    }

    /// Tensors of a file beside the prior.
    ///
    /// *Errors*: as [`Parameters::load`].
    pub fn tensors(&self, name: &str) -> Result<(Parameters, Header), Error> {
        self.read_tensors(&self.path(name), name)
    }

    fn read_tensors(&self, path: &Path, name: &str) -> Result<(Parameters, Header), Error> {
        match self {
            Self::File(_) => Parameters::load(path),
            Self::Carried { .. } => Parameters::from_bytes(self.carried(name)?, path),
        }
    }

    /// Text of a file beside the prior, of at most `limit` bytes.
    ///
    /// *Errors*: [`Error::Io`], [`Error::Format`].
    pub fn text(&self, name: &str, limit: u64) -> Result<String, Error> {
        let path = self.path(name);
        match self {
            Self::File(_) => {
                files::read_text(&path, limit).map_err(|source| Error::Io { verb: "read", path, source })
            }
            Self::Carried { .. } => String::from_utf8(self.carried(name)?.to_vec())
                .map_err(|_| Error::Format { path, problem: "is not text".to_owned() }),
        }
    }

    fn carried(&self, name: &str) -> Result<&'static [u8], Error> {
        let files = if let Self::Carried { files, .. } = self { *files } else { &[] };
        let found = files.iter().find(|(known, _)| *known == name);
        found.map(|(_, bytes)| *bytes).ok_or_else(|| Error::Io {
            verb: "read",
            path: self.path(name),
            source: std::io::ErrorKind::NotFound.into(),
        })
    }

    /// The prior and the header of its file.
    ///
    /// *Errors*: a file that is an expert, weights of another type than F32, a backbone that the registry
    /// does not hold, tensors that do not fit it.
    pub fn prior(&self, registry: &Registry<dyn Backbone>) -> Result<(Box<dyn Backbone>, Header), Error> {
        let path = match self {
            Self::File(path) => path.clone(),
            Self::Carried { .. } => self.path(PRIOR_FILE),
        };
        let (parameters, header) = self.read_tensors(&path, PRIOR_FILE)?;
        let fail = |problem| Err(Error::Format { path: path.clone(), problem });
        if let Some(expert) = header.notes.get(EXPERT_NOTE) {
            let expert = expert.escape_debug();
            return fail(format!(
                "is the {expert} expert of a prior, no prior; give the folder that holds it"
            ));
        }
        if let Some((name, tensor)) = parameters.iter().find(|(_, tensor)| tensor.dtype() != DType::F32) {
            return fail(format!(
                "tensor `{}` holds {:?}; the commands compute with F32: convert the weights",
                name.escape_debug(),
                tensor.dtype()
            ));
        }
        let network = registry.build(&header.backbone, &header.options);
        let network = match network {
            Ok(network) => network,
            Err(error) => return fail(format!("cannot be used: {error}")),
        };
        let network = network.load_parameters(parameters, &format!("`{}`", path.display()))?;
        Ok((network, header))
    }
}
