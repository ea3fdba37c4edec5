//! Text for people at a terminal: names and texts from files must not steer it.

use std::{borrow::Cow, fmt::Write as _, io};

use serde::Serialize;

/// Text in which control characters and marks that reorder text are spelled out. Line ends stay.
pub(crate) fn harmless(text: &str) -> Cow<'_, str> {
    if !text.chars().any(|c| steers(c) && c != '\n') {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        if steers(c) && c != '\n' {
            let _ = write!(out, "{}", c.escape_unicode());
        } else {
            out.push(c);
        }
    }
    Cow::Owned(out)
}

/// [`harmless`] for a name within a line: line ends are spelled out as well.
pub(crate) fn harmless_name(text: &str) -> String {
    harmless(text).replace('\n', "\\n")
}

/// Writes a value as a line of JSON, in which nothing steers a terminal. Programs read the same value.
///
/// *Errors*: those of the output.
pub(crate) fn json_line(out: &mut impl io::Write, value: &impl Serialize) -> io::Result<()> {
    let text = serde_json::to_string(value)?;
    if !text.chars().any(steers) {
        return writeln!(out, "{text}");
    }
    let mut spelled = String::with_capacity(text.len());
    for c in text.chars() {
        // Such characters stand within strings alone, and all have four digits.
        if steers(c) {
            let _ = write!(spelled, "\\u{:04x}", u32::from(c));
        } else {
            spelled.push(c);
        }
    }
    writeln!(out, "{spelled}")
}

/// Control characters, and those that change the direction of the text around them.
fn steers(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_steers_a_terminal_is_spelled_out() {
        assert_eq!(harmless("plain é\n"), "plain é\n");
        assert_eq!(harmless("\u{1b}[2Ja\u{9b}b\u{202e}c\r"), "\\u{1b}[2Ja\\u{9b}b\\u{202e}c\\u{d}");
        assert_eq!(harmless_name("a\nb"), "a\\nb");
    }

    #[test]
    fn json_keeps_its_value() {
        let text = "\u{1b}[2J\u{9b}\u{202e}é\u{7f}";
        let mut out = Vec::new();
        json_line(&mut out, &text).unwrap();
        let line = String::from_utf8(out).unwrap();
        assert!(!line.trim_end().chars().any(steers), "{line:?}");
        assert_eq!(serde_json::from_str::<String>(&line).unwrap(), text);
    }
}
