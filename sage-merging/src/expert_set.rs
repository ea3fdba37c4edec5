//! Sets of any number of experts tuned from one prior.

use std::{path::PathBuf, sync::Arc};

use sage_backbones::{
    Backbone, MotionModel, OwnEncoder, Parameters,
    backbone::{ParameterGroup, Shared},
    candle::{DType, Tensor},
    parameters::Header,
    training::Tunes,
    weights::Weights,
};
use sage_core::{generator::Mixture, registry::Registry};
use serde_json::Value;

use crate::Error;

/// The expert at λ = 0.
pub const REALISTIC: &str = "realistic";
/// The expert at λ = 1.
pub const ADVERSARIAL: &str = "adversarial";
/// The expert that keeps the traffic rules; a mixture by λ gives it no weight.
pub const LAWFUL: &str = "lawful";

/// A prior and its experts, checked: all have the same tensors, and tensors that fine-tuning does not
/// change have the same bits.
///
/// Two experts that are still their prior, and the mixture at a λ:
///
/// ```
/// use std::sync::Arc;
///
/// use sage_backbones::{Backbone, backbones};
/// use sage_merging::{ADVERSARIAL, ExpertSet, REALISTIC};
/// use serde_json::json;
///
/// let prior: Arc<dyn Backbone> = backbones()?.build("densetnt", &json!({"hidden": 8}))?.into();
/// let expert = |name: &str| (name.to_owned(), prior.parameters().clone());
/// let experts = ExpertSet::new(prior.clone(), vec![expert(REALISTIC), expert(ADVERSARIAL)])?;
/// assert_eq!(experts.between(0.75)?.weights(), [0.25, 0.75]);
/// assert_eq!(experts.mixture(&[(ADVERSARIAL, 0.75)])?.weights(), [0.0, 0.75]);
/// // Names are checked: there is no third expert.
/// assert!(experts.mixture(&[("lawful", 1.0)]).is_err());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone)]
pub struct ExpertSet {
    prior: Arc<dyn Backbone>,
    experts: Arc<[(String, Parameters)]>,
    tunes: Tunes,
    source: Option<Weights>,
}

/// Content of an expert's file.
pub struct ExpertFile {
    /// The file, for messages.
    pub path: PathBuf,
    /// Name of the expert that the header must give.
    pub named: String,
    /// The weights.
    pub parameters: Parameters,
    /// The header of the file.
    pub header: Header,
}

impl ExpertFile {
    /// Note in the header: name of the expert, such as `realistic` or `adversarial`.
    pub const EXPERT: &str = sage_backbones::weights::EXPERT_NOTE;
    /// Note in the header: hash of the prior that the expert was tuned from.
    pub const PRIOR: &str = "prior";
    /// Note in the header: [`Tunes`] of the expert; without it, [`Tunes::Scores`].
    pub const TUNES: &str = "tunes";

    /// What the file of an expert of a prior holds: the tensors that fine-tuning may change. The others are the prior's.
    pub fn content(prior: &dyn Backbone, expert: &Parameters, tunes: Tunes) -> Parameters {
        let tuned = expert.iter().filter(|(name, _)| is_tuned(prior, name, tunes));
        tuned.map(|(name, tensor)| (name.to_owned(), tensor.clone())).collect()
    }

    /// What was tuned.
    ///
    /// *Errors*: a note that names nothing known.
    fn tunes(&self) -> Result<Tunes, Error> {
        let Some(note) = self.header.notes.get(Self::TUNES) else { return Ok(Tunes::default()) };
        serde_json::from_value(Value::from(&**note)).map_err(|_| {
            let problem = format!(
                "the note `{}` is `{}`; expected `scores` or `all`",
                Self::TUNES,
                note.escape_debug()
            );
            sage_backbones::Error::Format { path: self.path.clone(), problem }.into()
        })
    }

