//! Groups of a network's parameters, by function and by the training stage that changes them.

/// Group of a parameter.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParameterGroup {
    /// What experts share with their prior, such as encoder and trajectory decoder. Pretraining changes it; fine-tuning does not.
    Prior,
    /// Scores of modes, or what draws them. Pretraining and fine-tuning change it.
    Scoring,
    /// The interaction head. Its output is zero in the prior; only fine-tuning changes it.
    Interaction,
    /// Read, but without effect on any result: its gradient is a rounding error.
    WithoutEffect,
    /// Present in files, never read.
    Unused,
}

impl ParameterGroup {
    /// Whether pretraining changes parameters of this group.
    pub fn is_pretrained(self) -> bool {
        matches!(self, Self::Prior | Self::Scoring)
    }

    /// Whether fine-tuning changes parameters of this group.
    pub fn is_finetuned(self) -> bool {
        matches!(self, Self::Scoring | Self::Interaction)
    }
}
