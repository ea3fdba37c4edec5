//! What distinguishes failures: features, a distance between them, clusters with names, and a diverse choice.

use std::{collections::BTreeMap, f64::consts::PI};

use sage_core::{
    geometry::{OrientedBox, wrap_angle},
    motion::DT,
    objective::{Candidate, CollisionType, Context},
    scene::TrackKind,
};
use serde::{Deserialize, Serialize};

use super::{
    Met,
    manoeuvre::{Manoeuvre, RoadKind},
};

/// Difference of relative speeds that counts in full, m/s.
const FULL_SPEED: f64 = 10.0;
/// Difference of latest starts that counts in full, s.
const FULL_TIME: f64 = 2.0;
/// Width of a band of the ego's speed, m/s, and the number of bands with an upper end.
const BAND: f64 = 5.0;
const BANDS: usize = 3;

/// A kind of people.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Person {
    /// On foot.
    Pedestrian,
    /// On a bicycle.
    Cyclist,
}

impl Person {
    fn of(kind: &TrackKind) -> Option<Self> {
        match kind {
            TrackKind::Pedestrian => Some(Self::Pedestrian),
            TrackKind::Cyclist => Some(Self::Cyclist),
            _ => None,
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Pedestrian => "pedestrian",
            Self::Cyclist => "cyclist",
        }
    }
}

/// Features of a failure.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Features {
    /// Type of the collision.
    pub collision: CollisionType,
    /// Heading of the adversary less that of the ego at the contact, rad.
    pub relative_heading: f64,
    /// Relative speed at the contact, m/s.
    pub relative_speed: f64,
    /// Speed of the ego at the contact, m/s.
    pub ego_speed: f64,
    /// What the ego does from *now* to the contact.
    pub ego: Manoeuvre,
    /// What the adversary does from *now* to the contact.
    pub adversary: Manoeuvre,
    /// Whether the adversary is a person, and which.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub person: Option<Person>,
    /// What the contact happens on.
    pub road: RoadKind,
    /// Latest start of an evasive manoeuvre, s before the contact; `None` if it was not asked for.
    pub latest_start: Option<f64>,
}

impl Features {
    /// Features of an attacked drive. The first path of `ctx` is that of the drive. `None` if the ego has no box at the
    /// contact.
    pub fn of(ctx: &Context, plan: &Candidate, met: &Met, latest_start: Option<f64>) -> Option<Self> {
        let step = usize::try_from(met.step).ok().filter(|step| (1..=plan.boxes().len()).contains(step))?;
        let boxes: Vec<OrientedBox> = ctx.ego().boxes().get(..step)?.iter().map_while(|area| *area).collect();
        let (ego, adversary) = (boxes.get(step - 1)?, &plan.boxes()[step - 1]);
        let heading = |area: &OrientedBox| area.axis[1].atan2(area.axis[0]);
        let before = boxes
            .len()
            .checked_sub(2)
            .map_or(ctx.scene().ego().point(sage_core::motion::NOW), |k| boxes[k].center);
        let index = ctx.index();
        Some(Self {
            collision: CollisionType::between(&boxes, &plan.boxes()[..boxes.len()])?,
            relative_heading: wrap_angle(heading(adversary) - heading(ego)),
            relative_speed: met.impact_speed,
            ego_speed: sage_core::geometry::distance(before, ego.center) / DT,
            ego: Manoeuvre::of(&boxes, index),
            adversary: Manoeuvre::of(&plan.boxes()[..step], index),
            person: Person::of(&ctx.adversary().kind),
            road: RoadKind::at(ego.center, index),
            latest_start,
        })
    }

    /// Gower's distance: the mean of the differences of seven features, each from 0 to 1. Kinds differ by 1; headings by
    /// their share of 180°, relative speeds by their share of 10 m/s, latest starts by their share of 2 s.
    pub fn distance(&self, other: &Self) -> f64 {
        let differs = |is: bool| f64::from(u8::from(is));
        let time = |features: &Self| features.latest_start.unwrap_or(0.0);
        let parts = [
            differs(self.collision != other.collision),
            differs(self.ego != other.ego),
            differs(self.adversary != other.adversary),
            differs(self.road != other.road),
            wrap_angle(self.relative_heading - other.relative_heading).abs() / PI,
            ((self.relative_speed - other.relative_speed).abs() / FULL_SPEED).min(1.0),
            ((time(self) - time(other)).abs() / FULL_TIME).min(1.0),
        ];
        parts.iter().sum::<f64>() / parts.len() as f64
    }

    /// Name of its cluster: type of the collision or kind of person, what the ego does, and its speed.
    pub fn cluster(&self) -> String {
        let band = (self.ego_speed / BAND).floor().clamp(0.0, BANDS as f64);
        let low = band * BAND;
        let speed = if band < BANDS as f64 {
            format!("{low:.0} to {:.0} m/s", low + BAND)
        } else {
            format!("over {low:.0} m/s")
        };
        let what = self.person.map_or(self.collision.name(), Person::name);
        format!("{what}, ego {}, {speed}", self.ego.words())
    }
}

