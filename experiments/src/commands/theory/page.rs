//! The page of the theory checks: one content, as Markdown and as a page for a browser.

mod block;
mod figure;
mod numbers;

use std::fmt::Write as _;

use anyhow::Result;
use sage_core::text::table::Table;
use sage_run::output::Folder;
use theory_checks::{Report, Setup, Verdict};

use self::{
    block::{Block, HEAD},
    figure::draw,
    numbers::{digits, numbers},
};
use super::{Claim, Injected, diagnostics::Diagnostic};

/// File names.
const HTML: &str = "index.html";
const MARKDOWN: &str = "theory.md";
const FIGURES: &str = "figures";

const INTRODUCTION: &str = "Each claim of the theory of preference-mixed experts is run as an experiment: the formula on one \
    side, a direct computation on the other. Rewards are maximised. R_μ = μ R_adv + (1 − μ) R_real has its maximum at θ̂_μ. Expert 1 \
    (adversarial) maximises R_β, expert 2 (realistic) R_(1−β), with β in (0.5, 1]. θ(λ) = (1 − λ) θ_2 + λ θ_1, d = θ_1 − θ_2, D = ‖d‖. The gap \
    of μ is R_μ(θ̂_μ) less the largest R_μ(θ(λ)) over λ in [0, 1]. μ is inside if 1 − β < μ < β. A reward is L-smooth and m-strongly concave if \
    the eigenvalues of the Hessian of −R lie in [m, L].";
/// Verdicts and what they mean.
pub(super) const VERDICTS: [(Verdict, &str); 6] = [
    (Verdict::Holds, "no comparison misses its tolerance; a bound is attained by some instance"),
    (Verdict::HoldsWithSlack, "a bound without violation that no instance attains"),
    (Verdict::HoldsIf, "true under a stated condition; outside it there are failures"),
    (Verdict::FailsAsPrinted, "an instance refutes the paper's text; the corrected form has no violation"),
    (Verdict::Violated, "a comparison or a stored case misses its tolerance"),
    (Verdict::Undecided, "a direct computation found no solution"),
];

/// What the page states.
pub(super) struct Page<'a> {
    pub(super) claims: &'a [Claim],
    pub(super) reports: &'a [Report],
    pub(super) injected: &'a [Injected<'a>],
    pub(super) setup: &'a Setup,
    pub(super) injected_setup: &'a Setup,
    /// Subject and diagnostics; `None` without scenes.
    pub(super) diagnostics: Option<&'a (String, Vec<Diagnostic>)>,
}

impl Page<'_> {
    /// Writes the page, as Markdown and for a browser, and its figures.
    ///
    /// *Errors*: the folder cannot be written to.
    pub(super) fn write(&self, folder: &Folder) -> Result<()> {
        let blocks = self.blocks();
        folder.inner(FIGURES.as_ref())?;
        let mut html = HEAD.to_owned();
        let mut markdown = String::new();
        for block in &blocks {
            let svg = match block {
                Block::Figure(file, figure) => {
                    let svg = draw(figure)?;
                    folder.write(&format!("{FIGURES}/{file}"), svg.as_bytes())?;
                    svg
                }
                _ => String::new(),
            };
            html += &block.html(&svg);
            markdown += &block.markdown();
        }
        html += "</main></html>\n";
        folder.write(HTML, html.as_bytes())?;
        Ok(folder.write(MARKDOWN, format!("{}\n", markdown.trim_end()).as_bytes())?)
    }

    fn blocks(&self) -> Vec<Block<'_>> {
        let mut blocks = vec![
            Block::Heading(
                1,
                "theory".into(),
                "The theorems of preference-mixed experts, checked numerically".into(),
            ),
            Block::Text(INTRODUCTION.into()),
            Block::Text(format!(
                "Made by `sage theory` {}, seed {}, {}.",
                env!("CARGO_PKG_VERSION"),
                self.setup.seed,
                size(self.setup)
            )),
        ];
        let mut meanings = Table::new("Verdicts", &["verdict", "meaning"]);
        VERDICTS.iter().for_each(|(verdict, meaning)| meanings.row(verdict.words(), [(*meaning).to_owned()]));
        blocks.extend([
            Block::Table(meanings),
            Block::Heading(2, "summary".into(), "Summary".into()),
            Block::Table(self.summary()),
        ]);
        for (claim, report) in self.claims.iter().zip(self.reports) {
            claim_blocks(claim, report, &mut blocks);
        }
        blocks.push(Block::Heading(2, "injected".into(), "Injected faults".into()));
        blocks.push(Block::Text(format!(
            "A check that cannot fail shows nothing. Each also ran with wrong versions of its formula ({}); it must notice all.",
            size(self.injected_setup)
        )));
        let mut injected = Table::new("", &["claim", "injected fault", "caught"]);
        for injected_fault in self.injected {
            let caught = if injected_fault.is_caught { "caught" } else { "MISSED: the check is broken" };
            injected.row(injected_fault.claim, [injected_fault.error.to_owned(), caught.to_owned()]);
        }
        blocks.push(Block::Table(injected));
        blocks.push(Block::Heading(2, "diagnostics".into(), "Diagnostics of trained experts".into()));
        match self.diagnostics {
            None => blocks.push(Block::Text(
                "Left out: no scenes were given. `sage theory --data SCENES --weights NAME --out DIR` includes them.".into(),
            )),
            Some((subject, diagnostics)) => {
                blocks.push(Block::Text(format!(
                    "{subject} The theory speaks of functions with known constants; of a trained network these are measurements, no proofs. \
                    Intervals: 95 %, bootstrap over scenes. All are expectations under the policy: the selection among candidates is outside of every claim here."
                )));
                diagnostics.iter().for_each(|diagnostic| diagnostic_blocks(diagnostic, &mut blocks));
            }
        }
        blocks
    }

    fn summary(&self) -> Table {
        let columns = [
            "claim",
            "statement",
            "verdict",
            "instances",
            "comparisons",
            "violations",
            "smallest bound/gap",
            "error of stored cases",
        ];
        let mut table = Table::new("The error of stored cases is a share of their tolerance", &columns);
        for (claim, report) in self.claims.iter().zip(self.reports) {
            let or_none = |value: Option<f64>| value.map_or("-".to_owned(), digits);
            let cells = [
                claim.statement.to_owned(),
                Verdict::of(report).words().to_owned(),
                report.instances.to_string(),
                report.comparisons.to_string(),
                report.violations.to_string(),
                or_none(report.tightness),
                or_none(report.fixture_error),
            ];
            table.row(claim.id, cells);
        }
        table
    }
}

