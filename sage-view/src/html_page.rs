//! Self-contained HTML pages: a template with its style, script, title and data.

mod glossary;

use sage_core::text::escaped_html;
use serde::{Serialize, ser::Error as _};
use serde_json::{Result, Value};

/// What pages begin with: no page loads anything from elsewhere.
const HEAD: &str = include_str!("html_page/head.html");
/// What they end with: data and script.
const TAIL: &str = include_str!("html_page/tail.html");

/// Data as JSON for a script element.
///
/// *Errors*: data that JSON cannot hold.
pub fn embedded(data: &impl Serialize) -> Result<String> {
    // Within a script element only `<` could end the data.
    Ok(serde_json::to_string(data)?.replace('<', "\\u003c"))
}

/// The parts of a page: its body, and what takes the places of `{{STYLE}}`, `{{SCRIPT}}`, `{{TITLE}}` and `{{DATA}}` in it.
#[derive(Clone, Copy, Debug)]
pub struct PageParts<'a> {
    /// HTML.
    pub body: &'a str,
    /// CSS.
    pub style: &'a str,
    /// JavaScript.
    pub script: &'a str,
    /// Plain text.
    pub title: &'a str,
    /// JSON, from [`embedded`].
    pub data: &'a str,
}

/// The page of its parts, with the glossary in place of `{{WORDS}}`.
///
/// *Errors*: a body without the places for title and data.
///
/// ```
/// use sage_view::html_page::{PageParts, assembled, data_of, embedded};
///
/// let data = embedded(&["</script>", "é"])?;
/// let body = r#"<main><h1>{{TITLE}}</h1></main>"#;
/// let page = assembled(PageParts { body, style: "", script: "", title: "a < b", data: &data })?;
/// // Data of strangers end no script, and are read again as they were.
/// assert_eq!(data_of(&page), Some(serde_json::json!(["</script>", "é"])));
/// # Ok::<(), serde_json::Error>(())
/// ```
pub fn assembled(PageParts { body, style, script, title, data }: PageParts) -> Result<String> {
    let title = escaped_html(title);
    // The data come last: a title may hold the name of another part.
    let page = [HEAD, body, TAIL].concat().replace("{{WORDS}}", &glossary::html());
    let page = page.replace("{{STYLE}}", style).replace("{{SCRIPT}}", script);
    let parts = page.split_once("{{TITLE}}").and_then(|(head, rest)| {
        let (middle, tail) = rest.split_once("{{DATA}}")?;
        Some([head, &title, middle, data, tail].concat())
    });
    parts.ok_or_else(|| serde_json::Error::custom("the page has no place for its title or data"))
}

/// The data of a page that [`assembled`] made; `None` if there are none.
pub fn data_of(page: &str) -> Option<Value> {
    let (_, data) = page.split_once("type=\"application/json\">")?;
    serde_json::from_str(data.split_once("</script>")?.0).ok()
}

/// A file name as a link.
pub fn link(name: &str) -> String {
    let mut out = String::new();
    for byte in name.bytes() {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'.' | b'_' | b'-' => out.push(char::from(byte)),
            _ => out += &format!("%{byte:02X}"),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn links_hold_no_character_with_a_meaning() {
        assert_eq!(link("a b#?<é.html"), "a%20b%23%3F%3C%C3%A9.html");
    }

    #[test]
    fn titles_and_data_end_no_element_and_name_no_part() {
        let body = "<body><main></main>\n";
        let data = embedded(&"</script>{{SCRIPT}}").unwrap();
        let parts = PageParts { body, style: "s", script: "j", title: "<b>{{DATA}}", data: &data };
        let page = assembled(parts).unwrap();
        assert!(page.contains("<title>&lt;b&gt;{{DATA}}</title>") && page.contains("<style>\ns\n</style>"));
        assert!(
            page.contains("json\">\"\\u003c/script>{{SCRIPT}}\"</script>\n<script>\nj\n</script>"),
            "{page}"
        );
    }
}
