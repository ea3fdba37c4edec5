//! Numbers of claims as texts.

use std::fmt::Write as _;

use sage_core::text::table::Table;
use theory_checks::Number;

/// The numbers of a claim, each with that of the independent implementation in parentheses.
pub(super) fn numbers(of: &theory_checks::Table) -> Table {
    let columns: Vec<&str> = of.columns.iter().map(String::as_str).collect();
    let mut table = Table::new(of.caption.clone(), &columns);
    for (name, numbers) in &of.rows {
        table.row(name, numbers.iter().map(shown));
    }
    table
}

/// A number with its standard error, and the other implementation's number in parentheses.
fn shown(number: &Number) -> String {
    if number.value.is_nan() {
        return "-".to_owned();
    }
    let mut text = digits(number.value);
    if let Some(error) = number.standard_error {
        let _ = write!(text, " ± {}", of_error(error));
    }
    if let Some(reference) = number.reference {
        let differs = if number.agrees() == Some(false) { ", differs" } else { "" };
        let _ = write!(text, " ({}{differs})", digits(reference));
    }
    text
}

/// Three significant digits, all of a whole number.
pub(super) fn digits(value: f64) -> String {
    let size = value.abs();
    // Counts are whole.
    if value.fract() == 0.0 && size < 1e7 {
        return format!("{value:.0}");
    }
    if (1e-3..1e4).contains(&size) {
        let decimals = 2 - size.log10().floor() as i32;
        return format!("{value:.*}", decimals.max(0) as usize);
    }
    if size.is_infinite() { "∞".to_owned() } else { format!("{value:.1e}") }
}

/// Two significant digits of a standard error.
fn of_error(error: f64) -> String {
    let size = error.abs();
    if (1e-3..10.0).contains(&size) {
        let decimals = 1 - size.log10().floor() as i32;
        return format!("{error:.*}", decimals.max(0) as usize);
    }
    digits(error)
}

#[cfg(test)]
mod tests {
    use super::*;
    use theory_checks::Agreement;

    #[test]
    fn numbers_have_three_digits_and_say_what_differs() {
        assert_eq!([0.0, 0.123456, 1.5, 12.34, 123.4].map(digits), ["0", "0.123", "1.50", "12.3", "123"]);
        assert_eq!(
            [1.2e-5, 47_123.4, 18_310.0, f64::INFINITY].map(digits),
            ["1.2e-5", "4.7e4", "18310", "∞"]
        );
        let number = Number::new(2.0).beside(3.0, Agreement::Factor(1.2));
        assert_eq!(shown(&number), "2 (3, differs)");
        assert_eq!(shown(&Number::new(f64::NAN)), "-");
    }
}
