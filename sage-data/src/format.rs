//! Formats of scene files, detected by their first bytes.

use crate::{
    gpudrive, parquet_files,
    pickle::{self, Walk},
    womd,
};

/// Formats of scene files. Commands and Python take from it what they offer; a new one has its arm in each `match` and its place in
/// [`Format::ALL`].
///
/// ```
/// use sage_data::Format;
///
/// # let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../examples/crossing.pkl");
/// // The content decides, not the name.
/// assert_eq!(Format::of(&std::fs::read(file)?), Some(Format::Pickle));
/// assert_eq!(Format::of(b"no scene at all"), None);
/// assert_eq!(Format::named("native").map(Format::ending), Some("safetensors"));
/// // Of all formats, which can be read but not written?
/// let read_alone: Vec<Format> = Format::ALL.into_iter().filter(|format| !format.is_written()).collect();
/// assert_eq!(read_alone, [Format::Parquet]);
/// # Ok::<(), std::io::Error>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// A native file: safetensors.
    Native,
    /// A Python pickle. Protocols 0 and 1 are refused, and are known here so that none is taken for another format.
    Pickle,
    /// Records of `Scenario` protos, as the Waymo Open Motion Dataset has them.
    TfRecord,
    /// JSON of GPUDrive.
    GpuDrive,
    /// OpenSCENARIO XML and its OpenDRIVE map; written and not read.
    OpenScenario,
    /// A Parquet file, as Argoverse 2 has them; read and not written.
    Parquet,
}

impl Format {
    /// All formats.
    pub const ALL: [Self; 6] =
        [Self::Native, Self::Pickle, Self::TfRecord, Self::GpuDrive, Self::OpenScenario, Self::Parquet];

    /// Name of the format for users, the ending of its files, and what it is for.
    fn described(self) -> (&'static str, &'static str, &'static str) {
        match self {
            Self::Native => {
                ("native", "safetensors", "safetensors file: fastest to load, readable by other tools")
            }
            Self::Pickle => ("pickle", "pkl", "Pickle for MetaDrive and ScenarioNet"),
            Self::TfRecord => {
                ("womd", "tfrecord", "TFRecord files of Scenario protos, as in the Waymo Open Motion Dataset")
            }
            Self::GpuDrive => {
                ("gpudrive", "json", "JSON of GPUDrive, which PufferDrive and ScenarioMax read too")
            }
            Self::OpenScenario => {
                ("openscenario", "xosc", "OpenSCENARIO XML with an OpenDRIVE map, for simulators")
            }
            Self::Parquet => ("argoverse2", "parquet", "Scenario of Argoverse 2"),
        }
    }

    /// Name of the format for users.
    pub fn name(self) -> &'static str {
        self.described().0
    }

    /// Ending of its files, without the dot.
    pub fn ending(self) -> &'static str {
        self.described().1
    }

    /// What it is for.
    pub fn about(self) -> &'static str {
        self.described().2
    }

    /// Ending of its files in a folder of rows, where rows alone end in `.json`.
    pub fn ending_beside_rows(self) -> &'static str {
        if self == Self::GpuDrive { "gpudrive.json" } else { self.ending() }
    }

    /// Whether scenes are written in it.
    pub fn is_written(self) -> bool {
        self != Self::Parquet
    }

    /// Whether scenes are read from it.
    pub fn is_read(self) -> bool {
        self != Self::OpenScenario
    }

    /// The formats that scenes are written in.
    pub fn all_written() -> impl Iterator<Item = Self> {
        Self::ALL.into_iter().filter(|format| format.is_written())
    }

    /// The format by its name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.name() == name)
    }

    /// The format of a file; `None` if it is none of them. No other code detects formats.
    ///
    /// A file that starts like a pickle is a pickle and nothing else, because Python would load it as one.
    /// A file that is data to one reader and a program to another would be a security risk.
    pub fn of(bytes: &[u8]) -> Option<Self> {
        // Protocols 0 and 1 have no mark of their own at the start.
        let walk = pickle::walk(bytes);
        match bytes {
            // The length of a record can begin like a pickle. Python refuses the zeros that follow, but for those
            // after BINFLOAT and UNICODE, which take any bytes.
            [0x80, 2..=5, third, 0, 0, 0, 0, 0, ..]
                if !matches!(third, b'G' | b'V') && womd::begins_with_record(bytes) =>
            {
                Some(Self::TfRecord)
            }
            [0x80, 2..=5, ..] => Some(Self::Pickle),
            _ if walk == Walk::Names => Some(Self::Pickle),
            // Before native files, because a checksum may look like their brace.
            _ if womd::begins_with_record(bytes) => Some(Self::TfRecord),
            // The length of the header in eight bytes, followed by its opening brace. No header has 4 GiB.
            [_, _, _, _, 0, 0, 0, 0, b'{', ..] => Some(Self::Native),
            _ if parquet_files::is_parquet(bytes) => Some(Self::Parquet),
            _ if walk == Walk::Ends => Some(Self::Pickle),
            // Before native files, whose brace may follow eight other bytes.
            _ if gpudrive::begins_scene(bytes) => Some(Self::GpuDrive),
            [_, _, _, _, _, _, _, _, b'{', ..] => Some(Self::Native),
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_that_start_like_a_pickle_are_pickles() {
        assert_eq!(Format::of(b"\x80\x04N."), Some(Format::Pickle));
        assert_eq!(Format::of(b"\x80\x04G\0\0\0\0\0{\"a\": 1}"), Some(Format::Pickle));
        assert_eq!(Format::of(b"\x88\x04\0\0\0\0\0\0{}"), Some(Format::Native));
        assert_eq!(Format::of(b"\x80\x06\0\0\0\0\0\0{}"), Some(Format::Native));
        // The checksum of some length begins with a brace.
        let brace = (0u64..).map(|n| womd::frame(&vec![0; n as usize])).find(|record| record[8] == b'{');
        assert_eq!(brace.and_then(|record| Format::of(&record)), Some(Format::TfRecord));
        let like_a_pickle = |third: u8| womd::frame(&vec![0; usize::from(third) << 16 | 0x0280]);
        assert_eq!(Format::of(&like_a_pickle(1)), Some(Format::TfRecord));
        assert_eq!(Format::of(&like_a_pickle(b'V')), Some(Format::Pickle));
        for neither in [&b""[..], b"\x80", b"{}", b"no scene at all"] {
            assert_eq!(Format::of(neither), None);
        }
    }
}
