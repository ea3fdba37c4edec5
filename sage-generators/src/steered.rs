//! SAGE: candidates of a steered network, and the best of them.
//!
//! Over the prior itself it is the row of a table that tells how much the choice does without steering.

use std::sync::Arc;

use sage_backbones::{
    Backbone,
    backbone::{Encoding, finite, to_world},
    candidates::{Selection, choose},
    candle::{Device, Tensor},
    features::{LOOKS, STRIDE},
    foresight::{View, foreseeing},
};
use sage_core::{
    Error,
    generator::{Attack, Generator, Proposed},
    geometry::Point,
    motion::HORIZON,
    objective::Context,
    registry::Entry,
    seed::Rng,
};
use serde::{Deserialize, Serialize};

use crate::{
    Method, Setting,
    choice::{Judge, Judged, drivable},
    method::check_candidates,
    timing::{Extended, PACES, Pace},
};

/// Modes looked at for each candidate: those that no car could drive are passed over.
pub(crate) const SPARE: usize = 3;

/// Log of how rarely another pace than the network's own is taken where no path is preferred.
const RARELY: f32 = -1.5;

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

/// The generator over one network.
pub struct Steered {
    /// Name for tables.
    pub name: String,
    /// The steered network.
    pub network: Arc<dyn Backbone>,
    /// The prior, for surprise; it must have the steered network's frozen part.
    pub prior: Arc<dyn Backbone>,
    /// Number of candidates.
    pub candidates: usize,
    /// How they are taken from the network's modes.
    pub selection: Selection,
    /// How closely the scene is looked at for them.
    pub view: View,
    /// Who chooses among them.
    pub judge: Judge,
}

impl Generator for Steered {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn generate(&self, ctx: &Context, seed: u64) -> Result<Attack, Error> {
        self.attack(ctx, seed).map_err(|error| in_scene(ctx, &error))
    }
}

impl Steered {
    fn attack(&self, ctx: &Context, seed: u64) -> Result<Attack, sage_backbones::Error> {
        let (candidates, judged) = self.propose(ctx, seed)?;
        let (chosen, note) = self.judge.choose(&judged);
        Ok(Attack { candidates, chosen, note })
    }

    /// The candidates and what each is worth, for whoever chooses at several weights.
    ///
    /// *Errors*: those of the network.
    pub fn propose(
        &self,
        ctx: &Context,
        seed: u64,
    ) -> Result<(Vec<Proposed>, Vec<Judged>), sage_backbones::Error> {
        let scene = ctx.scene();
        let adversary = scene.adversary_index()?;
        let features = foreseeing(&*self.prior, scene, ctx.index(), adversary, self.view)?;
        let encoding = self.network.encode(Arc::new(features))?;
        let log_probs = self.network.log_probs(&encoding)?;
        let ends = self.network.mode_ends(&encoding)?;
        let mut rng = Rng::new(seed, &scene.id, "candidates");
        let policy: Vec<f32> = finite(&log_probs)?;
        let modes = choose(&policy, &ends, SPARE * self.candidates, self.selection, &mut rng);
        let paths = to_world(&self.network.trajectories(&encoding, &modes)?, encoding.features())?;
        let origin = encoding.features().frame.origin();
        let paths: Vec<Extended> = paths.iter().map(|path| Extended::new(path, origin)).collect();
        let paces = PACES.map(Pace::new);
        let mut paced = all_paced(&paces, &modes, &paths, &policy);
        self.follow(&mut paced, &encoding, &log_probs, &paces, &paths)?;
        let paced = self.apart(paced);
        let driven = paced.iter().map(|p| paces[p.pace].whole(&paths[p.path]));
        let kept = drivable(driven, self.candidates, ctx)?;
        let of_kept: Vec<usize> = kept.iter().map(|(k, _)| paced[*k].mode).collect();
        let surprises = surprises(&self.judge, &*self.prior, &encoding, &of_kept)?;
        let (mut proposed, mut judged) = (Vec::new(), Vec::new());
        for ((k, candidate), surprise) in kept.into_iter().zip(surprises) {
            judged.push(self.judge.judge(&candidate, surprise, ctx));
            proposed.push(Proposed {
                trajectory: candidate.into_trajectory(),
                log_prob: Some(f64::from(paced[k].log_prob)),
                goal: Some(encoding.features().frame.to_world(ends[paced[k].mode].map(f64::from))),
            });
        }
        Ok((proposed, judged))
    }

