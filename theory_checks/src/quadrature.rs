//! Gauss and Legendre's quadrature.

/// Nodes in (−1, 1) with their weights.
pub fn gauss_legendre(count: usize) -> Vec<[f64; 2]> {
    let node = |k: usize| {
        let mut x = (std::f64::consts::PI * (k as f64 + 0.75) / (count as f64 + 0.5)).cos();
        let mut slope = 1.0;
        // Newton's method from an estimate that is good to three digits.
        for _ in 0..8 {
            let (mut before, mut value) = (0.0, 1.0);
            for degree in 0..count {
                let n = degree as f64;
                (before, value) = (value, ((2.0 * n + 1.0) * x * value - n * before) / (n + 1.0));
            }
            slope = count as f64 * (x * value - before) / (x * x - 1.0);
            x -= value / slope;
        }
        [x, 2.0 / ((1.0 - x * x) * slope * slope)]
    };
    (0..count).map(node).collect()
}

/// Integral of a function over [low, high].
pub fn integral(nodes: &[[f64; 2]], low: f64, high: f64, f: impl Fn(f64) -> f64) -> f64 {
    let (middle, half) = (0.5 * (low + high), 0.5 * (high - low));
    nodes.iter().map(|[x, weight]| weight * half * f(middle + half * x)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polynomials_of_twice_the_degree_are_exact() {
        let nodes = gauss_legendre(6);
        let found = integral(&nodes, 0.5, 2.0, |x| x.powi(11));
        approx::assert_relative_eq!(found, (2f64.powi(12) - 0.5f64.powi(12)) / 12.0, max_relative = 1e-13);
        let found = integral(&gauss_legendre(60), 0.0, 1.0, f64::exp);
        approx::assert_relative_eq!(found, 1f64.exp() - 1.0, max_relative = 1e-14);
    }
}
