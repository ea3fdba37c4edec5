//! Parts of programs that name globals and create objects from them.

use super::program::{Kind, Writer};

/// Globals that the reader knows: kind, module and name.
const NAMES: [(Kind, &str, &str); 9] = [
    (Kind::Reconstruct, "numpy.core.multiarray", "_reconstruct"),
    (Kind::Reconstruct, "numpy._core.multiarray", "_reconstruct"),
    (Kind::FromBuffer, "numpy.core.numeric", "_frombuffer"),
    (Kind::ScalarType, "numpy.core.multiarray", "scalar"),
    (Kind::NdArray, "numpy", "ndarray"),
    (Kind::DtypeType, "numpy", "dtype"),
    (Kind::Encode, "_codecs", "encode"),
    (Kind::DefaultDictType, "collections", "defaultdict"),
    (Kind::SetType, "builtins", "set"),
];

impl Writer {
    /// Names a global, by either opcode; memo entries may come between module and name.
    fn global(&mut self, kind: Kind) {
        let of_kind: Vec<_> = NAMES.iter().filter(|(k, ..)| *k == kind).collect();
        let (_, mut module, name) = *of_kind[self.rng.below(of_kind.len())];
        // Python 2's name of the module, valid in protocol 2 and invalid later.
        if module == "builtins" && (self.protocol == 2 || self.rng.below(8) == 0) {
            module = "__builtin__";
        }
        if self.rng.below(4) == 0 {
            self.op(b'c');
            self.out.extend(format!("{module}\n{name}\n").bytes());
            self.push(kind, 1);
        } else {
            self.word(module);
            self.push(Kind::Str, 1);
            self.maybe_store();
            self.word(name);
            self.push(Kind::Str, 1);
            self.maybe_store();
            self.op(0x93);
            self.stack.truncate(self.stack.len() - 2);
            self.push(kind, 1);
        }
        self.maybe_store();
    }

    /// REDUCE of `n` arguments on top of a global.
    fn reduce(&mut self, n: usize, kind: Kind) {
        self.op(b'R');
        self.stack.truncate(self.stack.len() - 1 - n.min(1));
        self.push(kind, 1);
    }

    /// A numpy type with its state, complete or with an error.
    fn dtype(&mut self) -> usize {
        let (name, size) =
            [("f8", 8), ("f4", 4), ("i8", 8), ("u2", 2), ("b1", 1), ("f2", 2)][self.rng.below(6)];
        let defect = if self.rng.below(8) == 0 { self.rng.below(6) } else { 9 };
        self.global(Kind::DtypeType);
        let name = if defect == 0 { format!(">{name}") } else { name.to_owned() };
        self.word(&name);
        if defect == 1 {
            self.op(0x85);
        } else {
            self.op(if defect == 2 { 0x88 } else { 0x89 });
            self.op(if defect == 3 { 0x89 } else { 0x88 });
            self.op(0x87);
        }
        self.push(Kind::Other, 1);
        self.reduce(1, Kind::Other);
        self.maybe_store();
        for _ in 0..if defect == 4 { 2 } else { 1 } {
            self.op(b'(');
            self.out.extend([b'K', 3]);
            let order = [">", "<", "|", "="][self.rng.below(if defect == 5 { 4 } else { 3 })];
            self.word(order);
            self.op(b'N');
            self.op(b'N');
            self.op(b'N');
            for _ in 0..2 {
                self.op(b'J');
                self.out.extend((-1i32).to_le_bytes());
            }
            self.out.extend([b'K', 0]);
            self.op(b't');
            self.op(b'b');
        }
        size
    }

    fn shape_and_data(&mut self, size: usize) -> (Vec<u8>, Vec<u8>) {
        let (rows, columns) = (self.rng.below(3), 1 + self.rng.below(2));
        let count = rows * columns * size + usize::from(self.rng.below(20) == 0);
        let data = (0..count).map(|_| self.rng.below(128) as u8).collect();
        (vec![b'K', rows as u8, b'K', columns as u8, 0x86], data)
    }

