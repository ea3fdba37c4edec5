//! Tables and rows as CSV.

use sage_core::text::table::Table;

/// A table as CSV.
pub fn of_table(table: &Table) -> String {
    csv(std::iter::once(&table.heads).chain(&table.rows))
}

/// Lines of CSV, quoted where they must be.
pub fn csv<T: AsRef<[u8]>>(rows: impl IntoIterator<Item = impl IntoIterator<Item = T>>) -> String {
    let mut writer = csv::WriterBuilder::new().flexible(true).from_writer(Vec::new());
    for row in rows {
        // Writing to memory does not fail.
        let _ = writer.write_record(row);
    }
    String::from_utf8(writer.into_inner().unwrap_or_default()).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_quoted_where_they_must_be() {
        let mut table = Table::new("A title.", &["name", "value"]);
        table.row("0 | \"x\", y", ["1".to_owned()]);
        assert_eq!(of_table(&table), "name,value\n\"0 | \"\"x\"\", y\",1\n");
    }
}
