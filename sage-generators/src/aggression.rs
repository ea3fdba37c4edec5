//! The aggression dial: one parameter for λ and μ.
//!
//! λ mixes the experts and μ weighs the selection. With μ = λ nearly all attacks appear in the first tenth
//! of the range, because any contact outweighs a small difference of penalties. An [`Aggression`] maps a in
//! [0, 1] to the operating point (λ, μ): λ = a, and μ from a table fitted such that the attack rate rises
//! evenly. Where the objective does not depend on μ, the table is of λ, and μ = 1.

use serde::{Deserialize, Serialize};

use crate::Error;

/// Table of μ at a = 0, 1/n, … 1, or of λ.
///
/// ```
/// use sage_generators::Aggression;
///
/// // μ at the aggressions 0, 0.5 and 1; λ is the aggression itself.
/// let dial = Aggression::new(vec![0.0, 0.1, 1.0])?;
/// assert_eq!(dial.lambda_and_mu(0.5)?, (0.5, 0.1));
/// assert_eq!(dial.lambda_and_mu(0.25)?, (0.25, 0.05));
/// assert!(dial.lambda_and_mu(1.5).is_err());
/// # Ok::<(), sage_generators::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Table", into = "Table")]
pub struct Aggression {
    table: Table,
}

/// A table as files hold it: of μ, or of λ.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
enum Table {
    Mu(Vec<f64>),
    Lambda { lambda: Vec<f64> },
}

impl Table {
    fn values(&self) -> (&'static str, &[f64]) {
        match self {
            Self::Mu(mu) => ("mu", mu),
            Self::Lambda { lambda } => ("lambda", lambda),
        }
    }
}

impl Aggression {
    /// A table from its values of μ.
    ///
    /// *Errors*: fewer than two, one outside [0, 1], or one smaller than the one before.
    pub fn new(mu: Vec<f64>) -> Result<Self, Error> {
        Self::of(Table::Mu(mu))
    }

    /// A table of λ, with μ = 1 everywhere: for objectives that do not depend on μ.
    ///
    /// *Errors*: as [`Aggression::new`].
    pub fn of_lambda(lambda: Vec<f64>) -> Result<Self, Error> {
        Self::of(Table::Lambda { lambda })
    }

    fn of(table: Table) -> Result<Self, Error> {
        let (name, values) = table.values();
        if values.len() < 2 {
            return fail(format!("a dial of {} values of {name}; expected at least 2", values.len()));
        }
        if let Some(bad) = values.iter().find(|value| !(0.0..=1.0).contains(*value)) {
            return fail(format!("a dial with {name} {bad}; expected 0 to 1"));
        }
        match values.windows(2).find(|pair| pair[1] < pair[0]) {
            Some(pair) => fail(format!("a dial whose {name} falls from {} to {}", pair[0], pair[1])),
            None => Ok(Self { table }),
        }
    }

    /// Checks an aggression.
    ///
    /// *Errors*: an aggression outside [0, 1].
    pub fn check(aggression: f64) -> Result<(), Error> {
        if (0.0..=1.0).contains(&aggression) {
            Ok(())
        } else {
            fail(format!("aggression is {aggression}; expected 0 (realistic) to 1 (adversarial)"))
        }
    }

    /// λ and μ at an aggression.
    ///
    /// *Errors*: an aggression outside [0, 1].
    pub fn lambda_and_mu(&self, aggression: f64) -> Result<(f64, f64), Error> {
        Self::check(aggression)?;
        let (_, values) = self.table.values();
        let last = values.len() - 1;
        let at = aggression * last as f64;
        let k = (at as usize).min(last - 1);
        let share = at - k as f64;
        let value = (1.0 - share) * values[k] + share * values[k + 1];
        Ok(match self.table {
            Table::Mu(_) => (aggression, value),
            Table::Lambda { .. } => (value, 1.0),
        })
    }

    /// Fits a table of λ in the same way to the attack rates at λ = 0 to 1, evenly spaced: the rate of an aggression should be on
    /// the straight line from the first to the last.
    ///
    /// *Errors*: fewer than two rates.
    pub fn fit_lambda(rates: &[f64], steps: usize) -> Result<Self, Error> {
        let last = rates.len().saturating_sub(1).max(1);
        let grid: Vec<f64> = (0..rates.len()).map(|k| k as f64 / last as f64).collect();
        // The rates do not depend on the step, only on the value that is chosen for it.
        let fitted = Self::fit(&grid, &vec![rates.to_vec(); steps])?;
        Self::of_lambda(fitted.table.values().1.to_vec())
    }

