//! Files of weights, read in this process: every tensor, and bits all over the file.

use std::path::Path;

use sage_backbones::Parameters;

use crate::mutants::tables::{TensorFile, changed};

/// The error of a file of weights.
fn error_of(bytes: &[u8]) -> Option<String> {
    Parameters::from_bytes(bytes, Path::new("some.safetensors")).err().map(|error| error.to_string())
}

#[test]
fn a_number_that_is_none_and_a_flipped_bit_are_noticed_in_every_file() {
    for name in ["prior", "realistic", "adversarial"] {
        let file = format!("../weights/procedural/{name}.safetensors");
        let whole = std::fs::read(Path::new(env!("CARGO_MANIFEST_DIR")).join(file)).unwrap();
        assert_eq!(error_of(&whole), None);
        for (number, tensor) in TensorFile::of(&whole).names().enumerate() {
            let value = ["NaN", "inf", "-inf"][number % 3];
            let error = error_of(&changed(&whole, &format!("{tensor}@0"), value)).unwrap();
            assert!(error.contains(tensor) && error.contains("expected finite numbers"), "{name}: {error}");
        }
        for share in 0..200 {
            let (mut flipped, at) = (whole.clone(), whole.len() * share / 200);
            flipped[at] ^= 1 << (share % 8);
            let error = error_of(&flipped).unwrap_or_else(|| panic!("{name}: byte {at}"));
            assert!(error.contains("some.safetensors") && error.len() < 1000, "byte {at} of {name}: {error}");
        }
        for cut in 0..40 {
            assert!(error_of(&whole[..whole.len() * cut / 40]).is_some(), "{name}: {cut} of 40");
        }
    }
}
