//! Two experts tuned from one prior.

use std::path::PathBuf;

use sage_backbones::{
    Backbone, Error, Parameters,
    candle::{DType, Device, Tensor},
    parameters::Header,
};

use crate::check;

/// A prior and its two experts, checked: the same tensors, and those that fine-tuning leaves alone the
/// same bits in all three.
pub struct Experts {
    prior: Box<dyn Backbone>,
    realistic: Parameters,
    adversarial: Parameters,
}

/// What the file of an expert holds.
pub struct ExpertFile {
    /// The file, for messages.
    pub path: PathBuf,
    /// The weights.
    pub parameters: Parameters,
    /// What the file says of them.
    pub header: Header,
}

impl ExpertFile {
    /// Note in the header: which expert it is, `realistic` or `adversarial`.
    pub const EXPERT: &str = "expert";
    /// Note in the header: hash of the prior that it was tuned from.
    pub const PRIOR: &str = "prior";

    /// Reads a file.
    ///
    /// *Errors*: as [`Parameters::load`].
    pub fn load(path: PathBuf) -> Result<Self, Error> {
        let (parameters, header) = Parameters::load(&path)?;
        Ok(Self { path, parameters, header })
    }

    /// The weights, if the file is that expert of that prior.
    fn checked(self, expert: &str, prior: &str) -> Result<Parameters, Error> {
        let remedy = "make the experts anew with `sage finetune`";
        let notes = &self.header.notes;
        let foreign = self.parameters.iter().find(|(_, tensor)| tensor.dtype() != DType::F32);
        let problem = match (notes.get(Self::EXPERT), notes.get(Self::PRIOR), foreign) {
            (None, ..) | (_, None, _) => {
                format!("it does not say which expert it is and of which prior: {remedy}")
            }
            (Some(says), ..) if says != expert => format!(
                "it says that it is the {says} expert, where the {expert} one belongs: the files were swapped or renamed"
            ),
            (_, Some(from), _) if from != prior => format!(
                "the {expert} expert was tuned from another prior ({from}) than the one beside it ({prior}): {remedy}"
            ),
            (.., Some((name, tensor))) => format!(
                "tensor `{}` holds {:?}; experts are mixed in F32: convert the weights",
                name.escape_debug(),
                tensor.dtype()
            ),
            (.., None) => return Ok(self.parameters),
        };
        Err(Error::Format { path: self.path, problem })
    }
}

impl Experts {
    /// The experts of a prior from their files.
    ///
    /// *Errors*: [`Error::Format`] for a file that is another expert, of another prior, or does not say so;
    /// else as [`Experts::new`].
    pub fn of_files(
        prior: Box<dyn Backbone>,
        realistic: ExpertFile,
        adversarial: ExpertFile,
    ) -> Result<Self, Error> {
        let hash = prior.parameters().hash()?;
        let realistic = realistic.checked("realistic", &hash)?;
        let adversarial = adversarial.checked("adversarial", &hash)?;
        Self::new(prior, realistic, adversarial)
    }

    /// Checks and takes the three.
    ///
    /// *Errors*: [`Error::Weights`] for an expert of another network, or of another prior, with each
    /// tensor at fault.
    pub fn new(
        prior: Box<dyn Backbone>,
        realistic: Parameters,
        adversarial: Parameters,
    ) -> Result<Self, Error> {
        for (name, expert) in [("realistic", &realistic), ("adversarial", &adversarial)] {
            let mut problems = expert.faults(prior.wanted());
            if problems.is_empty() {
                problems = moved_in_vain(&*prior, expert)?;
            }
            if !problems.is_empty() {
                return Err(Error::Weights { what: format!("the {name} expert"), problems });
            }
        }
        Ok(Self { prior, realistic, adversarial })
    }

    /// The prior.
    pub fn prior(&self) -> &dyn Backbone {
        &*self.prior
    }

    /// The realistic expert's weights.
    pub fn realistic(&self) -> &Parameters {
        &self.realistic
    }

    /// The adversarial expert's weights.
    pub fn adversarial(&self) -> &Parameters {
        &self.adversarial
    }

    /// Names of the tensors in which the experts differ.
    pub fn differing(&self) -> Result<Vec<String>, Error> {
        let mut names = Vec::new();
        for (name, a, b) in self.pairs() {
            if numbers(a)? != numbers(b)? {
                names.push(name.to_owned());
            }
        }
        Ok(names)
    }

    /// The mixture of every number; what both experts share is shared.
    pub(crate) fn merged(
        &self,
        lambda: f64,
        mix: impl Fn(f32, f32, f32) -> f32,
    ) -> Result<Parameters, Error> {
        check(lambda)?;
        if lambda == 0.0 {
            return Ok(self.realistic.clone());
        }
        if lambda == 1.0 {
            return Ok(self.adversarial.clone());
        }
        let mut merged = Parameters::default();
        for (name, a, b) in self.pairs() {
            merged.insert(name, self.mixed(name, a, b, &mix)?.unwrap_or_else(|| a.clone()));
        }
        Ok(merged)
    }

    /// The mixture of one tensor; `None` if both experts share it.
    fn mixed(
        &self,
        name: &str,
        a: &Tensor,
        b: &Tensor,
        mix: impl Fn(f32, f32, f32) -> f32,
    ) -> Result<Option<Tensor>, Error> {
        let (x, y) = (numbers(a)?, numbers(b)?);
        if x == y {
            return Ok(None);
        }
        let Some(prior) = self.prior.parameters().get(name) else { return Ok(None) };
        let prior = numbers(prior)?;
        let one = |k: usize| if x[k] == y[k] { x[k] } else { mix(prior[k], x[k], y[k]) };
        Ok(Some(Tensor::from_vec((0..x.len()).map(one).collect(), a.dims(), &Device::Cpu)?))
    }

    fn pairs(&self) -> impl Iterator<Item = (&str, &Tensor, &Tensor)> {
        // Both have exactly the wanted names, sorted.
        self.realistic.iter().zip(self.adversarial.iter()).map(|((name, a), (_, b))| (name, a, b))
    }
}

fn numbers(tensor: &Tensor) -> Result<Vec<f32>, Error> {
    Ok(tensor.flatten_all()?.to_vec1()?)
}

/// Tensors that differ from the prior's though fine-tuning does not move them: the mark of an expert
/// of another prior.
fn moved_in_vain(prior: &dyn Backbone, expert: &Parameters) -> Result<Vec<String>, Error> {
    let mut problems = Vec::new();
    for (name, own) in expert.iter() {
        let Some(base) = prior.parameters().get(name) else { continue };
        if !prior.role(name).is_finetuned() && numbers(own)? != numbers(base)? {
            problems.push(format!("tensor `{name}` is not the prior's: it was tuned from another one"));
        }
    }
    Ok(problems)
}
