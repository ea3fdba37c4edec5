//! What came of the selection among a generator's candidates: an attack, or why there is none.
//!
//! It is one enum, so the table, the row, the page and `explain` cannot disagree.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

use crate::{
    geometry::{OrientedBox, Point, distance, sub},
    motion::{NOW, Trajectory},
    objective::{Candidate, Context, Reason, Violation},
    scene::Scene,
};

/// What came of a selection. The names are those of `sage search`, where it has the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SelectionOutcome {
    /// A believable attack.
    Attack,
    /// The selected candidate is a feasible hit that a person would not believe.
    NotBelievable,
    /// No candidate is feasible.
    NoFeasiblePlan,
    /// No candidate touches the ego.
    NeverHit,
    /// Candidates touch the ego, none of them is feasible.
    NoFeasibleHit,
    /// A feasible one touches the ego, and the selection prefers another.
    NotPreferred,
}

impl SelectionOutcome {
    /// Whether the selected candidate is a feasible hit.
    pub fn is_attack(self) -> bool {
        matches!(self, Self::Attack | Self::NotBelievable)
    }

    /// Why there is no believable attack, in words; `None` if there is one.
    pub fn reason(self) -> Option<&'static str> {
        Some(match self {
            Self::Attack => return None,
            Self::NotBelievable => "the attack is not believable",
            Self::NoFeasiblePlan => "no candidate is feasible",
            Self::NeverHit => "no candidate touches the ego",
            Self::NoFeasibleHit => "no candidate that touches the ego is feasible",
            Self::NotPreferred => "the selection rates a miss higher",
        })
    }

    /// The outcome in words. A selection says more about an attack.
    pub fn words(self) -> String {
        match self {
            Self::Attack => "believable attack".to_owned(),
            Self::NotBelievable => "attack, not believable".to_owned(),
            other => format!("no attack: {}", other.reason().unwrap_or_default()),
        }
    }
}

/// What a candidate does.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum CandidateKind {
    /// It does not touch the ego.
    NoContact,
    /// It touches the ego, and is not feasible.
    InfeasibleHit,
    /// A feasible hit that a person would not believe.
    UnbelievableHit,
    /// A believable hit.
    BelievableHit,
}

impl CandidateKind {
    /// Words of a legend.
    pub fn words(self) -> &'static str {
        match self {
            Self::NoContact => "no contact",
            Self::InfeasibleHit => "hit, not feasible",
            Self::UnbelievableHit => "hit, not believable",
            Self::BelievableHit => "believable hit",
        }
    }
}

/// One candidate of a selection, measured.
#[derive(Clone, Copy, Debug)]
pub struct Measured<'a> {
    /// The candidate.
    pub trajectory: &'a Trajectory,
    /// Whether it touches the ego.
    pub is_hit: bool,
    /// Violations of the rule of the selection.
    pub violations: &'a [Violation],
    /// Why a person would not believe it; empty without contact.
    pub unbelievable: &'a [Reason],
    /// Where it comes nearest to the ego.
    pub nearest: Option<Nearest>,
}

/// Where a candidate comes nearest to the ego.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Nearest {
    /// Distance of the centres, metres.
    pub distance: f64,
    /// Seconds from *now*.
    pub after: f64,
}

impl Nearest {
    fn words(self) -> String {
        format!("the nearest has its centre {:.1} m from the ego's after {:.1} s", self.distance, self.after)
    }

    /// That of a candidate; `None` if the ego has no box at any of its steps.
    pub fn of(candidate: &Candidate, ctx: &Context) -> Option<Self> {
        let steps = candidate.boxes().iter().zip(ctx.ego().boxes()).enumerate();
        let steps = steps.filter_map(|(k, (own, ego))| Some((k, distance(own.center, ego.as_ref()?.center))));
        let (k, distance) = steps.min_by(|a, b| a.1.total_cmp(&b.1))?;
        Some(Self { distance, after: (k + 1) as f64 / 10.0 })
    }
}

/// Hits that break one rule.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Broken {
    /// Number of hits.
    pub hits: usize,
    /// Earliest violation, seconds from *now*; then the adversary's position and direction.
    pub from: f64,
    /// Centre of the adversary then, metres.
    pub place: Point,
    /// Its heading then, rad.
    pub heading: f64,
    /// Track or map feature that is touched.
    pub with: String,
}

