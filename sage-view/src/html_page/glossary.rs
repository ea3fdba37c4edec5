//! The words of the glossary, as pages show them.

use sage_core::text::escaped_html;

/// A table of words, meanings and links.
const GLOSSARY: &str = include_str!("../../../docs/glossary.md");

/// Words with their meanings.
fn words() -> impl Iterator<Item = [&'static str; 2]> {
    // After the head of the table and the line below it.
    let rows = GLOSSARY.lines().filter_map(|line| line.strip_prefix("| ")).skip(2);
    rows.filter_map(|row| {
        let mut cells = row.split(" | ");
        Some([cells.next()?, cells.next()?])
    })
}

/// The glossary as a list of definitions.
pub(super) fn html() -> String {
    let definition =
        |[word, meaning]: [&str; 2]| format!("<dt>{}</dt><dd>{}</dd>\n", escaped_html(word), plain(meaning));
    words().map(definition).collect()
}

fn plain(meaning: &str) -> String {
    escaped_html(&meaning.replace('`', ""))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_row_of_the_table_is_a_word_with_a_meaning() {
        let words: Vec<[&str; 2]> = words().collect();
        assert!(words.len() > 15 && words[0][0] == "ego, driver", "{words:?}");
        assert!(words.iter().all(|[word, meaning]| !word.is_empty() && meaning.len() > 20));
        assert_eq!(html().matches("<dt>").count(), words.len());
    }
}
