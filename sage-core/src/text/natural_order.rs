//! The order of names in which numbers count by value.

use std::cmp::Ordering;

/// Natural order: `2.pkl` comes before `10.pkl`. Names that differ in zeros before a number alone are compared as texts.
pub fn natural_order(a: &str, b: &str) -> Ordering {
    by_numbers(a.as_bytes(), b.as_bytes()).then_with(|| a.cmp(b))
}

/// Compares texts in which runs of digits are numbers.
fn by_numbers(mut a: &[u8], mut b: &[u8]) -> Ordering {
    while let ([first, ..], [other, ..]) = (a, b) {
        let ordering = if first.is_ascii_digit() && other.is_ascii_digit() {
            let (m, n) = (number(a), number(b));
            (a, b) = (&a[digits(a)..], &b[digits(b)..]);
            // Without zeros in front, the longer number is the larger.
            m.len().cmp(&n.len()).then_with(|| m.cmp(n))
        } else {
            let ordering = first.cmp(other);
            (a, b) = (&a[1..], &b[1..]);
            ordering
        };
        if ordering.is_ne() {
            return ordering;
        }
    }
    a.len().cmp(&b.len())
}

/// Length of the run of digits at the start of a text.
fn digits(text: &[u8]) -> usize {
    text.iter().position(|byte| !byte.is_ascii_digit()).unwrap_or(text.len())
}

/// The run of digits at the start of a text, without zeros in front.
fn number(text: &[u8]) -> &[u8] {
    let run = &text[..digits(text)];
    &run[run.iter().take_while(|digit| **digit == b'0').count()..]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_in_names_order_by_value() {
        let mut names = ["10.pkl", "2.pkl", "a/1.pkl", "02.pkl", "1.pkl", "x10y2", "x10y10", "x9"];
        names.sort_by(|a, b| natural_order(a, b));
        assert_eq!(names, ["1.pkl", "02.pkl", "2.pkl", "10.pkl", "a/1.pkl", "x9", "x10y2", "x10y10"]);
    }
}
