//! The page of the theory checks: one content, as Markdown and as a page for a browser.

use std::fmt::Write as _;

use anyhow::Result;
use theory_checks::{Figure, Number, Report, Setup, Table, Verdict};

use super::{Claim, Planted, diagnostics::Diagnostic};
use crate::{
    bench::line_chart::{Chart, Line},
    output::Folder,
    terminal::escaped_html,
};

/// File names.
const HTML: &str = "index.html";
const MARKDOWN: &str = "theory.md";
const FIGURES: &str = "figures";

const INTRODUCTION: &str = "Each claim of the theory of preference-mixed experts is run as an experiment: the formula on one \
    side, a direct computation on the other. Rewards are maximised. R_μ = μ R_adv + (1 − μ) R_real has its maximum at θ̂_μ. Expert 1 \
    (adversarial) maximises R_β, expert 2 (realistic) R_(1−β), with β in (0.5, 1]. θ(λ) = (1 − λ) θ_2 + λ θ_1, d = θ_1 − θ_2, D = ‖d‖. The gap \
    of μ is R_μ(θ̂_μ) less the largest R_μ(θ(λ)) over λ in [0, 1]. μ is inside if 1 − β < μ < β. A reward is L-smooth and m-strongly concave if \
    the eigenvalues of the Hessian of −R lie in [m, L].";
const VERDICTS: [(Verdict, &str); 6] = [
    (Verdict::Holds, "no comparison misses its tolerance; a bound is attained by some instance"),
    (Verdict::HoldsWithSlack, "a bound without violation that no instance attains"),
    (Verdict::HoldsIf, "true under a stated condition; outside it there are failures"),
    (Verdict::FailsAsPrinted, "an instance refutes the paper's text; the corrected form has no violation"),
    (Verdict::Violated, "a comparison or a stored case misses its tolerance"),
    (Verdict::Undecided, "a direct computation found no solution"),
];

/// A table of texts.
pub(super) struct Grid {
    pub(super) caption: String,
    pub(super) columns: Vec<String>,
    pub(super) rows: Vec<Vec<String>>,
}

impl Grid {
    /// A table without rows.
    pub(super) fn new(caption: &str, columns: &[&str]) -> Self {
        let columns = columns.iter().map(|column| (*column).to_owned()).collect();
        Self { caption: caption.to_owned(), columns, rows: Vec::new() }
    }

    /// Adds a row.
    pub(super) fn row(&mut self, name: &str, cells: impl IntoIterator<Item = String>) {
        self.rows.push(std::iter::once(name.to_owned()).chain(cells).collect());
    }

    /// Numbers, each with that of the independent implementation in parentheses.
    fn of(table: &Table) -> Self {
        let mut grid =
            Self { caption: table.caption.clone(), columns: table.columns.clone(), rows: Vec::new() };
        for (name, numbers) in &table.rows {
            grid.row(name, numbers.iter().map(shown));
        }
        grid
    }
}

/// A number with its standard error, and the other implementation's number in parentheses.
fn shown(number: &Number) -> String {
    if number.value.is_nan() {
        return "-".to_owned();
    }
    let mut text = digits(number.value);
    if let Some(error) = number.standard_error {
        let _ = write!(text, " ± {}", of_error(error));
    }
    if let Some(reference) = number.reference {
        let differs = if number.agrees() == Some(false) { ", differs" } else { "" };
        let _ = write!(text, " ({}{differs})", digits(reference));
    }
    text
}

/// Three significant digits, all of a whole number.
fn digits(value: f64) -> String {
    let size = value.abs();
    // Counts are whole.
    if value.fract() == 0.0 && size < 1e7 {
        return format!("{value:.0}");
    }
    if (1e-3..1e4).contains(&size) {
        let decimals = 2 - size.log10().floor() as i32;
        return format!("{value:.*}", decimals.max(0) as usize);
    }
    if size.is_infinite() { "∞".to_owned() } else { format!("{value:.1e}") }
}

