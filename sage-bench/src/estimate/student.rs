//! Student's t distribution, by the regularised incomplete beta function.

use std::f64::consts::PI;

/// Probability that |T| exceeds |t|, for T with Student's distribution of `freedom` degrees of freedom.
pub(super) fn two_sided(t: f64, freedom: f64) -> f64 {
    let square = t * t;
    if square.is_infinite() {
        return 0.0;
    }
    // I_x(ν/2, 1/2) with x = ν/(ν + t²). Its complement 1 − x is given apart, as x rounds to 1 for small t.
    incomplete_beta([0.5 * freedom, 0.5], [freedom / (freedom + square), square / (freedom + square)])
}

/// The value that |T| exceeds with probability `p` in (0, 1).
pub(super) fn quantile(p: f64, freedom: f64) -> f64 {
    let (mut low, mut high) = (0.0, 1.0);
    while two_sided(high, freedom) > p && high < f64::MAX.sqrt() {
        (low, high) = (high, 2.0 * high);
    }
    // More halvings than a mantissa has bits.
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if two_sided(middle, freedom) > p { low = middle } else { high = middle }
    }
    0.5 * (low + high)
}

/// I_x(a, b), for x and 1 − x.
fn incomplete_beta([a, b]: [f64; 2], [x, rest]: [f64; 2]) -> f64 {
    if x == 0.0 || rest == 0.0 {
        return if x == 0.0 { 0.0 } else { 1.0 };
    }
    let front = (ln_gamma(a + b) - ln_gamma(a) - ln_gamma(b) + a * x.ln() + b * rest.ln()).exp();
    // The continued fraction converges fast on this side of the mean alone.
    if x < (a + 1.0) / (a + b + 2.0) {
        front * continued_fraction(a, b, x) / a
    } else {
        1.0 - front * continued_fraction(b, a, rest) / b
    }
}

/// Lentz's method for the continued fraction of I_x(a, b) (Abramowitz and Stegun, 26.5.8).
fn continued_fraction(a: f64, b: f64, x: f64) -> f64 {
    const TINY: f64 = 1e-300;
    let away_from_zero = |v: f64| if v.abs() < TINY { TINY } else { v };
    let mut c = 1.0;
    let mut d = away_from_zero(1.0 - (a + b) * x / (a + 1.0)).recip();
    let mut value = d;
    for step in 1..500 {
        let m = f64::from(step);
        let even = m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m));
        let odd = -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0));
        let mut change = 1.0;
        for term in [even, odd] {
            d = away_from_zero(1.0 + term * d).recip();
            c = away_from_zero(1.0 + term / c);
            change = d * c;
            value *= change;
        }
        if (change - 1.0).abs() < 1e-15 {
            break;
        }
    }
    value
}

/// ln Γ(x) for x > 0: Lanczos's approximation with g = 7 and 9 terms, to about 1e-15.
fn ln_gamma(x: f64) -> f64 {
    const TERMS: [f64; 8] = [
        676.520_368_121_885_1,
        -1_259.139_216_722_402_8,
        771.323_428_777_653_1,
        -176.615_029_162_140_6,
        12.507_343_278_686_905,
        -0.138_571_095_265_720_12,
        9.984_369_578_019_572e-6,
        1.505_632_735_149_311_6e-7,
    ];
    if x < 0.5 {
        // Reflection.
        return (PI / (PI * x).sin()).ln() - ln_gamma(1.0 - x);
    }
    let x = x - 1.0;
    let base = x + 7.5;
    let sum =
        TERMS.iter().zip(1..).fold(0.999_999_999_999_809_9, |sum, (term, k)| sum + term / (x + f64::from(k)));
    0.5 * (2.0 * PI).ln() + (x + 0.5) * base.ln() - base + sum.ln()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_those_of_the_tables() {
        // Two-sided 5 % and 1 % points as printed in tables of the t distribution.
        let table = [
            (1.0, 12.706, 63.657),
            (2.0, 4.303, 9.925),
            (4.0, 2.776, 4.604),
            (7.0, 2.365, 3.499),
            (19.0, 2.093, 2.861),
            (60.0, 2.000, 2.660),
            (120.0, 1.980, 2.617),
        ];
        for (freedom, five, one) in table {
            assert!((quantile(0.05, freedom) - five).abs() < 5.1e-4, "{freedom}");
            assert!((quantile(0.01, freedom) - one).abs() < 5.1e-4, "{freedom}");
        }
        // Many degrees of freedom: the normal distribution's.
        assert!((quantile(0.05, 1e9) - 1.959_963_984_540_054).abs() < 1e-6);
    }

    #[test]
    fn probabilities_have_their_closed_forms() {
        for t in [1e-9, 0.3, 1.0, 2.5, 40.0, 1e6] {
            // One degree of freedom is Cauchy's distribution, two have a root.
            let cauchy = 1.0 - 2.0 * f64::atan(t) / PI;
            let two = 1.0 - t / (2.0 + t * t).sqrt();
            assert!((two_sided(t, 1.0) - cauchy).abs() < 1e-12, "{t}");
            assert!((two_sided(t, 2.0) - two).abs() < 1e-12, "{t}");
        }
        assert_eq!((two_sided(0.0, 3.5), two_sided(f64::INFINITY, 3.5)), (1.0, 0.0));
        assert!((two_sided(quantile(0.37, 5.3), 5.3) - 0.37).abs() < 1e-12);
    }
}
