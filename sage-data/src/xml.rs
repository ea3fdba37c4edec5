//! Writer of XML text: elements with attributes, one line an element, without indentation.

mod number;

pub(crate) use number::rounded;
use sage_core::text::{is_hidden, push_markup};

/// First line of every file.
const DECLARATION: &str = "<?xml version=\"1.0\" encoding=\"UTF-8\"?>";

/// XML text under construction. Attributes of an element come before its children.
pub(crate) struct Xml {
    text: String,
    /// Whether the start tag of the current element can still take attributes.
    takes_attributes: bool,
}

impl Xml {
    /// A file with room for this number of bytes.
    pub(crate) fn with_capacity(bytes: usize) -> Self {
        let mut text = String::with_capacity(bytes);
        text.push_str(DECLARATION);
        Self { text, takes_attributes: false }
    }

    /// The whole text.
    pub(crate) fn finish(mut self) -> String {
        self.text.push('\n');
        self.text
    }

    /// An element; `content` writes its attributes, then its children.
    pub(crate) fn element<R>(&mut self, tag: &'static str, content: impl FnOnce(&mut Self) -> R) -> R {
        self.close_start_tag();
        self.text.push_str("\n<");
        self.text.push_str(tag);
        self.takes_attributes = true;
        let result = content(self);
        if self.takes_attributes {
            self.text.push_str("/>");
            self.takes_attributes = false;
        } else {
            self.text.push_str("</");
            self.text.push_str(tag);
            self.text.push('>');
        }
        result
    }

    /// Elements without attributes, each the only child of the one before; `content` is that of the last.
    pub(crate) fn nested<R>(
        &mut self,
        tags: &[&'static str],
        content: impl FnOnce(&mut Self) -> R,
    ) -> Option<R> {
        let (first, rest) = tags.split_first()?;
        match rest {
            [] => Some(self.element(first, content)),
            _ => self.element(first, |xml| xml.nested(rest, content)),
        }
    }

    /// A text attribute.
    pub(crate) fn text(&mut self, name: &'static str, value: &str) -> &mut Self {
        self.begin_attribute(name);
        push_escaped(&mut self.text, value);
        self.text.push('"');
        self
    }

    /// An integer attribute.
    pub(crate) fn integer(&mut self, name: &'static str, value: i64) -> &mut Self {
        self.begin_attribute(name);
        number::push_integer(&mut self.text, value);
        self.text.push('"');
        self
    }

    /// A number as an attribute, with at most this number of decimals (0 to 12).
    pub(crate) fn number(&mut self, name: &'static str, value: f64, decimals: usize) -> &mut Self {
        self.begin_attribute(name);
        number::push(&mut self.text, value, decimals);
        self.text.push('"');
        self
    }

    /// Text between the tags of the current element.
    pub(crate) fn content(&mut self, text: &str) {
        self.close_start_tag();
        push_escaped(&mut self.text, text);
    }

    fn begin_attribute(&mut self, name: &'static str) {
        debug_assert!(self.takes_attributes, "attribute `{name}` after a child");
        self.text.push(' ');
        self.text.push_str(name);
        self.text.push_str("=\"");
    }

    fn close_start_tag(&mut self) {
        if self.takes_attributes {
            self.text.push('>');
            self.takes_attributes = false;
        }
    }
}

/// Number as text with at most this number of decimals (0 to 12).
pub(crate) fn number_text(value: f64, decimals: usize) -> String {
    let mut text = String::new();
    number::push(&mut text, value, decimals);
    text
}

/// Appends text for an attribute or an element. Characters that XML 1.0 cannot hold, or that are not seen, become
/// U+FFFD.
fn push_escaped(out: &mut String, text: &str) {
    for c in text.chars() {
        match c {
            // As references, because readers turn these characters into spaces in attributes.
            '\t' => out.push_str("&#9;"),
            '\n' => out.push_str("&#10;"),
            '\r' => out.push_str("&#13;"),
            c if is_hidden(c) => out.push('\u{fffd}'),
            _ => push_markup(out, c),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn elements_close_in_order_and_texts_are_escaped() {
        let mut xml = Xml::with_capacity(0);
        xml.element("A", |xml| {
            xml.text("name", "<&\"\u{1}\n>").integer("id", -3).number("x", 0.25, 6);
            xml.nested(&["B", "C"], |xml| xml.content("1 < 2"));
            xml.element("D", |_| {});
        });
        let body = "\n<A name=\"&lt;&amp;&quot;\u{fffd}&#10;&gt;\" id=\"-3\" x=\"0.25\">\
                    \n<B>\n<C>1 &lt; 2</C></B>\n<D/></A>\n";
        assert_eq!(xml.finish(), format!("{DECLARATION}{body}"));
    }
}
