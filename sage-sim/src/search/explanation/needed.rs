//! Which other road users a failure needs: the scene is driven anew without them.

use std::collections::HashMap;

use sage_core::{
    generator::Proposal,
    geometry::{cross, distance, dot, norm, sub},
    motion::{DT, NOW, Trajectory},
    objective::Context,
};
use serde::{Deserialize, Serialize};

use crate::{
    Error,
    attack_test::AttackTest,
    search::{AttackedPath, PoolPlan, Reason, SearchOptions, evaluation::Evaluator},
};

/// Road users who come no nearer to the ego than this are taken out together, metres.
const REACH: f64 = 80.0;
/// Most drives of a failure, unattacked ones included.
const MOST_DRIVES: usize = 30;
/// Road users that are tried alone, the likeliest first.
const ALONE: usize = 6;
/// The likeliest ones, among which a set is searched first.
const LIKELY: usize = 12;
/// What a second between two road users at one place counts, metres.
const SECOND: f64 = 1.0;

/// A road user that a failure needs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NeededRoadUser {
    /// Its track.
    pub track: String,
    /// Its kind.
    pub kind: String,
    /// Distance from the ego *now*, or when it is first seen, metres.
    pub distance: f64,
    /// Its bearing from the heading of the ego then, rad, positive to the left.
    pub bearing: f64,
}

/// The other road users that a failure needs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Needed {
    /// With these and none but these the failure is one; none: it takes the two cars alone.
    pub road_users: Vec<NeededRoadUser>,
    /// Whether it is no failure without any one of them; `false` if the drives ended before that was shown.
    pub is_minimal: bool,
    /// What it is without all others, if it is no failure then.
    pub without: Option<Reason>,
}

/// Drives a failure anew among some of the road users.
struct Subsets<'s> {
    test: &'s AttackTest<'s>,
    plan: &'s Trajectory,
    options: &'s SearchOptions,
    drives: usize,
    /// What came of it, by the tracks that stay.
    known: HashMap<Vec<usize>, Option<Reason>>,
}

impl Subsets<'_> {
    /// Why it is no failure among these road users; `None` if it is one.
    ///
    /// *Errors*: those of the scene; an error of the driver is a reason.
    fn passes(&mut self, tracks: &[usize]) -> Result<Option<Reason>, Error> {
        let mut key = tracks.to_vec();
        key.sort_unstable();
        if let Some(known) = self.known.get(&key) {
            return Ok(*known);
        }
        // The unattacked drive of a scene with other road users is another one.
        self.drives += 2;
        let reason = self.drive(&key)?;
        self.known.insert(key, reason);
        Ok(reason)
    }

    fn drive(&self, tracks: &[usize]) -> Result<Option<Reason>, Error> {
        let Ok(test) = self.test.among(|track| tracks.contains(&track)) else {
            return Ok(Some(Reason::Error));
        };
        let ctx = test.context()?;
        let evaluator = Evaluator::new(&test, &ctx, self.options.require, self.options.avoidable);
        let candidate = ctx.candidate(self.plan.clone());
        let proposal = Proposal::of(self.plan.clone());
        let plan = PoolPlan { proposal, source: 0, refined_from: None, candidate };
        Ok(evaluator.driven(&plan).missing(self.options.require))
    }

    fn fails(&mut self, tracks: &[usize]) -> Result<bool, Error> {
        Ok(self.passes(tracks)?.is_none())
    }

    fn is_spent(&self) -> bool {
        self.drives + 2 > MOST_DRIVES
    }
}

impl Needed {
    /// How many other road users it takes, in words.
    pub fn words(&self) -> &'static str {
        match (self.without, self.is_minimal, self.road_users.len()) {
            (None, ..) => "nobody else",
            (_, true, 1) => "one other",
            (_, true, _) => "several others",
            (_, false, _) => "others, not minimal",
        }
    }

    /// Finds the road users that a failure needs: nobody, one of the likeliest, or a set by delta debugging (Zeller and Hildebrandt
    /// 2002). The number of drives is added to `drives`.
    ///
    /// *Errors*: those of the scene.
    pub(super) fn of(
        test: &AttackTest,
        ctx: &Context,
        plan: &Trajectory,
        driven: &Driven,
        options: &SearchOptions,
        drives: &mut usize,
    ) -> Result<Self, Error> {
        let mut subsets = Subsets { test, plan, options, drives: 0, known: HashMap::new() };
        let found = subsets.search(ctx, driven);
        *drives += subsets.drives;
        found
    }
}

