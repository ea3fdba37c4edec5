//! Writes messages in the wire format of Protocol Buffers.

/// Bytes of a message.
#[derive(Default)]
pub(super) struct Writer(pub(super) Vec<u8>);

impl Writer {
    fn key(&mut self, number: u32, wire_type: u32) {
        self.varint(u64::from(number << 3 | wire_type));
    }

    fn varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.0.push(value as u8 | 0x80);
            value >>= 7;
        }
        self.0.push(value as u8);
    }

    pub(super) fn double(&mut self, number: u32, value: f64) {
        self.key(number, 1);
        self.0.extend(value.to_le_bytes());
    }

    pub(super) fn float(&mut self, number: u32, value: f64) {
        self.key(number, 5);
        self.0.extend((value as f32).to_le_bytes());
    }

    /// An integer, bool or enum. Negative ones take ten bytes.
    pub(super) fn integer(&mut self, number: u32, value: i64) {
        self.key(number, 0);
        self.varint(value as u64);
    }

    pub(super) fn bytes(&mut self, number: u32, bytes: &[u8]) {
        self.key(number, 2);
        self.varint(bytes.len() as u64);
        self.0.extend(bytes);
    }

    /// Integers in one field; none without integers.
    pub(super) fn packed(&mut self, number: u32, values: &[i64]) {
        if !values.is_empty() {
            self.message(number, |inner| values.iter().for_each(|value| inner.varint(*value as u64)));
        }
    }

    /// A message, written by `write`.
    pub(super) fn message(&mut self, number: u32, write: impl FnOnce(&mut Self)) {
        self.key(number, 2);
        let start = self.0.len();
        write(self);
        let end = self.0.len();
        self.varint((end - start) as u64);
        // The length goes before the content.
        let length = self.0.len() - end;
        self.0[start..].rotate_right(length);
    }

    /// A `MapPoint`.
    pub(super) fn point(&mut self, number: u32, [x, y, z]: [f64; 3]) {
        self.message(number, |point| {
            point.double(1, x);
            point.double(2, y);
            point.double(3, z);
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_have_their_length_before_them() {
        let mut writer = Writer::default();
        writer.message(2, |inner| {
            inner.integer(1, 150);
            inner.packed(3, &[1, 300]);
        });
        assert_eq!(writer.0, [0x12, 0x08, 0x08, 0x96, 0x01, 0x1a, 0x03, 0x01, 0xac, 0x02]);
        writer.0.clear();
        writer.message(1, |inner| inner.bytes(5, &[7; 200]));
        assert_eq!(writer.0[..6], [0x0a, 0xcb, 0x01, 0x2a, 0xc8, 0x01]);
        writer.0.clear();
        writer.integer(1, -1);
        assert_eq!(writer.0.len(), 11);
    }
}
