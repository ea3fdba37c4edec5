//! Scenes as OpenSCENARIO files: what the files say about their origin.

use std::path::Path;

use sage_data::{
    Recording,
    openscenario::{License, Provenance},
    womd::is_record_path,
};
use serde_json::{Map, Value};

/// Facts of `sage generate` that a scenario does not repeat, because they name files of the user.
const PRIVATE: [&str; 2] = ["command", "weights"];

/// Origin of a recording: its file, data set and scene, and how `sage generate` made it if it did.
///
/// *Errors*: a native file whose source is damaged.
pub fn provenance(recording: &Recording) -> Result<Provenance, sage_data::Error> {
    // The name of a pipe says nothing and may differ from run to run.
    let is_file = recording.path.is_file() || is_record_path(&recording.path);
    let name = recording.path.file_name().filter(|_| is_file);
    let file = name.map_or("pipe".into(), |name| name.to_string_lossy());
    let mut provenance = Provenance::default()
        .with("by", concat!("sage ", env!("CARGO_PKG_VERSION")))
        .with("source", file)
        .with("scene", &*recording.scene.id);
    if let Some(dataset) = recording.dataset()? {
        provenance = provenance.with("dataset", dataset);
    }
    let described = recording.provenance()?;
    let described = described.and_then(|text| serde_json::from_str::<Map<String, Value>>(&text).ok());
    Ok(with_facts(provenance, &described.unwrap_or_default()))
}

/// Licence of the scenes of a recording's data set, if it is known.
///
/// *Errors*: as [`provenance`].
pub fn license(recording: &Recording) -> Result<Option<License>, sage_data::Error> {
    Ok(recording.dataset()?.and_then(|dataset| License::of_dataset(&dataset)))
}

/// The same with the facts of an attack.
pub fn with_facts(mut provenance: Provenance, facts: &Map<String, Value>) -> Provenance {
    for (key, value) in facts.iter().filter(|(key, value)| !PRIVATE.contains(&&key[..]) && !value.is_null()) {
        let mut text = value.as_str().map_or_else(|| value.to_string(), str::to_owned);
        if let Some(path) = text.strip_prefix("path:") {
            let name = Path::new(path).file_name().unwrap_or_default();
            text = format!("path:{}", name.to_string_lossy());
        }
        provenance = provenance.with(key, text);
    }
    provenance
}