/// A violation in a picture: the boxes then, and a label.
#[derive(Clone, Debug)]
pub struct Mark {
    /// That of the adversary, and that of the road user that it touches, if it is one.
    pub boxes: Vec<OrientedBox>,
    /// What it says.
    pub label: String,
}

/// Feasible hits that a person would not believe for one reason.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Doubted {
    /// Number of hits.
    pub hits: usize,
    /// The value that comes nearest to the limit, and the limit, in the units of [`Reason`].
    pub nearest: f64,
    /// The limit that is broken, if there is one.
    pub limit: Option<f64>,
}

impl Doubted {
    /// The reason with its name, number of hits and values.
    fn words(&self, name: &str) -> String {
        let Self { hits, nearest, limit } = self;
        match (name, limit) {
            ("contact depth", Some(limit)) => {
                format!("contact depth ({hits}: at most {nearest:.2} m; {limit:.2} m needed)")
            }
            (_, Some(limit)) => {
                let (digits, unit) = match name {
                    "turning circle" => (2, " rad/m"),
                    "speeding" => (2, " times the limit"),
                    "acceleration" | "braking" | "lateral acceleration" => (1, " m/s²"),
                    _ => (1, " s"),
                };
                format!("{name} ({hits}: {nearest:.digits$}{unit} or more; {limit:.digits$}{unit} allowed)")
            }
            _ => format!("{name} ({hits}, from {nearest:.1} s on)"),
        }
    }
}

impl Measured<'_> {
    fn is_feasible(&self) -> bool {
        self.violations.is_empty()
    }

    fn is_believable(&self) -> bool {
        self.kind() == CandidateKind::BelievableHit
    }

    /// What it does.
    pub fn kind(&self) -> CandidateKind {
        match (self.is_hit, self.is_feasible()) {
            (false, _) => CandidateKind::NoContact,
            (true, false) => CandidateKind::InfeasibleHit,
            (true, true) if self.unbelievable.is_empty() => CandidateKind::BelievableHit,
            (true, true) => CandidateKind::UnbelievableHit,
        }
    }
}

/// The candidates of a selection by what they do.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CandidateCounts {
    /// All candidates.
    pub candidates: usize,
    /// Feasible by the rule of the selection.
    pub feasible: usize,
    /// Touch the ego.
    pub hits: usize,
    /// Feasible ones that touch the ego.
    pub feasible_hits: usize,
    /// Of these the believable ones.
    pub believable_hits: usize,
    /// The candidate that comes nearest.
    pub nearest: Option<Nearest>,
    /// Rules that infeasible candidates break, whether they hit or not.
    pub broken: BTreeMap<String, usize>,
    /// What makes hits infeasible: rule and what is touched.
    pub violations: BTreeMap<String, Broken>,
    /// Why feasible hits are not believable.
    pub unbelievable: BTreeMap<String, Doubted>,
}

