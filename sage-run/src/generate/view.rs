//! Picture and page of a scene's attacks.

use std::collections::HashMap;

use advsage::{operating_point::OperatingPointSpec, rows::attack};
use sage_core::{
    generator::Proposal,
    geometry::Point,
    motion::{HORIZON, NOW},
    objective::{Context, Reason},
    scene::Track,
};
use sage_sim::{avoidable::Avoidable, vehicle::Motion};
use sage_view::{
    drawing::{self, DrawnPath, Picture, drawn_path},
    player::{self, Meeting, Page, Panel, Path, Sweep},
};

use super::{
    job::Job,
    measured::MeasuredAttack,
    names::INDEX,
    scored::{ScoredCandidates, bits},
};
use crate::Result;

/// Most attacks that a page shows side by side. More share a box with a slider.
const MOST_BESIDE: usize = 3;

/// The attacks of a scene, to be shown.
pub(super) struct SceneView<'v> {
    pub(super) job: &'v Job<'v>,
    /// Name of the scene's outputs.
    pub(super) name: &'v str,
    pub(super) ctx: &'v Context,
    /// At each operating point.
    pub(super) measured: &'v [MeasuredAttack<'v>],
}

impl SceneView<'_> {
    /// All attacks from above as SVG.
    pub(super) fn picture(&self) -> String {
        // The evasive manoeuvre is that of the last attack that has one.
        let evasion = self.measured.iter().rev().find_map(|one| drawn_evasion(&one.avoidable, one.contact?));
        let picture =
            Picture { title: self.name.to_owned(), candidates: self.drawn(), evasion, ..Picture::default() };
        drawing::draw(self.ctx.scene(), &picture)
    }

    /// A page that plays the attacks: side by side, or with a slider.
    ///
    /// *Errors*: a template without the places for title and data.
    pub(super) fn page(&self, scored: &ScoredCandidates) -> Result<String> {
        let (scene, adversary) = (self.ctx.scene(), self.ctx.adversary());
        let mut paths = Paths::default();
        let tracks: Vec<Track> =
            self.measured.iter().map(|one| adversary.following(one.attack.trajectory())).collect();
        let drives: Vec<Vec<Motion>> = self.measured.iter().map(|one| self.ego_until(one.contact)).collect();
        let is_sweep = self.measured.len() > MOST_BESIDE;
        let mut panels = Vec::with_capacity(self.measured.len());
        for (k, (one, drawn)) in self.measured.iter().zip(self.drawn()).enumerate() {
            let point = &self.job.generator.points[k];
            let sweep = point.swept().filter(|_| is_sweep);
            let others = one.attack.candidates.iter().enumerate().filter(|(k, _)| *k != one.attack.chosen);
            let others = others.map(|(_, proposal)| paths.number(proposal, self.ctx, scored));
            let ending = ending(one, &scored.get(one.attack.trajectory())?.scores.unbelievable);
            panels.push(Panel {
                name: drawn.name.replace("lambda ", "λ "),
                id: self.job.variants()[k].clone(),
                sweep: sweep.map(|(axis, value)| Sweep { group: 0, axis, value }),
                motions: &drives[k],
                end: drives[k].len() - 1,
                shown: &[],
                contact: drawn
                    .contact
                    .map(|(step, ego, other)| Meeting { frame: NOW + step, areas: [ego, other] }),
                adversary: Some(&tracks[k]),
                unattacked: None,
                evasion: one
                    .contact
                    .and_then(|contact| one.avoidable.evasion(contact))
                    .map(|(_, poses)| poses),
                verdict: Some(one.outcome.is_attack()),
                is_failed: false,
                others: others.collect::<Result<_>>()?,
                marks: one.counts.marks(scene),
                badge: None,
                note: format!("{ending} Selected among {}.", one.counts.words()),
                ending,
            });
        }
        let generator = &self.job.generator;
        let subtitle = format!("attacks by {}", generator.method);
        let page = Page {
            scene,
            title: self.name,
            subtitle: &subtitle,
            panels: &panels,
            paths: &paths.all,
            columns: MOST_BESIDE,
            back: Some(INDEX),
        };
        Ok(player::page(&page)?)
    }

    fn drawn(&self) -> Vec<DrawnPath> {
        let points = self.job.generator.points.iter().zip(self.measured);
        let drawn = |(point, one): (&OperatingPointSpec, &MeasuredAttack)| {
            drawn_path(self.label(point), self.ctx, one.attack.trajectory().clone())
        };
        points.map(drawn).collect()
    }

    /// Label of an attack.
    fn label(&self, point: &OperatingPointSpec) -> String {
        let generator = &self.job.generator;
        if generator.points.len() > 1 { point.long_label() } else { generator.built.keys[0].label() }
    }

    /// The ego up to the contact, or to the end of the recording. A gap holds the last pose, because the page follows
    /// the ego.
    fn ego_until(&self, contact: Option<usize>) -> Vec<Motion> {
        let scene = self.ctx.scene();
        let (ego, last) = (scene.ego(), NOW + contact.unwrap_or_else(|| scene.horizon()).min(HORIZON));
        let motion = |frame: usize| Motion {
            position: ego.point(frame),
            heading: ego.heading[frame],
            velocity: ego.velocity[frame],
            yaw_rate: 0.0,
        };
        let first = (0..=last).find(|frame| ego.is_valid(*frame)).unwrap_or(NOW);
        let hold = |known: &mut usize, frame: usize| {
            *known = if ego.is_valid(frame) { frame } else { *known };
            Some(motion(*known))
        };
        (0..=last.min(scene.frames - 1)).scan(first, hold).collect()
    }
}

