//! SAGE's candidates: the likeliest drivable modes of the mixed experts with a minimum spacing, each under
//! several speed profiles. The same proposer with the prior alone shows the effect of the selection without
//! experts.
//!
//! Only candidates are retimed: doubling all goals would double the cost of every score.

use std::sync::Arc;

use sage_backbones::{
    Backbone, MotionModel,
    backbone::{finite, trajectories_in_world},
    candidates::{Sampling, drawn, select},
    candle::Tensor,
    encoding::Encoding,
    features::{FORECAST_STEPS, STRIDE},
    forecast::features_with_forecast,
    subsampling::Subsampling,
};
use sage_core::{
    Error,
    generator::{Generator, Mixture, Observation, PreparedProposer, Proposal, Proposer},
    geometry::Point,
    motion::HORIZON,
    objective::Body,
    registry::Entry,
    seed::Rng,
};
use serde::{Deserialize, Serialize};

use super::{Draw, check_candidates, goal, in_scene, nll};
use crate::{
    Facts, GeneratorInputs, GeneratorKind, ProposeAndSelect, Refinement, Rounds,
    drivable::drivable,
    mixtures::Mixtures,
    selector::Best,
    speed_profile::{Extended, SpeedProfile, speed_profiles},
};

/// Log-prior of a retimed speed profile.
const RETIMED_LOG_PRIOR: f32 = -1.5;

/// Modes that are drawn for each candidate.
const DRAWN_PER_CANDIDATE: usize = 8;

/// Most polylines of a map that the features hold.
const MOST_POLYLINES: usize = 128;

/// Options of `sage` and `prior`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ProposalOptions {
    /// Number of candidates; 48 by default, or 32 with a network that sees road boundaries alone.
    pub candidates: Option<usize>,
    /// Least distance between the ends of candidates, metres; 0 for the likeliest, however close.
    pub apart: f32,
    /// Whether modes are also retimed.
    pub retime: bool,
    /// Whether candidates that no car can follow come last.
    pub drivable: bool,
    /// Whether candidates are drawn by their probability, in place of the likeliest; `apart` is not read then.
    pub drawn: bool,
    /// Rounds of the refinement of the selected plan: plans, and tries for each. By default `[[16, 8], [4, 25], [1, 100]]` for `sage`
    /// with a selection that prefers believable attacks, such as `natural`, else none (`[]`).
    pub refine: Option<Rounds>,
    /// Map and goal subsampling.
    pub subsampling: Subsampling,
}

impl Default for ProposalOptions {
    fn default() -> Self {
        Self {
            candidates: None,
            apart: 6.0,
            retime: true,
            drivable: true,
            drawn: false,
            refine: None,
            subsampling: Subsampling::default(),
        }
    }
}

impl ProposalOptions {
    /// The options of `sage-published`: the 32 most likely of all goals.
    pub fn published() -> Self {
        Self {
            candidates: Some(32),
            apart: 0.0,
            retime: false,
            drivable: false,
            drawn: false,
            refine: Some(Rounds::default()),
            // All that the features hold.
            subsampling: Subsampling {
                max_polylines: MOST_POLYLINES,
                dense_goal_radius: 1000.0,
                ego_max_polylines: MOST_POLYLINES,
                ego_goal_stride: 1,
            },
        }
    }

    /// The options of `sage-drawn`: few candidates, drawn by their probability.
    pub fn few_drawn() -> Self {
        Self {
            candidates: Some(4),
            apart: 0.0,
            retime: false,
            drawn: true,
            refine: Some(Rounds::default()),
            ..Self::default()
        }
    }

    fn checked(self) -> Result<Self, String> {
        check_candidates(self.candidates)?;
        if !(0.0..=100.0).contains(&self.apart) {
            return Err(format!("`apart` is {}; expected 0 to 100 metres", self.apart));
        }
        if self.drawn && self.retime {
            return Err("`drawn` candidates are not retimed, which would change their probability: set `retime` to false".to_owned());
        }
        self.refine.as_ref().map_or(Ok(()), Rounds::check)?;
        self.subsampling.check().map_err(|error| format!("`subsampling`: {error}"))?;
        Ok(self)
    }
}

/// SAGE: the mixed experts.
#[derive(Clone, Debug, Default)]
pub struct MixedExperts(pub ProposalOptions);

impl MixedExperts {
    /// The proposer alone.
    ///
    /// *Errors*: a missing input.
    pub fn proposer(&self, inputs: &GeneratorInputs) -> Result<Box<dyn Proposer>, crate::Error> {
        let models = inputs.mixtures(Self::NAME)?;
        let (prior, with_nll) = (inputs.prior(Self::NAME)?, inputs.selection.needs_prior());
        Ok(Box::new(Network(Arc::new(Shared { options: self.0.clone(), models, prior, with_nll }))))
    }
}

