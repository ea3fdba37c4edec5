//! Parts of a page, as Markdown and as HTML.

use sage_core::text::table::Table;
use sage_run::terminal::escaped_html;
use theory_checks::{Figure, Verdict};

use super::{FIGURES, VERDICTS};

/// A part of the page.
pub(super) enum Block<'a> {
    /// Level, anchor and text.
    Heading(usize, String, String),
    Text(String),
    /// A label and its text.
    Labelled(&'a str, String),
    Table(Table),
    /// File name without folder, and the figure.
    Figure(String, &'a Figure),
}

impl Block<'_> {
    /// The part as Markdown.
    pub(super) fn markdown(&self) -> String {
        match self {
            Self::Heading(level, _, text) => format!("{} {text}\n\n", "#".repeat(*level)),
            Self::Text(text) => format!("{text}\n\n"),
            Self::Labelled("Formula", text) => format!("**Formula.** `{text}`\n\n"),
            Self::Labelled(label, text) => format!("**{label}.** {text}\n\n"),
            Self::Figure(file, figure) => format!("![{}]({FIGURES}/{file})\n\n", figure.title),
            Self::Table(table) => {
                let colon = if table.title.is_empty() { "" } else { ":" };
                let titled = Table { title: format!("{}{colon}", table.title), ..table.clone() };
                format!("{}\n", titled.markdown())
            }
        }
    }

    /// The part as HTML, a figure as the given SVG.
    pub(super) fn html(&self, svg: &str) -> String {
        match self {
            Self::Heading(level, anchor, text) => {
                format!("<h{level} id=\"{anchor}\">{}</h{level}>\n", inline(text))
            }
            Self::Text(text) => format!("<p>{}</p>\n", inline(text)),
            Self::Labelled("Formula", text) => format!("<p class=formula>{}</p>\n", escaped_html(text)),
            Self::Labelled(label, text) => format!("<p><b>{label}.</b> {}</p>\n", inline(text)),
            Self::Figure(_, figure) => {
                format!("<figure>{svg}<figcaption>{}</figcaption></figure>\n", inline(&figure.title))
            }
            Self::Table(table) => {
                let caption = match &*table.title {
                    "" => String::new(),
                    title => format!("<caption>{}</caption>", inline(title)),
                };
                let row = |tag: &str, cells: &[String]| -> String {
                    let cells = cells.iter().map(|cell| format!("<{tag}>{}</{tag}>", linked(cell)));
                    format!("<tr>{}</tr>", cells.collect::<String>())
                };
                let rows: String = table.rows.iter().map(|cells| row("td", cells)).collect();
                format!("<div class=wide><table>{caption}{}{rows}</table></div>\n", row("th", &table.heads))
            }
        }
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

/// What stands before the parts of a page in HTML.
pub(super) const HEAD: &str = "<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport content=\"width=device-width\"><title>sage theory</title>
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

    #[test]
    fn text_is_escaped_and_ids_are_links() {
        assert_eq!(inline("a < `b & c`"), "a &lt; <code>b &amp; c</code>");
        assert_eq!(linked("T14x"), "<a href=\"#T14x\">T14x</a>");
        assert_eq!(linked("The"), "The");
        let mut table = Table::new("of |x|", &["a"]);
        table.row("|b|", []);
        let out = Block::Table(table).markdown();
        assert!(out.contains("| \\|b\\| |"), "{out}");
    }
}
