//! How much it takes: the smallest λ from which a driver fails at the plan that is selected there.

/// Consecutive points at which a driver must fail.
const CONSECUTIVE: usize = 3;

/// Number of the first point from which the driver fails at three consecutive points, or at all up to the last.
///
/// ```
/// use sage_sim::search::threshold::threshold;
///
/// // The driver fails at λ = 0.2 alone, and from 0.4 on.
/// let fails = [false, true, false, true, true, true];
/// assert_eq!(threshold(&fails), Some(3));
/// assert_eq!(threshold(&[false; 6]), None);
/// ```
pub fn threshold(fails: &[bool]) -> Option<usize> {
    let stays = |first: &usize| fails[*first..].iter().take(CONSECUTIVE).all(|fails| *fails);
    (0..fails.len()).find(stays)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_threshold_needs_three_failures_or_all_up_to_the_end() {
        let of = |text: &str| threshold(&text.chars().map(|c| c == 'x').collect::<Vec<_>>());
        assert_eq!(of("..xx.xxx."), Some(5));
        assert_eq!(of("xxx......"), Some(0));
        assert_eq!(of("......xx."), None);
        assert_eq!(of(".......xx"), Some(7));
        assert_eq!(of("........x"), Some(8));
        assert_eq!(of("........."), None);
        assert_eq!(of(""), None);
    }
}
