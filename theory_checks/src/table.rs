//! Measured numbers beside those of an independent implementation.

use sage_core::statistics;
use serde::Serialize;

use crate::json;

/// A table of measured numbers.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Table {
    /// What the table shows, with the distribution that its numbers depend on.
    pub caption: String,
    /// Heading of the first column, then of each column of numbers.
    pub columns: Vec<String>,
    /// Rows: a name and its numbers.
    pub rows: Vec<(String, Vec<Number>)>,
}

impl Table {
    /// A table without rows.
    pub fn new(caption: &str, columns: &[&str]) -> Self {
        let columns = columns.iter().map(|column| (*column).to_owned()).collect();
        Self { caption: caption.to_owned(), columns, rows: Vec::new() }
    }

    /// Adds a row.
    pub fn row(&mut self, name: impl Into<String>, numbers: impl IntoIterator<Item = Number>) {
        self.rows.push((name.into(), numbers.into_iter().collect()));
    }
}

/// How near a number must be to that of an independent implementation, which drew other instances.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Agreement {
    /// Within three standard errors of the difference; the other number is of the same number of instances.
    ThreeStandardErrors,
    /// Of the same sign and within a factor.
    Factor(f64),
    /// Within a distance.
    Distance(f64),
}

/// A measured number.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Number {
    /// The value; not a number where nothing was measured.
    #[serde(serialize_with = "json::number")]
    pub value: f64,
    /// Its standard error, if it has one.
    #[serde(serialize_with = "json::optional")]
    pub standard_error: Option<f64>,
    /// The number of an independent implementation.
    pub reference: Option<f64>,
    /// How near it must be; `None` where it depends on a distribution that is not the same.
    pub agreement: Option<Agreement>,
}

impl Number {
    /// A number without an error.
    pub fn new(value: f64) -> Self {
        Self { value, standard_error: None, reference: None, agreement: None }
    }

    /// A share of trials, with its standard error.
    pub fn share(of: &[f64]) -> Self {
        let value = statistics::mean(of).unwrap_or(f64::NAN);
        // Half a success keeps the error of 0 and 1 above 0.
        let n = of.len().max(1) as f64;
        let smoothed = (value * n + 0.5) / (n + 1.0);
        Self { standard_error: Some((smoothed * (1.0 - smoothed) / n).sqrt()), ..Self::new(value) }
    }

    /// The median of values of which `independent` are independent, with its standard error: half the distance
    /// of the quantiles that lie a standard deviation of the rank to either side.
    pub fn median(values: &[f64], independent: usize) -> Self {
        let quantile = |share: f64| statistics::quantile(values, share).unwrap_or(f64::NAN);
        let step = 0.5 / (independent.max(1) as f64).sqrt();
        let error = 0.5 * (quantile(0.5 + step) - quantile(0.5 - step));
        Self { standard_error: Some(error), ..Self::new(quantile(0.5)) }
    }

    /// Root of the mean square of values, with its standard error.
    pub fn root_mean_square(values: &[f64]) -> Self {
        let squares: Vec<f64> = values.iter().map(|value| value * value).collect();
        let mean = statistics::mean(&squares).unwrap_or(f64::NAN);
        let variance = squares.iter().map(|square| (square - mean).powi(2)).sum::<f64>();
        let n = squares.len() as f64;
        let error = (variance / (n * (n - 1.0).max(1.0))).sqrt() / (2.0 * mean.sqrt());
        Self { standard_error: Some(error), ..Self::new(mean.sqrt()) }
    }

    /// Quantiles of values.
    pub fn quantiles<const N: usize>(values: &[f64], shares: [f64; N]) -> [Self; N] {
        shares.map(|share| Self::new(statistics::quantile(values, share).unwrap_or(f64::NAN)))
    }

    /// The same with the number of an independent implementation.
    #[must_use]
    pub fn beside(self, reference: f64, agreement: Agreement) -> Self {
        Self { reference: Some(reference), agreement: Some(agreement), ..self }
    }

    /// The same beside a number that another distribution of instances gave.
    #[must_use]
    pub fn beside_another(self, reference: f64) -> Self {
        Self { reference: Some(reference), ..self }
    }

    /// Whether the number agrees with that of an independent implementation; `None` if it need not.
    pub fn agrees(&self) -> Option<bool> {
        let (reference, agreement) = (self.reference?, self.agreement?);
        let distance = (self.value - reference).abs();
        Some(match agreement {
            Agreement::ThreeStandardErrors => {
                // Printed with two or three digits, and drawn as often as ours.
                let printed = 0.005 * reference.abs();
                distance <= 3.0 * std::f64::consts::SQRT_2 * self.standard_error? + printed
            }
            Agreement::Factor(factor) => (1.0 / factor..=factor).contains(&(self.value / reference)),
            Agreement::Distance(most) => distance <= most,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_agree_within_their_tolerance() {
        let values: Vec<f64> = (0..101).map(f64::from).collect();
        let median = Number::median(&values, 100);
        // A twentieth of the range to either side of the middle rank.
        approx::assert_relative_eq!(median.value, 50.0);
        approx::assert_relative_eq!(median.standard_error.unwrap_or(0.0), 5.0, max_relative = 1e-12);
        let agrees = |reference: f64| median.beside(reference, Agreement::ThreeStandardErrors).agrees();
        assert_eq!((agrees(60.0), agrees(75.0), median.agrees()), (Some(true), Some(false), None));
        let two = Number::new(2.0);
        assert_eq!(two.beside(4.0, Agreement::Factor(2.0)).agrees(), Some(true));
        assert_eq!(two.beside(0.9, Agreement::Factor(2.0)).agrees(), Some(false));
        assert_eq!(two.beside(2.1, Agreement::Distance(0.15)).agrees(), Some(true));
        let nothing = Number::new(f64::NAN);
        assert_eq!(nothing.beside(2.0, Agreement::Factor(2.0)).agrees(), Some(false));
        assert!(Number::share(&[1.0; 20]).standard_error.is_some_and(|error| error > 0.0));
    }
}