/// A diverse choice of at most `count`: the one with the number `first`, then always the one that is farthest from all that
/// are chosen (farthest-first traversal, Gonzalez 1985); the first of equals. In their order.
pub fn diverse(all: &[Features], first: usize, count: usize) -> Vec<usize> {
    let mut chosen = Vec::new();
    let mut nearest = vec![f64::INFINITY; all.len()];
    let mut next = (first < all.len()).then_some(first);
    while let Some(one) = next.filter(|_| chosen.len() < count) {
        chosen.push(one);
        for (k, nearest) in nearest.iter_mut().enumerate() {
            *nearest = nearest.min(all[k].distance(&all[one]));
        }
        // What is chosen is not chosen again, however near the others are.
        nearest[one] = f64::NEG_INFINITY;
        let is_open = |k: &usize| nearest[*k] > f64::NEG_INFINITY;
        next = (0..all.len()).filter(is_open).reduce(|a, b| if nearest[b] > nearest[a] { b } else { a });
    }
    chosen.sort_unstable();
    chosen
}

/// How failures spread over clusters.
///
/// ```
/// use sage_sim::search::features::Spread;
///
/// let spread = Spread::of(["rear-end", "cut-in", "rear-end", "cut-in"]);
/// // Two clusters of the same size: one bit. Equal ones are in the order of their names.
/// assert_eq!(spread.entropy(), 1.0);
/// assert_eq!(spread.largest().next(), Some(("cut-in", 2)));
/// ```
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Number of failures in each cluster, by its name.
    pub clusters: BTreeMap<String, usize>,
}

impl Spread {
    /// The spread of some failures, by the names of their clusters.
    pub fn of(names: impl IntoIterator<Item = impl Into<String>>) -> Self {
        let mut spread = Self::default();
        for name in names {
            *spread.clusters.entry(name.into()).or_default() += 1;
        }
        spread
    }

    /// Clusters with their numbers of failures, the largest first, equal ones by name.
    pub fn largest(&self) -> impl Iterator<Item = (&str, usize)> {
        let mut all: Vec<(&str, usize)> =
            self.clusters.iter().map(|(name, count)| (&**name, *count)).collect();
        all.sort_by_key(|(_, count)| std::cmp::Reverse(*count));
        all.into_iter()
    }

    /// Shannon entropy of the clusters, bits: 0 if all failures are in one, log₂ n if they are evenly in n.
    pub fn entropy(&self) -> f64 {
        let total: usize = self.clusters.values().sum();
        let of = |count: &usize| {
            let share = *count as f64 / total.max(1) as f64;
            -share * share.log2()
        };
        // An empty sum is -0.
        self.clusters.values().map(of).sum::<f64>().max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn features(collision: CollisionType, ego_speed: f64) -> Features {
        Features {
            collision,
            relative_heading: 0.0,
            relative_speed: 4.0,
            ego_speed,
            ego: Manoeuvre::DrivesOn,
            adversary: Manoeuvre::MovesLeft,
            person: None,
            road: RoadKind::Road,
            latest_start: Some(1.0),
        }
    }

    #[test]
    fn the_distance_is_a_mean_of_shares() {
        let a = features(CollisionType::CutIn, 8.0);
        assert_eq!(a.distance(&a), 0.0);
        let b = Features { relative_heading: PI, relative_speed: 9.0, latest_start: None, ..a };
        assert!((a.distance(&b) - (1.0 + 0.5 + 0.5) / 7.0).abs() < 1e-12);
        assert_eq!(a.distance(&b), b.distance(&a));
        let far = Features {
            collision: CollisionType::Oncoming,
            ego: Manoeuvre::Brakes,
            adversary: Manoeuvre::Brakes,
            road: RoadKind::Junction,
            relative_heading: PI,
            relative_speed: 99.0,
            latest_start: Some(9.0),
            ..a
        };
        assert!((a.distance(&far) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn clusters_are_named_by_a_fixed_rule() {
        let name = |speed: f64| features(CollisionType::CutIn, speed).cluster();
        assert_eq!(name(0.0), "cut-in, ego drives on, 0 to 5 m/s");
        assert_eq!(name(5.0), "cut-in, ego drives on, 5 to 10 m/s");
        assert_eq!(name(14.99), "cut-in, ego drives on, 10 to 15 m/s");
        assert_eq!(name(40.0), "cut-in, ego drives on, over 15 m/s");
    }

    #[test]
    fn a_diverse_choice_takes_each_kind_before_it_repeats_one() {
        use CollisionType::*;
        let kinds = [CutIn, CutIn, CutIn, Oncoming, CutIn, Crossing];
        let all = kinds.map(|kind| features(kind, 8.0));
        assert_eq!(diverse(&all, 1, 3), [1, 3, 5]);
        assert_eq!(diverse(&all, 1, 4), [0, 1, 3, 5], "the first of equals");
        assert_eq!(diverse(&all, 0, 99), [0, 1, 2, 3, 4, 5]);
        assert!(diverse(&all, 0, 0).is_empty() && diverse(&[], 0, 3).is_empty());
    }

    #[test]
    fn entropy_is_that_of_the_clusters() {
        let spread = Spread::of(["a", "b", "a", "b", "c", "c", "d", "d"]);
        assert_eq!(spread.clusters.len(), 4);
        assert!((spread.entropy() - 2.0).abs() < 1e-12);
        assert_eq!(Spread::of(["a", "a"]).entropy(), 0.0);
        assert!(Spread::default().entropy().is_sign_positive());
    }
}
