//! Groups of successive rows of a matrix.

use std::sync::Arc;

use candle_core::{Device, Result, Tensor};

/// Successive rows of a matrix that belong together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Group {
    /// First row.
    pub start: usize,
    /// One past the last seen row: the maxima of other rows include it.
    pub seen: usize,
    /// One past the last row. In [`super::max_of_others`], unseen rows (from `seen` on) get the maximum of the seen
    /// rows and are not part of it.
    pub end: usize,
}

/// The groups of a matrix, which cover its rows in order without a gap.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Groups(Arc<[Group]>);

impl Groups {
    /// Groups of the given lengths without unseen rows.
    pub fn of_lengths(lengths: impl IntoIterator<Item = usize>) -> Self {
        Self::with_unseen(lengths.into_iter().map(|n| (n, 0)))
    }

    /// Groups, each given by its number of seen rows and of unseen rows after them.
    pub fn with_unseen(lengths: impl IntoIterator<Item = (usize, usize)>) -> Self {
        let mut start = 0;
        let group = |(seen, unseen)| {
            let group = Group { start, seen: start + seen, end: start + seen + unseen };
            start = group.end;
            group
        };
        Self(lengths.into_iter().map(group).collect())
    }

    /// The first `most` groups.
    pub fn first(&self, most: usize) -> Self {
        Self(self.0[..most.min(self.len())].into())
    }

    /// The groups.
    pub fn as_slice(&self) -> &[Group] {
        &self.0
    }

    /// Number of groups.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Whether there is none.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// The number of its group for each row.
    ///
    /// *Shapes*: (rows).
    pub(super) fn of_rows(&self, device: &Device) -> Result<Tensor> {
        let numbers =
            self.0.iter().enumerate().flat_map(|(k, group)| vec![k as u32; group.end - group.start]);
        Tensor::from_iter(numbers, device)
    }

    /// Number of rows they cover.
    pub fn rows(&self) -> usize {
        self.0.last().map_or(0, |group| group.end)
    }
}