    /// Sets the log-probability of modes at other paces than their own.
    fn follow(
        &self,
        all: &mut [Paced],
        encoding: &Encoding,
        log_probs: &Tensor,
        paces: &[Pace],
        paths: &[Extended],
    ) -> Result<(), sage_backbones::Error> {
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
        let found = self.network.log_probs_along(encoding, log_probs, &modes, &places)?;
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
        let Selection::Nms { radius } = self.selection else { return all };
        let most = SPARE * self.candidates;
        let mut kept: Vec<Paced> = Vec::with_capacity(most);
        let radius = f64::from(radius) * f64::from(radius);
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

/// `sage`, and `prior`, the same over the untuned prior.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct SteeredOptions {
    /// Number of candidates.
    pub candidates: usize,
    /// Least distance of their ends, metres.
    pub apart: f32,
    /// How closely the scene is looked at for them.
    pub view: View,
}

impl Default for SteeredOptions {
    fn default() -> Self {
        Self { candidates: 32, apart: 6.0, view: View::default() }
    }
}

impl SteeredOptions {
    fn check(self) -> Result<Self, String> {
        check_candidates(self.candidates)?;
        if !(0.0..=100.0).contains(&self.apart) {
            return Err(format!("`apart` is {}; expected 0 to 100 metres", self.apart));
        }
        self.view.check().map_err(|problem| format!("`view`: {problem}"))?;
        Ok(self)
    }

    /// The generator over a network for a setting.
    ///
    /// *Errors*: a setting out of range.
    pub fn over(
        self,
        name: String,
        network: Arc<dyn Backbone>,
        setting: &Setting,
    ) -> Result<Steered, String> {
        Ok(Steered {
            name,
            network,
            prior: setting.prior()?,
            candidates: self.candidates,
            selection: Selection::Nms { radius: self.apart },
            view: self.view,
            judge: setting.judge()?,
        })
    }
}

/// SAGE.
pub(crate) struct SageMethod(SteeredOptions);

impl Method for SageMethod {
    fn is_steered(&self) -> bool {
        true
    }

    fn generator(&self, setting: &Setting) -> Result<Box<dyn Generator>, String> {
        let name = format!("sage {}", setting.label);
        Ok(Box::new(self.0.over(name, setting.mixture()?, setting)?))
    }
}

impl Entry<dyn Method> for SageMethod {
    const NAME: &'static str = "sage";
    const SUMMARY: &'static str = "experts mixed at lambda, the best of their candidates";
    const SOURCE: &'static str = "SAGE (ICLR 2026)";
    type Options = SteeredOptions;

    fn build(options: SteeredOptions) -> Result<Box<dyn Method>, String> {
        Ok(Box::new(Self(options.check()?)))
    }
}

/// The prior with SAGE's choice.
pub(crate) struct PriorMethod(SteeredOptions);

impl Method for PriorMethod {
    fn is_steered(&self) -> bool {
        true
    }

    fn generator(&self, setting: &Setting) -> Result<Box<dyn Generator>, String> {
        let name = format!("prior, choice {}", setting.label);
        Ok(Box::new(self.0.over(name, setting.prior()?, setting)?))
    }
}

impl Entry<dyn Method> for PriorMethod {
    const NAME: &'static str = "prior";
    const SUMMARY: &'static str = "the untuned prior with the same choice";
    const SOURCE: &'static str = "this project: what choice alone does";
    type Options = SteeredOptions;

    fn build(options: SteeredOptions) -> Result<Box<dyn Method>, String> {
        Ok(Box::new(Self(options.check()?)))
    }
}

/// −log p of modes under a prior, up to what they share: a choice compares them. Zeros where it does not
/// look at them.
pub(crate) fn surprises(
    judge: &Judge,
    prior: &dyn Backbone,
    encoding: &Encoding,
    modes: &[usize],
) -> Result<Vec<f64>, sage_backbones::Error> {
    if !judge.needs_surprise() {
        return Ok(vec![0.0; modes.len()]);
    }
    let log_probs: Vec<f64> = finite(&prior.relative_log_probs(encoding, modes)?)?;
    Ok(log_probs.into_iter().map(|log_prob| -log_prob).collect())
}

/// A network's error as one of its scene.
pub(crate) fn in_scene(ctx: &Context, error: &sage_backbones::Error) -> Error {
    match error {
        sage_backbones::Error::Core(error) => error.clone(),
        other => Error::Scene { scene: ctx.scene().id.clone(), problem: other.to_string() },
    }
}
