//! PID controller over a window of errors, as in the published autopilot: no time step, mean of the window.

/// Length of the window.
const WINDOW: usize = 40;

/// A controller and its window, at first zeros.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pid {
    gains: [f64; 3],
    errors: [f64; WINDOW],
    next: usize,
}

impl Pid {
    /// A controller with proportional, integral and derivative gains.
    pub(super) fn new(gains: [f64; 3]) -> Self {
        Self { gains, errors: [0.0; WINDOW], next: 0 }
    }

    /// The output after an error.
    pub(super) fn output(&mut self, error: f64) -> f64 {
        let last = self.errors[(self.next + WINDOW - 1) % WINDOW];
        self.errors[self.next] = error;
        self.next = (self.next + 1) % WINDOW;
        let mean = self.errors.iter().sum::<f64>() / WINDOW as f64;
        let [p, i, d] = self.gains;
        p * error + i * mean + d * (error - last)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use approx::assert_relative_eq;

    #[test]
    fn the_terms_are_those_of_the_formula() {
        let mut pid = Pid::new([2.0, 4.0, 8.0]);
        assert_relative_eq!(pid.output(1.0), 2.0 + 4.0 / 40.0 + 8.0);
        assert_relative_eq!(pid.output(1.5), 3.0 + 4.0 * 2.5 / 40.0 + 4.0);
        for _ in 0..40 {
            pid.output(0.5);
        }
        assert_relative_eq!(pid.output(0.5), 1.0 + 2.0, epsilon = 1e-12);
    }
}
