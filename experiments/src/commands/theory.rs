//! `sage theory`: the theorems, checked numerically.

use std::fmt::Write as _;

use anyhow::Result;
use rayon::prelude::*;
use serde_json::json;
use theory_checks::{Check, Report, Setup, Verdict, notices};

use crate::{Outcome, Registries, cli::TheoryArgs, output};

/// A claim with its experiment.
pub(crate) struct Claim {
    pub(crate) id: &'static str,
    pub(crate) statement: &'static str,
    pub(crate) source: &'static str,
    pub(crate) check: Box<dyn Check>,
}

pub(crate) fn run(args: &TheoryArgs, registries: &Registries) -> Result<Outcome> {
    let claims = selected(&args.only, registries)?;
    let setup = Setup { seed: args.seed, instances: args.instances as usize };
    let (text, is_well) =
        if args.plant { planted(&claims, &setup, args.json)? } else { checked(&claims, &setup, args.json)? };
    output::print(&text)?;
    Ok(if is_well { Outcome::Done } else { Outcome::Partial })
}

/// The claims with these ids, or all.
fn selected(only: &[String], registries: &Registries) -> Result<Vec<Claim>> {
    let known = &registries.claims;
    let ids: Vec<&str> = match only {
        [] => known.entries().iter().map(|entry| entry.name).collect(),
        only => only.iter().map(|id| Ok(known.get(id)?.name)).collect::<Result<_>>()?,
    };
    let claim = |id: &str| {
        let entry = known.get(id)?;
        let check = known.build_default(id)?;
        Ok(Claim { id: entry.name, statement: entry.summary, source: entry.source, check })
    };
    ids.into_iter().map(claim).collect()
}

/// A line for each claim, and whether all verdicts are the expected ones.
fn checked(claims: &[Claim], setup: &Setup, as_json: bool) -> Result<(String, bool)> {
    let reports: Vec<Report> = claims.par_iter().map(|claim| claim.check.run(setup, None)).collect();
    let mut out = String::new();
    if !as_json {
        let head = "claim  instances  comparisons  violations  margin left  tightness  stored  verdict           statement";
        writeln!(out, "{head}")?;
    }
    let mut all_expected = true;
    for (claim, report) in claims.iter().zip(&reports) {
        let verdict = Verdict::of(report);
        all_expected &= verdict == claim.check.expected();
        if as_json {
            let row = json!({
                "claim": claim.id, "statement": claim.statement, "source": claim.source,
                "formula": claim.check.formula(), "experiment": claim.check.experiment(),
                "caveat": claim.check.caveat(), "report": report, "verdict": verdict,
                "expected": claim.check.expected(), "seed": setup.seed, "instances": setup.instances,
            });
            writeln!(out, "{row}")?;
            continue;
        }
        let or_none = |value: Option<String>| value.unwrap_or("-".to_owned());
        writeln!(
            out,
            "{:<5}  {:>9}  {:>11}  {:>10}  {:>10.2}%  {:>9}  {:>6}  {:<16}  {}",
            claim.id,
            report.instances,
            report.comparisons,
            report.violations,
            100.0 * report.worst_margin,
            or_none(report.tightness.map(|ratio| format!("{ratio:.4}"))),
            or_none(report.fixture_error.map(|error| format!("{error:.1e}"))),
            verdict.words(),
            claim.statement
        )?;
    }
    Ok((out, all_expected))
}

/// A line for each planted error, and whether all are noticed.
fn planted(claims: &[Claim], setup: &Setup, as_json: bool) -> Result<(String, bool)> {
    let cases: Vec<(&Claim, usize)> =
        claims.iter().flat_map(|claim| (0..claim.check.planted().len()).map(move |k| (claim, k))).collect();
    let caught: Vec<bool> = cases.par_iter().map(|(claim, k)| notices(&*claim.check, *k, setup)).collect();
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
