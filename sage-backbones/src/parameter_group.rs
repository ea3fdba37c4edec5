//! What each parameter of a network is for, and which training moves it.

/// What a parameter is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParameterGroup {
    /// Encoder and trajectory decoder. Pretraining moves it; fine-tuning does not.
    Prior,
    /// Scores of modes. Pretraining and fine-tuning move it.
    Scoring,
    /// The interaction head: zero in the prior; only fine-tuning moves it.
    Interaction,
    /// Read, but without effect on any result: its gradient is rounding.
    WithoutEffect,
    /// Present in files, read by nothing.
    Unused,
}

impl ParameterGroup {
    /// Whether pretraining moves it.
    pub fn is_pretrained(self) -> bool {
        matches!(self, Self::Prior | Self::Scoring)
    }

    /// Whether fine-tuning moves it.
    pub fn is_finetuned(self) -> bool {
        matches!(self, Self::Scoring | Self::Interaction)
    }
}