/// Candidates of all attacks, each once.
#[derive(Default)]
struct Paths {
    all: Vec<Path>,
    numbers: HashMap<Vec<u64>, usize>,
}

impl Paths {
    /// Number of a candidate.
    ///
    /// *Errors*: it was not scored.
    fn number(&mut self, proposal: &Proposal, ctx: &Context, scored: &ScoredCandidates) -> Result<usize> {
        let key = bits(&proposal.trajectory);
        if let Some(number) = self.numbers.get(&key) {
            return Ok(*number);
        }
        let start = ctx.adversary().point(NOW);
        let points: Vec<Point> =
            std::iter::once(start).chain(proposal.trajectory.points().iter().copied()).collect();
        self.all.push(Path { kind: scored.kind(&proposal.trajectory)?, points });
        self.numbers.insert(key, self.all.len() - 1);
        Ok(self.all.len() - 1)
    }
}

/// What came of an attack, in a sentence.
fn ending(one: &MeasuredAttack, unbelievable: &[Reason]) -> String {
    // The page shows no code, so names stand there without quotation marks.
    let mut sentence = attack::words(one.outcome, &one.counts, one.contact, unbelievable);
    if let Some(first) = sentence.get(..1).map(str::to_uppercase) {
        sentence.replace_range(..1, &first);
    }
    match (one.avoidable.avoidable, one.avoidable.latest_start) {
        (Some(true), Some(time)) => {
            format!("{sentence}. An evasive manoeuvre can begin up to {time:.1} s before the contact.")
        }
        (Some(false), _) => format!("{sentence}. No evasive manoeuvre was found."),
        _ => match one.counts.cause(one.outcome).replace('`', "") {
            cause if cause.is_empty() => format!("{sentence}."),
            cause => format!("{sentence}: {cause}."),
        },
    }
}

/// The evasive manoeuvre for the picture of an attack.
fn drawn_evasion(avoidable: &Avoidable, contact: usize) -> Option<(f64, Vec<Point>)> {
    let (start, rows) = avoidable.evasion(contact)?;
    Some((start, rows.iter().map(|[x, y, _]| [*x, *y]).collect()))
}
