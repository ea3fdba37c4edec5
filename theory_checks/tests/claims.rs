//! Every claim comes to its verdict, and every planted error is noticed.

#![allow(clippy::unwrap_used)] // A failed unwrap is a failed test.

use theory_checks::{Setup, Verdict, claims, notices};

const SMALL: Setup = Setup { seed: 0, instances: 100 };

#[test]
fn claims_come_to_their_verdicts_and_planted_errors_are_noticed() {
    let claims = claims().unwrap();
    for entry in claims.entries() {
        let check = claims.build_default(entry.name).unwrap();
        let report = check.run(&SMALL, None);
        assert_eq!(Verdict::of(&report), check.expected(), "{}: {report:?}", entry.name);
        assert_ne!(check.expected(), Verdict::Violated);
        assert!(!check.planted().is_empty());
        for (k, planted) in check.planted().iter().enumerate() {
            assert!(notices(&*check, k, &SMALL), "{}: {planted}", entry.name);
        }
    }
}

#[test]
fn the_same_seed_gives_the_same_bits_on_any_number_of_threads() {
    let setup = Setup { seed: 3, instances: 20 };
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let claims = claims().unwrap();
            let report = |id: &str| claims.build_default(id).unwrap().run(&setup, None);
            claims.entries().iter().map(|entry| report(entry.name)).collect::<Vec<_>>()
        })
    };
    // As text, so that values that are not numbers are equal too.
    assert_eq!(format!("{:?}", run(1)), format!("{:?}", run(3)));
}
