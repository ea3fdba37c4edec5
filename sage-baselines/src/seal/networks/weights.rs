//! The weights of SEAL in one file: the parts that a generator needs.

use candle_core::DType;
use sage_backbones::{
    Error, Parameters,
    nn::is_running_variance,
    parameters::{Header, ParameterSpec, Scope},
    weights::Weights,
};
use serde::{Deserialize, Serialize};

use super::{CriticalityNetwork, SkillDecoder, SkillPrior};

/// File of SEAL's networks in a folder of weights.
pub const SEAL_FILE: &str = "seal.safetensors";
/// Name in the header of the file.
const NAME: &str = "seal";
/// Prefixes of the parts' tensors.
const PARTS: [&str; 3] = ["criticality", "decoder", "adversarial"];
/// What a message about an unfit file ends with.
const REMEDY: &str = "train it again with `sage train-adversary seal`";

/// Options of SEAL's networks.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SealOptions {
    /// Width of the networks in the skill prior, 1 to 4096; 512 as published.
    pub hidden: usize,
}

impl Default for SealOptions {
    fn default() -> Self {
        Self { hidden: 64 }
    }
}

impl SealOptions {
    /// *Errors*: [`Error::Option`] for a width out of its range.
    pub fn check(&self) -> Result<(), Error> {
        match self.hidden {
            1..=4096 => Ok(()),
            hidden => Err(Error::Option(format!("`hidden` is {hidden}; expected 1 to 4096"))),
        }
    }
}

/// The parts of SEAL that a generator needs.
#[derive(Clone, Debug)]
pub struct SealWeights {
    /// Scores of candidates.
    pub criticality: CriticalityNetwork,
    /// Actions of skills.
    pub decoder: SkillDecoder,
    /// Distribution of skills before collisions.
    pub adversarial: SkillPrior,
}

impl SealWeights {
    /// Takes `criticality.*`, `decoder.*` and `adversarial.*` from the scope.
    fn of_scope(scope: &Scope, options: &SealOptions) -> candle_core::Result<Self> {
        let [criticality, decoder, adversarial] = PARTS.map(|part| scope.at(part));
        Ok(Self {
            criticality: CriticalityNetwork::new(&criticality)?,
            decoder: SkillDecoder::new(&decoder)?,
            adversarial: SkillPrior::new(&adversarial, options.hidden)?,
        })
    }

    /// The specifications of all tensors of the file, sorted by name.
    ///
    /// *Errors*: [`Error::Option`].
    pub fn parameter_specs(options: &SealOptions) -> Result<Vec<ParameterSpec>, Error> {
        options.check()?;
        Ok(Scope::list(|scope| Self::of_scope(scope, options))?)
    }

    /// The tensors of the file, from those of the trained parts. Of the skills, `decoder.*` are taken.
    pub fn file_parameters(
        criticality: &Parameters,
        skills: &Parameters,
        adversarial: &Parameters,
    ) -> Parameters {
        let prefixed = |part: &'static str, parameters: &Parameters| -> Vec<_> {
            parameters.iter().map(|(name, tensor)| (format!("{part}.{name}"), tensor.clone())).collect()
        };
        let decoder = skills.iter().filter(|(name, _)| name.starts_with("decoder."));
        prefixed(PARTS[0], criticality)
            .into_iter()
            .chain(decoder.map(|(name, tensor)| (name.to_owned(), tensor.clone())))
            .chain(prefixed(PARTS[2], adversarial))
            .collect()
    }

    /// The networks of given tensors; `what` names their source in errors.
    ///
    /// *Errors*: [`Error::Option`], [`Error::Weights`] with each tensor that does not fit.
    pub fn new(parameters: &Parameters, options: &SealOptions, what: &str) -> Result<Self, Error> {
        let specs = Self::parameter_specs(options)?;
        let mut problems = parameters.mismatches(&specs);
        for (name, tensor) in parameters.iter() {
            let shown = name.escape_debug();
            if tensor.dtype() != DType::F32 {
                problems.push(format!("tensor `{shown}` holds {:?}, expected F32", tensor.dtype()));
            } else if is_running_variance(name) {
                let least = tensor.flatten_all()?.to_vec1::<f32>()?.into_iter().find(|x| *x < 0.0);
                problems.extend(least.map(|x| format!("tensor `{shown}` holds the variance {x}")));
            }
        }
        if problems.is_empty() {
            return Ok(Self::of_scope(&Scope::of(parameters), options)?);
        }
        Err(Error::Weights { what: format!("{what} does not fit SEAL; {REMEDY}"), problems })
    }

    /// Reads [`SEAL_FILE`] from a source of weights.
    ///
    /// *Errors*: [`Error::Io`] for a file that is missing or cannot be read, [`Error::Format`] for one that is damaged or
    /// of another network, and those of [`SealWeights::new`]; each names the file and the remedy.
    pub fn load(weights: &Weights) -> Result<Self, Error> {
        Self::load_file(weights, SEAL_FILE)
    }

    /// The same from a file of another name beside the prior.
    ///
    /// *Errors*: as [`SealWeights::load`].
    pub fn load_file(weights: &Weights, file: &str) -> Result<Self, Error> {
        let path = weights.path(file);
        if !weights.has(file) {
            let problem = "the file is missing; copy that of `sage train-adversary seal` beside the prior, or name weights that hold it";
            let source = std::io::Error::new(std::io::ErrorKind::NotFound, problem);
            return Err(Error::Io { verb: "read", path, source });
        }
        let (parameters, header) = weights.tensors(file)?;
        let options = options_of(&header).map_err(|problem| Error::Format {
            path: path.clone(),
            problem: format!("{problem}; {REMEDY}"),
        })?;
        Self::new(&parameters, &options, &format!("`{}`", path.display()))
    }
}

