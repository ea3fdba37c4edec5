//! Numbers as decimal text: a fixed number of decimals without trailing zeros, no exponent, no `-0`.

/// Powers of ten up to the largest number of decimals.
const POWERS: [f64; 13] = [1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12];
/// Integers below this are exact in a 64-bit float.
const EXACT: f64 = 9_007_199_254_740_992.0;

/// The value that the text of a number has: [`push`] writes it, and parsing the text gives it back.
pub(crate) fn rounded(value: f64, decimals: usize) -> f64 {
    let scaled = (value * POWERS[decimals]).round();
    // The division of two exact integers is rounded once, as parsing is. Larger numbers are written with
    // fewer digits than they have, and change by less than their own resolution.
    if scaled.abs() < EXACT { scaled / POWERS[decimals] + 0.0 } else { value }
}

/// Appends a number with at most this number of decimals. Scenes hold finite numbers; others become 0.
pub(super) fn push(out: &mut String, value: f64, decimals: usize) {
    debug_assert!(value.is_finite(), "a number that is not finite");
    let scaled = (value * POWERS[decimals]).round();
    if !scaled.is_finite() {
        out.push('0');
    } else if scaled.abs() < EXACT {
        push_scaled(out, scaled as i64, decimals);
    } else {
        let text = format!("{value:.decimals$}");
        let text = if decimals > 0 { text.trim_end_matches('0').trim_end_matches('.') } else { &text };
        out.push_str(text);
    }
}

/// Appends an integer.
pub(super) fn push_integer(out: &mut String, value: i64) {
    push_scaled(out, value, 0);
}

/// Appends `scaled / 10^decimals`.
fn push_scaled(out: &mut String, scaled: i64, decimals: usize) {
    // From the last digit to the first: 20 digits, a sign and a point.
    let mut buffer = [0u8; 24];
    let mut start = buffer.len();
    let mut rest = scaled.unsigned_abs();
    let mut skips_zeros = true;
    for _ in 0..decimals {
        let digit = (rest % 10) as u8;
        rest /= 10;
        if digit != 0 || !skips_zeros {
            skips_zeros = false;
            start -= 1;
            buffer[start] = b'0' + digit;
        }
    }
    if !skips_zeros {
        start -= 1;
        buffer[start] = b'.';
    }
    loop {
        start -= 1;
        buffer[start] = b'0' + (rest % 10) as u8;
        rest /= 10;
        if rest == 0 {
            break;
        }
    }
    if scaled < 0 {
        start -= 1;
        buffer[start] = b'-';
    }
    out.extend(buffer[start..].iter().map(|byte| char::from(*byte)));
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(value: f64, decimals: usize) -> String {
        let mut out = String::new();
        push(&mut out, value, decimals);
        out
    }

    #[test]
    fn numbers_are_trimmed_and_have_no_exponent_and_no_minus_zero() {
        let cases = [
            (0.0, 6, "0"),
            (-0.0, 6, "0"),
            (-4e-7, 6, "0"),
            (1e-6, 6, "0.000001"),
            (-12.5, 6, "-12.5"),
            (100.0, 3, "100"),
            (0.1 + 0.2, 12, "0.3"),
            (1e-12, 12, "0.000000000001"),
            (7.6, 0, "8"),
            (1e20, 6, "100000000000000000000"),
            (123_456_789.125, 12, "123456789.125"),
            (f64::from(i32::MIN), 1, "-2147483648"),
        ];
        for (value, decimals, expected) in cases {
            assert_eq!(text(value, decimals), expected);
        }
    }

    #[test]
    fn parsing_a_text_gives_the_rounded_number() {
        let mut value = 1e-7f64;
        while value < 1e8 {
            for x in [value, -value, value * 1.000_123_456_789, (value * 1e3).sin() * value] {
                for (decimals, power) in POWERS.iter().enumerate() {
                    let read: f64 = text(x, decimals).parse().unwrap();
                    let is_exact = (x * power).abs() < EXACT - 1.0;
                    assert!(!is_exact || read == rounded(x, decimals), "{x} with {decimals}");
                    assert!((read - x).abs() <= 0.501 / power + 1e-15 * x.abs(), "{x} {read}");
                }
            }
            value *= 1.37;
        }
    }
}
