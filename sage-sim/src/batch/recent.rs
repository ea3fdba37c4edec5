//! A map that forgets its oldest entries.

use std::{collections::HashMap, hash::Hash};

/// A map of a bounded number of entries. When it is full, the entry that was put in first goes.
pub struct Recent<K, V> {
    entries: HashMap<K, (u64, V)>,
    next: u64,
    most: usize,
}

impl<K: Eq + Hash + Clone, V> Recent<K, V> {
    /// An empty map of at most `most` entries, at least one.
    pub fn new(most: usize) -> Self {
        Self { entries: HashMap::new(), next: 0, most: most.max(1) }
    }

    /// The value of a key.
    pub fn get(&self, key: &K) -> Option<&V> {
        self.entries.get(key).map(|(_, value)| value)
    }

    /// Puts in a value, in place of an older one of its key.
    pub fn put(&mut self, key: K, value: V) {
        self.entries.insert(key, (self.next, value));
        self.next += 1;
        if self.entries.len() > self.most {
            let oldest = self.entries.iter().min_by_key(|(_, (number, _))| *number);
            if let Some(oldest) = oldest.map(|(key, _)| key.clone()) {
                self.entries.remove(&oldest);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_entry_goes_first() {
        let mut recent = Recent::new(2);
        for (key, value) in [("a", 1), ("b", 2), ("a", 3), ("c", 4)] {
            recent.put(key, value);
        }
        assert_eq!([recent.get(&"a"), recent.get(&"b"), recent.get(&"c")], [Some(&3), None, Some(&4)]);
    }
}
