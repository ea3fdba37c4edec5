//! Files of learnt policies: safetensors with the actor's six tensors (`actor.l1.weight`, …) and a card in the header.
//!
//! The card states what each of the 101 numbers of the observation is, so that a file of another layout is refused by
//! the entries that differ, and how the policy was trained and evaluated.

use std::path::Path;

use safetensors::{Dtype, SafeTensors};
use sage_core::{content_hash::check_hash, files};
use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::{
    ActorPolicy, Network, Shape,
    tensor_file::{actor_tensors, hashed_tensors, write_tensors},
};
use crate::{
    Error,
    observation::{self, LENGTH, ObservationKind},
};

/// Key of the card in the header.
const CARD: &str = "card";
/// What marks a file as a policy of this format.
const FORMAT: &str = "sage policy 1";
/// Largest file that is read, bytes.
const MAX_POLICY_FILE: u64 = 64 << 20;

/// What a file says about its policy.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PolicyCard {
    /// Format of the file.
    pub format: String,
    /// What each number of the observation is.
    pub observation: Vec<String>,
    /// Hash of these names.
    pub observation_hash: String,
    /// Share of the last action that an action keeps.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub kept: f64,
    /// How it was trained: generator, curriculum, updates, steps, seed, scenes and their hash.
    pub training: Value,
    /// How it was evaluated, with the number of scenes.
    pub evaluation: Value,
    /// Licence of the weights.
    pub license: String,
}

impl PolicyCard {
    /// A card for policies of a kind of observation.
    pub fn new(kind: ObservationKind, training: Value, evaluation: Value, license: String) -> Self {
        let observation = observation::names(kind);
        let observation_hash = hash(&observation);
        let format = FORMAT.to_owned();
        Self { format, observation, observation_hash, kept: 0.0, training, evaluation, license }
    }
}

impl PolicyCard {
    /// The policy of an actor that this card describes.
    pub fn policy(&self, actor: Network<f32>) -> ActorPolicy {
        ActorPolicy::new(actor).observing(self.observes()).keeping(self.kept)
    }

    /// The kind of observation that the policy is made for.
    pub fn observes(&self) -> ObservationKind {
        let continued = ObservationKind::Continued;
        if self.observation == observation::names(continued) { continued } else { ObservationKind::Corrected }
    }
}

/// Whether a number need not be written.
#[allow(clippy::trivially_copy_pass_by_ref)] // As serde asks.
pub fn is_zero(x: &f64) -> bool {
    *x == 0.0
}

/// Hash of the names of an observation's numbers.
fn hash(names: &[String]) -> String {
    blake3::hash(names.join("\n").as_bytes()).to_hex()[..16].to_owned()
}

/// Writes a policy, with a hash of its content.
///
/// *Errors*: as the system.
pub fn write_policy(path: &Path, actor: &Network<f32>, card: &PolicyCard) -> std::io::Result<()> {
    write_tensors(path, &actor_tensors("actor.", actor), CARD, &serde_json::to_string(card)?)
}

/// Reads a policy.
///
/// *Errors*: a message that names the file, and what is wrong with it: no policy, content that does not match its hash,
/// another observation, a tensor that is missing, of another shape, or not finite.
pub fn read_policy(path: &Path) -> Result<(Network<f32>, PolicyCard), Error> {
    let fail = |problem: String| Error::Value(format!("`{}`: {problem}", path.display()));
    let bytes = files::read(path, MAX_POLICY_FILE).map_err(|error| fail(error.to_string()))?;
    parse_policy(&bytes).map_err(|error| fail(error.to_string()))
}

