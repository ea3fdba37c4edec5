//! `sage theory`: the theorems, checked numerically.

use std::fmt::Write as _;

use anyhow::Result;
use rayon::prelude::*;
use serde_json::json;
use theory_checks::{Check, Outcome as Found, Setup, Verdict, evaluate};

use crate::{Outcome, Registries, cli::TheoryArgs, output};

/// A claim with its experiment.
struct Claim {
    id: &'static str,
    statement: &'static str,
    source: &'static str,
    check: Box<dyn Check>,
}

pub(crate) fn run(args: &TheoryArgs, registries: &Registries) -> Result<Outcome> {
    let known = &registries.claims;
    let ids: Vec<&str> = match &args.only[..] {
        [] => known.entries().iter().map(|entry| entry.name).collect(),
        only => only.iter().map(|id| Ok(known.get(id)?.name)).collect::<Result<_>>()?,
    };
    let claims = ids.into_iter().map(|id| {
        let entry = known.get(id)?;
        let check = known.build_default(id)?;
        Ok(Claim { id: entry.name, statement: entry.summary, source: entry.source, check })
    });
    let claims = claims.collect::<Result<Vec<_>>>()?;
    let setup = Setup { seed: args.seed, instances: args.instances as usize };
    let (text, is_well) =
        if args.plant { planted(&claims, &setup, args.json)? } else { checked(&claims, &setup, args.json)? };
    output::print(&text)?;
    Ok(if is_well { Outcome::Done } else { Outcome::Partial })
}

/// A line for each claim, and whether all verdicts are the expected ones.
fn checked(claims: &[Claim], setup: &Setup, as_json: bool) -> Result<(String, bool)> {
    let found: Vec<Found> = claims.par_iter().map(|claim| claim.check.run(setup, None)).collect();
    let mut out = String::new();
    if !as_json {
        let head =
            "claim  comparisons  violations  tolerance left  stored cases  verdict           statement";
        writeln!(out, "{head}")?;
    }
    let mut all_hold = true;
    for (claim, found) in claims.iter().zip(&found) {
        let verdict = evaluate(&*claim.check, found);
        all_hold &= verdict == claim.check.confirmed();
        if as_json {
            let row = json!({
                "claim": claim.id, "statement": claim.statement, "source": claim.source,
                "formula": claim.check.formula(), "caveat": claim.check.caveat(), "found": found, "verdict": verdict,
                "seed": setup.seed, "instances": setup.instances,
            });
            writeln!(out, "{row}")?;
            continue;
        }
        let stored = found.fixture_error.map_or("-".to_owned(), |error| format!("{error:.1e}"));
        writeln!(
            out,
            "{:<5}  {:>11}  {:>10}  {:>13.2}%  {stored:>12}  {:<16}  {}",
            claim.id,
            found.comparisons,
            found.violations,
            100.0 * found.worst_margin,
            word(verdict),
            claim.statement
        )?;
    }
    Ok((out, all_hold))
}

/// A line for each planted error, and whether all are noticed.
fn planted(claims: &[Claim], setup: &Setup, as_json: bool) -> Result<(String, bool)> {
    let cases: Vec<(&Claim, usize)> =
        claims.iter().flat_map(|claim| (0..claim.check.planted().len()).map(move |k| (claim, k))).collect();
    let caught: Vec<bool> = cases
        .par_iter()
        .map(|(claim, k)| evaluate(&*claim.check, &claim.check.run(setup, Some(*k))) == Verdict::Violated)
        .collect();
    let mut out = String::new();
    for ((claim, k), caught) in cases.iter().zip(&caught) {
        let error = claim.check.planted()[*k];
        if as_json {
            writeln!(out, "{}", json!({"claim": claim.id, "planted": error, "caught": caught}))?;
        } else {
            writeln!(out, "{:<5}  {:<6}  {error}", claim.id, if *caught { "caught" } else { "MISSED" })?;
        }
    }
    let count = caught.iter().filter(|caught| **caught).count();
    if !as_json {
        writeln!(out, "caught {count} of {}", caught.len())?;
    }
    Ok((out, count == caught.len()))
}

fn word(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Holds => "holds",
        Verdict::FailsAsPrinted => "fails as printed",
        Verdict::Violated => "VIOLATED",
    }
}
