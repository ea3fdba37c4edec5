//! Links between lanes: direct joints and junctions.

use std::collections::{HashMap, HashSet};

use sage_core::{geometry::distance, scene::Map};

use super::{center_line::CenterLine, lanes::RoadLane};

/// Largest distance from the end of a lane to the start of the next, metres.
const GAP: f64 = 0.5;
/// Length of a lane's start that becomes part of a junction, metres. Of a short lane it is half its length.
const HEAD: f64 = 2.0;
/// Smallest length of a connecting road along the heading of the lane that it leads to, metres.
const ROOM: f64 = 0.02;

/// Most lanes that are left out between two that are linked.
const MOST_PASSED: usize = 64;
/// Most exits that are looked at behind a lane.
const MOST_EXITS: usize = 4096;

/// A link from one lane to the next, as indices of written lanes.
pub(super) type Link = [usize; 2];

/// Joins lanes that have only each other at their ends, and gives the links of all others by junction.
///
/// A junction is a group of lane ends and lane starts that links connect, directly or through others. Each of
/// its links becomes a connecting road, which replaces the first metres of the later lane.
pub(super) fn join(
    map: &Map,
    lanes: &mut [RoadLane],
    written: &HashMap<usize, usize>,
    notes: &mut Vec<String>,
) -> Vec<Vec<Link>> {
    let links = recorded(map, lanes, written, notes);
    let (mut exits, mut entries) = (vec![0usize; lanes.len()], vec![0usize; lanes.len()]);
    for [a, b] in &links {
        exits[*a] += 1;
        entries[*b] += 1;
    }
    let (mut direct, mut others) = (Vec::new(), Vec::new());
    for link in links {
        let [a, b] = link;
        let is_only = exits[a] == 1 && entries[b] == 1 && a != b;
        let joined = is_only.then(|| lanes[b].line.starting_at_end_of(&lanes[a].line)).flatten();
        match joined {
            Some(line) => {
                lanes[b].line = line;
                direct.push(link);
            }
            None => others.push(link),
        }
    }
    for [a, b] in direct {
        let (before, after) = two(lanes, a, b);
        CenterLine::align_joint(&mut before.line, &mut after.line);
        let mean = [0, 1].map(|side| 0.5 * (before.end[side] + after.start[side]));
        (before.end, after.start) = (mean, mean);
        (before.next_road, after.previous_road) = (Some(b), Some(a));
    }
    junctions(map, lanes, others, notes)
}

/// The links of the scene between written lanes, each once, without those over a gap.
fn recorded(
    map: &Map,
    lanes: &[RoadLane],
    written: &HashMap<usize, usize>,
    notes: &mut Vec<String>,
) -> Vec<Link> {
    let mut links = Vec::new();
    let mut seen = HashSet::new();
    for (a, lane) in lanes.iter().enumerate() {
        for (b, is_direct) in followers(map, &lane.recorded.exits, written) {
            if !seen.insert([a, b]) {
                continue;
            }
            let gap = distance(lane.line.last(), lanes[b].line.first());
            if gap <= GAP {
                links.push([a, b]);
            } else if is_direct {
                notes.push(format!("{}: left out, {gap:.2} m lie between", name(map, lanes, [a, b])));
            }
        }
    }
    links
}

/// The written lanes that follow a lane with these exits, and whether directly: those behind a lane that is left out, because it
/// is too short, take its place.
fn followers(map: &Map, exits: &[usize], written: &HashMap<usize, usize>) -> Vec<(usize, bool)> {
    let mut found = Vec::new();
    let mut passed = HashSet::new();
    let mut next: Vec<(usize, bool)> = exits.iter().rev().map(|exit| (*exit, true)).collect();
    let mut exits_seen = 0;
    while let Some((feature, is_direct)) = next.pop() {
        exits_seen += 1;
        if exits_seen > MOST_EXITS {
            break;
        }
        if let Some(lane) = written.get(&feature) {
            found.push((*lane, is_direct));
        } else if passed.insert(feature) && passed.len() <= MOST_PASSED {
            let lane = map.features.get(feature).and_then(|feature| feature.lane.as_deref());
            let exits = lane.map_or(&[][..], |lane| &lane.exits);
            next.extend(exits.iter().rev().map(|exit| (*exit, false)));
        }
    }
    found
}

/// Shortens the lanes that junctions lead to, and groups the links by junction.
fn junctions(map: &Map, lanes: &mut [RoadLane], links: Vec<Link>, notes: &mut Vec<String>) -> Vec<Vec<Link>> {
    let mut shortened: HashMap<usize, CenterLine> = HashMap::new();
    let mut kept = Vec::with_capacity(links.len());
    for link in links {
        let [a, b] = link;
        let line = &lanes[b].line;
        let cut = shortened.entry(b).or_insert_with(|| line.without_start(HEAD.min(0.5 * line.length())));
        if cut.start_ahead_of(lanes[a].line.last()) >= ROOM {
            kept.push(link);
        } else {
            notes.push(format!("{}: left out, no room for a connecting road", name(map, lanes, link)));
        }
    }
    for [_, b] in &kept {
        if let Some(line) = shortened.remove(b) {
            lanes[*b].line = line;
        }
    }
    let mut groups = Groups::new(2 * lanes.len());
    for [a, b] in &kept {
        groups.unite(2 * a, 2 * b + 1);
    }
    let mut number_of: HashMap<usize, usize> = HashMap::new();
    let mut junctions: Vec<Vec<Link>> = Vec::new();
    for link in kept {
        let group = groups.root(2 * link[0]);
        let junction = *number_of.entry(group).or_insert(junctions.len());
        if junction == junctions.len() {
            junctions.push(Vec::new());
        }
        junctions[junction].push(link);
        lanes[link[0]].next_junction = Some(junction);
        lanes[link[1]].previous_junction = Some(junction);
    }
    junctions
}

fn name(map: &Map, lanes: &[RoadLane], link: Link) -> String {
    let [a, b] = link.map(|lane| &map.features[lanes[lane].feature].id);
    format!("link from lane `{a}` to lane `{b}`")
}

/// Two different lanes.
fn two<'l, 's>(
    lanes: &'l mut [RoadLane<'s>],
    a: usize,
    b: usize,
) -> (&'l mut RoadLane<'s>, &'l mut RoadLane<'s>) {
    let (low, high) = lanes.split_at_mut(a.max(b));
    if a < b { (&mut low[a], &mut high[0]) } else { (&mut high[0], &mut low[b]) }
}

/// Disjoint sets.
struct Groups(Vec<usize>);

impl Groups {
    fn new(count: usize) -> Self {
        Self((0..count).collect())
    }

    fn root(&mut self, mut of: usize) -> usize {
        while self.0[of] != of {
            self.0[of] = self.0[self.0[of]];
            of = self.0[of];
        }
        of
    }

    fn unite(&mut self, a: usize, b: usize) {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a.max(b)] = a.min(b);
    }
}
