//! The table at the end of a run: what came of the drives of each driver at each attack.

use std::path::Path;

use advsage::rows::drive::DriveRow;
use sage_core::text::table::Table;
use sage_run::scene_queue::{Input, is_row_of};

use super::Job;

/// Drives of one driver at one attack.
#[derive(Default)]
struct Tally {
    drives: usize,
    contacts: usize,
    at_fault: usize,
    /// Drives that left the road where the recording does not, and all on a map with road edges.
    off_road: [usize; 2],
    attacks: usize,
    avoidable: [usize; 2],
    /// Sum of the shares of the routes that are driven, and their number.
    completion: (f64, usize),
}

impl Tally {
    fn add(&mut self, row: &DriveRow) {
        let is_attack = row.verdict().is_some_and(|verdict| verdict.is_attack);
        self.drives += 1;
        self.contacts += usize::from(!row.contacts.is_empty());
        self.at_fault +=
            usize::from(row.contacts.first().is_some_and(|contact| contact.at_fault == Some(true)));
        self.off_road[0] +=
            usize::from(row.off_road_measured && row.off_road.is_some() && !row.off_road_as_recorded);
        self.off_road[1] += usize::from(row.off_road_measured);
        self.attacks += usize::from(is_attack);
        if let Some(completion) = row.completion {
            self.completion.0 += completion;
            self.completion.1 += 1;
        }
        let avoidable =
            row.attack.as_ref().and_then(|attack| attack.avoidable.avoidable).filter(|_| is_attack);
        self.avoidable[0] += usize::from(avoidable == Some(true));
        self.avoidable[1] += usize::from(avoidable.is_some());
    }

    /// A number with its share of the drives.
    fn share(&self, count: usize) -> String {
        format!("{count} ({:.0} %)", 100.0 * count as f64 / self.drives.max(1) as f64)
    }
}

fn of([some, all]: [usize; 2]) -> String {
    if all == 0 { "-".to_owned() } else { format!("{some} of {all}") }
}

/// The table of a run; `None` if it has at most one drive.
pub(super) fn table(simulation: &Job, folder: &Path, inputs: &[&Input], run_hash: &str) -> Option<Table> {
    let variants = simulation.variants();
    let mut tallies: Vec<Tally> = Vec::new();
    tallies.resize_with(simulation.egos.len() * variants.len(), Tally::default);
    for input in inputs {
        for ((.., file), tally) in simulation.files(&input.scene).zip(&mut tallies) {
            let path = folder.join(file);
            let row = if is_row_of(&path, run_hash) { DriveRow::read(&path) } else { None };
            row.iter().for_each(|row| tally.add(row));
        }
    }
    if tallies.iter().map(|tally| tally.drives).sum::<usize>() < 2 {
        return None;
    }
    let is_attacked = variants.iter().any(|variant| !variant.is_empty());
    let attacked: &[&str] = if is_attacked { &["attack", "attacked", "avoidable"] } else { &[] };
    let heads =
        [&["driver"], attacked, &["drives", "contact", "at fault", "off road", "completion"]].concat();
    let mut table = Table { names: 1 + usize::from(is_attacked), ..Table::new("", &heads) };
    for (k, tally) in tallies.iter().enumerate() {
        let (ego, variant) = (&simulation.egos[k / variants.len()], &variants[k % variants.len()]);
        let mut cells = Vec::new();
        if is_attacked {
            cells.extend([variant.clone(), tally.share(tally.attacks), of(tally.avoidable)]);
        }
        cells.push(tally.drives.to_string());
        cells.extend([tally.share(tally.contacts), tally.share(tally.at_fault), of(tally.off_road)]);
        // How much of the recorded route it drives: whoever stands is at fault in nothing.
        let (sum, drives) = tally.completion;
        cells.push(if drives == 0 {
            "-".to_owned()
        } else {
            format!("{:.0} %", 100.0 * sum / drives as f64)
        });
        table.row(&ego.label, cells);
    }
    Some(table)
}