    /// Fits the table in least squares: the attack rate should follow a straight line from its first to its
    /// last value, with μ never falling.
    ///
    /// `rates[k][m]` is the attack rate at λ = k/n and the m-th value of `grid`, the values of μ, which
    /// rise from 0 to 1.
    ///
    /// *Errors*: rates of other shapes.
    pub fn fit(grid: &[f64], rates: &[Vec<f64>]) -> Result<Self, Error> {
        let steps = rates.len();
        if steps < 2 || grid.len() < 2 || rates.iter().any(|row| row.len() != grid.len()) {
            return fail(format!(
                "attack rates at {steps} values of lambda and {} of mu cannot be fitted",
                grid.len()
            ));
        }
        let last = grid.len() - 1;
        let (low, high) = (rates[0][0], rates[steps - 1][last]);
        let cost = |k: usize, m: usize| {
            let line = low + (high - low) * k as f64 / (steps - 1) as f64;
            (rates[k][m] - line).powi(2)
        };
        // Dynamic programming: least cost of ending at each m, and the previous m of that solution. Both
        // ends are fixed.
        let mut total: Vec<f64> = (0..=last).map(|m| if m == 0 { 0.0 } else { f64::INFINITY }).collect();
        let mut from = Vec::with_capacity(steps);
        for k in 1..steps {
            let (mut best, mut came) = (0, vec![0; last + 1]);
            let mut next = vec![f64::INFINITY; last + 1];
            for m in 0..=last {
                if total[m] < total[best] {
                    best = m;
                }
                came[m] = best;
                next[m] = total[best] + cost(k, m);
            }
            total = next;
            from.push(came);
        }
        let mut selected = vec![last];
        for came in from.iter().rev() {
            let next = came[selected[selected.len() - 1]];
            selected.push(next);
        }
        selected.reverse();
        Self::new(selected.into_iter().map(|m| grid[m]).collect())
    }
}

fn fail<T>(problem: String) -> Result<T, Error> {
    Err(Error::Dial { problem })
}

impl TryFrom<Table> for Aggression {
    type Error = Error;

    fn try_from(table: Table) -> Result<Self, Error> {
        Self::of(table)
    }
}

impl From<Aggression> for Table {
    fn from(dial: Aggression) -> Self {
        dial.table
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_is_interpolated_linearly_and_lambda_is_the_aggression() {
        let dial = Aggression::new(vec![0.0, 0.1, 1.0]).unwrap();
        assert_eq!(dial.lambda_and_mu(0.0).unwrap(), (0.0, 0.0));
        assert_eq!(dial.lambda_and_mu(0.5).unwrap(), (0.5, 0.1));
        assert_eq!(dial.lambda_and_mu(1.0).unwrap(), (1.0, 1.0));
        let (lambda, mu) = dial.lambda_and_mu(0.75).unwrap();
        assert!(lambda == 0.75 && (mu - 0.55).abs() < 1e-12);
    }

    #[test]
    fn a_fit_makes_a_curved_rate_linear() {
        // The rate rises steeply at small μ, like that of the best of many candidates.
        let grid: Vec<f64> = (0..=200).map(|m| m as f64 / 200.0).collect();
        let rate = |mu: f64| 0.1 + 0.8 * mu.powf(0.2);
        let rates = vec![grid.iter().map(|mu| rate(*mu)).collect(); 11];
        let dial = Aggression::fit(&grid, &rates).unwrap();
        for k in 0..=10 {
            let a = k as f64 / 10.0;
            let (_, mu) = dial.lambda_and_mu(a).unwrap();
            // One step of the grid near 0 is a third of the range: the fit is as good as the grid.
            let line = 0.1 + 0.8 * a;
            let best = grid.iter().map(|mu| (rate(*mu) - line).abs()).fold(f64::INFINITY, f64::min);
            assert!((rate(mu) - line).abs() <= best + 1e-9, "a {a}: {} for {line}", rate(mu));
        }
    }

    #[test]
    fn a_rate_that_falls_with_mu_still_gives_a_rising_table() {
        let grid = [0.0, 0.1, 0.5, 1.0];
        let rates = vec![vec![0.0, 0.8, 0.4, 1.0], vec![0.0, 0.9, 0.5, 1.0], vec![0.0, 0.5, 0.6, 1.0]];
        let fitted = Aggression::fit(&grid, &rates).unwrap();
        assert_eq!(fitted.table, Table::Mu(vec![0.0, 0.5, 1.0]));
    }

    #[test]
    fn a_table_of_lambda_follows_a_curved_rate_and_is_kept_in_files() {
        // The rate is that of λ squared, so λ is the root of the aggression.
        let rates: Vec<f64> = (0..=100).map(|k| (f64::from(k) / 100.0).powi(2)).collect();
        let dial = Aggression::fit_lambda(&rates, 11).unwrap();
        for k in 0..=10 {
            let a = f64::from(k) / 10.0;
            let (lambda, mu) = dial.lambda_and_mu(a).unwrap();
            assert!((lambda - a.sqrt()).abs() < 0.006 && mu == 1.0, "{a}: {lambda}");
        }
        let text = serde_json::to_string(&dial).unwrap();
        assert!(text.starts_with(r#"{"lambda":[0.0,"#), "{text}");
        assert_eq!(serde_json::from_str::<Aggression>(&text).unwrap(), dial);
        assert_eq!(serde_json::to_string(&Aggression::new(vec![0.0, 1.0]).unwrap()).unwrap(), "[0.0,1.0]");
        assert!(Aggression::fit_lambda(&[0.5], 11).is_err());
        assert!(serde_json::from_str::<Aggression>(r#"{"lambda":[0.5,0.2]}"#).is_err());
    }

    #[test]
    fn tables_and_aggressions_out_of_range_are_refused() {
        for mu in [vec![0.0], vec![0.0, 1.5], vec![0.0, 0.5, 0.4], vec![0.0, f64::NAN]] {
            assert!(Aggression::new(mu).is_err());
        }
        let dial = Aggression::new(vec![0.0, 1.0]).unwrap();
        assert!(dial.lambda_and_mu(1.01).is_err() && dial.lambda_and_mu(f64::NAN).is_err());
    }
}
