//! One network whose weights follow λ.

use sage_backbones::{Backbone, Error, candle::Tensor, parameters::Variables};

use crate::{Experts, Merger, check};

/// A network at some λ. Turning it sets the tensors that the experts differ in, in place: nothing is
/// built anew, and what the network's frozen part made of a scene stays valid.
pub struct Dial {
    network: Box<dyn Backbone>,
    variables: Variables,
    /// For each variable the numbers of prior, realistic and adversarial expert.
    ends: Vec<[Vec<f32>; 3]>,
    merger: Box<dyn Merger>,
    lambda: f64,
}

impl Dial {
    /// A network at λ = 0.
    ///
    /// *Errors*: none for checked experts.
    pub fn new(experts: &Experts, merger: Box<dyn Merger>) -> Result<Self, Error> {
        let differing = experts.differing()?;
        let (tracked, variables) =
            experts.realistic().variables(|name| differing.iter().any(|n| n == name))?;
        // Detached tensors share the variables' storage: the network follows and records no graph.
        let network = experts.prior().rebuilt(tracked.detached())?;
        let numbers = |parameters: &sage_backbones::Parameters, name: &str| -> Result<Vec<f32>, Error> {
            let tensor =
                parameters.get(name).ok_or_else(|| Error::Training(format!("no tensor `{name}`")))?;
            Ok(tensor.flatten_all()?.to_vec1()?)
        };
        let of = |name: &str| {
            Ok([
                numbers(experts.prior().parameters(), name)?,
                numbers(experts.realistic(), name)?,
                numbers(experts.adversarial(), name)?,
            ])
        };
        let ends = variables.iter().map(|(name, _)| of(name)).collect::<Result<_, Error>>()?;
        Ok(Self { network, variables, ends, merger, lambda: 0.0 })
    }

    /// Where it stands.
    pub fn lambda(&self) -> f64 {
        self.lambda
    }

    /// The network as it stands.
    pub fn network(&self) -> &dyn Backbone {
        &*self.network
    }

    /// Turns it.
    ///
    /// *Errors*: λ outside [0, 1].
    pub fn turn(&mut self, lambda: f64) -> Result<(), Error> {
        check(lambda)?;
        for ((_, variable), [prior, a, b]) in self.variables.iter().zip(&self.ends) {
            let one = |k: usize| {
                if lambda == 0.0 || a[k] == b[k] {
                    a[k]
                } else if lambda == 1.0 {
                    b[k]
                } else {
                    self.merger.mix(prior[k], a[k], b[k], lambda)
                }
            };
            let values = (0..a.len()).map(one).collect();
            variable.set(&Tensor::from_vec(values, variable.shape(), variable.device())?)?;
        }
        self.lambda = lambda;
        Ok(())
    }
}
