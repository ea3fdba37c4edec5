//! A prior and experts trained on procedural scenes, with their dial, as files by name.

/// A driving policy trained by PPO on procedural scenes without attacks; its card says how.
pub const PPO: &[u8] = include_bytes!("../procedural/ppo.safetensors");

/// A driving policy trained by TD3 on procedural scenes without attacks: `sage train-ego --method none`.
pub const TD3: &[u8] = include_bytes!("../procedural/td3.safetensors");

/// Files of the folder `weights/procedural`.
///
/// ```
/// // A prior, and experts that are named by their files.
/// let names: Vec<&str> = sage_weights::PROCEDURAL.iter().map(|(name, _)| *name).collect();
/// assert_eq!(names[..3], ["prior.safetensors", "realistic.safetensors", "adversarial.safetensors"]);
/// ```
pub const PROCEDURAL: &[(&str, &[u8])] = &[
    ("prior.safetensors", include_bytes!("../procedural/prior.safetensors")),
    ("realistic.safetensors", include_bytes!("../procedural/realistic.safetensors")),
    ("adversarial.safetensors", include_bytes!("../procedural/adversarial.safetensors")),
    ("lawful.safetensors", include_bytes!("../procedural/lawful.safetensors")),
    #[cfg(feature = "adversaries")]
    ("seal.safetensors", include_bytes!("../procedural/seal.safetensors")),
    #[cfg(feature = "adversaries")]
    ("goose.safetensors", include_bytes!("../procedural/goose.safetensors")),
    ("dial.json", include_bytes!("../procedural/dial.json")),
];