impl Entry<dyn GeneratorKind> for MixedExperts {
    const NAME: &'static str = "sage";
    const SUMMARY: &'static str = "experts mixed at lambda, the best of their candidates";
    const SOURCE: &'static str = "SAGE (ICLR 2026)";
    type Options = ProposalOptions;

    fn build(options: ProposalOptions) -> Result<Box<dyn GeneratorKind>, String> {
        Ok(Box::new(Self(options.checked()?)))
    }
}

impl GeneratorKind for MixedExperts {
    fn facts(&self) -> Facts {
        Facts { depends_on_lambda: true, ..Best::FACTS }
    }

    fn build(&self, inputs: &GeneratorInputs) -> Result<Box<dyn Generator>, crate::Error> {
        let (proposer, selector) = (self.proposer(inputs)?, Best::boxed(inputs));
        // What prefers believable attacks is refined unless told otherwise; the selections of the paper are not.
        let standard = inputs.selection.spec().believable_first.then(Rounds::standard);
        let refinement = Refinement::of(inputs, self.0.refine.as_ref().or(standard.as_ref()));
        Ok(Box::new(ProposeAndSelect { proposer, selector, refinement, facts: self.facts() }))
    }
}

/// The untuned prior.
#[derive(Clone, Debug, Default)]
pub struct Prior(ProposalOptions);

impl Entry<dyn GeneratorKind> for Prior {
    const NAME: &'static str = "prior";
    const SUMMARY: &'static str = "the untuned prior with the same selection";
    const SOURCE: &'static str = "this project: the effect of the selection alone";
    type Options = ProposalOptions;

    fn build(options: ProposalOptions) -> Result<Box<dyn GeneratorKind>, String> {
        Ok(Box::new(Self(options.checked()?)))
    }
}

impl GeneratorKind for Prior {
    fn facts(&self) -> Facts {
        Best::FACTS
    }

    fn build(&self, inputs: &GeneratorInputs) -> Result<Box<dyn Generator>, crate::Error> {
        let models = inputs.prior_at_any_mixture(Self::NAME)?;
        let (prior, with_nll) = (inputs.prior(Self::NAME)?, inputs.selection.needs_prior());
        let proposer =
            Box::new(Network(Arc::new(Shared { options: self.0.clone(), models, prior, with_nll })));
        let (selector, refinement) = (Best::boxed(inputs), Refinement::of(inputs, self.0.refine.as_ref()));
        Ok(Box::new(ProposeAndSelect { proposer, selector, refinement, facts: self.facts() }))
    }
}

struct Network(Arc<Shared>);

struct Shared {
    options: ProposalOptions,
    models: Mixtures,
    /// Encodes and decodes: the tensors that fine-tuning does not change are the prior's at every mixture.
    prior: Arc<dyn Backbone>,
    with_nll: bool,
}

