//! Tables and rows as CSV.

use sage_core::text::table::Table;

/// A table as CSV.
pub fn of_table(table: &Table) -> String {
    csv(std::iter::once(&table.heads).chain(&table.rows))
}

/// Lines of CSV, quoted where they must be. A text that a spreadsheet would take for a formula has an apostrophe before it, as
/// spreadsheets write such texts; [`text`] takes it away.
pub fn csv<T: AsRef<str>>(rows: impl IntoIterator<Item = impl IntoIterator<Item = T>>) -> String {
    let mut writer = csv::WriterBuilder::new().flexible(true).from_writer(Vec::new());
    for row in rows {
        let cells = row.into_iter().map(|cell| match is_formula(cell.as_ref()) {
            true => format!("'{}", cell.as_ref()),
            false => cell.as_ref().to_owned(),
        });
        // Writing to memory does not fail.
        let _ = writer.write_record(cells);
    }
    String::from_utf8(writer.into_inner().unwrap_or_default()).unwrap_or_default()
}

/// The text of a cell that [`csv()`] has written.
pub fn text(cell: &str) -> &str {
    cell.strip_prefix('\'').filter(|text| is_formula(text)).unwrap_or(cell)
}

fn is_formula(cell: &str) -> bool {
    cell.starts_with(['=', '+', '@', '\t', '\r'])
        || cell.starts_with('-') && cell.parse::<f64>().is_err() && cell.len() > 1
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_is_no_formula() {
        let cells = ["=1+1", "-rf", "-0.5", "-", "@x", "plain", "'quoted"];
        let line = csv([cells]);
        assert_eq!(line, "'=1+1,'-rf,-0.5,-,'@x,plain,'quoted\n");
        let read: Vec<&str> = line.trim_end().split(',').map(text).collect();
        assert_eq!(read, cells);
    }

    #[test]
    fn cells_are_quoted_where_they_must_be() {
        let mut table = Table::new("A title.", &["name", "value"]);
        table.row("0 | \"x\", y", ["1".to_owned()]);
        assert_eq!(of_table(&table), "name,value\n\"0 | \"\"x\"\", y\",1\n");
    }
}
