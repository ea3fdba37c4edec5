//! A batch of sequences of different lengths, packed without padding.

use candle_core::{Device, Tensor, WithDType};

use crate::Error;

/// Sequences of different lengths, step by step, the longest first.
pub struct Sequences {
    /// (rows, inputs): all rows of the first step first.
    pub inputs: Tensor,
    /// Sequences that have each step. It never grows.
    pub counts: Vec<usize>,
    /// For each row of the first step, the place of its sequence among those given.
    pub order: Vec<usize>,
}

impl Sequences {
    /// *Errors*: [`Error::Mismatch`] for no sequence, and for a sequence without steps.
    pub fn new<T: WithDType, const INPUTS: usize>(given: &[&[[T; INPUTS]]]) -> Result<Self, Error> {
        if given.is_empty() {
            return Err(Error::Mismatch("no sequence to encode".to_owned()));
        }
        if let Some(index) = given.iter().position(|sequence| sequence.is_empty()) {
            return Err(Error::Mismatch(format!("sequence {index} of {} has no step", given.len())));
        }
        let mut order: Vec<usize> = (0..given.len()).collect();
        order.sort_by_key(|k| std::cmp::Reverse(given[*k].len()));
        let mut counts = Vec::with_capacity(given[order[0]].len());
        let mut numbers = Vec::with_capacity(given.iter().map(|sequence| sequence.len() * INPUTS).sum());
        for step in 0..given[order[0]].len() {
            let present = order.iter().map_while(|k| given[*k].get(step));
            let before = numbers.len();
            present.for_each(|row| numbers.extend_from_slice(row));
            counts.push((numbers.len() - before) / INPUTS);
        }
        let rows = counts.iter().sum::<usize>();
        Ok(Self { inputs: Tensor::from_vec(numbers, (rows, INPUTS), &Device::Cpu)?, counts, order })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_by_step_and_the_longest_sequence_is_first() {
        let [a, b, c] = [vec![[1.0]], vec![[2.0], [3.0], [4.0]], vec![[5.0], [6.0]]];
        let Sequences { inputs, counts, order } = Sequences::new(&[&a[..], &b, &c]).unwrap();
        assert_eq!(inputs.flatten_all().unwrap().to_vec1::<f64>().unwrap(), [2.0, 5.0, 1.0, 3.0, 6.0, 4.0]);
        assert_eq!((counts, order), (vec![3, 2, 1], vec![1, 2, 0]));
    }

    #[test]
    fn no_sequence_and_sequences_without_steps_are_refused() {
        let message = |given: &[&[[f64; 2]]]| Sequences::new(given).err().unwrap().to_string();
        assert!(message(&[]).contains("no sequence"));
        assert!(message(&[&[[0.0; 2]], &[]]).contains("sequence 1 of 2 has no step"));
    }
}
