//! How long the processes of a group have computed, as Linux says it in `/proc`.

use std::{fs, time::Duration};

use rustix::param::clock_ticks_per_second;

/// User and system time of all processes of a group, those that have ended and were waited for included.
pub(super) fn of_group(group: u32) -> Option<Duration> {
    let processes = fs::read_dir("/proc").ok()?.flatten();
    let names = processes.map(|entry| entry.path()).filter(|path| {
        let name = path.file_name().unwrap_or_default().as_encoded_bytes();
        name.iter().all(u8::is_ascii_digit)
    });
    let stats = names.filter_map(|path| fs::read_to_string(path.join("stat")).ok());
    let ticks: u64 = stats.filter_map(|stat| ticks(&stat, group)).sum();
    Some(Duration::from_secs_f64(ticks as f64 / clock_ticks_per_second() as f64))
}

/// The ticks of one process, if it is of a group.
fn ticks(stat: &str, group: u32) -> Option<u64> {
    // The name before may hold anything, parentheses too. Then: state, parent, group, …, four times.
    let (_, fields) = stat.rsplit_once(')')?;
    let fields: Vec<&str> = fields.split_whitespace().collect();
    if fields.get(2)?.parse() != Ok(group) {
        return None;
    }
    // Those of the children that it waited for count too.
    fields.get(11..15)?.iter().map(|field| field.parse::<u64>().ok()).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_those_of_the_group_alone() {
        let stat = "77 (a) b (c) S 1 42 42 0 -1 4194304 100 0 0 0 7 5 3 1 20 0 1 0 100 0 0";
        assert_eq!(ticks(stat, 42), Some(16));
        assert_eq!(ticks(stat, 1), None);
        assert_eq!(ticks("torn", 42), None);
    }
}