/// Two significant digits of a standard error.
fn of_error(error: f64) -> String {
    let size = error.abs();
    if (1e-3..10.0).contains(&size) {
        let decimals = 1 - size.log10().floor() as i32;
        return format!("{error:.*}", decimals.max(0) as usize);
    }
    digits(error)
}

/// A part of the page.
enum Block<'a> {
    /// Level, anchor and text.
    Heading(usize, String, String),
    Text(String),
    /// A label and its text.
    Labelled(&'a str, String),
    Grid(Grid),
    /// File name without folder, and the figure.
    Figure(String, &'a Figure),
}

/// What the page states.
pub(super) struct Page<'a> {
    pub(super) claims: &'a [Claim],
    pub(super) reports: &'a [Report],
    pub(super) planted: &'a [Planted<'a>],
    pub(super) setup: &'a Setup,
    pub(super) planted_setup: &'a Setup,
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
            block.html(&svg, &mut html)?;
            block.markdown(&mut markdown)?;
        }
        html += "</main></html>\n";
        folder.write(HTML, html.as_bytes())?;
        folder.write(MARKDOWN, format!("{}\n", markdown.trim_end()).as_bytes())
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
        let mut meanings = Grid::new("Verdicts", &["verdict", "meaning"]);
        VERDICTS.iter().for_each(|(verdict, meaning)| meanings.row(verdict.words(), [(*meaning).to_owned()]));
        blocks.extend([
            Block::Grid(meanings),
            Block::Heading(2, "summary".into(), "Summary".into()),
            Block::Grid(self.summary()),
        ]);
        for (claim, report) in self.claims.iter().zip(self.reports) {
            claim_blocks(claim, report, &mut blocks);
        }
        blocks.push(Block::Heading(2, "planted".into(), "Planted errors".into()));
        blocks.push(Block::Text(format!(
            "A check that cannot fail shows nothing. Each also ran with wrong versions of its formula ({}); it must notice all.",
            size(self.planted_setup)
        )));
        let mut planted = Grid::new("", &["claim", "planted error", "caught"]);
        for planted_error in self.planted {
            let caught = if planted_error.is_caught { "caught" } else { "MISSED: the check is broken" };
            planted.row(planted_error.claim, [planted_error.error.to_owned(), caught.to_owned()]);
        }
        blocks.push(Block::Grid(planted));
        blocks.push(Block::Heading(2, "diagnostics".into(), "Diagnostics of trained experts".into()));
        match self.diagnostics {
            None => blocks.push(Block::Text(
                "Left out: no scenes were given. `sage theory --data SCENES --weights NAME --report DIR` includes them.".into(),
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

    fn summary(&self) -> Grid {
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
        let mut grid = Grid::new("The error of stored cases is a share of their tolerance", &columns);
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
            grid.row(claim.id, cells);
        }
        grid
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
    blocks.extend(report.tables.iter().map(|table| Block::Grid(Grid::of(table))));
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
    blocks.extend(diagnostic.tables.iter().map(|grid| {
        Block::Grid(Grid {
            caption: grid.caption.clone(),
            columns: grid.columns.clone(),
            rows: grid.rows.clone(),
        })
    }));
    let figures = diagnostic.figures.iter().enumerate();
    blocks
        .extend(figures.map(|(k, figure)| Block::Figure(format!("{}-{}.svg", diagnostic.id, k + 1), figure)));
}

/// Draws a figure.
///
/// *Errors*: none that a caller can cause.
fn draw(figure: &Figure) -> Result<String> {
    let [x, y] = &figure.axes;
    let of = |is_line: bool| -> Vec<Line> {
        let series = figure.series.iter().filter(|series| series.is_line == is_line);
        series.map(|series| (series.name.clone(), series.points.clone())).collect()
    };
    let (axes, is_legend_high) = ([&**x, &**y], is_low_right(figure));
    Chart {
        axes,
        lines: of(true),
        dots: of(false),
        is_log: figure.is_log,
        is_legend_high,
        ..Chart::default()
    }
    .draw()
}

/// Whether more points are at the lower right of a figure than at the upper right, where a legend then is.
fn is_low_right(figure: &Figure) -> bool {
    let place = |point: &[f64; 2]| [0, 1].map(|k| if figure.is_log[k] { point[k].log10() } else { point[k] });
    let points = figure.series.iter().flat_map(|series| &series.points).map(place);
    let points: Vec<[f64; 2]> = points.filter(|point| point.iter().all(|x| x.is_finite())).collect();
    let share = |point: &[f64; 2], k: usize| {
        let (low, high) = points.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), point| {
            (low.min(point[k]), high.max(point[k]))
        });
        (point[k] - low) / (high - low)
    };
    let right = points.iter().filter(|point| share(point, 0) > 0.7).map(|point| share(point, 1));
    let (low, high) =
        right.fold((0, 0), |(low, high), y| (low + u32::from(y < 0.25), high + u32::from(y > 0.75)));
    low > high
}

