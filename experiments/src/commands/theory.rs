//! `sage theory`: the theorems, checked numerically.

mod diagnostics;
mod page;

use std::{
    fmt::Write as _,
    sync::{Mutex, PoisonError},
};

use anyhow::{Result, ensure};
use rayon::prelude::*;
use sage_core::text::wrap::wrapped;
use sage_run::{
    Outcome,
    output::{self, Folder},
    progress::{self, Progress},
    scenes,
};
use serde_json::json;
use theory_checks::{Check, Report, Setup, Verdict, caught};

use self::{diagnostics::Diagnostic, page::Page};
use crate::{Registries, cli::TheoryArgs};

/// Share of the instances with which injected faults run for a page.
const INJECTED_SHARE: usize = 10;

/// A claim with its experiment.
pub(crate) struct Claim {
    pub(crate) id: &'static str,
    pub(crate) statement: &'static str,
    pub(crate) source: &'static str,
    pub(crate) check: Box<dyn Check>,
}

/// An injected fault, and whether its check noticed it.
struct Injected<'c> {
    claim: &'c str,
    error: &'static str,
    is_caught: bool,
}

pub(crate) fn run(args: &TheoryArgs, registries: &Registries) -> Result<Outcome> {
    let split = &args.split;
    ensure!(
        args.data.is_some() || (split.splits.is_none() && split.scenes.is_empty()),
        "`--splits` and `--scenes` select scenes for the diagnostics; give these with `--data`"
    );
    let claims = selected(&args.only, registries)?;
    let setup = Setup { seed: args.seed, instances: args.instances as usize };
    if args.inject {
        let injected = injected(&claims, &setup);
        output::print(&injected_lines(&injected, args.json)?)?;
        return Ok(if injected.iter().all(|injected| injected.is_caught) {
            Outcome::Done
        } else {
            Outcome::NotHeld
        });
    }
    // A folder that cannot be written to is an error before the work.
    let folder = args.out.as_ref().map(|out| Folder::make(out, args.force)).transpose()?;
    // Scenes that cannot be read are an error before the claims, which take longer.
    let found = args.data.is_some().then(|| diagnostics::run(args, &registries.parts)).transpose()?;
    let failed = found.as_ref().map_or(0, |(.., failed)| *failed);
    let diagnostics = found.map(|(subject, diagnostics, _)| (subject, diagnostics));
    let progress = Mutex::new(Progress::new("checked", claims.len()));
    let run = |claim: &Claim| {
        let report = claim.check.run(&setup, None);
        progress.lock().unwrap_or_else(PoisonError::into_inner).step();
        report
    };
    let reports: Vec<Report> = claims.par_iter().map(run).collect();
    let progress = progress.into_inner().unwrap_or_else(PoisonError::into_inner);
    progress.finish(&progress::count(claims.len(), "claim"));
    let mut text = claim_lines(&claims, &reports, &setup, args.json)?;
    if let Some((subject, diagnostics)) = &diagnostics {
        text += &diagnostic_lines(subject, diagnostics, args.json)?;
    } else {
        progress::say(
            "diagnostics of trained experts are left out: they need scenes (--data) and weights (--weights)",
        );
    }
    output::print(&text)?;
    let is_expected = |(claim, report): (&Claim, &Report)| Verdict::of(report) == claim.check.expected();
    let mut is_well = claims.iter().zip(&reports).all(is_expected);
    if let Some(folder) = &folder {
        let injected_setup = Setup { instances: (setup.instances / INJECTED_SHARE).max(1), ..setup };
        let injected = injected(&claims, &injected_setup);
        is_well &= injected.iter().all(|injected| injected.is_caught);
        let page = Page {
            claims: &claims,
            reports: &reports,
            injected: &injected,
            setup: &setup,
            injected_setup: &injected_setup,
            diagnostics: diagnostics.as_ref(),
        };
        page.write(folder)?;
        folder.finish()?;
        progress::say(&format!("index.html, theory.md and figures are in `{}`", folder.path().display()));
    }
    Ok(if is_well { scenes::outcome_without(failed) } else { Outcome::NotHeld })
}

