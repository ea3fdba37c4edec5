//! The candidates of a selection from above: by what they do, the selected one in front.

use sage_core::{
    generator::{Attack, Proposal},
    geometry::OrientedBox,
    motion::NOW,
    objective::Context,
    scene::Scene,
    selection_outcome::CandidateKind,
};
use sage_view::drawing::{self, DrawnPath, Outcome, Picture, Tried, drawn_path};

use super::explanation::Explanation;

/// Candidates to draw.
#[derive(Default)]
pub(super) struct Candidates {
    others: Vec<Tried>,
    selected: Vec<DrawnPath>,
    /// Where hits first break a rule.
    marks: Vec<(Vec<OrientedBox>, String)>,
}

impl Candidates {
    /// Those of an attack.
    pub(super) fn of(
        attack: &Attack,
        ctx: &Context,
        explanation: &Explanation,
        kinds: &[CandidateKind],
    ) -> Self {
        let start = ctx.adversary().point(NOW);
        let tried = |(proposal, kind): (&Proposal, &CandidateKind)| Tried {
            points: std::iter::once(start).chain(proposal.trajectory.points().iter().copied()).collect(),
            dot: None,
            outcome: match kind {
                CandidateKind::NoContact => Outcome::NoContact,
                CandidateKind::InfeasibleHit => Outcome::OtherContact,
                CandidateKind::UnbelievableHit => Outcome::Attack,
                CandidateKind::BelievableHit => Outcome::Failure,
            },
            words: kind.words(),
            contact: None,
        };
        let selected =
            drawn_path(format!("selected, {}", explanation.attack), ctx, attack.trajectory().clone());
        let marks = explanation.counts.marks(ctx.scene());
        Self {
            others: attack.candidates.iter().zip(kinds).map(tried).collect(),
            selected: vec![selected],
            marks: marks.into_iter().map(|mark| (mark.boxes, mark.label)).collect(),
        }
    }
}

/// Draws candidates in their scene.
pub(super) fn draw(scene: &Scene, title: &str, candidates: Candidates) -> String {
    let Candidates { others, selected, marks } = candidates;
    let picture =
        Picture { title: title.to_owned(), tried: others, candidates: selected, marks, ..Picture::default() };
    drawing::draw(scene, &picture)
}
