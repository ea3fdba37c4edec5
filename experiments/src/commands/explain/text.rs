//! An explanation as text.

use sage_core::{selection_outcome::SelectionOutcome, text::table::Table, text::wrap::wrapped};
use sage_run::terminal;

use super::explanation::{Explanation, ValuedCandidate};

/// An explanation in words, with the values of the best candidates.
pub(super) fn text(one: &Explanation) -> String {
    let mut out =
        format!("{}\n  {}\n", wrapped(&format!("{}: {}", one.attack, words(one)), 2), one.counts.words());
    if let Some(note) = &one.note {
        out += &format!("{}\n", wrapped(&format!("  note: {}", terminal::escaped_name(note)), 4));
    }
    for (head, causes) in [
        ("hits infeasible, over all 8 s", one.counts.violated()),
        ("hits not believable", one.counts.doubted()),
    ] {
        if !causes.is_empty() {
            let line = format!("  {head}: {}", terminal::escaped_name(&causes.join(", ")));
            out += &format!("{}\n", wrapped(&line, 4));
        }
    }
    out + &values(one)
}

/// What came of the selection, in words.
fn words(one: &Explanation) -> String {
    match one.outcome {
        SelectionOutcome::NotPreferred => {
            let hit = one.best.iter().find(|candidate| candidate.feasible && candidate.contact.is_some());
            let loss = hit.zip(one.best.first()).and_then(|(hit, chosen)| hit.largest_loss(chosen));
            let loss =
                loss.map_or(String::new(), |(name, loss)| format!(", by {:.2} in `{name}` above all", -loss));
            format!("{}{loss}", one.counts.outcome_words(one.outcome))
        }
        SelectionOutcome::NotBelievable => {
            format!("{}: {}", one.outcome.words(), one.selected_unbelievable.join(", "))
        }
        other => other.words(),
    }
}

/// A value with two digits, and no minus before a zero.
fn hundredths(value: f64) -> String {
    let text = format!("{value:.2}");
    if text == "-0.00" { "0.00".to_owned() } else { text }
}

/// The values of the best candidates, and what they consist of.
fn values(one: &Explanation) -> String {
    let names = one.best.first().map_or(&[][..], |candidate| &candidate.terms);
    let heads = ["candidate", "contact", "value"].map(str::to_owned).into_iter();
    let row = |candidate: &ValuedCandidate| {
        let mut name = candidate.number.to_string();
        if candidate.is_chosen {
            name += if one.is_refined { ", refined" } else { ", selected" };
        }
        if !candidate.feasible {
            name += ", infeasible";
        } else if candidate.is_doubted {
            name += ", not believable";
        }
        let contact = candidate.contact.map_or("-".to_owned(), |step| format!("{:.1} s", step as f64 / 10.0));
        let terms = candidate.terms.iter().map(|(_, value)| hundredths(*value));
        [name, contact, hundredths(candidate.value)].into_iter().chain(terms).collect()
    };
    let table = Table {
        title: String::new(),
        heads: heads.chain(names.iter().map(|(name, _)| name.clone())).collect(),
        rows: one.best.iter().map(row).collect(),
        names: 1,
    };
    format!("\n{}", table.terminal())
}
