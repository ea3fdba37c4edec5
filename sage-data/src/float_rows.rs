//! Rows of floats from little-endian bytes, in loops whose lengths the compiler knows.

/// Rows of `N` floats of 32 bits.
pub(crate) fn of_f32<const N: usize>(bytes: &[u8]) -> impl Iterator<Item = [f64; N]> {
    let rows = bytes.as_chunks::<4>().0.as_chunks::<N>().0;
    rows.iter().map(|row| row.map(|x| f64::from(f32::from_le_bytes(x))))
}

/// Rows of `N` floats of 64 bits.
pub(crate) fn of_f64<const N: usize>(bytes: &[u8]) -> impl Iterator<Item = [f64; N]> {
    let rows = bytes.as_chunks::<8>().0.as_chunks::<N>().0;
    rows.iter().map(|row| row.map(f64::from_le_bytes))
}
