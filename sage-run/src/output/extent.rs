//! Which part of a run a process does.

use sage_data::dataset::Shard;

/// The part of a run that a process does.
///
/// ```
/// use sage_data::dataset::Shard;
/// use sage_run::output::Extent;
///
/// // Two machines share the scenes; a third process joins what they did, and works on none.
/// let [first, second] = [1, 2].map(|number| Extent::of(Some(Shard { number, of: 2 })));
/// assert_ne!(first.holds("crossing"), second.holds("crossing"));
/// assert!(Extent::Whole.holds("crossing") && !Extent::Join.holds("crossing"));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Extent {
    /// All scenes, and the summary.
    Whole,
    /// The scenes of a shard, and their manifest.
    Shard(Shard),
    /// The summary alone: the command takes what became of the scenes from the manifests of shards and works on none. So it
    /// leaves the bytes of one run.
    Join,
}

impl Extent {
    /// The part that the option --shard names.
    pub fn of(shard: Option<Shard>) -> Self {
        shard.map_or(Self::Whole, Self::Shard)
    }

    /// True if a scene belongs to the part.
    pub fn holds(self, scene: &str) -> bool {
        match self {
            Self::Whole => true,
            Self::Shard(shard) => shard.holds(scene),
            Self::Join => false,
        }
    }
}
