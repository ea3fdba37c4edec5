//! Writes the embedded files with the bytes of their numbers in four planes: first the lowest byte of each, last the highest. Signs
//! and exponents beside each other are compressed better, which takes 110 kB from a package; in a program nothing changes.

use std::{env, fs, io, path::Path};

/// The embedded files of tensors.
const FILES: [&str; 8] = ["prior", "realistic", "adversarial", "lawful", "seal", "goose", "ppo", "td3"];

fn main() -> io::Result<()> {
    let out = env::var("OUT_DIR").map_err(io::Error::other)?;
    for name in FILES {
        let path = format!("procedural/{name}.safetensors");
        println!("cargo::rerun-if-changed={path}");
        fs::write(Path::new(&out).join(name), in_planes(&fs::read(path)?))?;
    }
    Ok(())
}

/// A file of safetensors with 32-bit numbers, in planes.
fn in_planes(file: &[u8]) -> Vec<u8> {
    let header =
        file.first_chunk().map_or(0, |length| u64::from_le_bytes(*length) as usize + 8).min(file.len());
    let (header, numbers) = file.split_at(header);
    let whole = numbers.len() - numbers.len() % 4;
    let plane = |k: usize| numbers[k.min(whole)..whole].iter().step_by(4);
    let planes = (0..4).flat_map(plane).chain(&numbers[whole..]);
    header.iter().chain(planes).copied().collect()
}
