//! A small XML reader for tests: elements, attributes and text; no comments, no namespaces.

/// An element.
#[derive(Clone, Debug, Default)]
pub struct Element {
    pub tag: String,
    pub attributes: Vec<(String, String)>,
    pub children: Vec<Self>,
    pub text: String,
}

impl Element {
    /// The root of a file.
    pub fn parse(text: &str) -> Result<Self, String> {
        let body = text
            .strip_prefix("<?xml version=\"1.0\" encoding=\"UTF-8\"?>")
            .ok_or("the declaration is missing")?;
        if let Some(c) =
            body.chars().find(|c| (*c < ' ' && !"\t\n\r".contains(*c)) || "\u{fffe}\u{ffff}".contains(*c))
        {
            return Err(format!("character {c:?}"));
        }
        let mut reader = Reader { rest: body.trim() };
        let root = reader.element()?;
        if reader.rest.is_empty() { Ok(root) } else { Err("text after the root".to_owned()) }
    }

    pub fn get(&self, name: &str) -> Option<&str> {
        self.attributes.iter().find(|(key, _)| key == name).map(|(_, value)| value.as_str())
    }

    /// An attribute that must be there.
    pub fn at(&self, name: &str) -> &str {
        self.get(name).unwrap_or_else(|| panic!("{} has no {name}: {:?}", self.tag, self.attributes))
    }

    /// An attribute that must be a number without an exponent.
    pub fn number(&self, name: &str) -> f64 {
        let text = self.at(name);
        assert!(text != "-0" && !text.contains(['e', 'E', 'N', 'n']), "{name}={text}");
        text.parse().unwrap_or_else(|_| panic!("{name}={text}"))
    }

    pub fn all<'e>(&'e self, tag: &'e str) -> impl Iterator<Item = &'e Self> {
        self.children.iter().filter(move |child| child.tag == tag)
    }

    pub fn child(&self, tag: &str) -> Option<&Self> {
        self.children.iter().find(|child| child.tag == tag)
    }

    /// The element at the end of a path of tags, first children each.
    pub fn find(&self, path: &[&str]) -> Option<&Self> {
        path.iter().try_fold(self, |element, tag| element.child(tag))
    }

    /// This element and all below it.
    pub fn walk(&self) -> Vec<&Self> {
        let mut all = vec![self];
        let mut next = 0;
        while next < all.len() {
            all.extend(&all[next].children);
            next += 1;
        }
        all
    }
}

struct Reader<'t> {
    rest: &'t str,
}

impl<'t> Reader<'t> {
    fn take(&mut self, prefix: &str) -> bool {
        let found = self.rest.strip_prefix(prefix);
        self.rest = found.unwrap_or(self.rest);
        found.is_some()
    }

    fn expect(&mut self, prefix: &str) -> Result<(), String> {
        let here: String = self.rest.chars().take(40).collect();
        if self.take(prefix) { Ok(()) } else { Err(format!("expected {prefix:?} at {here:?}")) }
    }

    fn word(&mut self) -> Result<&'t str, String> {
        let end = self.rest.find(|c: char| !c.is_ascii_alphanumeric()).ok_or("unexpected end")?;
        let (word, rest) = self.rest.split_at(end);
        self.rest = rest;
        if word.is_empty() { Err(format!("no name at {:?}", &rest[..rest.len().min(20)])) } else { Ok(word) }
    }

    fn until(&mut self, end: char) -> Result<&'t str, String> {
        let (text, rest) = self.rest.split_once(end).ok_or("unexpected end")?;
        self.rest = rest;
        Ok(text)
    }

    fn element(&mut self) -> Result<Element, String> {
        self.expect("<")?;
        let mut element = Element { tag: self.word()?.to_owned(), ..Element::default() };
        loop {
            self.rest = self.rest.trim_start();
            if self.take("/>") {
                return Ok(element);
            }
            if self.take(">") {
                break;
            }
            let name = self.word()?.to_owned();
            self.expect("=\"")?;
            let value = decode(self.until('"')?)?;
            if element.get(&name).is_some() {
                return Err(format!("{name} twice"));
            }
            element.attributes.push((name, value));
        }
        loop {
            let end = self.rest.find('<').ok_or("unexpected end")?;
            let (text, rest) = self.rest.split_at(end);
            element.text.push_str(decode(text)?.trim());
            self.rest = rest;
            if self.take("</") {
                let tag = element.tag.clone();
                self.expect(&tag)?;
                self.expect(">")?;
                return Ok(element);
            }
            element.children.push(self.element()?);
        }
    }
}

/// The text that an escaped text stands for.
fn decode(text: &str) -> Result<String, String> {
    if text.contains('<') {
        return Err(format!("`<` in {text:?}"));
    }
    let mut out = String::new();
    let mut parts = text.split('&');
    out.push_str(parts.next().unwrap_or_default());
    for part in parts {
        let (name, rest) = part.split_once(';').ok_or_else(|| format!("bare `&` in {text:?}"))?;
        out.push(match name {
            "amp" => '&',
            "lt" => '<',
            "gt" => '>',
            "quot" => '"',
            "#9" => '\t',
            "#10" => '\n',
            "#13" => '\r',
            _ => return Err(format!("entity {name}")),
        });
        out.push_str(rest);
    }
    Ok(out)
}