impl Proposer for Network {
    fn prepare(&self, now: &Observation) -> Result<Box<dyn PreparedProposer>, Error> {
        let Shared { options, prior, .. } = &*self.0;
        let encode = || {
            let adversary = now.scene().adversary_index()?;
            let features = features_with_forecast(&**prior, now, adversary, options.subsampling)?;
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

impl PreparedProposer for Encoded {
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
        let nms = Sampling::Nms { radius: options.apart };
        let draw = Draw::of(options.candidates, encoding.features().edge_kinds);
        let modes = match options.drawn {
            // Those that no car can follow are passed over, so more are drawn.
            true => drawn(&policy, DRAWN_PER_CANDIDATE * draw.candidates, &mut rng),
            false => select(&policy, &ends, draw.modes, nms, &mut rng),
        };
        let trajectories =
            trajectories_in_world(&model.trajectories(encoding, &modes)?, encoding.features())?;
        let origin = encoding.features().frame.origin();
        let trajectories: Vec<Extended> =
            trajectories.iter().map(|trajectory| Extended::new(trajectory, origin)).collect();
        let profiles = speed_profiles(encoding.features().edge_kinds);
        // The first profile is the mode's own.
        let profiles = if options.retime { &profiles[..] } else { &profiles[..1] };
        let mut retimed = at_all_profiles(profiles, &modes, &trajectories, &policy);
        if options.retime {
            self.score_retimed(&*model, &mut retimed, &log_probs, profiles, &trajectories)?;
        }
        let retimed = if options.drawn { retimed } else { self.apart(retimed, draw.modes) };
        let retimed_trajectories =
            retimed.iter().map(|p| profiles[p.profile].whole(&trajectories[p.trajectory]));
        let edges = encoding.features().edge_kinds.of(self.now.index());
        let accepted = if options.drivable {
            drivable(retimed_trajectories, draw.candidates, &self.body, edges)?
        } else {
            let likeliest = retimed_trajectories.enumerate().take(draw.candidates);
            likeliest.map(|(k, trajectory)| Ok((k, trajectory?))).collect::<Result<_, Error>>()?
        };
        let accepted_modes: Vec<usize> = accepted.iter().map(|(k, _)| retimed[*k].mode).collect();
        let accepted_modes = model.modes_of_prior(encoding, &accepted_modes)?;
        let nll = nll(&**prior, encoding, &accepted_modes, *with_nll)?;
        let proposal = |((k, trajectory), nll): ((usize, _), _)| Proposal {
            trajectory,
            log_prob: Some(f64::from(retimed[k].log_prob)),
            goal: Some(goal(encoding, ends[retimed[k].mode])),
            nll,
        };
        Ok(accepted.into_iter().zip(nll).map(proposal).collect())
    }

    /// Sets the log-probabilities of the retimed modes.
    fn score_retimed(
        &self,
        model: &dyn MotionModel,
        all: &mut [RetimedMode],
        log_probs: &Tensor,
        profiles: &[SpeedProfile],
        trajectories: &[Extended],
    ) -> Result<(), sage_backbones::Error> {
        let encoding = &self.encoding;
        let frame = encoding.features().frame;
        let mut retimed_modes: Vec<&mut RetimedMode> =
            all.iter_mut().filter(|p| !profiles[p.profile].is_plain()).collect();
        let mut points = Vec::with_capacity(2 * FORECAST_STEPS * retimed_modes.len());
        for retimed in &retimed_modes {
            let at =
                |step: usize| profiles[retimed.profile].at(&trajectories[retimed.trajectory], step * STRIDE);
            points.extend(
                (1..=FORECAST_STEPS).flat_map(|step| frame.frame_from_world(at(step)).map(|x| x as f32)),
            );
        }
        let modes: Vec<usize> = retimed_modes.iter().map(|p| p.mode).collect();
        let points = Tensor::from_vec(points, (modes.len(), FORECAST_STEPS, 2), log_probs.device())?;
        let points = points.to_dtype(log_probs.dtype())?;
        let found = model.log_probs_along(encoding, log_probs, &modes, &points)?;
        for (retimed, log_prob) in retimed_modes.iter_mut().zip(finite::<f32>(&found)?) {
            retimed.log_prob = log_prob + RETIMED_LOG_PRIOR;
        }
        Ok(())
    }

    /// Sorts retimed modes by probability and removes those close to a likelier one at both half time and
    /// the end; keeps at most `most`.
    fn apart(&self, mut all: Vec<RetimedMode>, most: usize) -> Vec<RetimedMode> {
        // Stable sort: among equals the mode's own profile comes first.
        all.sort_by(|a, b| b.log_prob.total_cmp(&a.log_prob));
        let mut accepted: Vec<RetimedMode> = Vec::with_capacity(most);
        let radius = f64::from(self.shared.options.apart).powi(2);
        for retimed in all {
            // At half time half the distance suffices.
            let is_apart = |other: &RetimedMode| {
                squared(retimed.end, other.end) >= radius || 4.0 * squared(retimed.half, other.half) >= radius
            };
            if accepted.iter().all(is_apart) {
                accepted.push(retimed);
            }
            if accepted.len() == most {
                break;
            }
        }
        accepted
    }
}

/// A mode under a speed profile.
struct RetimedMode {
    /// Index of its trajectory.
    trajectory: usize,
    mode: usize,
    /// Index of its speed profile.
    profile: usize,
    log_prob: f32,
    /// Positions at half time and at the end.
    half: Point,
    end: Point,
}

/// Squared distance.
fn squared(a: Point, b: Point) -> f64 {
    let [dx, dy] = [a[0] - b[0], a[1] - b[1]];
    dx * dx + dy * dy
}

/// Every mode under every profile, with the log-probability of its own profile.
fn at_all_profiles(
    profiles: &[SpeedProfile],
    modes: &[usize],
    trajectories: &[Extended],
    log_probs: &[f32],
) -> Vec<RetimedMode> {
    let retimed = |number: usize, trajectory: usize, mode: usize| {
        let [half, end] =
            [HORIZON / 2, HORIZON].map(|step| profiles[number].at(&trajectories[trajectory], step));
        RetimedMode { trajectory, mode, profile: number, log_prob: log_probs[mode], half, end }
    };
    let of_profile =
        |number| modes.iter().enumerate().map(move |(trajectory, &mode)| retimed(number, trajectory, mode));
    (0..profiles.len()).flat_map(of_profile).collect()
}
