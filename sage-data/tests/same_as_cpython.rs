//! 20 000 generated pickle programs: whatever our reader accepts has the value that CPython reads.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

mod differential;

use std::collections::BTreeSet;

use sage_data::pickle::{Document, PickleProblem};

#[test]
fn accepted_programs_have_cpythons_value() {
    if !differential::has_python() {
        return eprintln!("left out: there is no python3 to compare with");
    }
    let found = differential::compare(20_000).unwrap_or_else(|difference| panic!("{difference}"));
    assert!(found.accepted * 3 >= found.programs, "{} of {} accepted", found.accepted, found.programs);
    let missing: Vec<u8> =
        differential::OPCODES.iter().copied().filter(|code| !found.opcodes.contains(code)).collect();
    assert!(missing.is_empty(), "opcodes in no accepted program: {missing:02x?}");
    assert!(found.memoizes_after_gap > 100, "{}", found.memoizes_after_gap);
}

#[test]
fn exactly_the_generated_opcodes_are_known() {
    let known: BTreeSet<u8> = differential::OPCODES.iter().copied().collect();
    for code in 0..=u8::MAX {
        let error = Document::parse(vec![0x80, 4, code]).unwrap_err().kind;
        let is_refused = matches!(error, PickleProblem::Opcode { .. });
        assert_eq!(is_refused, !known.contains(&code), "opcode {code:#04x}: {error}");
    }
}
