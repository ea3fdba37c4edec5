//! A prior and experts trained on procedural scenes, with their dial, as files by name.

use std::sync::LazyLock;

/// Files by name.
type Files = Vec<(&'static str, &'static [u8])>;

/// A file of tensors, as it is in `weights/procedural`, from the planes that the build writes.
macro_rules! tensors {
    ($name:literal) => {
        from_planes(include_bytes!(concat!(env!("OUT_DIR"), "/", $name)))
    };
}

/// A driving policy trained by PPO on procedural scenes without attacks; its card says how.
pub static PPO: LazyLock<&[u8]> = LazyLock::new(|| tensors!("ppo"));

/// A driving policy trained by TD3 on procedural scenes without attacks: `sage train-ego --method none`.
pub static TD3: LazyLock<&[u8]> = LazyLock::new(|| tensors!("td3"));

/// Files of the folder `weights/procedural`.
///
/// ```
/// // A prior, and experts that are named by their files.
/// let names: Vec<&str> = sage_weights::PROCEDURAL.iter().map(|(name, _)| *name).collect();
/// assert_eq!(names[..3], ["prior.safetensors", "realistic.safetensors", "adversarial.safetensors"]);
/// ```
pub static PROCEDURAL: LazyLock<Files> = LazyLock::new(|| {
    vec![
        ("prior.safetensors", tensors!("prior")),
        ("realistic.safetensors", tensors!("realistic")),
        ("adversarial.safetensors", tensors!("adversarial")),
        ("lawful.safetensors", tensors!("lawful")),
        #[cfg(feature = "adversaries")]
        ("seal.safetensors", tensors!("seal")),
        #[cfg(feature = "adversaries")]
        ("goose.safetensors", tensors!("goose")),
        ("dial.json", include_bytes!("../procedural/dial.json")),
        ("nominal.json", include_bytes!("../procedural/nominal.json")),
    ]
});

/// The file whose numbers stand in four planes of bytes. It stays to the end of the program, as what is embedded does.
fn from_planes(file: &[u8]) -> &'static [u8] {
    let header =
        file.first_chunk().map_or(0, |length| u64::from_le_bytes(*length) as usize + 8).min(file.len());
    let (header, planes) = file.split_at(header);
    let count = planes.len() / 4;
    let numbers = (0..count).flat_map(|number| (0..4).map(move |plane| planes[plane * count + number]));
    let rest = &planes[4 * count..];
    Vec::leak(header.iter().copied().chain(numbers).chain(rest.iter().copied()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn embedded_files_are_those_of_the_folder() {
        let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("procedural");
        let policies = [("ppo.safetensors", *PPO), ("td3.safetensors", *TD3)];
        for (name, file) in PROCEDURAL.iter().copied().chain(policies) {
            assert!(std::fs::read(folder.join(name)).is_ok_and(|bytes| bytes == file), "{name}");
        }
    }
}
