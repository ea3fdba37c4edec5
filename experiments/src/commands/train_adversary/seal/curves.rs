//! The training curves: a table, and a picture of each part.

use anyhow::Result;
use sage_bench::{
    chart::line::{self, Line},
    csv_text::of_table,
};
use sage_core::text::table::Table;
use sage_run::output::Folder;

/// File of the table.
pub(super) const TABLE: &str = "curves.csv";
const HEADS: [&str; 5] = ["part", "epoch", "training_loss", "validation_loss", "rate"];

/// Losses of all epochs of all parts.
pub(super) struct Curves {
    table: Table,
    parts: Vec<(&'static str, [Vec<[f64; 2]>; 2])>,
}

impl Curves {
    pub(super) fn new() -> Self {
        Self { table: Table::new("", &HEADS), parts: Vec::new() }
    }

    /// Adds an epoch of a part.
    pub(super) fn add(&mut self, part: &'static str, epoch: u32, training: f64, validation: f64, rate: f64) {
        let cells = [f64::from(epoch), training, validation, rate].map(|x| x.to_string());
        self.table.row(part, cells);
        if self.parts.last().is_none_or(|(last, _)| *last != part) {
            self.parts.push((part, [Vec::new(), Vec::new()]));
        }
        if let Some((_, lines)) = self.parts.last_mut() {
            for (line, y) in lines.iter_mut().zip([training, validation]) {
                line.push([f64::from(epoch), y]);
            }
        }
    }

    /// Writes the table and the pictures.
    ///
    /// *Errors*: the folder cannot be written to.
    pub(super) fn write(&self, folder: &Folder) -> Result<()> {
        folder.write(TABLE, of_table(&self.table).as_bytes())?;
        for (part, [training, validation]) in &self.parts {
            let lines: Vec<Line> = [("training", training), ("validation", validation)]
                .map(|(name, points)| (name.to_owned(), points.clone()))
                .into();
            let picture = line::draw(["epoch", "loss"], lines)?;
            folder.write(&format!("{part}.svg"), picture.as_bytes())?;
        }
        Ok(())
    }
}
