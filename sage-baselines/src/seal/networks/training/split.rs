//! Split of examples into training and validation by group, so that they share no scene or roll-out.

use std::collections::BTreeSet;

use sage_backbones::Error;
use sage_core::seed::Rng;

/// Indices of examples in ascending order.
pub(super) struct Split {
    pub(super) training: Vec<usize>,
    pub(super) validation: Vec<usize>,
}

/// Splits examples by their groups. `share` of the groups, at least one, are for validation.
///
/// *Errors*: [`Error::NothingToTrain`] for fewer than two groups.
pub(super) fn split(groups: &[u32], share: f64, seed: u64, name: &str) -> Result<Split, Error> {
    let distinct: BTreeSet<u32> = groups.iter().copied().collect();
    let mut order: Vec<u32> = distinct.into_iter().collect();
    if order.len() < 2 {
        let problem = format!("{name}: examples of {} groups; training needs 2 or more", order.len());
        return Err(Error::NothingToTrain(problem));
    }
    Rng::new(seed, name, "split").shuffle(&mut order);
    let count = (share * order.len() as f64).round() as usize;
    let held: BTreeSet<u32> = order[..count.clamp(1, order.len() - 1)].iter().copied().collect();
    let (validation, training) = (0..groups.len()).partition(|index| held.contains(&groups[*index]));
    Ok(Split { training, validation })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_stay_together_and_their_share_is_met() {
        let groups: Vec<u32> = (0..200).map(|k| k % 20).collect();
        let Split { training, validation } = split(&groups, 0.15, 1, "test").unwrap();
        assert_eq!((training.len(), validation.len()), (170, 30));
        let of = |indices: &[usize]| indices.iter().map(|k| groups[*k]).collect::<BTreeSet<_>>();
        assert!(of(&training).is_disjoint(&of(&validation)));
        assert_eq!(split(&groups, 0.15, 1, "test").unwrap().validation, validation);
        assert_ne!(split(&groups, 0.15, 2, "test").unwrap().validation, validation);
        assert_eq!(split(&[4, 9], 0.01, 1, "test").unwrap().validation.len(), 1);
        assert!(split(&[4, 4], 0.5, 1, "test").is_err());
    }
}