/// The claims with these ids, or all.
fn selected(only: &[String], registries: &Registries) -> Result<Vec<Claim>> {
    let known = &registries.claims;
    let ids: Vec<&str> = match only {
        [] => known.entries().iter().map(|entry| entry.name).collect(),
        only => only.iter().map(|id| Ok(known.get(id)?.name)).collect::<Result<_>>()?,
    };
    let claim = |id: &str| -> Result<Claim> {
        let entry = known.get(id)?;
        let check = known.build_default(id)?;
        Ok(Claim { id: entry.name, statement: entry.summary, source: entry.source, check })
    };
    let mut claims: Vec<Claim> = Vec::new();
    for id in ids {
        if claims.iter().all(|known| known.id != id) {
            claims.push(claim(id)?);
        }
    }
    Ok(claims)
}

/// A line for each claim.
fn claim_lines(claims: &[Claim], reports: &[Report], setup: &Setup, as_json: bool) -> Result<String> {
    let mut out = String::new();
    if !as_json {
        writeln!(out, "claim  comparisons  verdict           statement")?;
    }
    let mut verdicts = Vec::new();
    for (claim, report) in claims.iter().zip(reports) {
        let (verdict, expected) = (Verdict::of(report), claim.check.expected());
        verdicts.push(verdict);
        if as_json {
            let row = json!({
                "claim": claim.id, "statement": claim.statement, "source": claim.source,
                "formula": claim.check.formula(), "experiment": claim.check.experiment(),
                "caveat": claim.check.caveat(), "report": report, "verdict": verdict, "expected": expected,
                "seed": setup.seed, "instances": setup.instances,
            });
            writeln!(out, "{row}")?;
            continue;
        }
        let note = if verdict == expected { "" } else { " (another verdict was expected)" };
        let line = format!(
            "{:<5}  {:>11}  {:<16}  {}{note}",
            claim.id,
            report.comparisons,
            verdict.words(),
            claim.statement
        );
        writeln!(out, "{}", wrapped(&line, 38))?;
    }
    if !as_json {
        // A verdict such as "fails as printed" beside thousands of comparisons that hold asks for words.
        out.push('\n');
        for (verdict, meaning) in page::VERDICTS.iter().filter(|(verdict, _)| verdicts.contains(verdict)) {
            writeln!(out, "{}", wrapped(&format!("{}: {meaning}", verdict.words()), 4))?;
        }
    }
    Ok(out)
}

/// A line for each diagnostic.
fn diagnostic_lines(subject: &str, diagnostics: &[Diagnostic], as_json: bool) -> Result<String> {
    let mut out = String::new();
    if !as_json {
        writeln!(out, "\nDiagnostics, no proofs. {subject}")?;
    }
    for diagnostic in diagnostics {
        let Diagnostic { id, question, finding, .. } = diagnostic;
        if as_json {
            let tables: Vec<_> = diagnostic
                .tables
                .iter()
                .map(|table| json!({"caption": table.title, "columns": table.heads, "rows": table.rows}))
                .collect();
            let row = json!({
                "diagnostic": id, "question": question, "finding": finding, "caveat": diagnostic.caveat,
                "subject": subject, "tables": tables,
            });
            writeln!(out, "{row}")?;
        } else {
            writeln!(out, "{}\n    {}", wrapped(&format!("{id}  {question}"), 4), wrapped(finding, 4))?;
        }
    }
    Ok(out)
}

/// All injected faults, and whether they are noticed.
fn injected<'c>(claims: &'c [Claim], setup: &Setup) -> Vec<Injected<'c>> {
    let one = |claim: &'c Claim| {
        let errors = claim.check.injected().iter().zip(caught(&*claim.check, setup));
        errors.map(|(error, is_caught)| Injected { claim: claim.id, error, is_caught }).collect::<Vec<_>>()
    };
    claims.par_iter().flat_map_iter(one).collect()
}

/// A line for each injected fault, the checks that are broken, and how many errors were caught.
fn injected_lines(injected: &[Injected<'_>], as_json: bool) -> Result<String> {
    let mut out = String::new();
    for Injected { claim, error, is_caught } in injected {
        if as_json {
            writeln!(out, "{}", json!({"claim": claim, "injected": error, "caught": is_caught}))?;
        } else {
            let word = if *is_caught { "caught" } else { "MISSED" };
            writeln!(out, "{claim:<5}  {word}  {error}")?;
        }
    }
    if !as_json {
        let mut broken: Vec<&str> = injected.iter().filter(|p| !p.is_caught).map(|p| p.claim).collect();
        broken.dedup();
        for claim in broken {
            writeln!(out, "the check of {claim} is broken")?;
        }
        let count = injected.iter().filter(|injected| injected.is_caught).count();
        writeln!(out, "caught {count} of {}", injected.len())?;
    }
    Ok(out)
}