/// The options in the header of SEAL's file, or what is wrong with it.
fn options_of(header: &Header) -> Result<SealOptions, String> {
    if header.backbone != NAME {
        return Err(format!("holds the network `{}`, expected `{NAME}`", header.backbone.escape_debug()));
    }
    let options = SealOptions::deserialize(&header.options)
        .map_err(|error| format!("has options that SEAL cannot use ({error})"))?;
    options.check().map_err(|error| format!("has options that SEAL cannot use ({error})"))?;
    Ok(options)
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::{Device, Tensor};
    use serde_json::json;

    fn header() -> Header {
        Header { backbone: NAME.to_owned(), options: json!({ "hidden": 8 }), ..Header::default() }
    }

    fn parameters() -> Parameters {
        Parameters::start(&SealWeights::parameter_specs(&SealOptions { hidden: 8 }).unwrap(), 1).unwrap()
    }

    /// The message of loading a file of these bytes, with the causes.
    fn message(bytes: &[u8]) -> String {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join(SEAL_FILE), bytes).unwrap();
        message_of(&Weights::at(folder.path()))
    }

    fn message_of(weights: &Weights) -> String {
        let error = SealWeights::load(weights).unwrap_err();
        let cause = std::error::Error::source(&error).map(ToString::to_string).unwrap_or_default();
        format!("{error}: {cause}")
    }

    fn changed(change: impl FnOnce(&mut Parameters)) -> String {
        let mut parameters = parameters();
        change(&mut parameters);
        message(&parameters.to_bytes(&header()).unwrap())
    }

    fn assert_names(message: &str, parts: &[&str]) {
        for part in [SEAL_FILE].iter().chain(parts) {
            assert!(message.contains(part), "`{part}` is not in `{message}`");
        }
    }

    #[test]
    fn a_written_file_is_read_with_the_same_results() {
        let folder = tempfile::tempdir().unwrap();
        parameters().save(&header(), &folder.path().join(SEAL_FILE)).unwrap();
        let read = SealWeights::load(&Weights::at(folder.path())).unwrap();
        let own = SealWeights::new(&parameters(), &SealOptions { hidden: 8 }, "own").unwrap();
        let sequences = [vec![[1.0, 2.0, 1.0]; 5]];
        let scores = |weights: &SealWeights| weights.criticality.scores(&sequences).unwrap();
        assert_eq!(scores(&read), scores(&own));
        let action = |weights: &SealWeights| {
            let skill = weights.adversarial.sample(&[0.5; 8], &[0.1; 101]).unwrap();
            weights.decoder.action(&[0.1; 101], &skill).unwrap()
        };
        assert_eq!(action(&read), action(&own));
    }

    #[test]
    fn unfit_files_are_refused_with_the_tensor_and_the_remedy() {
        let remedy = "sage train-adversary seal";
        let folder = tempfile::tempdir().unwrap();
        assert_names(&message_of(&Weights::at(folder.path())), &["missing", remedy]);
        let carried = Weights::Carried { name: "shipped", files: &[] };
        assert_names(&message_of(&carried), &["shipped", "missing", remedy]);

        let with_header = |header: Header| message(&parameters().to_bytes(&header).unwrap());
        let other = Header { backbone: "densetnt".to_owned(), ..header() };
        assert_names(&with_header(other), &["densetnt", remedy]);
        for options in [json!({ "hiden": 8 }), json!({ "hidden": 0 }), json!({ "hidden": 4097 }), json!(3)] {
            assert_names(&with_header(Header { options, ..header() }), &["options", remedy]);
        }
        // The default width is not that of the tensors.
        let default = with_header(Header { options: json!({}), ..header() });
        assert_names(&default, &["adversarial.layers.0.scale.0.bias", "[8]", "[64]", remedy]);

        let name = "decoder.layers.1.batch_norm.running_var";
        let insert = |values: Tensor| changed(|all| all.insert(name, values));
        let ones = Tensor::ones(32, DType::F32, &Device::Cpu).unwrap();
        assert_names(&insert(ones.to_dtype(DType::F64).unwrap()), &[name, "F64", remedy]);
        assert_names(&insert((&ones * -0.5).unwrap()), &[name, "-0.5", remedy]);
        assert_names(&insert(ones.narrow(0, 0, 31).unwrap()), &[name, "[31]", "[32]", remedy]);
        assert_names(&insert((&ones * f64::NAN).unwrap()), &[name, "NaN"]);
        let extra = changed(|all| all.insert("decoder.more", ones.clone()));
        assert_names(&extra, &["decoder.more", "not part", remedy]);
        let without = Parameters::from_iter(
            parameters().iter().filter(|(other, _)| *other != name).map(|(n, t)| (n.to_owned(), t.clone())),
        );
        assert_names(&message(&without.to_bytes(&header()).unwrap()), &[name, "missing", remedy]);
        let bytes = parameters().to_bytes(&header()).unwrap();
        assert_names(&message(&bytes[..bytes.len() - 5]), &["whole"]);
        assert_names(&message(&[]), &[]);
    }
}
