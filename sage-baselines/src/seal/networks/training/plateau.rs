//! Learning rate that is halved where the validation stops improving, as PyTorch's `ReduceLROnPlateau`.

/// A validation must be better than the best by this share to count as an improvement.
const THRESHOLD: f64 = 1e-4;

/// Learning rate after epochs with these validation losses. It is halved after more than `patience` epochs without an
/// improvement; the `cooldown` epochs after that do not count.
pub(super) fn rate(start: f64, patience: u32, cooldown: u32, validations: impl Iterator<Item = f64>) -> f64 {
    let (mut rate, mut best) = (start, f64::INFINITY);
    let (mut without, mut cooling) = (0, 0);
    for validation in validations {
        if validation < best * (1.0 - THRESHOLD) {
            (best, without) = (validation, 0);
        } else {
            without += 1;
        }
        if cooling > 0 {
            (cooling, without) = (cooling - 1, 0);
        }
        if without > patience {
            (rate, cooling, without) = (rate / 2.0, cooldown, 0);
        }
    }
    rate
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rate_is_halved_after_the_patience_and_again_after_the_cooldown() {
        let after = |epochs: usize| rate(1.0, 2, 3, std::iter::once(1.0).chain(vec![1.0; epochs]));
        // Epochs 1 to 3 bring no improvement; 4 to 6 are the cooldown; 7 to 9 bring none.
        assert_eq!([2, 3, 8, 9].map(after), [1.0, 0.5, 0.5, 0.25]);
        let improving = (0..50).map(|k| 0.9_f64.powi(k));
        assert_eq!(rate(1.0, 2, 3, improving), 1.0);
    }
}