    /// The weights, if the file holds that expert of that prior.
    fn checked(self, prior: &str, options: &Value) -> Result<Parameters, Error> {
        let expert = &self.named;
        let remedy = "recreate the experts with `sage finetune`";
        let notes = &self.header.notes;
        let foreign = self.parameters.iter().find(|(_, tensor)| tensor.dtype() != DType::F32);
        let problem = match (notes.get(Self::EXPERT), notes.get(Self::PRIOR), foreign) {
            (None, ..) | (_, None, _) => {
                format!("the header does not name the expert and its prior: {remedy}")
            }
            (Some(named), ..) if named != expert => format!(
                "the header names the {named} expert, expected the {expert} one: the files were swapped or renamed"
            ),
            (_, Some(from), _) if from != prior => format!(
                "the {expert} expert was tuned from another prior ({from}) than the given prior ({prior}): {remedy}"
            ),
            (.., Some((name, tensor))) => format!(
                "tensor `{}` holds {:?}; experts are mixed in F32: convert the weights",
                name.escape_debug(),
                tensor.dtype()
            ),
            (.., None) if edges(&self.header.options) != edges(options) => format!(
                "the {expert} expert was tuned with the edges `{}` in its features, the prior has `{}`: use the prior that `sage finetune` wrote beside it",
                edges(&self.header.options),
                edges(options)
            ),
            (.., None) => return Ok(self.parameters),
        };
        Err(sage_backbones::Error::Format { path: self.path, problem }.into())
    }
}

/// The edges in a network's features by its options; networks without the option have road boundaries.
fn edges(options: &Value) -> &str {
    options.get("edges").and_then(Value::as_str).unwrap_or("boundaries")
}

/// One tensor of the prior and of every expert, flattened.
pub struct TensorSet<'t> {
    /// Its name.
    pub name: &'t str,
    /// The prior's values.
    pub prior: &'t [f32],
    /// Each expert's values, in the order of the set.
    pub experts: &'t [Vec<f32>],
}

/// A tensor that fine-tuning changed in some expert, flattened.
pub(crate) struct TunedTensor {
    pub name: String,
    pub shape: Vec<usize>,
    pub prior: Vec<f32>,
    experts: Vec<Vec<f32>>,
}

impl TunedTensor {
    pub fn set(&self) -> TensorSet<'_> {
        TensorSet { name: &self.name, prior: &self.prior, experts: &self.experts }
    }
}

impl ExpertSet {
    /// Loads a prior and its experts from a folder of weights: all files whose header names an expert, the
    /// realistic and the adversarial one first, others by name.
    ///
    /// *Errors*: those of [`Weights::prior`], and of [`ExpertSet::of_files`]; no expert, or a file of
    /// tensors that cannot be read.
    pub fn load(weights: &Weights, registry: &Registry<dyn Backbone>) -> Result<(Self, Header), Error> {
        let (prior, header) = weights.prior(registry)?;
        let mut files = Vec::new();
        for file in weights.tensor_files() {
            let Some(name) = file.strip_suffix(".safetensors") else { continue };
            let path = weights.path(&file);
            if weights.is_prior(&file) {
                continue;
            }
            // A file named as an expert without the note is refused; checkpoints of training and driving policies are
            // skipped.
            let is_named = [REALISTIC, ADVERSARIAL].contains(&name);
            let (parameters, header) = match weights.tensors(&file) {
                Err(sage_backbones::Error::NoNetwork { .. }) if !is_named => continue,
                read => read?,
            };
            if is_named || header.notes.contains_key(ExpertFile::EXPERT) {
                let named = name.to_owned();
                files.push((named.clone(), ExpertFile { path, named, parameters, header }));
            }
        }
        if files.is_empty() {
            let path = weights.path(&format!("{REALISTIC}.safetensors"));
            let problem = "does not exist: `sage finetune` tunes experts from a prior".to_owned();
            return Err(sage_backbones::Error::Format { path, problem }.into());
        }
        files.sort_by_key(|(name, _)| (name != REALISTIC, name != ADVERSARIAL, name.clone()));
        Ok((Self::of_files(prior.into(), files)?.from_source(weights.clone()), header))
    }

    /// A prior without experts, for what needs no mixture.
    pub fn of_prior(prior: Arc<dyn Backbone>) -> Self {
        Self { prior, experts: Arc::new([]), tunes: Tunes::Scores, source: None }
    }

