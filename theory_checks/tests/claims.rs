//! Every claim holds, and every planted error is noticed.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

use theory_checks::{Setup, Verdict, claims, evaluate};

#[test]
fn claims_hold_and_planted_errors_are_noticed() {
    let claims = claims().unwrap();
    let setup = Setup { instances: 200, ..Setup::default() };
    for entry in claims.entries() {
        let check = claims.build_default(entry.name).unwrap();
        let outcome = check.run(&setup, None);
        assert_eq!(evaluate(&*check, &outcome), check.confirmed(), "{}: {outcome:?}", entry.name);
        assert_ne!(check.confirmed(), Verdict::Violated);
        assert!(!check.planted().is_empty() && outcome.comparisons >= setup.instances);
        for (k, planted) in check.planted().iter().enumerate() {
            let outcome = check.run(&setup, Some(k));
            assert_eq!(evaluate(&*check, &outcome), Verdict::Violated, "{}: {planted}", entry.name);
        }
        assert_eq!(check.run(&setup, None), outcome, "the same seed gives the same bits");
    }
}