    pub(super) fn numpy(&mut self) {
        if self.stack.len() > 40 {
            return;
        }
        match self.rng.below(4) {
            0 => {
                self.dtype();
            }
            1 => {
                self.global(Kind::ScalarType);
                let size = self.dtype();
                let data: Vec<u8> = (0..size).map(|_| self.rng.below(128) as u8).collect();
                let (code, width) = [(b'C', 1), (b'U', 1), (0x96, 8)][self.rng.below(20).saturating_sub(17)];
                self.counted(code, width, &data);
                self.op(0x86);
                self.stack.pop();
                self.push(Kind::Other, 1);
                self.reduce(1, Kind::Key);
            }
            2 => {
                self.global(Kind::FromBuffer);
                self.op(b'(');
                let start = self.out.len();
                self.marks.push(self.stack.len());
                let (code, width) = [(0x96, 8), (b'C', 1), (b'U', 1)][self.rng.below(20).saturating_sub(17)];
                self.counted(code, width, b"");
                let size = self.dtype();
                self.stack.pop();
                let (shape, data) = self.shape_and_data(size);
                // The buffer precedes the type that determines its length.
                let head = 1 + width;
                self.out.splice(start + head..start + head, data.iter().copied());
                self.out.splice(
                    start + 1..start + head,
                    (data.len() as u64).to_le_bytes()[..width].iter().copied(),
                );
                self.out.extend(shape);
                let order = ["C", "F", "A"][self.rng.below(11) / 5];
                self.word(order);
                self.op(b't');
                self.marks.pop();
                self.push(Kind::Other, 1);
                self.reduce(1, Kind::Other);
            }
            _ => {
                self.global(Kind::Reconstruct);
                self.global(Kind::NdArray);
                let length = u8::from(self.rng.below(20) == 0);
                self.out.extend([b'K', length, 0x85]);
                self.counted(b'C', 1, b"b");
                self.op(0x87);
                self.stack.pop();
                self.push(Kind::Other, 1);
                self.reduce(1, Kind::Other);
                self.maybe_store();
                self.op(b'(');
                let version = 1 + u8::from(self.rng.below(20) == 0);
                self.out.extend([b'K', version]);
                let before = self.out.len();
                self.marks.push(self.stack.len());
                let size = self.dtype();
                self.stack.pop();
                self.marks.pop();
                let (shape, data) = self.shape_and_data(size);
                self.out.splice(before..before, shape);
                let fortran = [0x89, 0x88][self.rng.below(2)];
                self.op(fortran);
                let (code, width) = [(b'C', 1), (b'U', 1), (0x96, 8)][self.rng.below(20).saturating_sub(17)];
                self.counted(code, width, &data);
                self.op(b't');
                self.op(b'b');
            }
        }
        self.maybe_store();
    }

    /// MetaDrive's `Vector`, as an object and as a call, and with errors.
    pub(super) fn vector(&mut self) {
        let module = ["metadrive.utils.math", "metadrive.utils.math_utils"][self.rng.below(2)];
        self.op(b'c');
        self.out.extend(format!("{module}\nVector\n").bytes());
        match self.rng.below(12) {
            0 => self.out.extend(b"]\x85"),
            1 => self.op(b')'),
            _ => self.out.extend(b"G@D\0\0\0\0\0\0K\x02\x86\x85"),
        }
        let code = [0x81, b'R'][self.rng.below(2)];
        self.op(code);
        self.push(Kind::Key, 3);
        self.maybe_store();
    }

    /// Calls that create objects other than numpy's.
    pub(super) fn call(&mut self) {
        match self.rng.below(3) {
            0 => {
                self.global(Kind::Encode);
                let raw = if self.rng.below(2) == 0 { "é".to_owned() } else { "ab".to_owned() };
                self.word(&raw);
                let encoding = if self.rng.below(10) == 0 { "utf-8" } else { "latin1" };
                self.word(encoding);
                self.op(0x86);
                self.push(Kind::Other, 1);
                self.reduce(1, Kind::Bytes);
            }
            1 => {
                self.global(Kind::DefaultDictType);
                match self.rng.below(3) {
                    0 => self.op(b')'),
                    1 => {
                        self.op(b'N');
                        self.op(0x85);
                    }
                    _ => {
                        let (module, name) = match (self.protocol, self.rng.below(2)) {
                            (2, 0) => ("__builtin__", "long"),
                            (2, _) => ("__builtin__", "int"),
                            _ => ("builtins", "int"),
                        };
                        self.op(b'c');
                        self.out.extend(format!("{module}\n{name}\n").bytes());
                        self.push(Kind::Int, 1);
                        self.stack.pop();
                        self.op(0x85);
                    }
                }
                self.push(Kind::Other, 1);
                self.reduce(1, Kind::Dict);
            }
            _ => {
                self.global(Kind::SetType);
                self.op(b']');
                self.op(b'(');
                for _ in 0..self.rng.below(4) {
                    let text = String::from_utf8(self.key_text()).expect("it is ASCII");
                    self.word(&text);
                }
                self.op(b'e');
                self.op(0x85);
                self.push(Kind::Other, 1);
                self.reduce(1, Kind::Set);
            }
        }
        self.maybe_store();
    }
}
