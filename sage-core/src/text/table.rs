//! Tables of text: Markdown, and what fits a terminal.

use super::wrap::COLUMNS;

/// Most columns and characters of a table in a terminal.
const MOST_COLUMNS: usize = 8;
const MOST_CHARACTERS: usize = COLUMNS;
/// Least width of an aligned column, for its rule.
const LEAST: usize = 3;

/// A table with heads.
///
/// ```
/// use sage_core::text::table::Table;
///
/// let mut table = Table::new("", &["driver"]);
/// table.heads.push("contacts".to_owned());
/// table.row("idm", ["3".to_owned()]);
/// assert_eq!(table.markdown(), "| driver | contacts |\n| --- | ---: |\n| idm | 3 |\n");
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    /// Title above it; empty for none.
    pub title: String,
    /// Heads of the columns.
    pub heads: Vec<String>,
    /// Cells, row by row.
    pub rows: Vec<Vec<String>>,
    /// Number of first columns that name a row.
    pub names: usize,
}

impl Table {
    /// A table of texts without rows.
    pub fn new(title: impl Into<String>, heads: &[&str]) -> Self {
        let names = heads.len();
        let heads = heads.iter().map(|head| (*head).to_owned()).collect();
        Self { title: title.into(), heads, rows: Vec::new(), names }
    }

    /// Adds a row: its name and its other cells.
    pub fn row(&mut self, name: impl Into<String>, cells: impl IntoIterator<Item = String>) {
        self.rows.push(std::iter::once(name.into()).chain(cells).collect());
    }

    /// The table as Markdown.
    pub fn markdown(&self) -> String {
        let mut out = if self.title.is_empty() { String::new() } else { format!("{}\n\n", self.title) };
        // A bar would end the cell, unless it is escaped already.
        let escaped = |cell: &String| cell.replace("\\|", "|").replace('|', "\\|");
        let line = |cells: &[String]| {
            let cells: Vec<String> = cells.iter().map(escaped).collect();
            format!("| {} |\n", cells.join(" | "))
        };
        out += &line(&self.heads);
        let rule = |column: usize| if column < self.names { " --- |" } else { " ---: |" };
        out += &format!("|{}\n", (0..self.heads.len()).map(rule).collect::<String>());
        self.rows.iter().for_each(|row| out += &line(row));
        out
    }

    /// The table for a terminal: the columns that fit, aligned.
    pub fn terminal(&self) -> String {
        self.narrow().aligned()
    }

    /// The table with columns of equal width. It is still Markdown.
    pub fn aligned(&self) -> String {
        let cells = |k: usize| self.rows.iter().filter_map(move |row| row.get(k)).chain([&self.heads[k]]);
        let length = |cell: &String| cell.chars().count();
        let widths: Vec<usize> =
            (0..self.heads.len()).map(|k| cells(k).map(length).max().unwrap_or(0).max(LEAST)).collect();
        let padded = |row: &Vec<String>| -> Vec<String> {
            let one = |(k, cell): (usize, &String)| {
                let space = " ".repeat(widths[k].saturating_sub(length(cell)));
                if self.is_text(k) { format!("{cell}{space}") } else { format!("{space}{cell}") }
            };
            row.iter().enumerate().map(one).collect()
        };
        let rule = |k: usize| {
            let dashes = "-".repeat(widths[k]);
            if self.is_text(k) { dashes } else { format!("{}:", &dashes[1..]) }
        };
        let line = |cells: &[String]| format!("| {} |\n", cells.join(" | "));
        let mut out = if self.title.is_empty() { String::new() } else { format!("{}\n\n", self.title) };
        out += &line(&padded(&self.heads));
        out += &line(&(0..widths.len()).map(rule).collect::<Vec<_>>());
        self.rows.iter().for_each(|row| out += &line(&padded(row)));
        out
    }

    /// Whether a column holds text: it names a row, or a cell of it has words.
    fn is_text(&self, k: usize) -> bool {
        let is_words = |cell: &String| cell.chars().filter(|c| c.is_alphabetic()).count() > 4;
        k < self.names || self.rows.iter().filter_map(|row| row.get(k)).any(is_words)
    }

    /// The columns that fit a terminal: those that name a row, and of the others the first.
    pub fn narrow(&self) -> Self {
        let width = |k: usize| {
            let cells = self.rows.iter().filter_map(|row| row.get(k)).chain([&self.heads[k]]);
            cells.map(|cell| cell.chars().count()).max().unwrap_or(0).max(LEAST) + 3
        };
        let (mut kept, mut used) = (0, 1);
        while kept < self.heads.len().min(MOST_COLUMNS) {
            used += width(kept);
            if kept >= self.names && used > MOST_CHARACTERS {
                break;
            }
            kept += 1;
        }
        // One value at least.
        kept = kept.max((self.names + 1).min(self.heads.len()));
        let title = match self.heads.len() - kept {
            0 => self.title.clone(),
            1 => format!("{} (1 more column with --wide)", self.title).trim_start().to_owned(),
            left => format!("{} ({left} more columns with --wide)", self.title).trim_start().to_owned(),
        };
        Self {
            heads: self.heads[..kept].to_vec(),
            rows: self.rows.iter().map(|row| row[..kept.min(row.len())].to_vec()).collect(),
            title,
            ..self.clone()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(columns: usize) -> Table {
        let text = |k: usize| format!("value {k}");
        Table {
            title: "A title.".into(),
            heads: (0..columns).map(text).collect(),
            rows: vec![(0..columns).map(|k| format!("{k} | \"x\", y")).collect()],
            names: 1,
        }
    }

    #[test]
    fn aligned_columns_have_one_width() {
        let mut table = Table { names: 1, ..Table::new("", &["scene", "n", "why"]) };
        table.row("crossing", ["3".to_owned(), "never hits".to_owned()]);
        let expected = "| scene    |   n | why        |\n| -------- | --: | ---------- |\n| crossing |   3 | never hits |\n";
        assert_eq!(table.terminal(), expected);
    }

    #[test]
    fn cells_are_escaped() {
        let table = table(2);
        assert_eq!(
            table.markdown(),
            "A title.\n\n| value 0 | value 1 |\n| --- | ---: |\n| 0 \\| \"x\", y | 1 \\| \"x\", y |\n"
        );
    }

    #[test]
    fn a_terminal_gets_at_most_eight_columns_of_a_hundred_characters() {
        let narrow = table(20).narrow();
        assert!(narrow.heads.len() <= 8 && narrow.rows[0].len() == narrow.heads.len());
        assert!(narrow.markdown().lines().all(|line| line.chars().count() <= 110), "{}", narrow.markdown());
        assert_eq!(table(2).narrow(), table(2));
        let long = Table { heads: vec!["x".repeat(200), "y".repeat(200)], names: 1, ..Table::default() };
        assert_eq!(long.narrow().heads.len(), 2, "one value is always shown");
    }
}
