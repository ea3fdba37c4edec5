//! Adam: steps along the gradient, scaled by its running moments (Kingma and Ba, 2015).

/// Prevents a division by zero.
const EPSILON: f64 = 1e-8;

/// State of an optimisation over pairs of numbers.
pub(crate) struct Adam {
    rate: f64,
    betas: [f64; 2],
    moments: Vec<[[f64; 2]; 2]>,
    /// Powers of the betas, for the correction of the first steps.
    powers: [f64; 2],
}

impl Adam {
    pub(crate) fn new(count: usize, rate: f64, betas: [f64; 2]) -> Self {
        Self { rate, betas, moments: vec![[[0.0; 2]; 2]; count], powers: [1.0; 2] }
    }

    /// Moves parameters in the direction of a gradient: uphill for a positive `sign`, downhill for a negative one.
    pub(crate) fn step(&mut self, parameters: &mut [[f64; 2]], gradient: &[[f64; 2]], sign: f64) {
        let [b1, b2] = self.betas;
        self.powers = [self.powers[0] * b1, self.powers[1] * b2];
        let [c1, c2] = self.powers.map(|power| 1.0 / (1.0 - power));
        for ((parameter, g), moments) in parameters.iter_mut().zip(gradient).zip(&mut self.moments) {
            for k in 0..2 {
                let [first, second] = &mut moments[k];
                *first = b1 * *first + (1.0 - b1) * g[k];
                *second = b2 * *second + (1.0 - b2) * g[k] * g[k];
                parameter[k] += sign * self.rate * *first * c1 / ((*second * c2).sqrt() + EPSILON);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_step_has_the_length_of_the_rate_and_a_parabola_is_solved() {
        let mut adam = Adam::new(1, 0.1, [0.9, 0.999]);
        let mut x = [[3.0, -2.0]];
        let gradient = |x: &[[f64; 2]]| [[2.0 * (x[0][0] - 1.0), 20.0 * (x[0][1] + 1.0)]];
        let slope = gradient(&x);
        adam.step(&mut x, &slope, -1.0);
        assert!((x[0][0] - 2.9).abs() < 1e-6 && (x[0][1] + 1.9).abs() < 1e-6, "{x:?}");
        for _ in 0..600 {
            let slope = gradient(&x);
            adam.step(&mut x, &slope, -1.0);
        }
        assert!((x[0][0] - 1.0).abs() < 1e-3 && (x[0][1] + 1.0).abs() < 1e-3, "{x:?}");
    }
}
