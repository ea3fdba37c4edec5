//! The weights of GOOSE in one file: encoder and actor.

use candle_core::{DType, Device, Module as _, Tensor};
use sage_backbones::{
    Error, Parameters,
    nn::{Gru, Linear, Sequences},
    parameters::{Header, ParameterSpec, Scope},
    weights::Weights,
};
use serde::{Deserialize, Serialize};

use super::{ACTION, ACTOR_HIDDEN, FEATURES, Features, HIDDEN, REST, STATE};

/// File of GOOSE's networks in a folder of weights.
pub const GOOSE_FILE: &str = "goose.safetensors";
/// Name in the header of the file.
const NAME: &str = "goose";
/// Prefixes of the parts' tensors.
const ENCODER: &str = "encoder";
const ACTOR: &str = "actor";
/// What a message about an unfit file ends with.
const REMEDY: &str = "train it again with `sage train-adversary goose`";

/// Options of GOOSE's networks: what the numbers mean that they were trained on.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct GooseOptions {
    /// Whether the curve begins at frame 0, as published; else at *now*.
    pub from_start: bool,
    /// Whether the networks see metres and seconds unscaled, as published.
    pub unscaled: bool,
}

/// Encoder and actor of GOOSE.
#[derive(Clone, Debug)]
pub struct GooseWeights {
    options: GooseOptions,
    encoder: Gru,
    actor: [Linear; 3],
}

impl GooseWeights {
    /// Takes `encoder.*` and `actor.*` from the scope.
    fn of_scope(scope: &Scope, options: &GooseOptions) -> candle_core::Result<Self> {
        let actor = scope.at(ACTOR);
        Ok(Self {
            options: options.clone(),
            encoder: Self::encoder_of(scope)?,
            actor: [
                Linear::new(&actor.at("l1"), STATE, ACTOR_HIDDEN)?,
                Linear::new(&actor.at("l2"), ACTOR_HIDDEN, ACTOR_HIDDEN)?,
                Linear::new(&actor.at("l3"), ACTOR_HIDDEN, ACTION)?,
            ],
        })
    }

    fn encoder_of(scope: &Scope) -> candle_core::Result<Gru> {
        Gru::new(&scope.at(ENCODER), FEATURES, HIDDEN)
    }

    /// The specifications of all tensors of the file, sorted by name: `encoder.weight_ih`, …, `actor.l1.weight`, …
    ///
    /// *Shapes*: weights [outputs, inputs], those of the encoder [3 · [`HIDDEN`], inputs] with the gates reset,
    /// update and candidate.
    ///
    /// *Errors*: none on a CPU.
    pub fn parameter_specs() -> Result<Vec<ParameterSpec>, Error> {
        Ok(Scope::list(|scope| Self::of_scope(scope, &GooseOptions::default()))?)
    }

    /// The tensors of the file, from those of the encoder (`weight_ih`, …) and of the actor (`l1.weight`, …).
    pub fn file_parameters(encoder: &Parameters, actor: &Parameters) -> Parameters {
        let parts = [(ENCODER, encoder), (ACTOR, actor)].into_iter();
        let prefixed = parts.flat_map(|(part, parameters)| {
            parameters.iter().map(move |(name, tensor)| (format!("{part}.{name}"), tensor.clone()))
        });
        prefixed.collect()
    }

    /// The networks of given tensors; `what` names their source in errors.
    ///
    /// *Errors*: [`Error::Weights`] with each tensor that does not fit.
    pub fn new(parameters: &Parameters, options: &GooseOptions, what: &str) -> Result<Self, Error> {
        let mut problems = parameters.mismatches(&Self::parameter_specs()?);
        let others = parameters.iter().filter(|(_, tensor)| tensor.dtype() != DType::F32);
        problems.extend(others.map(|(name, tensor)| {
            format!("tensor `{}` holds {:?}, expected F32", name.escape_debug(), tensor.dtype())
        }));
        if problems.is_empty() {
            return Ok(Self::of_scope(&Scope::of(parameters), options)?);
        }
        Err(Error::Weights { what: format!("{what} does not fit GOOSE; {REMEDY}"), problems })
    }