/// Reads a policy from the bytes of its file.
///
/// *Errors*: as [`read_policy`], without the name of the file.
pub fn parse_policy(bytes: &[u8]) -> Result<(Network<f32>, PolicyCard), Error> {
    let foreign = "not a policy of `sage train-ego`";
    let (_, header) =
        SafeTensors::read_metadata(bytes).map_err(|error| Error::Value(format!("{foreign} ({error})")))?;
    let file =
        SafeTensors::deserialize(bytes).map_err(|error| Error::Value(format!("{foreign} ({error})")))?;
    let text = header.metadata().as_ref().and_then(|entries| entries.get(CARD));
    let text = text.ok_or_else(|| Error::Value(format!("{foreign}: its header has no card")))?;
    let text = check_hash(text, hashed_tensors(&file)).map_err(|error| Error::Value(error.to_string()))?;
    let card: PolicyCard =
        serde_json::from_str(&text).map_err(|error| Error::Value(format!("its card: {error}")))?;
    if card.format != FORMAT {
        return Err(Error::Value(format!("its format is `{}`; expected `{FORMAT}`", card.format)));
    }
    check_observation(&card)?;
    if !(0.0..1.0).contains(&card.kept) {
        return Err(Error::Value(format!(
            "its actions keep a share of {} of the last one; expected a number from 0 to below 1",
            card.kept
        )));
    }
    let tensor = |name: &str| {
        file.tensor(&format!("actor.{name}"))
            .map_err(|_| Error::Value(format!("tensor `actor.{name}` is missing")))
    };
    let [first, second] =
        ["l1.bias", "l2.bias"].map(|name| tensor(name).map(|t| t.shape().iter().product::<usize>()));
    let shape = Shape { inputs: LENGTH, hidden: [first?, second?], outputs: 2 };
    if shape.hidden.contains(&0) {
        return Err(Error::Value("a hidden layer of its network has no units".to_owned()));
    }
    // The sizes are the file's own words so far.
    if shape.count() > bytes.len() / 4 {
        return Err(Error::Value(format!(
            "its hidden layers of {:?} units need more numbers than it holds",
            shape.hidden
        )));
    }
    let mut parameters = Vec::with_capacity(shape.count());
    for (name, expected) in shape.tensors() {
        let found = tensor(name)?;
        if found.shape() != expected || found.dtype() != Dtype::F32 {
            return Err(Error::Value(format!(
                "tensor `actor.{name}` is {:?} {:?}; expected F32 {expected:?}",
                found.dtype(),
                found.shape()
            )));
        }
        parameters.extend(found.data().chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])));
    }
    let network = Network::of(shape, parameters)
        .ok_or_else(|| Error::Value("its tensors are incomplete".to_owned()))?;
    match network.not_finite() {
        Some(name) => Err(Error::Value(format!("tensor `actor.{name}` holds a number that is not finite"))),
        None => Ok((network, card)),
    }
}

/// Refuses another observation, and says which of its numbers differ.
fn check_observation(card: &PolicyCard) -> Result<(), Error> {
    let differences = |known: &[String]| -> Vec<usize> {
        let differs = |k: &usize| card.observation.get(*k) != known.get(*k);
        (0..known.len().max(card.observation.len())).filter(differs).collect()
    };
    let kinds = [ObservationKind::Corrected, ObservationKind::Continued].map(observation::names);
    let [corrected, continued] = &kinds;
    // Of the one that it is most like.
    let known =
        if differences(continued).len() < differences(corrected).len() { continued } else { corrected };
    let all = differences(known);
    let Some(first) = all.first() else {
        if card.observation_hash == hash(known) {
            return Ok(());
        }
        return Err(Error::Value(format!(
            "its card names the numbers of this version's observation with the hash `{}`, which is `{}`; copy or train it again",
            card.observation_hash.escape_debug(),
            hash(known)
        )));
    };
    let name = |names: &[String]| names.get(*first).map_or("nothing".to_owned(), |name| format!("`{name}`"));
    Err(Error::Value(format!(
        "it is for another observation: {} of {} numbers differ (numbers {}); number {first} is {} there and {} here; train it again",
        all.len(),
        known.len(),
        ranges(&all),
        name(&card.observation),
        name(known)
    )))
}