impl Block<'_> {
    fn markdown(&self, out: &mut String) -> Result<()> {
        match self {
            Self::Heading(level, _, text) => writeln!(out, "{} {text}\n", "#".repeat(*level))?,
            Self::Text(text) => writeln!(out, "{text}\n")?,
            Self::Labelled("Formula", text) => writeln!(out, "**Formula.** `{text}`\n")?,
            Self::Labelled(label, text) => writeln!(out, "**{label}.** {text}\n")?,
            Self::Figure(file, figure) => writeln!(out, "![{}]({FIGURES}/{file})\n", figure.title)?,
            Self::Grid(grid) => {
                if !grid.caption.is_empty() {
                    writeln!(out, "{}:\n", grid.caption)?;
                }
                // A bar would end the cell.
                let line = |cells: &[String]| {
                    let cells: Vec<String> = cells.iter().map(|cell| cell.replace('|', "\\|")).collect();
                    format!("| {} |", cells.join(" | "))
                };
                writeln!(out, "{}", line(&grid.columns))?;
                writeln!(out, "|{}", " --- |".repeat(grid.columns.len()))?;
                for row in &grid.rows {
                    writeln!(out, "{}", line(row))?;
                }
                out.push('\n');
            }
        }
        Ok(())
    }

    fn html(&self, svg: &str, out: &mut String) -> Result<()> {
        match self {
            Self::Heading(level, anchor, text) => {
                writeln!(out, "<h{level} id=\"{anchor}\">{}</h{level}>", inline(text))?;
            }
            Self::Text(text) => writeln!(out, "<p>{}</p>", inline(text))?,
            Self::Labelled("Formula", text) => {
                writeln!(out, "<p class=formula>{}</p>", escaped_html(text))?;
            }
            Self::Labelled(label, text) => {
                writeln!(out, "<p><b>{label}.</b> {}</p>", inline(text))?;
            }
            Self::Figure(_, figure) => {
                writeln!(out, "<figure>{svg}<figcaption>{}</figcaption></figure>", inline(&figure.title))?;
            }
            Self::Grid(grid) => {
                out.push_str("<div class=wide><table>");
                if !grid.caption.is_empty() {
                    write!(out, "<caption>{}</caption>", inline(&grid.caption))?;
                }
                let cells = |tag: &str, cells: &[String]| -> String {
                    cells.iter().map(|cell| format!("<{tag}>{}</{tag}>", linked(cell))).collect()
                };
                write!(out, "<tr>{}</tr>", cells("th", &grid.columns))?;
                for row in &grid.rows {
                    write!(out, "<tr>{}</tr>", cells("td", row))?;
                }
                out.push_str("</table></div>\n");
            }
        }
        Ok(())
    }
}

/// A cell; the id of a claim links to its section, and a verdict has a colour.
fn linked(cell: &str) -> String {
    let is_id = cell
        .strip_prefix('T')
        .is_some_and(|rest| rest.starts_with(|c: char| c.is_ascii_digit()) && rest.len() < 4);
    let text = inline(cell);
    let class =
        VERDICTS.iter().find(|(verdict, _)| verdict.words() == cell).map(|(verdict, _)| class(*verdict));
    match class {
        Some(class) => format!("<span class={class}>{text}</span>"),
        None if is_id => format!("<a href=\"#{text}\">{text}</a>"),
        None => text,
    }
}