impl CandidateCounts {
    /// Counts candidates.
    pub fn of<'a>(all: impl IntoIterator<Item = Measured<'a>>) -> Self {
        let mut counts = Self::default();
        all.into_iter().for_each(|one| counts.add(&one));
        counts
    }

    fn add(&mut self, one: &Measured) {
        self.candidates += 1;
        self.feasible += usize::from(one.is_feasible());
        let is_nearer = |a: &Nearest| self.nearest.is_none_or(|b| a.distance < b.distance);
        self.nearest = one.nearest.filter(is_nearer).or(self.nearest);
        let rules: BTreeSet<String> = one.violations.iter().map(Violation::words).collect();
        rules.into_iter().for_each(|rule| *self.broken.entry(rule).or_default() += 1);
        if !one.is_hit {
            return;
        }
        self.hits += 1;
        if !one.is_feasible() {
            let mut first: BTreeMap<String, &Violation> = BTreeMap::new();
            for violation in one.violations {
                let known = first.entry(violated(violation)).or_insert(violation);
                if violation.step < known.step {
                    *known = violation;
                }
            }
            for (what, violation) in first {
                let first = Broken {
                    hits: 0,
                    from: violation.step as f64 / 10.0,
                    place: violation.place,
                    heading: heading(one.trajectory, violation.step),
                    with: violation.with.clone(),
                };
                let known = self.violations.entry(what).or_insert(first.clone());
                let hits = known.hits + 1;
                *known = if first.from < known.from { first } else { known.clone() };
                known.hits = hits;
            }
            return;
        }
        self.feasible_hits += 1;
        self.believable_hits += usize::from(one.is_believable());
        for Reason { reason, value, limit } in one.unbelievable {
            let first = Doubted { hits: 0, nearest: *value, limit: *limit };
            let doubted = self.unbelievable.entry(reason.replace('_', " ")).or_insert(first);
            doubted.hits += 1;
            let is_deeper = &**reason == "contact_depth";
            doubted.nearest =
                if is_deeper { doubted.nearest.max(*value) } else { doubted.nearest.min(*value) };
        }
    }

    /// What makes hits infeasible, in words; empty if nothing does. The most frequent first.
    pub fn violated(&self) -> Vec<String> {
        let mut all: Vec<(&String, &Broken)> = self.violations.iter().collect();
        all.sort_by_key(|(_, broken)| std::cmp::Reverse(broken.hits));
        let words = |(what, Broken { hits, from, .. }): (&String, &Broken)| {
            format!("{what} ({hits}, at {from:.1} s or later)")
        };
        all.into_iter().map(words).collect()
    }

    /// Where hits first break each rule, with a label for pictures.
    pub fn marks(&self, scene: &Scene) -> Vec<Mark> {
        let Some(adversary) = scene.adversary.map(|k| &scene.tracks[k]) else { return Vec::new() };
        let mark = |(what, broken): (&String, &Broken)| {
            let frame = (NOW + (10.0 * broken.from).round() as usize).min(scene.frames - 1);
            let [length, width, _] = adversary.size[NOW];
            let mut boxes = vec![OrientedBox::new(broken.place, broken.heading, length, width)];
            let other = scene.tracks.iter().find(|track| track.id == broken.with && track.is_valid(frame));
            let what = match other {
                Some(track) => {
                    boxes.push(track.oriented_box(frame));
                    format!("{} {}", track.kind.name().to_lowercase(), broken.with)
                }
                None => what.replace('`', ""),
            };
            Mark { boxes, label: format!("{what}, {:.1} s", broken.from) }
        };
        self.violations.iter().map(mark).collect()
    }

    /// Why feasible hits are not believable, in words; empty if all are.
    pub fn doubted(&self) -> Vec<String> {
        self.unbelievable.iter().map(|(name, doubted)| doubted.words(name)).collect()
    }

    /// What came of a selection among these, in words.
    pub fn outcome_words(&self, outcome: SelectionOutcome) -> String {
        match outcome {
            SelectionOutcome::NotPreferred if self.believable_hits == 0 => {
                "no attack: no hit is believable, and the selection rates a miss higher".to_owned()
            }
            other => other.words(),
        }
    }

    /// What caused an outcome, in words; empty for a believable attack.
    pub fn cause(&self, outcome: SelectionOutcome) -> String {
        match outcome {
            SelectionOutcome::Attack | SelectionOutcome::NotBelievable => String::new(),
            SelectionOutcome::NeverHit => self.nearest.map_or(String::new(), |nearest| nearest.words()),
            SelectionOutcome::NoFeasiblePlan | SelectionOutcome::NoFeasibleHit => self.violated().join(", "),
            SelectionOutcome::NotPreferred if self.believable_hits == 0 => self.doubted().join(", "),
            SelectionOutcome::NotPreferred => {
                let (hits, believable) = (self.feasible_hits, self.believable_hits);
                format!("{hits} feasible hits, {believable} believable, are worth less to it here")
            }
        }
    }

    /// What came of a selection among these.
    pub fn outcome(&self, selected: &Measured) -> SelectionOutcome {
        match selected.is_hit && selected.is_feasible() {
            true if selected.is_believable() => SelectionOutcome::Attack,
            true => SelectionOutcome::NotBelievable,
            false if self.feasible == 0 => SelectionOutcome::NoFeasiblePlan,
            false if self.hits == 0 => SelectionOutcome::NeverHit,
            false if self.feasible_hits == 0 => SelectionOutcome::NoFeasibleHit,
            false => SelectionOutcome::NotPreferred,
        }
    }

    /// The counts in a sentence.
    pub fn words(&self) -> String {
        let touching = match (self.hits, self.feasible_hits) {
            (0, _) => {
                let nearest = self.nearest.map_or(String::new(), |nearest| format!(" ({})", nearest.words()));
                format!("none touches the ego{nearest}")
            }
            (1, 0) => "1 touches the ego, and is not feasible".to_owned(),
            (hits, 0) => format!("{hits} touch the ego, none of them is feasible"),
            (hits, feasible) => {
                let touch = if hits == 1 { "touches" } else { "touch" };
                let of = |some: usize, all: usize| match some {
                    0 => "none".to_owned(),
                    some if some == all && all > 1 => "all".to_owned(),
                    some => some.to_string(),
                };
                let (feasible, believable) = (of(feasible, hits), of(self.believable_hits, feasible));
                format!("{hits} {touch} the ego, {feasible} feasible, {believable} believable")
            }
        };
        let many = if self.candidates == 1 { "candidate" } else { "candidates" };
        let broken: Vec<String> = self.broken.iter().map(|(rule, count)| format!("{rule} {count}")).collect();
        let broken =
            if broken.is_empty() { String::new() } else { format!(" (others: {})", broken.join(", ")) };
        format!("{} {many}, {} feasible{broken}; {touching}", self.candidates, self.feasible)
    }
}

