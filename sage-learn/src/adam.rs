//! Adam (Kingma and Ba 2015), with the move of the target network in the same pass over the weights.

use super::kernels::Real;

/// Adam's numbers that stay.
#[derive(Clone, Copy, Debug)]
pub(super) struct Adam {
    /// Decay of the first and second moments.
    pub(super) betas: [f64; 2],
    /// Term against division by zero.
    pub(super) epsilon: f64,
}

/// The target network that follows, and the share τ of the online weights that it takes over.
pub(super) struct Following<'a, T> {
    pub(super) target: &'a mut [T],
    pub(super) tau: f64,
}

/// Moments of one network's parameters.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Moments<T> {
    pub(super) first: Vec<T>,
    pub(super) second: Vec<T>,
}

/// Numbers of one step that all parameters share.
#[derive(Clone, Copy)]
struct Step<T> {
    /// 1 − β₁, β₂ and 1 − β₂.
    decays: [T; 3],
    /// Rate, corrected for the first moment's start at 0.
    rate: T,
    /// √(1 − β₂ᵗ), the correction of the second moment.
    root: T,
    epsilon: T,
}

impl<T: Real> Step<T> {
    fn new(rate: f64, step: u64, adam: Adam) -> Self {
        let [beta1, beta2] = adam.betas;
        let exponent = step as f64;
        Self {
            decays: [1.0 - beta1, beta2, 1.0 - beta2].map(T::of),
            rate: T::of(rate / (1.0 - beta1.powf(exponent))),
            root: T::of((1.0 - beta2.powf(exponent)).sqrt()),
            epsilon: T::of(adam.epsilon),
        }
    }

    #[inline(always)]
    fn apply(self, m: &mut T, v: &mut T, p: &mut T, g: T) {
        let [take, keep, add] = self.decays;
        *m += (g - *m) * take;
        *v = *v * keep + g * g * add;
        *p -= self.rate * (*m / (v.root() / self.root + self.epsilon));
    }
}

impl<T: Real> Moments<T> {
    pub(super) fn new(count: usize) -> Self {
        Self { first: vec![T::default(); count], second: vec![T::default(); count] }
    }

    /// Step number `step` (1 the first): `p ← p − rate/(1 − β₁ᵗ) · m / (√v/√(1 − β₂ᵗ) + ε)`. With a target, it
    /// then moves by `target ← τ p + (1 − τ) target`.
    pub(super) fn step(
        &mut self,
        parameters: &mut [T],
        gradient: &[T],
        follows: Option<Following<T>>,
        rate: f64,
        step: u64,
        adam: Adam,
    ) {
        let step = Step::<T>::new(rate, step, adam);
        let share = follows.as_ref().map_or(0.0, |follows| follows.tau);
        let (tau, rest) = (T::of(share), T::of(1.0 - share));
        let target = follows.map(|follows| follows.target);
        let (first, second) = (&mut self.first[..], &mut self.second[..]);
        pulp::Arch::new().dispatch(Pass { first, second, parameters, gradient, target, step, tau, rest });
    }
}

/// One pass over the parameters.
struct Pass<'a, T> {
    first: &'a mut [T],
    second: &'a mut [T],
    parameters: &'a mut [T],
    gradient: &'a [T],
    target: Option<&'a mut [T]>,
    step: Step<T>,
    tau: T,
    rest: T,
}

impl<T: Real> pulp::NullaryFnOnce for Pass<'_, T> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { first, second, parameters, gradient, target, step, tau, rest } = self;
        let all = first.iter_mut().zip(second).zip(parameters).zip(gradient);
        match target {
            None => {
                for (((m, v), p), g) in all {
                    step.apply(m, v, p, *g);
                }
            }
            Some(target) => {
                for ((((m, v), p), g), t) in all.zip(target) {
                    step.apply(m, v, p, *g);
                    *t = tau * *p + rest * *t;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_step_has_the_size_of_the_rate_and_the_target_follows() {
        let adam = Adam { betas: [0.9, 0.999], epsilon: 1e-8 };
        let mut moments = Moments::new(2);
        let (mut p, mut target) = ([1.0_f64, 1.0], [0.0, 0.0]);
        let follows = Some(Following { target: &mut target, tau: 0.25 });
        moments.step(&mut p, &[3.0, -0.1], follows, 0.1, 1, adam);
        assert!((p[0] - 0.9).abs() < 1e-8 && (p[1] - 1.1).abs() < 1e-7, "{p:?}");
        assert_eq!(target, [0.25 * p[0], 0.25 * p[1]]);
    }
}
