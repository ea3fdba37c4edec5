//! Conventions of the formulas: the paper's text or the published code.
//!
//! Both share one set of files. They differ in kinematics, mirrored boxes and a few constants; the switch is in
//! [`super::Context`].

/// An interpretation of the paper's formulas.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Convention {
    /// The formulas as written, made well posed: boxes with the correct orientation, headings by
    /// differences and held while standing, steps counted from 1.
    #[default]
    Paper,
    /// What the published code computes, to reproduce its figures: mirrored boxes against the map, smoothed
    /// headings, central differences, steps counted from 0, at most 126 other agents.
    Release,
}

impl Convention {
    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Paper => "paper",
            Self::Release => "release",
        }
    }
}
