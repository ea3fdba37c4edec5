//! KING: gradient ascent on the controls of a kinematic bicycle (Hanselmann et al., ECCV 2022), with the objective and the
//! steps that the SAGE paper gives it.
//!
//! The search starts from controls that follow the adversary's recorded motion, or SAGE's attack, and maximises a smooth
//! surrogate of `0.9 R_adv − 0.1 P_real` minus what is missing to a clearance from edges and others. The published method has no
//! such term in the paper's set-up and leaves the road.

use sage_core::{
    Error,
    generator::Generator,
    objective::{Context, PoseGradient},
    registry::Entry,
};
use sage_generators::{Facts, GeneratorInputs, GeneratorKind};
use serde::{Deserialize, Serialize};

use crate::optimisers::{
    Optimised, Optimiser, Optimum, Start, StartFrom, Weights, adam::Adam, bicycle::Bicycle, check_steps,
    evaluate, facts, fit, generator_of,
};

/// Rate of a further search by that of the one before.
const RETRY: f64 = 0.2;
/// Most further searches.
const MOST_RETRIES: usize = 10;
/// Decay of Adam's moments.
const BETAS: [f64; 2] = [0.8, 0.99];

/// The generator `king`.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct King {
    /// Weight of the smooth adversarial reward.
    pub adversarial: f64,
    /// Weight of the smooth realism penalty.
    pub realism: f64,
    /// Weight of missing distance to edges and others.
    pub clearance: f64,
    /// Steps of the search.
    pub steps: usize,
    /// Rate of Adam.
    pub rate: f64,
    /// Further searches, each at a fifth of the rate, if one finds nothing better than its start.
    pub retries: usize,
    /// Where the search begins: `log`, or the attack of `prior` or `sage`.
    pub start: StartFrom,
}

impl Default for King {
    fn default() -> Self {
        Self {
            adversarial: 0.9,
            realism: 0.1,
            clearance: 0.3,
            steps: 100,
            rate: 0.005,
            retries: 2,
            start: StartFrom::Log,
        }
    }
}

impl King {
    /// The options of `king-published`: blind to the map, one search.
    pub fn published() -> Self {
        Self { clearance: 0.0, retries: 0, ..Self::default() }
    }

    fn weights(&self) -> Weights {
        Weights { adversarial: self.adversarial, realism: self.realism, clearance: self.clearance }
    }
}

impl Entry<dyn GeneratorKind> for King {
    const NAME: &'static str = "king";
    const SUMMARY: &'static str = "gradient ascent on the controls of a bicycle, clear of edges and others";
    const SOURCE: &'static str = "Hanselmann et al. (2022), as the SAGE paper configures it, with a map term";
    type Options = Self;

    fn build(options: Self) -> Result<Box<dyn GeneratorKind>, String> {
        options.weights().check()?;
        check_steps(options.steps, options.rate)?;
        if options.retries > MOST_RETRIES {
            return Err(format!("`retries` is {}; expected 0 to {MOST_RETRIES}", options.retries));
        }
        Ok(Box::new(options))
    }
}

impl GeneratorKind for King {
    fn facts(&self) -> Facts {
        facts(self.start, self.clearance > 0.0)
    }

    fn build(&self, inputs: &GeneratorInputs) -> Result<Box<dyn Generator>, sage_generators::Error> {
        Ok(Box::new(Optimised { optimiser: *self, first: generator_of(self.start, inputs)? }))
    }
}

impl Optimiser for King {
    fn optimise(&self, start: &Start, ctx: &Context) -> Result<Optimum, Error> {
        let bicycle = Bicycle::of_length(ctx.size()[0]);
        let (controls, _) = fit::controls(&bicycle, &start.now, &start.poses);
        let mut rate = self.rate;
        let mut found = self.search(&bicycle, start, controls.clone(), rate, ctx)?;
        for _ in 0..self.retries {
            if found.value > found.began {
                break;
            }
            // Adam's first step is as long as its rate: at speed it leaves the road.
            rate *= RETRY;
            found = self.search(&bicycle, start, controls.clone(), rate, ctx)?;
        }
        Ok(found)
    }
}

impl King {
    /// A search from controls, at a rate.
    fn search(
        &self,
        bicycle: &Bicycle,
        start: &Start,
        mut controls: Vec<[f64; 2]>,
        rate: f64,
        ctx: &Context,
    ) -> Result<Optimum, Error> {
        let mut objective = self.weights().objective();
        let mut adam = Adam::new(controls.len(), rate, BETAS);
        let mut gradient = PoseGradient::default();
        let mut motion = bicycle.motion(&start.now, &controls);
        let value = evaluate(&mut objective, &motion.poses, ctx, &mut gradient, 0)?;
        let mut best = Optimum::start(value, &motion.poses);
        for step in 1..=self.steps {
            adam.step(&mut controls, &bicycle.gradient(&motion, &gradient), 1.0);
            motion = bicycle.motion(&start.now, &controls);
            let value = evaluate(&mut objective, &motion.poses, ctx, &mut gradient, step)?;
            best.update(value, &motion.poses);
        }
        Ok(best)
    }
}
