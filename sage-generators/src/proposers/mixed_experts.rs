//! SAGE's candidates: the likeliest modes of the mixed experts that a car could drive, some way apart, at
//! several speed profiles. Over the prior alone they tell what the choice does without any expert.

use std::sync::Arc;

use sage_backbones::{
    Backbone, MotionModel,
    backbone::{finite, to_world},
    candidates::{Selection, choose},
    candle::{Device, Tensor},
    encoding::Encoding,
    features::{LOOKS, STRIDE},
    forecast::{View, features_with_forecast},
};
use sage_core::{
    Error,
    generator::{Mixture, Observation, PreparedScene, Proposal, Proposer},
    geometry::Point,
    motion::HORIZON,
    objective::Body,
    seed::Rng,
};
use serde::{Deserialize, Serialize};

use super::{SPARE, check_candidates, goal, in_scene, nll};
use crate::{
    GeneratorInputs,
    drivable::drivable,
    mixtures::Mixtures,
    pair::ProposerKind,
    timing::{Extended, PACES, Pace},
};

/// Log of how rarely another pace than the network's own is taken where no path is preferred.
const RARELY: f32 = -1.5;

/// Options of `sage` and `prior`.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ProposalOptions {
    /// Number of candidates.
    pub candidates: usize,
    /// Least distance of their ends, metres.
    pub apart: f32,
    /// How closely the scene is looked at for them.
    pub view: View,
}

impl Default for ProposalOptions {
    fn default() -> Self {
        Self { candidates: 32, apart: 6.0, view: View::default() }
    }
}

impl ProposalOptions {
    fn check<P: ProposerKind>(&self) -> Result<(), Error> {
        check_candidates::<P>(self.candidates)?;
        if !(0.0..=100.0).contains(&self.apart) {
            return Err(P::refused(format!("`apart` is {}; expected 0 to 100 metres", self.apart)));
        }
        self.view.check().map_err(|error| P::refused(format!("`view`: {error}"))).map(|_| ())
    }

    fn over(
        self,
        models: Mixtures,
        name: &'static str,
        inputs: &GeneratorInputs,
    ) -> Result<Box<dyn Proposer>, crate::Error> {
        let (prior, with_nll) = (inputs.prior(name)?, inputs.selection.needs_prior());
        Ok(Box::new(Network(Arc::new(Shared { options: self, models, prior, with_nll }))))
    }
}

/// SAGE: the experts mixed.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub struct MixedExperts(ProposalOptions);

impl ProposerKind for MixedExperts {
    const NAME: &'static str = "sage";
    const SUMMARY: &'static str = "experts mixed at lambda, the best of their candidates";
    const SOURCE: &'static str = "SAGE (ICLR 2026)";
    const USES_MIXTURE: bool = true;

    fn check(&self) -> Result<(), Error> {
        self.0.check::<Self>()
    }

    fn build(&self, inputs: &GeneratorInputs) -> Result<Box<dyn Proposer>, crate::Error> {
        self.0.over(inputs.mixtures(Self::NAME)?, Self::NAME, inputs)
    }
}

/// The untuned prior.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Prior(ProposalOptions);

impl ProposerKind for Prior {
    const NAME: &'static str = "prior";
    const SUMMARY: &'static str = "the untuned prior with the same choice";
    const SOURCE: &'static str = "this project: what choice alone does";
    const USES_MIXTURE: bool = false;

    fn check(&self) -> Result<(), Error> {
        self.0.check::<Self>()
    }

    fn build(&self, inputs: &GeneratorInputs) -> Result<Box<dyn Proposer>, crate::Error> {
        self.0.over(inputs.prior_at_any_mixture(Self::NAME)?, Self::NAME, inputs)
    }
}

struct Network(Arc<Shared>);

struct Shared {
    options: ProposalOptions,
    models: Mixtures,
    /// Encodes and decodes: what fine-tuning leaves alone is the prior's at every mixture.
    prior: Arc<dyn Backbone>,
    with_nll: bool,
}

impl Proposer for Network {
    fn prepare(&self, now: &Observation) -> Result<Box<dyn PreparedScene>, Error> {
        let Shared { options, prior, .. } = &*self.0;
        let encode = || {
            let adversary = now.scene().adversary_index()?;
            let features = features_with_forecast(&**prior, now, adversary, options.view)?;
            prior.encode(Arc::new(features))
        };
        let encoding = encode().map_err(|error| in_scene(now.scene(), error))?;
        let body = Body::of(now.scene())?;
        Ok(Box::new(Encoded { shared: self.0.clone(), encoding, body, now: now.clone() }))
    }
}

struct Encoded {
    shared: Arc<Shared>,
    encoding: Encoding,
    body: Body,
    now: Observation,
}

impl PreparedScene for Encoded {
    fn propose(&self, at: &Mixture, seed: u64) -> Result<Vec<Proposal>, Error> {
        self.proposals(at, seed).map_err(|error| in_scene(self.now.scene(), error))
    }
}