    /// The same with the place that it was loaded from, where files of other networks lie beside the prior.
    pub fn from_source(self, source: Weights) -> Self {
        Self { source: Some(source), ..self }
    }

    /// Where it was loaded from; `None` if it was put together in memory.
    pub fn source(&self) -> Option<&Weights> {
        self.source.as_ref()
    }

    /// The experts of a prior from their files, by names of the caller.
    ///
    /// *Errors*: a file that holds another expert, an expert of another prior, or no note of either; else
    /// as [`ExpertSet::new`].
    pub fn of_files(
        prior: Arc<dyn Backbone>,
        files: impl IntoIterator<Item = (String, ExpertFile)>,
    ) -> Result<Self, Error> {
        let hash = prior.parameters().hash()?;
        let mut tunes = Tunes::Scores;
        let checked = files.into_iter().map(|(name, file)| {
            // One expert with its own encoder makes all models of the set encode for themselves.
            let own_tunes = file.tunes()?;
            if own_tunes == Tunes::All {
                tunes = Tunes::All;
            }
            let mut parameters = file.checked(&hash, prior.options())?;
            // A file need not repeat what is the prior's.
            for (name, tensor) in prior.parameters().iter() {
                if parameters.get(name).is_none() && !is_tuned(&*prior, name, own_tunes) {
                    parameters.insert(name, tensor.clone());
                }
            }
            Ok((name, parameters))
        });
        let experts = checked.collect::<Result<Vec<_>, Error>>()?;
        Self::tuned(prior, experts, tunes)
    }

    /// A prior and named experts of which the scores alone were tuned, in the order of a mixture's weights.
    ///
    /// *Errors*: as [`ExpertSet::tuned`].
    pub fn new(prior: Arc<dyn Backbone>, experts: Vec<(String, Parameters)>) -> Result<Self, Error> {
        Self::tuned(prior, experts, Tunes::Scores)
    }

    /// Checks and takes a prior and named experts, in the order of a mixture's weights. `tunes` says what of them
    /// was tuned.
    ///
    /// *Errors*: no expert, or two of the same name; weights of another network or of another prior, with
    /// each mismatching tensor.
    pub fn tuned(
        prior: Arc<dyn Backbone>,
        experts: Vec<(String, Parameters)>,
        tunes: Tunes,
    ) -> Result<Self, Error> {
        let names: Vec<&str> = experts.iter().map(|(name, _)| name.as_str()).collect();
        let twice = names.iter().enumerate().find(|(k, name)| names[..*k].contains(name));
        if let Some((_, name)) = twice {
            return Err(Error::SameName((*name).to_owned()));
        }
        if names.is_empty() {
            return Err(Error::NoExperts);
        }
        for (name, expert) in &experts {
            let mut problems = expert.mismatches(prior.parameter_specs());
            if problems.is_empty() {
                problems = differences_from_prior(&*prior, expert, tunes)?;
            }
            if !problems.is_empty() {
                let what = format!("the {name} expert");
                return Err(sage_backbones::Error::Weights { what, problems }.into());
            }
        }
        Ok(Self { prior, experts: experts.into(), tunes, source: None })
    }

    /// What of the experts was tuned.
    pub fn tunes(&self) -> Tunes {
        self.tunes
    }

    /// The model of merged weights, for encodings of the prior.
    ///
    /// *Errors*: weights that do not fit the network.
    pub fn model(&self, weights: Parameters) -> Result<Arc<dyn MotionModel>, Error> {
        let network = self.prior.with_parameters(weights)?;
        Ok(match (self.prior.shared(), self.tunes) {
            (Shared::Nothing, _) => Arc::new(OwnEncoder::with_own_modes(network)),
            (_, Tunes::Scores) => {
                let network: Arc<dyn Backbone> = network.into();
                network
            }
            (_, Tunes::All) => Arc::new(OwnEncoder::scoring(network, self.prior.clone())),
        })
    }

    /// The prior.
    pub fn prior(&self) -> &Arc<dyn Backbone> {
        &self.prior
    }