/// Colour of a verdict: it holds, holds in part, or does not.
fn class(verdict: Verdict) -> &'static str {
    match verdict {
        Verdict::Holds => "yes",
        Verdict::HoldsWithSlack | Verdict::HoldsIf => "partly",
        Verdict::FailsAsPrinted | Verdict::Violated | Verdict::Undecided => "no",
    }
}

/// Text with code between back-ticks.
fn inline(text: &str) -> String {
    let parts = text.split('`').enumerate();
    let part = |(k, part): (usize, &str)| {
        let part = escaped_html(part);
        if k % 2 == 1 { format!("<code>{part}</code>") } else { part }
    };
    parts.map(part).collect()
}

const HEAD: &str = "<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport content=\"width=device-width\"><title>sage theory</title>
<style>
:root{color-scheme:light dark}
body{font:16px/1.5 system-ui,sans-serif;margin:0;color:#1d2230;background:#fff}
main{max-width:58rem;margin:0 auto;padding:1rem 1.2rem 4rem}
h1{line-height:1.2}h2{margin-top:2.6rem;border-top:1px solid #d5d9e2;padding-top:1.2rem;line-height:1.3}
.formula{background:#f2f4f8;border-left:3px solid #0072b2;padding:.6rem .9rem;overflow-wrap:anywhere}
.wide{overflow-x:auto}table{border-collapse:collapse;font-size:.88rem;margin:.8rem 0}
caption{text-align:left;padding:.3rem 0;color:#4a5265}
th,td{border-bottom:1px solid #e1e4ea;padding:.25rem .7rem .25rem 0;text-align:left;vertical-align:top;font-variant-numeric:tabular-nums}
figure{margin:1.2rem 0;background:#fff}figure svg{max-width:100%;height:auto}figcaption{color:#4a5265;font-size:.9rem}
.yes,.partly,.no{white-space:nowrap;padding:.05rem .45rem;border-radius:.6rem;font-size:.85em;color:#10251c;background:#bfe8d5}.partly{background:#fbe3ae}.no{background:#f7c6b5}
code{background:#f2f4f8;padding:0 .2rem}
@media (prefers-color-scheme:dark){body{color:#e6e8ee;background:#14171d}.formula,code{background:#20252f}h2,th,td{border-color:#333a48}caption,figcaption{color:#a9b1c2}a{color:#7cc4ff}figcaption{background:#14171d}}
</style><main>
";

#[cfg(test)]
mod tests {
    use super::*;
    use theory_checks::Agreement;

    #[test]
    fn numbers_have_three_digits_and_say_what_differs() {
        assert_eq!([0.0, 0.123456, 1.5, 12.34, 123.4].map(digits), ["0", "0.123", "1.50", "12.3", "123"]);
        assert_eq!(
            [1.2e-5, 47_123.4, 18_310.0, f64::INFINITY].map(digits),
            ["1.2e-5", "4.7e4", "18310", "∞"]
        );
        let number = Number::new(2.0).beside(3.0, Agreement::Factor(1.2));
        assert_eq!(shown(&number), "2 (3, differs)");
        assert_eq!(shown(&Number::new(f64::NAN)), "-");
    }

    #[test]
    fn text_is_escaped_and_ids_are_links() {
        assert_eq!(inline("a < `b & c`"), "a &lt; <code>b &amp; c</code>");
        assert_eq!(linked("T14x"), "<a href=\"#T14x\">T14x</a>");
        assert_eq!(linked("The"), "The");
        let mut out = String::new();
        let mut grid = Grid::new("of |x|", &["a"]);
        grid.row("|b|", []);
        Block::Grid(grid).markdown(&mut out).unwrap();
        assert!(out.contains("| \\|b\\| |"), "{out}");
    }
}