/// Size of the experiments in words.
fn size(setup: &Setup) -> String {
    if *setup == (Setup { seed: setup.seed, ..Setup::default() }) {
        return "every experiment at the size that it states".to_owned();
    }
    format!("experiments at {} % of the size that they state", setup.instances as f64 / 10.0)
}

fn claim_blocks<'a>(claim: &'a Claim, report: &'a Report, blocks: &mut Vec<Block<'a>>) {
    let verdict = Verdict::of(report);
    blocks.push(Block::Heading(2, claim.id.into(), format!("{}: {}", claim.id, claim.statement)));
    let mut outcome =
        format!("{} ({} comparisons, {} violations", verdict.words(), report.comparisons, report.violations);
    if report.unsolved > 0 {
        let _ = write!(outcome, ", {} without a solution", report.unsolved);
    }
    if let Some(count) = report.counterexamples {
        let _ = write!(outcome, ", {count} counterexamples to the printed claim");
    }
    if let Some(count) = report.exceptions {
        let _ = write!(outcome, ", {count} failures outside the condition");
    }
    if let Some(ratio) = report.tightness {
        let _ = write!(outcome, ", smallest bound/gap {}", digits(ratio));
    }
    if let Some(error) = report.fixture_error {
        let _ = write!(outcome, ", stored cases within {} of their tolerance", digits(error));
    }
    outcome.push(')');
    if verdict != claim.check.expected() {
        let _ = write!(outcome, "; expected: {}", claim.check.expected().words());
    }
    blocks.extend([
        Block::Labelled("Verdict", outcome),
        Block::Labelled("Formula", claim.check.formula().into()),
        Block::Labelled("Experiment", claim.check.experiment().into()),
        Block::Labelled("Caveat", claim.check.caveat().into()),
        Block::Labelled("Source", claim.source.into()),
    ]);
    let has_references = report
        .tables
        .iter()
        .flat_map(|table| &table.rows)
        .flat_map(|(_, row)| row)
        .any(|n| n.reference.is_some());
    blocks.extend(report.tables.iter().map(|table| Block::Table(numbers(table))));
    if has_references {
        blocks.push(Block::Text(
            "±: standard error. In parentheses: an independent implementation on instances of its own; where it drew from another distribution, only the trend is comparable."
                .into(),
        ));
    }
    let figures = report.figures.iter().enumerate();
    blocks.extend(figures.map(|(k, figure)| Block::Figure(format!("{}-{}.svg", claim.id, k + 1), figure)));
}

fn diagnostic_blocks<'a>(diagnostic: &'a Diagnostic, blocks: &mut Vec<Block<'a>>) {
    let title = format!("{}: {}", diagnostic.id, diagnostic.question);
    blocks.push(Block::Heading(3, diagnostic.id.into(), title));
    blocks.push(Block::Labelled("Found", diagnostic.finding.clone()));
    blocks.push(Block::Labelled("Caveat", diagnostic.caveat.into()));
    blocks.extend(diagnostic.tables.iter().cloned().map(Block::Table));
    let figures = diagnostic.figures.iter().enumerate();
    blocks
        .extend(figures.map(|(k, figure)| Block::Figure(format!("{}-{}.svg", diagnostic.id, k + 1), figure)));
}