/// Numbers as ranges: `3, 7-9`.
fn ranges(all: &[usize]) -> String {
    let mut spans: Vec<[usize; 2]> = Vec::new();
    for k in all {
        match spans.last_mut() {
            Some(span) if span[1] + 1 == *k => span[1] = *k,
            _ => spans.push([*k, *k]),
        }
    }
    let text = spans.iter().map(|[a, b]| if a == b { a.to_string() } else { format!("{a}-{b}") });
    text.collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::{super::tensor_file::TensorBytes, *};

    fn policy() -> (Network<f32>, PolicyCard) {
        let shape = Shape { inputs: LENGTH, hidden: [4, 3], outputs: 2 };
        let network = Network::random(shape, &mut sage_core::seed::Rng::new(1, "policy", "test"));
        (
            network,
            PolicyCard::new(
                ObservationKind::Corrected,
                json!({"seed": 1}),
                json!({"scenes": 3}),
                "none".to_owned(),
            ),
        )
    }

    #[test]
    fn a_policy_survives_its_file() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("policy.safetensors");
        let (network, card) = policy();
        write_policy(&path, &network, &card).expect("written");
        assert_eq!(read_policy(&path).expect("read"), (network, card));
    }

    #[test]
    fn flipped_bits_are_refused_or_change_nothing() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("policy.safetensors");
        let shape = Shape { inputs: LENGTH, hidden: [1, 1], outputs: 2 };
        let network = Network::random(shape, &mut sage_core::seed::Rng::new(1, "policy", "test"));
        let card = PolicyCard::new(
            ObservationKind::Corrected,
            json!({"seed": 1}),
            json!({"scenes": 3}),
            "none".to_owned(),
        );
        write_policy(&path, &network, &card).expect("written");
        let good = std::fs::read(&path).expect("read");
        let expected = parse_policy(&good).expect("whole");
        for bit in (0..good.len()).map(|byte| 8 * byte + byte % 8) {
            let mut bad = good.clone();
            bad[bit / 8] ^= 1 << (bit % 8);
            // A flipped bit of the JSON around the content may still leave the same content.
            if let Ok(found) = parse_policy(&bad) {
                assert_eq!(found, expected, "bit {bit}");
            }
        }
    }

    #[test]
    fn layers_larger_than_the_file_are_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("policy.safetensors");
        let (_, card) = policy();
        let bias = |name: &str| {
            let tensor = TensorBytes { dtype: Dtype::U8, shape: vec![400_000], bytes: vec![0; 400_000] };
            (format!("actor.{name}.bias"), tensor)
        };
        let card = serde_json::to_string(&card).expect("a card");
        write_tensors(&path, &[bias("l1"), bias("l2")], CARD, &card).expect("written");
        assert!(
            read_policy(&path).expect_err("too large").to_string().contains("more numbers than it holds")
        );
    }

    #[test]
    fn a_wrong_hash_of_the_observation_is_refused() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("policy.safetensors");
        let (network, mut card) = policy();
        card.observation_hash = "0123456789abcdef".to_owned();
        write_policy(&path, &network, &card).expect("written");
        assert!(read_policy(&path).expect_err("another hash").to_string().contains("0123456789abcdef"));
    }

    #[test]
    fn another_observation_is_refused_by_its_entries() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("policy.safetensors");
        let (network, mut card) = policy();
        card.observation[31] = "speed of 100 km/h".to_owned();
        card.observation.swap(33, 34);
        write_policy(&path, &network, &card).expect("written");
        let error = read_policy(&path).expect_err("another observation").to_string();
        assert!(error.contains("numbers 31, 33-34") && error.contains("speed of 100 km/h"), "{error}");
    }

    #[test]
    fn what_is_no_policy_is_refused_by_name() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("policy.safetensors");
        let (mut network, card) = policy();
        network = Network::of(*network.shape(), network.parameters().iter().map(|_| f32::NAN).collect())
            .expect("as many");
        write_policy(&path, &network, &card).expect("written");
        assert!(
            read_policy(&path)
                .expect_err("NaN")
                .to_string()
                .contains("`actor.l1.weight` holds a number that is not finite")
        );
        let empty = Network::of(Shape { hidden: [0, 3], ..*network.shape() }, vec![0.0; 3 + 6 + 2]);
        write_policy(&path, &empty.expect("as many"), &card).expect("written");
        assert!(read_policy(&path).expect_err("no units").to_string().contains("no units"));
        write_policy(&path, &network, &card).expect("written");
        let bytes = std::fs::read(&path).expect("read");
        std::fs::write(&path, &bytes[..bytes.len() - 7]).expect("cut");
        assert!(
            read_policy(&path).expect_err("cut").to_string().contains("policy.safetensors`: not a policy")
        );
    }
}
