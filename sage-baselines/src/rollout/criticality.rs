//! What a roll-out says of how critical a vehicle was for the ego. Source: SEAL (Stoler et al., 2025).

use sage_core::geometry::{Point, distance};

use super::{Rollout, RolloutEnd};

/// Distance that the scores are relative to, metres.
pub const DISTANCE_SCALE: f64 = 8.0;

/// Scores of a vehicle in [0, 1]; more is more critical.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Targets {
    /// 1 if the ego had a contact (with this vehicle, unless it is the adversary), else `exp(−d/8)` of the least distance d
    /// of the centres; 0 if they were never there at once.
    pub collision: f64,
    /// `1 − exp(−s/8)` of the sum s of the distances, over the common frames, to the path without the adversary.
    pub difference: f64,
}

/// Scores of a vehicle of a roll-out: of the adversary, for which the ego's path counts, or of another vehicle, for which
/// its own path counts. `None` for another vehicle that is absent from either drive.
pub fn targets(
    attacked: &Rollout,
    unattacked: &Rollout,
    ego: usize,
    track: usize,
    is_adversary: bool,
) -> Option<Targets> {
    let has_contact = attacked.end == RolloutEnd::Contact;
    let is_touched = has_contact && (is_adversary || attacked.touched.contains(&track));
    let moved = if is_adversary { ego } else { track };
    let difference = difference(attacked.path(moved), unattacked.path(moved))?;
    let collision = if is_touched { 1.0 } else { closeness(attacked.path(ego), attacked.path(track)) };
    Some(Targets { collision, difference })
}

/// `exp(−d/8)` of the least distance at a common frame; 0 without one.
fn closeness(ego: impl Iterator<Item = Option<Point>>, other: impl Iterator<Item = Option<Point>>) -> f64 {
    let least = common(ego, other).min_by(f64::total_cmp);
    least.map_or(0.0, |d| (-d / DISTANCE_SCALE).exp().min(1.0))
}

/// `1 − exp(−s/8)` of the summed distance over the common frames; `None` without one.
fn difference(a: impl Iterator<Item = Option<Point>>, b: impl Iterator<Item = Option<Point>>) -> Option<f64> {
    let distances: Vec<f64> = common(a, b).collect();
    (!distances.is_empty()).then(|| 1.0 - (-distances.iter().sum::<f64>() / DISTANCE_SCALE).exp())
}

fn common(
    a: impl Iterator<Item = Option<Point>>,
    b: impl Iterator<Item = Option<Point>>,
) -> impl Iterator<Item = f64> {
    a.zip(b).filter_map(|(a, b)| Some(distance(a?, b?)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use sage_core::motion::Pose;

    fn rollout(paths: &[&[Option<Point>]], touched: &[usize]) -> Rollout {
        let pose = |p: &Option<Point>| p.map(|[x, y]| Pose::new(x, y, 0.0));
        let end = if touched.is_empty() { RolloutEnd::Horizon } else { RolloutEnd::Contact };
        Rollout {
            observations: Vec::new(),
            actions: Vec::new(),
            poses: paths.iter().map(|path| path.iter().map(pose).collect()).collect(),
            touched: touched.to_vec(),
            end,
        }
    }

    fn line(y: f64) -> Vec<Option<Point>> {
        (0..6).map(|k| Some([f64::from(k), y])).collect()
    }

    #[test]
    fn worked_cases_have_the_scores_of_the_formulas() {
        let before = rollout(&[&line(0.0), &line(9.0), &line(30.0)], &[]);
        // Two metres apart: exp(−2/8); the ego is 0.5 m aside in each of the six common frames: 1 − exp(−3/8).
        let near = rollout(&[&line(0.5), &line(2.5), &line(30.0)], &[]);
        let found = targets(&near, &before, 0, 1, true).unwrap();
        assert!((found.collision - 0.778_800_783).abs() < 1e-9, "{found:?}");
        assert!((found.difference - 0.312_710_721).abs() < 1e-9, "{found:?}");
        // Ten metres in all: 1 − exp(−10/8) = 0.71, on a drive that ends earlier.
        let short: Vec<_> = (0..4).map(|k| Some([f64::from(k), 2.5])).collect();
        let hit = rollout(&[&short, &line(2.5), &line(30.0)], &[1]);
        let found = targets(&hit, &before, 0, 1, true).unwrap();
        assert_eq!(found.collision, 1.0);
        assert!((found.difference - 0.713_495_203).abs() < 1e-9, "{found:?}");
        // A contact with another vehicle counts for the adversary, and for that vehicle alone.
        let other = rollout(&[&line(0.0), &line(9.0), &line(30.0)], &[2]);
        assert_eq!(targets(&other, &before, 0, 1, true).unwrap().collision, 1.0);
        assert_eq!(
            targets(&other, &before, 0, 2, false).unwrap(),
            Targets { collision: 1.0, difference: 0.0 }
        );
        let untouched = targets(&other, &before, 0, 1, false).unwrap();
        assert!((untouched.collision - (-9.0f64 / 8.0).exp()).abs() < 1e-12);
        // An adversary that is never there has no closeness; another vehicle that is absent has no scores.
        let absent = rollout(&[&line(0.0), &[None; 6], &line(30.0)], &[]);
        assert_eq!(
            targets(&absent, &before, 0, 1, true).unwrap(),
            Targets { collision: 0.0, difference: 0.0 }
        );
        assert_eq!(targets(&absent, &before, 0, 1, false), None);
    }
}