impl Encoded {
    fn proposals(&self, at: &Mixture, seed: u64) -> Result<Vec<Proposal>, crate::Error> {
        let Shared { options, models, prior, with_nll } = &*self.shared;
        let (encoding, model) = (&self.encoding, models.at(at)?);
        let log_probs = model.log_probs(encoding)?;
        let ends = model.mode_ends(encoding)?;
        let mut rng = Rng::new(seed, &self.now.scene().id, "candidates");
        let policy: Vec<f32> = finite(&log_probs)?;
        let nms = Selection::Nms { radius: options.apart };
        let modes = choose(&policy, &ends, SPARE * options.candidates, nms, &mut rng);
        let paths = to_world(&model.trajectories(encoding, &modes)?, encoding.features())?;
        let origin = encoding.features().frame.origin();
        let paths: Vec<Extended> = paths.iter().map(|path| Extended::new(path, origin)).collect();
        let paces = PACES.map(Pace::new);
        let mut paced = all_paced(&paces, &modes, &paths, &policy);
        self.follow(&*model, &mut paced, &log_probs, &paces, &paths)?;
        let paced = self.apart(paced);
        let driven = paced.iter().map(|p| paces[p.pace].whole(&paths[p.path]));
        let kept = drivable(driven, options.candidates, &self.body, self.now.index())?;
        let of_kept: Vec<usize> = kept.iter().map(|(k, _)| paced[*k].mode).collect();
        let nll = nll(&**prior, encoding, &of_kept, *with_nll)?;
        let proposal = |((k, trajectory), nll): ((usize, _), _)| Proposal {
            trajectory,
            log_prob: Some(f64::from(paced[k].log_prob)),
            goal: Some(goal(encoding, ends[paced[k].mode])),
            nll,
        };
        Ok(kept.into_iter().zip(nll).map(proposal).collect())
    }

    /// Sets the log-probability of modes at other paces than their own.
    fn follow(
        &self,
        model: &dyn MotionModel,
        all: &mut [Paced],
        log_probs: &Tensor,
        paces: &[Pace],
        paths: &[Extended],
    ) -> Result<(), sage_backbones::Error> {
        let encoding = &self.encoding;
        let frame = encoding.features().frame;
        let mut bent: Vec<&mut Paced> = all.iter_mut().filter(|p| !paces[p.pace].is_plain()).collect();
        let mut places = Vec::with_capacity(2 * LOOKS * bent.len());
        for paced in &bent {
            let at = |look: usize| paces[paced.pace].at(&paths[paced.path], look * STRIDE);
            places.extend((1..=LOOKS).flat_map(|look| frame.to_local(at(look)).map(|x| x as f32)));
        }
        let modes: Vec<usize> = bent.iter().map(|p| p.mode).collect();
        let places = Tensor::from_vec(places, (modes.len(), LOOKS, 2), &Device::Cpu)?;
        let places = places.to_dtype(log_probs.dtype())?;
        let found = model.log_probs_along(encoding, log_probs, &modes, &places)?;
        for (paced, log_prob) in bent.iter_mut().zip(finite::<f32>(&found)?) {
            paced.log_prob = log_prob + RARELY;
        }
        Ok(())
    }

    /// Modes at their paces, the likeliest first, those left out that are too much like a likelier one at
    /// half time and at the end.
    fn apart(&self, mut all: Vec<Paced>) -> Vec<Paced> {
        // Stable: of equals the plain pace comes first.
        all.sort_by(|a, b| b.log_prob.total_cmp(&a.log_prob));
        let most = SPARE * self.shared.options.candidates;
        let mut kept: Vec<Paced> = Vec::with_capacity(most);
        let radius = f64::from(self.shared.options.apart).powi(2);
        for paced in all {
            // Half the distance counts at half time.
            let is_apart = |other: &Paced| {
                squared(paced.end, other.end) >= radius || 4.0 * squared(paced.half, other.half) >= radius
            };
            if kept.iter().all(is_apart) {
                kept.push(paced);
            }
            if kept.len() == most {
                break;
            }
        }
        kept
    }
}

/// A mode at a pace.
struct Paced {
    /// Number of its path.
    path: usize,
    mode: usize,
    /// Number of its pace.
    pace: usize,
    log_prob: f32,
    /// Where it is after half the time, and in the end.
    half: Point,
    end: Point,
}

/// Squared distance.
fn squared(a: Point, b: Point) -> f64 {
    let [dx, dy] = [a[0] - b[0], a[1] - b[1]];
    dx * dx + dy * dy
}

/// Modes at every pace, as likely as at their own.
fn all_paced(paces: &[Pace], modes: &[usize], paths: &[Extended], log_probs: &[f32]) -> Vec<Paced> {
    let paced = |number: usize, path: usize, mode: usize| {
        let [half, end] = [HORIZON / 2, HORIZON].map(|step| paces[number].at(&paths[path], step));
        Paced { path, mode, pace: number, log_prob: log_probs[mode], half, end }
    };
    let of_pace = |number| modes.iter().enumerate().map(move |(path, &mode)| paced(number, path, mode));
    (0..paces.len()).flat_map(of_pace).collect()
}
