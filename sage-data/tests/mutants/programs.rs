//! Pickles in a short notation, so that each crafted one is a line of a table (`programs.table`).
//!
//! Words with spaces between them: bytes with escapes (`\x80`, `\n`), a text in quotes as SHORT_BINUNICODE, `#` for the
//! number of the repetition as such a text, `%` in a word for that number, and `< … >N` for N repetitions. `WORD*N` repeats one
//! word.

use sage_core::seed::Rng;

use super::{Format, Mutant};

/// A crafted pickle: what it is, its bytes, and the words of its error (`;` between them); none if it is a scene.
pub struct Program {
    pub name: &'static str,
    pub bytes: Vec<u8>,
    pub words: &'static str,
}

/// The programs of the table.
pub fn all() -> impl Iterator<Item = Program> {
    rows().map(program)
}

fn rows() -> impl Iterator<Item = [&'static str; 3]> {
    super::formats::lines(include_str!("programs.table"))
}

fn program([name, program, words]: [&'static str; 3]) -> Program {
    Program { name, bytes: [b"\x80\x04", &assembled(program)[..]].concat(), words }
}

/// Globals that scanners for hostile pickles detect, and some that appear harmless, as module and name.
pub fn hostile_globals() -> impl Iterator<Item = (&'static str, &'static str)> {
    include_str!("globals.txt").lines().map(|line| line.split_once(' ').unwrap_or((line, "")))
}

/// A program of the table, or a whole pickle that begins with a call of a hostile global.
pub fn made(format: &Format, rng: &mut Rng) -> Mutant {
    if rng.below(2) == 0 {
        let rows: Vec<_> = rows().collect();
        let Program { bytes, words, .. } = program(rows[rng.below(rows.len())]);
        let refused_with = Some(words.to_owned()).filter(|words| !words.is_empty());
        return Mutant { bytes, kind: "crafted", refused_with };
    }
    let globals: Vec<_> = hostile_globals().collect();
    let (module, name) = globals[rng.below(globals.len())];
    let code = match rng.below(2) {
        0 => [b"c", module.as_bytes(), b"\n", name.as_bytes(), b"\n"].concat(),
        _ => [text(module), text(name), b"\x93".to_vec()].concat(),
    };
    let call = [&code[..], b"\x8c\x07echo hi\x85R0"].concat();
    let mut bytes = format.bases[rng.below(format.bases.len())].clone();
    bytes.splice(2..2, call);
    Mutant { bytes, kind: "hostile global", refused_with: Some(format!("is not allowed;{module}")) }
}

/// SHORT_BINUNICODE.
pub fn text(word: &str) -> Vec<u8> {
    [&[0x8c, word.len() as u8], word.as_bytes()].concat()
}

/// The bytes of a notation.
pub fn assembled(program: &str) -> Vec<u8> {
    let mut out = Vec::new();
    let mut group: Option<Vec<&str>> = None;
    for word in program.split_whitespace() {
        match (word.strip_prefix('>'), &mut group) {
            (Some(count), Some(words)) => {
                (0..times(count))
                    .for_each(|number| out.extend(words.iter().flat_map(|word| bytes(word, number))));
                group = None;
            }
            (_, Some(words)) => words.push(word),
            _ if word == "<" => group = Some(Vec::new()),
            _ => match word.rsplit_once('*').filter(|(part, _)| !part.is_empty()) {
                Some((part, count)) => out.extend(bytes(part, 0).repeat(times(count))),
                None => out.extend(bytes(word, 0)),
            },
        }
    }
    out
}

fn times(count: &str) -> usize {
    count.parse().expect("a number of repetitions")
}

fn bytes(word: &str, number: usize) -> Vec<u8> {
    if word == "#" {
        return text(&number.to_string());
    }
    if let Some(word) = word.strip_prefix('\'') {
        return text(word.trim_end_matches('\''));
    }
    super::formats::unescaped(&word.replace('%', &number.to_string()))
}
