//! Texts for people: characters in the words of strangers that must reach no terminal, page or drawing, and numbers with their nouns.

mod natural_order;
pub mod table;
pub mod wrap;

pub use natural_order::natural_order;

use std::{borrow::Cow, fmt::Write as _};

/// True for control characters, and for characters that change the direction of text, are not seen, or are none.
pub fn is_hidden(c: char) -> bool {
    let code = u32::from(c);
    c.is_control()
        || code & 0xfffe == 0xfffe
        || matches!(
            c,
            '\u{ad}' | '\u{61c}' | '\u{180e}' | '\u{200b}'..='\u{200f}' | '\u{2028}'..='\u{202e}'
                | '\u{2060}'..='\u{206f}' | '\u{fdd0}'..='\u{fdef}' | '\u{feff}' | '\u{fff9}'..='\u{fffb}'
                | '\u{e0000}'..='\u{e007f}'
        )
}

/// Escapes control characters, and characters that change the text direction or are not seen. Line ends stay.
pub fn escaped(text: &str) -> Cow<'_, str> {
    if !text.chars().any(|c| is_hidden(c) && c != '\n') {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        if is_hidden(c) && c != '\n' {
            let _ = write!(out, "{}", c.escape_unicode());
        } else {
            out.push(c);
        }
    }
    Cow::Owned(out)
}

/// As [`escaped`], for a name within a line: line ends are escaped as well.
pub fn escaped_name(text: &str) -> String {
    escaped(text).replace('\n', "\\n")
}

/// The text for an HTML page, without characters that control a terminal or a page.
pub fn escaped_html(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in escaped(text).chars() {
        push_markup(&mut out, c);
    }
    out
}

/// Appends a character to the text of an element or an attribute of HTML and XML, so that it is no markup.
pub fn push_markup(out: &mut String, c: char) {
    match c {
        '&' => out.push_str("&amp;"),
        '<' => out.push_str("&lt;"),
        '>' => out.push_str("&gt;"),
        '"' => out.push_str("&quot;"),
        c => out.push(c),
    }
}

/// A number with its noun: `1 scene`, `2 scenes`.
///
/// ```
/// use sage_core::text::{count, escaped_name, natural_order};
///
/// assert_eq!((count(1, "scene"), count(2, "search")), ("1 scene".to_owned(), "2 searches".to_owned()));
/// // A name from a file cannot clear the terminal or begin a new line.
/// assert_eq!(escaped_name("a\u{1b}[2J\nb"), "a\\u{1b}[2J\\nb");
/// // Numbers count by value.
/// let mut names = ["10.pkl", "9.pkl"];
/// names.sort_by(|a, b| natural_order(a, b));
/// assert_eq!(names, ["9.pkl", "10.pkl"]);
/// ```
pub fn count(number: usize, noun: &str) -> String {
    let ending = match number {
        1 => "",
        _ if noun.ends_with("rch") => "es",
        _ => "s",
    };
    format!("{number} {noun}{ending}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn letters_are_seen_and_marks_are_not() {
        assert!("aé漢ا😀 -_.".chars().all(|c| !is_hidden(c)));
        assert!(
            "\u{1b}\n\u{9b}\u{202e}\u{2066}\u{fffe}\u{1ffff}\u{200b}\u{feff}\u{e0041}".chars().all(is_hidden)
        );
    }
}
