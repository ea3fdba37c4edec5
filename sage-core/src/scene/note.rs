//! What a reader of a scene mended, left out or noticed. Prose stands at the edge: in files, messages and pages.

use std::fmt;

/// A note on a scene.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Note {
    /// Something was mended, which changes what is computed from the scene.
    Repair(Repair, String),
    /// A track cannot be used, and was left out.
    TrackLeftOut {
        /// Its id.
        track: String,
        /// Why, and what was left out.
        text: String,
    },
    /// The track that the data set was recorded for.
    Focal(String),
    /// How the scene was derived from its source, as JSON.
    Provenance(String),
    /// Standing road users are held through gaps.
    HeldInGap(String),
    /// Length and width of a vehicle were swapped in the file.
    SwappedSizes(String),
    /// Links between lanes are derived, because the map has none.
    DerivedLinks(String),
    /// Anything else that a reader noticed.
    Other(String),
}

/// A kind of notes that change what is computed from a scene. In files such a note begins with its name and a colon, and
/// `inspect` counts it as a warning.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Repair {
    /// Times at another rate than 10 Hz, or in another unit.
    FrameRate,
    /// A track that cannot be used.
    TrackLeftOut,
    /// A traffic light that cannot be used.
    LightLeftOut,
    /// A road user without a size.
    NoSize,
    /// A second recording of the ego.
    EgoCopy,
    /// Velocities and headings of the positions, as asked for.
    TrustPositions,
    /// Values of the map that cannot be used.
    MapValues,
    /// A record without an id: the name that it is given decides its seeds.
    NoId,
    /// The road user that the file names as the adversary is passed over.
    NamedAdversary,
}

impl Repair {
    /// All kinds.
    pub const ALL: [Self; 9] = [
        Self::FrameRate,
        Self::TrackLeftOut,
        Self::LightLeftOut,
        Self::NoSize,
        Self::EgoCopy,
        Self::TrustPositions,
        Self::MapValues,
        Self::NoId,
        Self::NamedAdversary,
    ];

    /// Its name in notes and warnings.
    pub fn name(self) -> &'static str {
        match self {
            Self::FrameRate => "frame-rate",
            Self::TrackLeftOut => "track-left-out",
            Self::LightLeftOut => "light-left-out",
            Self::NoSize => "no-size",
            Self::EgoCopy => "ego-copy",
            Self::TrustPositions => "trust-positions",
            Self::MapValues => "map-values",
            Self::NoId => "no-id",
            Self::NamedAdversary => "named-adversary",
        }
    }

    /// A note of this kind.
    pub fn note(self, text: impl Into<String>) -> Note {
        Note::Repair(self, text.into())
    }
}

/// Metadata key of a written file for the provenance: how the scene was derived from its source.
pub const PROVENANCE: &str = "sage_provenance";
/// How notes begin, or what they hold, that are no repairs.
const FOCAL: &str = "the data set was recorded for the track ";
const HELD: &str = "held-in-gap: ";
const SWAPPED: &str = "length and width were swapped in the file";
const NO_LINKS: &str = "the map has no links between lanes";

impl Note {
    /// A track that is left out, because a value of it is unusable.
    pub fn track_left_out(track: &str, why: &str) -> Self {
        Self::TrackLeftOut { track: track.to_owned(), text: format!("track `{track}` is left out: {why}") }
    }

    /// A track whose length and width were swapped.
    pub fn swapped_sizes(track: &str) -> Self {
        Self::SwappedSizes(format!("track `{track}`: {SWAPPED}; swapped back"))
    }

    /// A number of links that are derived; `how` says from what.
    pub fn derived_links(count: usize, how: &str) -> Self {
        let words = if count == 1 { "1 link is" } else { &format!("{count} links are") };
        Self::DerivedLinks(format!("{NO_LINKS}; {words} derived {how}"))
    }

    /// What was mended, if anything was.
    pub fn repair(&self) -> Option<Repair> {
        match self {
            Self::Repair(kind, _) => Some(*kind),
            Self::TrackLeftOut { .. } => Some(Repair::TrackLeftOut),
            _ => None,
        }
    }

    /// What it says, without its kind.
    pub fn text(&self) -> &str {
        match self {
            Self::Repair(_, text)
            | Self::TrackLeftOut { text, .. }
            | Self::Focal(text)
            | Self::Provenance(text)
            | Self::HeldInGap(text)
            | Self::SwappedSizes(text)
            | Self::DerivedLinks(text)
            | Self::Other(text) => text,
        }
    }

    /// The note of a text, as files hold it.
    pub fn of_text(text: String) -> Self {
        let rest = |start: &str| text.strip_prefix(start).map(str::to_owned);
        for kind in Repair::ALL {
            let Some(rest) = text.strip_prefix(kind.name()).and_then(|rest| rest.strip_prefix(": ")) else {
                continue;
            };
            let track = rest.strip_prefix("track `").and_then(|rest| rest.split_once("` is left out: "));
            return match track.filter(|_| kind == Repair::TrackLeftOut) {
                Some((track, _)) => Self::TrackLeftOut { track: track.to_owned(), text: rest.to_owned() },
                None => kind.note(rest),
            };
        }
        if let Some(id) = rest(FOCAL) {
            Self::Focal(id)
        } else if let Some(text) = rest(PROVENANCE) {
            Self::Provenance(text.trim_start_matches(": ").to_owned())
        } else if let Some(text) = rest(HELD) {
            Self::HeldInGap(text)
        } else if text.contains(SWAPPED) {
            Self::SwappedSizes(text)
        } else if text.starts_with(NO_LINKS) {
            Self::DerivedLinks(text)
        } else {
            Self::Other(text)
        }
    }
}

impl fmt::Display for Note {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        match self {
            Self::Focal(_) => f.write_str(FOCAL)?,
            Self::Provenance(_) => write!(f, "{PROVENANCE}: ")?,
            Self::HeldInGap(_) => f.write_str(HELD)?,
            _ => {}
        }
        if let Some(kind) = self.repair() {
            write!(f, "{}: ", kind.name())?;
        }
        f.write_str(self.text())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_note_is_read_from_the_text_that_it_is_written_as() {
        let notes = [
            Repair::NoSize.note("1 track of type X"),
            Note::track_left_out("7`, é", "`position` is nan; expected a number"),
            Repair::TrackLeftOut.note("3 more tracks are left out, because a value of theirs is unusable"),
            Note::Focal("12".into()),
            Note::Provenance("{\"by\": \"sage\"}".into()),
            Note::HeldInGap("1 road user".into()),
            Note::swapped_sizes("5"),
            Note::derived_links(1, "from ends"),
            Note::Other("map points have two columns".into()),
        ];
        for note in notes {
            assert_eq!(Note::of_text(note.to_string()), note);
        }
        assert_eq!(Note::track_left_out("7", "x").to_string(), "track-left-out: track `7` is left out: x");
    }
}