/// Direction of a trajectory at a step from 1 on, rad.
fn heading(trajectory: &Trajectory, step: usize) -> f64 {
    let points = trajectory.points();
    let at = step.clamp(2, points.len()) - 1;
    // A car that stands keeps the direction that it came with.
    let moved = (1..=at).rev().map(|k| sub(points[k], points[k - 1])).find(|d| d[0].hypot(d[1]) > 0.05);
    moved.map_or(0.0, |d| d[1].atan2(d[0]))
}

/// What a violation breaks, and what it touches.
fn violated(violation: &Violation) -> String {
    let rule = violation.words();
    if violation.with.is_empty() { rule } else { format!("{rule} `{}`", violation.with) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A car that stands.
    fn still() -> &'static Trajectory {
        static STILL: std::sync::OnceLock<Trajectory> = std::sync::OnceLock::new();
        STILL.get_or_init(|| Trajectory::new("still", vec![[0.0; 2]; 80]).unwrap())
    }

    fn measured<'a>(is_hit: bool, violations: &'a [Violation], unbelievable: &'a [Reason]) -> Measured<'a> {
        Measured { trajectory: still(), is_hit, violations, unbelievable, nearest: None }
    }

    #[test]
    fn every_outcome_has_its_candidates() {
        let edge =
            [Violation { rule: "road_edge".into(), cost: 50.0, step: 3, place: [0.0; 2], with: "7".into() }];
        let grazes = [Reason { reason: "contact_depth".into(), value: 0.1, limit: Some(0.5) }];
        let (hit, miss) = (measured(true, &[], &[]), measured(false, &[], &[]));
        let (grazing, infeasible_hit) = (measured(true, &[], &grazes), measured(true, &edge, &[]));
        let infeasible = measured(false, &edge, &[]);
        let outcome = |all: &[Measured]| CandidateCounts::of(all.iter().copied()).outcome(&all[0]);
        assert_eq!(outcome(&[hit, miss]), SelectionOutcome::Attack);
        assert_eq!(outcome(&[grazing, miss]), SelectionOutcome::NotBelievable);
        assert_eq!(outcome(&[infeasible_hit, infeasible]), SelectionOutcome::NoFeasiblePlan);
        assert_eq!(outcome(&[miss, infeasible]), SelectionOutcome::NeverHit);
        assert_eq!(outcome(&[miss, infeasible_hit]), SelectionOutcome::NoFeasibleHit);
        assert_eq!(outcome(&[miss, hit]), SelectionOutcome::NotPreferred);
        let counts = CandidateCounts::of([miss, infeasible_hit, grazing]);
        assert_eq!(
            counts.words(),
            "3 candidates, 2 feasible (others: road edge 1); 2 touch the ego, 1 feasible, none believable"
        );
        assert_eq!(counts.violated(), ["road edge `7` (1, at 0.3 s or later)"]);
        assert_eq!(counts.doubted(), ["contact depth (1: at most 0.10 m; 0.50 m needed)"]);
        let taste = "no attack: no hit is believable, and the selection rates a miss higher";
        assert_eq!(counts.outcome_words(SelectionOutcome::NotPreferred), taste);
    }
}