    /// Reads a file beside the prior, such as [`GOOSE_FILE`].
    ///
    /// *Errors*: [`Error::Io`] for a file that is missing or cannot be read, [`Error::Format`] for one that is
    /// damaged or of another network, and those of [`GooseWeights::new`]; each names the file and the remedy.
    pub fn load_file(weights: &Weights, file: &str) -> Result<Self, Error> {
        let path = weights.path(file);
        if !weights.has(file) {
            let problem = "the file is missing; copy that of `sage train-adversary goose` beside the \
                           prior, or name weights that hold it";
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

    /// What the numbers mean that the networks were trained on.
    pub fn options(&self) -> &GooseOptions {
        &self.options
    }

    /// The same actor with an encoder of random weights, as in the published evaluation, whose encoder is not saved.
    ///
    /// *Errors*: none on a CPU.
    pub fn with_random_encoder(&self, seed: u64) -> Result<Self, Error> {
        let start = Parameters::start(&Scope::list(Self::encoder_of)?, seed)?;
        Ok(Self { encoder: Self::encoder_of(&Scope::of(&start))?, ..self.clone() })
    }

    /// The action after a drive: changes of weights and control points, each in [−1, 1].
    ///
    /// *Shapes*: `sequence` one row per step of the drive, the first step first; `rest` curve, achieved goal, desired
    /// goal.
    ///
    /// *Errors*: [`Error::Mismatch`] for a drive without steps, [`Error::NotFinite`] for an input or a result of a
    /// layer that is not finite.
    pub fn action(&self, sequence: &[Features], rest: &[f32; REST]) -> Result<[f64; ACTION], Error> {
        check_finite(sequence.as_flattened(), "drive")?;
        check_finite(rest, "state")?;
        let mut state =
            self.encoder.forward(Sequences::new(&[sequence])?)?.flatten_all()?.to_vec1::<f32>()?;
        state.extend_from_slice(rest);
        let [l1, l2, l3] = &self.actor;
        let mut layer = Tensor::from_vec(state, (1, STATE), &Device::Cpu)?;
        for hidden in [l1, l2] {
            layer = hidden.forward(&layer)?;
            // Before the ReLU, which takes NaN for 0.
            check_finite(&layer.flatten_all()?.to_vec1::<f32>()?, "hidden layer of the actor")?;
            layer = layer.relu()?;
        }
        let output = l3.forward(&layer)?.flatten_all()?.to_vec1::<f32>()?;
        check_finite(&output, "output of the actor")?;
        match <[f32; ACTION]>::try_from(output) {
            Ok(output) => Ok(output.map(|x| f64::from(x.tanh()))),
            Err(output) => Err(Error::Mismatch(format!("an action of {} numbers", output.len()))),
        }
    }
}

fn check_finite(numbers: &[f32], what: &str) -> Result<(), Error> {
    match numbers.iter().position(|x| !x.is_finite()) {
        None => Ok(()),
        Some(at) => {
            Err(Error::NotFinite(format!("an action of GOOSE: the {what} holds {} at {at}", numbers[at])))
        }
    }
}

/// The options in the header of GOOSE's file, or what is wrong with it.
fn options_of(header: &Header) -> Result<GooseOptions, String> {
    if header.backbone != NAME {
        return Err(format!("holds the network `{}`, expected `{NAME}`", header.backbone.escape_debug()));
    }
    GooseOptions::deserialize(&header.options)
        .map_err(|error| format!("has options that GOOSE cannot use ({error})"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn header() -> Header {
        Header { backbone: NAME.to_owned(), options: json!({ "unscaled": true }), ..Header::default() }
    }

    fn parameters() -> Parameters {
        Parameters::start(&GooseWeights::parameter_specs().unwrap(), 1).unwrap()
    }

    fn own() -> GooseWeights {
        GooseWeights::new(&parameters(), &GooseOptions::default(), "own").unwrap()
    }

    fn drive() -> Vec<Features> {
        (0..6_u8).map(|step| std::array::from_fn(|k| f32::from(step) * 0.1 - k as f32 * 0.03)).collect()
    }

    /// The message of loading a file of these bytes, with the causes.
    fn message(bytes: &[u8]) -> String {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join(GOOSE_FILE), bytes).unwrap();
        message_of(&Weights::at(folder.path()))
    }

    fn message_of(weights: &Weights) -> String {
        let error = GooseWeights::load_file(weights, GOOSE_FILE).unwrap_err();
        let cause = std::error::Error::source(&error).map(ToString::to_string).unwrap_or_default();
        format!("{error}: {cause}")
    }

    fn changed(change: impl FnOnce(&mut Parameters)) -> String {
        let mut parameters = parameters();
        change(&mut parameters);
        message(&parameters.to_bytes(&header()).unwrap())
    }

    fn assert_names(message: &str, parts: &[&str]) {
        for part in [GOOSE_FILE].iter().chain(parts) {
            assert!(message.contains(part), "`{part}` is not in `{message}`");
        }
    }

    #[test]
    fn parts_have_the_stated_numbers_of_parameters() {
        let count = |part: &str| -> usize {
            let all = parameters();
            all.iter().filter(|(name, _)| name.starts_with(part)).map(|(_, tensor)| tensor.elem_count()).sum()
        };
        assert_eq!(count("encoder."), 65_280);
        assert_eq!(count("actor."), 106_508);
    }

    #[test]
    fn a_written_file_is_read_with_the_same_results() {
        let folder = tempfile::tempdir().unwrap();
        let part = |part: &str| -> Parameters {
            let all = parameters();
            let own =
                all.iter().filter_map(|(name, tensor)| Some((name.strip_prefix(part)?, tensor.clone())));
            own.map(|(name, tensor)| (name.to_owned(), tensor)).collect()
        };
        let written = GooseWeights::file_parameters(&part("encoder."), &part("actor."));
        written.save(&header(), &folder.path().join(GOOSE_FILE)).unwrap();
        let read = GooseWeights::load_file(&Weights::at(folder.path()), GOOSE_FILE).unwrap();
        assert_eq!(read.options(), &GooseOptions { from_start: false, unscaled: true });
        let action = |weights: &GooseWeights| weights.action(&drive(), &[0.3; REST]).unwrap();
        assert_eq!(action(&read), action(&own()));
    }

    #[test]
    fn actions_depend_on_drive_and_rest_and_are_bounded() {
        let (weights, rest) = (own(), [0.3; REST]);
        let action = weights.action(&drive(), &rest).unwrap();
        assert_ne!(action, weights.action(&drive()[..5], &rest).unwrap());
        assert_ne!(action, weights.action(&drive(), &[0.4; REST]).unwrap());
        let far = weights.action(&drive(), &[1e6; REST]).unwrap();
        assert!(far.iter().all(|x| x.abs() <= 1.0) && far.iter().any(|x| x.abs() == 1.0), "{far:?}");
    }

    #[test]
    fn the_action_is_that_of_the_layers() {
        let (weights, rest) = (own(), [0.3; REST]);
        let all = parameters().to_dtype(DType::F64).unwrap();
        let encoding = weights.encoder.forward(Sequences::new(&[&drive()[..]]).unwrap()).unwrap();
        let mut layer: Vec<f64> = encoding
            .flatten_all()
            .unwrap()
            .to_vec1::<f32>()
            .unwrap()
            .iter()
            .chain(&rest)
            .map(|x| f64::from(*x))
            .collect();
        for name in ["l1", "l2", "l3"] {
            let weight = all.get(&format!("actor.{name}.weight")).unwrap().to_vec2::<f64>().unwrap();
            let bias = all.get(&format!("actor.{name}.bias")).unwrap().to_vec1::<f64>().unwrap();
            let units = weight.iter().zip(bias);
            layer =
                units.map(|(row, b)| row.iter().zip(&layer).map(|(w, x)| w * x).sum::<f64>() + b).collect();
            if name != "l3" {
                layer.iter_mut().for_each(|x| *x = x.max(0.0));
            }
        }
        for (found, expected) in weights.action(&drive(), &rest).unwrap().iter().zip(layer) {
            assert!((found - expected.tanh()).abs() < 1e-6, "{found} and {}", expected.tanh());
        }
    }

    #[test]
    fn numbers_that_are_not_finite_give_no_action() {
        let weights = own();
        for bad in [f32::NAN, f32::INFINITY] {
            let mut drive = drive();
            drive[2][7] = bad;
            assert!(matches!(weights.action(&drive, &[0.0; REST]), Err(Error::NotFinite(_))));
        }
        assert!(matches!(weights.action(&drive(), &[f32::NAN; REST]), Err(Error::NotFinite(_))));
        // Twice the largest number: an overflow within the actor.
        let mut large = parameters();
        let twos = (Tensor::ones((ACTOR_HIDDEN, STATE), DType::F32, &Device::Cpu).unwrap() * 2.0).unwrap();
        large.insert("actor.l1.weight", twos);
        let large = GooseWeights::new(&large, &GooseOptions::default(), "large").unwrap();
        let message = large.action(&drive(), &[f32::MAX; REST]).unwrap_err().to_string();
        assert!(message.contains("hidden layer"), "{message}");
        assert!(matches!(weights.action(&[], &[0.0; REST]), Err(Error::Mismatch(_))));
    }

    #[test]
    fn random_encoders_differ_by_seed_and_keep_the_actor() {
        let weights = own();
        let action = |weights: &GooseWeights| weights.action(&drive(), &[0.3; REST]).unwrap();
        let random = |seed| weights.with_random_encoder(seed).unwrap();
        assert_eq!(action(&random(7)), action(&random(7)));
        assert_ne!(action(&random(7)), action(&random(8)));
        // The weights here are the initial ones of seed 1.
        assert_eq!(action(&random(1)), action(&weights));
    }

    #[test]
    fn unfit_files_are_refused_with_the_tensor_and_the_remedy() {
        let remedy = "sage train-adversary goose";
        let folder = tempfile::tempdir().unwrap();
        assert_names(&message_of(&Weights::at(folder.path())), &["missing", remedy]);
        let carried = Weights::Carried { name: "shipped", files: &[] };
        assert_names(&message_of(&carried), &["shipped", "missing", remedy]);

        let with_header = |header: Header| message(&parameters().to_bytes(&header).unwrap());
        let other = Header { backbone: "densetnt".to_owned(), ..header() };
        assert_names(&with_header(other), &["densetnt", remedy]);
        for options in [json!({ "unscale": true }), json!({ "unscaled": 1 }), json!(3)] {
            assert_names(&with_header(Header { options, ..header() }), &["options", remedy]);
        }

        let name = "encoder.bias_hh";
        let insert = |values: Tensor| changed(|all| all.insert(name, values));
        let ones = Tensor::ones(3 * HIDDEN, DType::F32, &Device::Cpu).unwrap();
        assert_names(&insert(ones.to_dtype(DType::F64).unwrap()), &[name, "F64", remedy]);
        assert_names(&insert(ones.narrow(0, 0, 31).unwrap()), &[name, "[31]", "[384]", remedy]);
        assert_names(&insert((&ones * f64::NAN).unwrap()), &[name, "NaN", "train"]);
        let extra = changed(|all| all.insert("actor.more", ones.clone()));
        assert_names(&extra, &["actor.more", "not part", remedy]);
        let without = Parameters::from_iter(
            parameters().iter().filter(|(other, _)| *other != name).map(|(n, t)| (n.to_owned(), t.clone())),
        );
        assert_names(&message(&without.to_bytes(&header()).unwrap()), &[name, "missing", remedy]);
        let bytes = parameters().to_bytes(&header()).unwrap();
        assert_names(&message(&bytes[..bytes.len() - 5]), &["whole"]);
        assert_names(&message(&[]), &[]);
    }
}