impl Subsets<'_> {
    fn search(&mut self, ctx: &Context, driven: &Driven) -> Result<Needed, Error> {
        let scene = ctx.scene();
        let roles = [Some(scene.ego), scene.adversary];
        let others: Vec<usize> = (0..scene.tracks.len()).filter(|k| !roles.contains(&Some(*k))).collect();
        // Among all of them it is the failure that is explained.
        self.known.insert(others.clone(), None);
        let Some(without) = self.passes(&[])? else {
            return Ok(Needed { road_users: Vec::new(), is_minimal: true, without: None });
        };
        let near = driven.likeliest(ctx, &others);
        let mut set = None;
        for track in near.iter().take(ALONE) {
            if self.fails(&[*track])? {
                set = Some((vec![*track], true));
                break;
            }
        }
        let (set, is_minimal) = match set {
            Some(found) => found,
            None if near.len() > LIKELY && self.fails(&near[..LIKELY])? => {
                self.minimise(near[..LIKELY].to_vec())?
            }
            None if self.fails(&near)? => self.minimise(near)?,
            None => (others, false),
        };
        let road_users = set.into_iter().map(|track| driven.described(ctx, track)).collect();
        Ok(Needed { road_users, is_minimal, without: Some(without) })
    }

    /// Delta debugging: a set that fails, and without any one of which it does not; `false` if the drives ended before.
    fn minimise(&mut self, mut set: Vec<usize>) -> Result<(Vec<usize>, bool), Error> {
        let mut parts = 2;
        while set.len() > 1 {
            let size = set.len().div_ceil(parts.min(set.len()));
            let chunks: Vec<Vec<usize>> = set.chunks(size).map(<[usize]>::to_vec).collect();
            let mut smaller = None;
            let rest = |chunk: &Vec<usize>| set.iter().copied().filter(|k| !chunk.contains(k)).collect();
            let complements: Vec<Vec<usize>> =
                if chunks.len() > 2 { chunks.iter().map(rest).collect() } else { Vec::new() };
            let subsets = chunks.iter().map(|chunk| (chunk, true));
            for (tried, is_chunk) in subsets.chain(complements.iter().map(|rest| (rest, false))) {
                if self.is_spent() {
                    return Ok((set, false));
                }
                if self.fails(tried)? {
                    smaller = Some((tried.clone(), is_chunk));
                    break;
                }
            }
            match smaller {
                Some((tried, is_chunk)) => {
                    set = tried;
                    parts = if is_chunk { 2 } else { (parts - 1).max(2) };
                }
                None if size == 1 => return Ok((set, true)),
                None => parts = (2 * parts).min(set.len()),
            }
        }
        Ok((set, true))
    }
}

/// The ego's poses in the attacked drive from frame 0 to the contact.
pub(super) struct Driven(Vec<[f64; 3]>);

impl Driven {
    /// The poses up to a contact at a step.
    pub(super) fn new(path: &AttackedPath, contact: usize) -> Self {
        let after = path.positions.iter().zip(&path.headings).map(|([x, y], heading)| [*x, *y, *heading]);
        Self(path.history.iter().copied().chain(after.take(contact)).collect())
    }

    /// The road users within [`REACH`], in turn by two orders: who drives just ahead in the ego's way, and who is where the ego comes
    /// to be, at nearly the same time.
    fn likeliest(&self, ctx: &Context, others: &[usize]) -> Vec<usize> {
        let near = others.iter().filter_map(|track| Some((*track, self.measures(ctx, *track)?)));
        let near: Vec<(usize, [f64; 2])> = near.collect();
        let by = |measure: usize| {
            let mut order: Vec<&(usize, [f64; 2])> = near.iter().collect();
            order.sort_by(|a, b| a.1[measure].total_cmp(&b.1[measure]).then(a.0.cmp(&b.0)));
            order.into_iter().map(|(track, _)| *track).collect::<Vec<_>>()
        };
        let mut order = Vec::with_capacity(near.len());
        for (ahead, there) in by(0).into_iter().zip(by(1)) {
            for track in [ahead, there] {
                if !order.contains(&track) {
                    order.push(track);
                }
            }
        }
        order
    }

    /// How far a road user is from driving just ahead, and from being where the ego comes to be, metres; `None` beyond [`REACH`].
    fn measures(&self, ctx: &Context, track: usize) -> Option<[f64; 2]> {
        let track = &ctx.scene().tracks[track];
        let frames: Vec<usize> = (0..self.0.len()).filter(|frame| track.is_valid(*frame)).collect();
        let ways = frames.iter().map(|frame| {
            let [x, y, heading] = self.0[*frame];
            let (axis, way) = ([heading.cos(), heading.sin()], sub(track.point(*frame), [x, y]));
            (norm(way), dot(axis, way), cross(axis, way))
        });
        let ahead = |(metres, along, left): (f64, f64, f64)| {
            // Along the way counts half, across it three times.
            if along > 0.0 { (0.5 * along).hypot(3.0 * left) } else { 2.0 * metres + 10.0 }
        };
        let (mut least, mut just_ahead) = (f64::INFINITY, f64::INFINITY);
        for way in ways {
            least = least.min(way.0);
            just_ahead = just_ahead.min(ahead(way));
        }
        let there = |frame: &usize| {
            let p = track.point(*frame);
            let apart = |(k, [x, y, _]): (usize, &[f64; 3])| {
                distance(p, [*x, *y]) + SECOND * DT * k.abs_diff(*frame) as f64
            };
            self.0.iter().enumerate().map(apart).fold(f64::INFINITY, f64::min)
        };
        let there = frames.iter().map(there).fold(f64::INFINITY, f64::min);
        (least <= REACH).then_some([just_ahead, there])
    }

    /// Where a road user is, seen from the ego.
    fn described(&self, ctx: &Context, track: usize) -> NeededRoadUser {
        let track = &ctx.scene().tracks[track];
        let last = self.0.len() - 1;
        let frame = (NOW..=last).find(|frame| track.is_valid(*frame)).unwrap_or(NOW.min(last));
        let [x, y, heading] = self.0[frame];
        let axis = [heading.cos(), heading.sin()];
        let way = sub(track.point(frame), [x, y]);
        NeededRoadUser {
            track: track.id.clone(),
            kind: track.kind.name().to_owned(),
            distance: norm(way),
            bearing: cross(axis, way).atan2(dot(axis, way)),
        }
    }
}
