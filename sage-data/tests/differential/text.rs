//! Opcodes of protocols 0 and 1, whose arguments are lines, in the forms that Python writes and in forms that it
//! only reads or refuses.

use super::program::{Kind, Writer};

/// Forms of numbers and text, with the number of those that Python writes, which come first.
const INTS: (usize, [&str; 18]) = (
    10,
    [
        "0",
        "5",
        "-5",
        "00",
        "01",
        "2147483648",
        "-9223372036854775808",
        "9223372036854775808",
        "123456789012345678901234567890",
        "-98765432109876543210",
        "-0",
        "007",
        "0x10",
        "1L",
        " 3",
        "+3",
        "",
        "1_000",
    ],
);
const LONGS: (usize, [&str; 12]) = (
    9,
    [
        "0L",
        "5L",
        "-5L",
        "5",
        "-255L",
        "-256L",
        "18446744073709551615L",
        "-18446744073709551616L",
        "340282366920938463463374607431768211456L",
        "00L",
        "L",
        "01L",
    ],
);
const FLOATS: (usize, [&str; 20]) = (
    15,
    [
        "1.5",
        "-1.5",
        "0.0",
        "-0.0",
        "inf",
        "-inf",
        "nan",
        "1e+16",
        "1e-05",
        "1e-400",
        "5e-324",
        ".5",
        "5.",
        "1",
        "0.1000000000000000055511151231257827021181583404541015625",
        "1e400",
        "1_0.0",
        "0x1p3",
        " 1.0",
        "Infinity",
    ],
);
const STRINGS: (usize, [&str; 16]) = (
    7,
    [
        "'a'",
        "\"a'b\"",
        "'a\\'b'",
        "'\\x41\\n\\t\\\\'",
        "'\\101\\0'",
        "''",
        "'a'b'",
        "'\\xe9'",
        "'\\q'",
        "'a",
        "a",
        "'",
        "'\\x4'",
        "'\\'",
        "'\\400'",
        "'a' ",
    ],
);
const UNICODES: (usize, [&[u8]; 14]) = (
    11,
    [
        b"a",
        b"",
        b"\xe9",
        b"\\u00e9",
        b"\\U0001f600",
        b"\\\\u0041",
        b"a\\",
        b"\\x41",
        b"\\u005c",
        b"a\\nb",
        b"\xff\\u0100\xfe",
        b"\\ud83d\\ude00",
        b"\\u12",
        b"\\U00110000",
    ],
);

impl Writer {
    fn line(&mut self, code: u8, line: &[u8]) {
        self.op(code);
        self.out.extend(line);
        self.out.push(b'\n');
    }

    /// One of several forms, most often one that Python writes.
    fn form<T: Copy, const N: usize>(&mut self, (written, all): (usize, [T; N])) -> T {
        let count = if self.rng.below(12) == 0 { N } else { written };
        all[self.rng.below(count)]
    }

    /// A literal as a line.
    pub(super) fn text_literal(&mut self) {
        let kind = match self.rng.below(5) {
            0 => {
                let long = "7".repeat([4299, 4300, 4301][self.rng.below(3)]);
                let line = if self.rng.below(200) == 0 { &long } else { self.form(INTS) };
                self.line(b'I', line.as_bytes());
                Kind::Key
            }
            1 => {
                let line = self.form(LONGS);
                self.line(b'L', line.as_bytes());
                Kind::Key
            }
            2 => {
                let line = self.form(FLOATS);
                self.line(b'F', line.as_bytes());
                Kind::Key
            }
            3 => {
                let line = self.form(STRINGS);
                self.line(b'S', line.as_bytes());
                Kind::Str
            }
            _ => {
                let line = self.form(UNICODES);
                self.line(b'V', line);
                Kind::Str
            }
        };
        self.push(kind, 1);
    }

    /// PUT.
    pub(super) fn put(&mut self, entry: u32) {
        let line = if self.rng.below(40) == 0 { format!("0{entry}") } else { entry.to_string() };
        self.line(b'p', line.as_bytes());
    }

    /// GET.
    pub(super) fn get(&mut self, entry: u32) {
        self.line(b'g', entry.to_string().as_bytes());
    }

    /// MetaDrive's `Vector` in the forms of all protocols, and with errors.
    pub(super) fn vector(&mut self) {
        let module = ["metadrive.utils.math", "metadrive.utils.math_utils"][self.rng.below(2)];
        let old = self.protocol <= 2 || self.rng.below(8) == 0;
        let (copyreg, builtins) = if old { ("copy_reg", "__builtin__") } else { ("copyreg", "builtins") };
        let form = self.rng.below(3);
        if form == 0 {
            self.line(b'c', format!("{copyreg}\n_reconstructor").as_bytes());
            self.op(b'(');
        }
        self.line(b'c', format!("{module}\nVector").as_bytes());
        if form == 0 {
            self.line(b'c', format!("{builtins}\ntuple").as_bytes());
        }
        let error = self.rng.below(12);
        if error == 0 {
            self.out.extend(b"]");
        } else {
            self.out.extend(b"G@D\0\0\0\0\0\0K\x02");
            self.op(0x86);
        }
        match form {
            0 => self.op(b't'),
            _ if error == 1 => self.op(b')'),
            _ => self.op(0x85),
        }
        self.op(if form == 1 { 0x81 } else { b'R' });
        self.push(Kind::Key, 3);
        self.maybe_store();
    }
}
