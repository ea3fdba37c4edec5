//! Output to a terminal. Names and texts from files must not control the terminal.

use std::{fmt::Write as _, io};

use sage_core::text::is_hidden;
pub use sage_core::text::{escaped, escaped_html, escaped_name};
use serde::Serialize;

/// Writes a value as a line of JSON and escapes characters that control a terminal. A parser reads the same
/// value.
///
/// *Errors*: those of the output.
///
/// ```
/// use sage_run::terminal::json_line;
///
/// // A name from a file that would clear the screen; parsers read the same name.
/// let mut line = Vec::new();
/// json_line(&mut line, &"a\u{9b}2J")?;
/// assert_eq!(line, b"\"a\\u009b2J\"\n");
/// # Ok::<(), std::io::Error>(())
/// ```
pub fn json_line(out: &mut impl io::Write, value: &impl Serialize) -> io::Result<()> {
    write_json_line(out, &serde_json::to_string(value)?)
}

/// As [`json_line`], for a value that is JSON already.
///
/// *Errors*: those of the output.
pub fn write_json_line(out: &mut impl io::Write, text: &str) -> io::Result<()> {
    if !text.chars().any(is_hidden) {
        return writeln!(out, "{text}");
    }
    let mut escaped = String::with_capacity(text.len());
    for c in text.chars() {
        // In JSON such characters occur only within strings.
        if is_hidden(c) {
            for unit in c.encode_utf16(&mut [0; 2]) {
                let _ = write!(escaped, "\\u{unit:04x}");
            }
        } else {
            escaped.push(c);
        }
    }
    writeln!(out, "{escaped}")
}

/// A text of a stranger within a line of a Markdown page: what would be markup, HTML or a new line is escaped.
pub fn escaped_markdown(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in escaped_name(text).chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '\\' | '`' | '*' | '_' | '[' | ']' | '|' | '!' | '#' | '~' => out.extend(['\\', c]),
            _ => out.push(c),
        }
    }
    out
}

/// A text of a stranger between backticks on a Markdown page, also in a table.
pub fn escaped_markdown_code(text: &str) -> String {
    escaped_name(text).replace('`', "'").replace('|', "\\u{7c}")
}

/// A line of a table that ends with a text: the text goes to a line of its own if both have no room in one.
pub fn with_remark(cells: &str, remark: &str) -> String {
    let is_long = cells.chars().count() + 2 + remark.chars().count() > sage_core::text::wrap::COLUMNS;
    let gap = if is_long { "\n    " } else { "  " };
    format!("{cells}{gap}{remark}").trim_end().to_owned()
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
        for hidden in ['\u{fffe}', '\u{1fffe}', '\u{200b}', '\u{2029}', '\u{2066}', '\u{feff}', '\u{e0041}'] {
            assert_eq!(escaped(&format!("a{hidden}b")), format!("a{}b", hidden.escape_unicode()));
        }
    }

    #[test]
    fn a_stranger_writes_no_markup() {
        let text = "MIT |\n\n# Install\n<script>![](http://x)`*_\u{1b}";
        let page = escaped_markdown(text);
        assert!(!page.contains(['\n', '<', '>', '\u{1b}']), "{page}");
        assert!(page.contains("\\|") && page.contains("\\!\\[\\]") && page.contains("\\`\\*\\_"), "{page}");
        assert!(!escaped_markdown_code(text).contains(['`', '|', '\n']));
        assert_eq!(escaped_markdown("MIT OR Apache-2.0 (2026)."), "MIT OR Apache-2.0 (2026).");
    }

    #[test]
    fn json_keeps_its_value() {
        let text = "\u{1b}[2J\u{9b}\u{202e}é\u{7f}\u{fffe}\u{e0041}";
        let mut out = Vec::new();
        json_line(&mut out, &text).unwrap();
        let line = String::from_utf8(out).unwrap();
        assert!(!line.trim_end().chars().any(is_hidden), "{line:?}");
        assert_eq!(serde_json::from_str::<String>(&line).unwrap(), text);
    }
}
