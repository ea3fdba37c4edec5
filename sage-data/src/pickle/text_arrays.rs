//! Arrays of texts, such as numpy makes of a list of names: they are read as lists.

use super::{
    Array, Dtype, ElementKind, Id, Node, PickleProblem as Problem,
    machine::{Machine, kind},
};

impl Machine {
    /// An array, or the list of the texts of one. Axes but the first are not for texts.
    pub(super) fn array_or_texts(&mut self, array: Array) -> Result<Node, Problem> {
        if !array.dtype.is_text() {
            return Ok(Node::Array(Box::new(array)));
        }
        if array.shape.len() != 1 {
            return Err(Problem::Kind {
                what: "an array of texts",
                found: "another number of axes",
                expected: "one axis",
            });
        }
        let (start, size) = (array.data.start as usize, usize::from(array.dtype.size));
        let mut items = Vec::with_capacity(array.shape[0] as usize);
        for k in 0..array.shape[0] as usize {
            let bytes = self.document[start + k * size..start + (k + 1) * size].to_vec();
            let node = self.text_element(array.dtype, &bytes)?;
            if self.nodes.len() >= self.limit {
                return Err(Problem::TooMuch(self.limit));
            }
            items.push(Id(self.nodes.len() as u32));
            self.nodes.push(node);
        }
        Ok(Node::List(items))
    }

    /// A text of numpy: four bytes a character, or one a byte, and zeros behind it.
    pub(super) fn text_element(&mut self, dtype: Dtype, bytes: &[u8]) -> Result<Node, Problem> {
        if dtype.kind == ElementKind::Bytes {
            let length = bytes.iter().rposition(|byte| *byte != 0).map_or(0, |last| last + 1);
            self.pay(length)?;
            return Ok(Node::Bytes(self.append(&bytes[..length])));
        }
        let characters = bytes.as_chunks::<4>().0.iter().map(|raw| match dtype.big_endian {
            true => u32::from_be_bytes(*raw),
            false => u32::from_le_bytes(*raw),
        });
        let text: Option<String> = characters.map(char::from_u32).collect();
        let text = text.ok_or(Problem::Text)?;
        let text = text.trim_end_matches('\0');
        self.pay(text.len())?;
        Ok(Node::Str(self.append(text.as_bytes())))
    }

    /// Whether the size and alignment in the state of a numpy type are those of its texts.
    pub(super) fn is_state_of_texts(&self, dtype: Dtype, size: Id, alignment: Id) -> bool {
        let unit = if dtype.kind == ElementKind::Bytes { 1 } else { 4 };
        self.is_int(size, i64::from(dtype.size)) && self.is_int(alignment, unit)
    }

    /// A text that stands for itself.
    ///
    /// *Errors*: it is of another length than its type says.
    pub(super) fn text_scalar(&mut self, dtype: Dtype, data: super::Span) -> Result<Node, Problem> {
        if data.len != u32::from(dtype.size) {
            return Err(kind(
                "the data of a numpy text",
                &Node::Bytes(data),
                "as many bytes as its type says",
            ));
        }
        let bytes = self.slice(data).to_vec();
        self.text_element(dtype, &bytes)
    }
}
