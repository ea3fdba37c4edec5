//! Output to a terminal. Names and texts from files must not control the terminal.

use std::{borrow::Cow, fmt::Write as _, io};

use serde::Serialize;

/// Escapes control characters and characters that change the text direction. Line ends stay.
pub(crate) fn escaped(text: &str) -> Cow<'_, str> {
    if !text.chars().any(|c| controls_terminal(c) && c != '\n') {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        if controls_terminal(c) && c != '\n' {
            let _ = write!(out, "{}", c.escape_unicode());
        } else {
            out.push(c);
        }
    }
    Cow::Owned(out)
}

/// As [`escaped`], for a name within a line: line ends are escaped as well.
pub(crate) fn escaped_name(text: &str) -> String {
    escaped(text).replace('\n', "\\n")
}

/// The text for an HTML page, without characters that control a terminal or a page.
pub(crate) fn escaped_html(text: &str) -> String {
    let text = escaped(text);
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// Writes a value as a line of JSON and escapes characters that control a terminal. A parser reads the same
/// value.
///
/// *Errors*: those of the output.
pub(crate) fn json_line(out: &mut impl io::Write, value: &impl Serialize) -> io::Result<()> {
    write_json_line(out, &serde_json::to_string(value)?)
}

/// As [`json_line`], for a value that is JSON already.
///
/// *Errors*: those of the output.
pub(crate) fn write_json_line(out: &mut impl io::Write, text: &str) -> io::Result<()> {
    if !text.chars().any(controls_terminal) {
        return writeln!(out, "{text}");
    }
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        // In JSON such characters occur only within strings, and all have four hexadecimal digits.
        if controls_terminal(c) {
            let _ = write!(escaped, "\\u{:04x}", u32::from(c));
        } else {
            escaped.push(c);
        }
    }
    writeln!(out, "{escaped}")
}

/// True for control characters, and for characters that change the direction of text.
fn controls_terminal(c: char) -> bool {
    c.is_control()
        || matches!(c, '\u{61c}' | '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn characters_that_control_a_terminal_are_escaped() {
        assert_eq!(escaped("plain é\n"), "plain é\n");
        assert_eq!(escaped("\u{1b}[2Ja\u{9b}b\u{202e}c\r"), "\\u{1b}[2Ja\\u{9b}b\\u{202e}c\\u{d}");
        assert_eq!(escaped_name("a\nb"), "a\\nb");
        assert_eq!(escaped_html("<b>\"&\u{202e}"), "&lt;b&gt;&quot;&amp;\\u{202e}");
    }

    #[test]
    fn json_keeps_its_value() {
        let text = "\u{1b}[2J\u{9b}\u{202e}é\u{7f}";
        let mut out = Vec::new();
        json_line(&mut out, &text).unwrap();
        let line = String::from_utf8(out).unwrap();
        assert!(!line.trim_end().chars().any(controls_terminal), "{line:?}");
        assert_eq!(serde_json::from_str::<String>(&line).unwrap(), text);
    }
}