    /// The same prior with some of the experts, in the given order.
    ///
    /// *Errors*: [`Error::Expert`] for a name that is not in the set.
    pub fn only(&self, names: &[&str]) -> Result<Self, Error> {
        let experts = names.iter().map(|name| Ok(self.experts[self.index_of(name)?].clone()));
        let experts = experts.collect::<Result<Vec<_>, Error>>()?;
        Ok(Self { experts: experts.into(), ..self.clone() })
    }

    /// Names of the experts, in the order of a mixture's weights.
    pub fn names(&self) -> Vec<&str> {
        self.experts.iter().map(|(name, _)| name.as_str()).collect()
    }

    /// Names and weights of the experts.
    pub fn experts(&self) -> &[(String, Parameters)] {
        &self.experts
    }

    /// The weights of an expert.
    ///
    /// *Errors*: [`Error::Expert`].
    pub fn expert(&self, name: &str) -> Result<&Parameters, Error> {
        Ok(&self.experts[self.index_of(name)?].1)
    }

    fn index_of(&self, name: &str) -> Result<usize, Error> {
        let index = self.experts.iter().position(|(known, _)| known == name);
        index.ok_or_else(|| Error::Expert {
            name: name.to_owned(),
            known: self.experts.iter().map(|(name, _)| name.clone()).collect(),
        })
    }

    /// The mixture at λ: weight 1 − λ for the realistic expert, λ for the adversarial one, 0 for others.
    ///
    /// *Errors*: [`Error::Expert`] if the set lacks one of the two.
    pub fn between(&self, lambda: f64) -> Result<Mixture, Error> {
        self.mixture(&[(REALISTIC, 1.0 - lambda), (ADVERSARIAL, lambda)])
    }

    /// The mixture of named weights; an expert that is not named has weight 0.
    ///
    /// *Errors*: [`Error::Expert`] for a name that is not in the set.
    pub fn mixture<'n>(
        &self,
        weights: impl IntoIterator<Item = &'n (&'n str, f64)>,
    ) -> Result<Mixture, Error> {
        let mut all = vec![0.0; self.experts.len()];
        for (name, weight) in weights {
            all[self.index_of(name)?] = *weight;
        }
        Ok(Mixture::new(all))
    }

    /// Tensors that differ from the prior's in some expert, sorted by name.
    pub(crate) fn tuned_tensors(&self) -> Result<Vec<TunedTensor>, Error> {
        let mut tuned = Vec::new();
        for (name, tensor) in self.prior.parameters().iter() {
            let prior = numbers(tensor)?;
            let of = |(_, expert): &(String, Parameters)| match expert.get(name) {
                Some(tensor) => numbers(tensor),
                None => Ok(prior.clone()),
            };
            let experts = self.experts.iter().map(of).collect::<Result<Vec<_>, _>>()?;
            if experts.iter().any(|expert| *expert != prior) {
                tuned.push(TunedTensor {
                    name: name.to_owned(),
                    shape: tensor.dims().to_vec(),
                    prior,
                    experts,
                });
            }
        }
        Ok(tuned)
    }
}

fn numbers(tensor: &Tensor) -> Result<Vec<f32>, Error> {
    Ok(tensor.flatten_all()?.to_vec1()?)
}

/// Whether fine-tuning may change a tensor.
fn is_tuned(prior: &dyn Backbone, tensor: &str, tunes: Tunes) -> bool {
    let group = prior.parameter_group(tensor);
    group.is_finetuned() || tunes == Tunes::All && group == ParameterGroup::Prior
}

/// Problems of an expert tuned from another prior: tensors that differ from the prior's although
/// fine-tuning does not change them.
fn differences_from_prior(
    prior: &dyn Backbone,
    expert: &Parameters,
    tunes: Tunes,
) -> Result<Vec<String>, Error> {
    let mut problems = Vec::new();
    for (name, own) in expert.iter() {
        let Some(base) = prior.parameters().get(name) else { continue };
        if !is_tuned(prior, name, tunes) && numbers(own)? != numbers(base)? {
            problems.push(format!("tensor `{name}` differs from the prior's: it was tuned from another one"));
        }
    }
    Ok(problems)
}
