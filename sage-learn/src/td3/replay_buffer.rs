//! The replay buffer: the newest transitions, drawn uniformly with replacement.
//!
//! A row is an observation and how it was reached: the distance back to the row of the observation before it, the
//! action, the reward, and whether the episode ended there. So each observation is stored once, episodes of several
//! environments may interleave, and the first row of an episode is no transition.

use std::io::{self, Read, Write};

use sage_core::seed::Rng;

use super::TransitionBatch;

/// Rows beyond the transitions: one in sixteen is the start of an episode, at most.
const STARTS: usize = 16;
/// Draws in vain after which a buffer counts as empty.
const MOST_DRAWS: usize = 1000;

/// One transition, as it enters the buffer.
#[derive(Clone, Copy, Debug)]
pub struct Transition<'a> {
    /// Number of the row of the observation before the step.
    pub from: u64,
    /// Action.
    pub action: &'a [f32],
    /// Reward.
    pub reward: f32,
    /// Whether the step ended the episode by arrival or failure. A limit of steps is no end of this kind.
    pub is_terminal: bool,
    /// Observation after the step: the last one of the episode where it ended, not the first of the next.
    pub next: &'a [f32],
}

/// A ring of rows.
///
/// ```
/// use sage_learn::{ReplayBuffer, Transition};
///
/// // Observations of two numbers, actions of one.
/// let mut buffer = ReplayBuffer::new(100, [2, 1]);
/// let from = buffer.start(&[0.0, 0.0]);
/// let next = &[0.1, 0.0];
/// let from = buffer.step(&Transition { from, action: &[0.5], reward: 1.0, is_terminal: false, next });
/// // Each observation is stored once: two of them make a transition.
/// assert_eq!((from, buffer.written_count()), (1, 2));
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct ReplayBuffer {
    sizes: [usize; 2],
    capacity: usize,
    /// Rows written so far; the ring holds the newest.
    written: u64,
    observations: Vec<f32>,
    actions: Vec<f32>,
    rewards: Vec<f32>,
    /// Distance to the row before; 0 for the first of an episode, negative where the episode ended.
    back: Vec<i32>,
}

impl ReplayBuffer {
    /// An empty buffer for about `transitions` transitions of given observation and action sizes.
    pub fn new(transitions: usize, sizes: [usize; 2]) -> Self {
        let capacity = (transitions + transitions / STARTS).max(2);
        Self {
            sizes,
            capacity,
            written: 0,
            observations: Vec::with_capacity(capacity * sizes[0]),
            actions: Vec::with_capacity(capacity * sizes[1]),
            rewards: Vec::with_capacity(capacity),
            back: Vec::with_capacity(capacity),
        }
    }

    /// Number of rows written so far, which is the number of the next row.
    pub fn written_count(&self) -> u64 {
        self.written
    }

    /// Adds the first observation of an episode. Returns the number of its row.
    pub fn start(&mut self, observation: &[f32]) -> u64 {
        let zeros = [0.0; 16];
        match zeros.get(..self.sizes[1]) {
            Some(action) => self.write(observation, action, 0.0, 0),
            None => self.write(observation, &vec![0.0; self.sizes[1]], 0.0, 0),
        }
    }

    /// Adds a transition. Returns the number of the row of its last observation.
    pub fn step(&mut self, transition: &Transition) -> u64 {
        let Transition { from, action, reward, is_terminal, next } = *transition;
        // A distance beyond the ring is never drawn.
        let back = i32::try_from(self.written - from).unwrap_or(i32::MAX);
        self.write(next, action, reward, if is_terminal { -back } else { back })
    }

    fn write(&mut self, observation: &[f32], action: &[f32], reward: f32, back: i32) -> u64 {
        let number = self.written;
        let row = (number % self.capacity as u64) as usize;
        if row == self.back.len() {
            self.observations.extend_from_slice(observation);
            self.actions.extend_from_slice(action);
            self.rewards.push(reward);
            self.back.push(back);
        } else {
            let [o, a] = self.sizes;
            self.observations[row * o..][..o].copy_from_slice(observation);
            self.actions[row * a..][..a].copy_from_slice(action);
            self.rewards[row] = reward;
            self.back[row] = back;
        }
        self.written += 1;
        number
    }

    /// Number of the oldest row.
    pub fn oldest(&self) -> u64 {
        self.written - self.back.len() as u64
    }

    /// Draws a batch. `false` if there is no transition to draw.
    pub fn draw(&self, rows: &mut Rng, to: &mut TransitionBatch<f32>) -> bool {
        let [o, a] = self.sizes;
        let capacity = self.capacity as u64;
        for k in 0..to.rewards.len() {
            let Some((number, back)) = self.draw_one(rows) else { return false };
            let row = (number % capacity) as usize;
            let before = ((number - u64::from(back.unsigned_abs())) % capacity) as usize;
            to.observations[k * o..][..o].copy_from_slice(&self.observations[before * o..][..o]);
            to.next_observations[k * o..][..o].copy_from_slice(&self.observations[row * o..][..o]);
            to.actions[k * a..][..a].copy_from_slice(&self.actions[row * a..][..a]);
            to.rewards[k] = self.rewards[row];
            to.not_terminal[k] = if back < 0 { 0.0 } else { 1.0 };
        }
        true
    }

    /// Number and distance of a random transition of which both rows are in the ring.
    fn draw_one(&self, rows: &mut Rng) -> Option<(u64, i32)> {
        let oldest = self.oldest();
        (0..MOST_DRAWS).find_map(|_| {
            let number = oldest + rows.below(self.back.len()) as u64;
            let back = *self.back.get((number % self.capacity as u64) as usize)?;
            let is_whole = back != 0 && number - oldest >= u64::from(back.unsigned_abs());
            is_whole.then_some((number, back))
        })
    }

    /// Whether every number is finite.
    pub fn is_finite(&self) -> bool {
        self.observations.iter().chain(&self.actions).chain(&self.rewards).all(|x| x.is_finite())
    }

    /// Bytes of a row in a log.
    pub fn row_bytes(&self) -> usize {
        4 * (self.sizes[0] + self.sizes[1] + 2)
    }

    /// Writes the rows from number `from` on, little-endian.
    ///
    /// *Errors*: as the writer; rows that the ring no longer holds.
    pub fn write_rows(&self, from: u64, to: &mut impl Write) -> io::Result<()> {
        if from < self.oldest() {
            return Err(io::Error::other(format!("row {from} is no longer in the replay buffer")));
        }
        let [o, a] = self.sizes;
        let mut bytes = Vec::with_capacity(self.row_bytes());
        for number in from..self.written {
            let row = (number % self.capacity as u64) as usize;
            bytes.clear();
            bytes.extend_from_slice(&self.back[row].to_le_bytes());
            let numbers = self.observations[row * o..][..o].iter().chain(&self.actions[row * a..][..a]);
            numbers.chain([&self.rewards[row]]).for_each(|x| bytes.extend_from_slice(&x.to_le_bytes()));
            to.write_all(&bytes)?;
        }
        Ok(())
    }

    /// Empties the buffer for [`ReplayBuffer::read_rows`] of `count` rows; `written` is the number of the row after the
    /// last of them.
    pub fn restart(&mut self, written: u64, count: u64) {
        let [o, a] = self.sizes;
        self.written = written - count;
        let held = if count == self.capacity as u64 { self.capacity } else { 0 };
        // A full ring may begin at any of its rows.
        self.observations.resize(held * o, 0.0);
        self.actions.resize(held * a, 0.0);
        self.rewards.resize(held, 0.0);
        self.back.resize(held, 0);
    }

    /// Reads rows that were written.
    ///
    /// *Errors*: as the reader; a number that is not finite.
    pub fn read_rows(&mut self, count: u64, from: &mut impl Read) -> io::Result<()> {
        let [o, a] = self.sizes;
        let mut bytes = vec![0; self.row_bytes()];
        let mut numbers = vec![0.0_f32; o + a + 1];
        for _ in 0..count {
            from.read_exact(&mut bytes)?;
            let (back, rest) = bytes.split_at(4);
            let back = i32::from_le_bytes([back[0], back[1], back[2], back[3]]);
            for (x, bytes) in numbers.iter_mut().zip(rest.chunks_exact(4)) {
                *x = f32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
            }
            if let Some(column) = numbers.iter().position(|x| !x.is_finite()) {
                let problem =
                    format!("row {} of the replay buffer: number {column} is not finite", self.written);
                return Err(io::Error::other(problem));
            }
            self.write(&numbers[..o], &numbers[o..o + a], numbers[o + a], back);
        }
        Ok(())
    }

    /// Number of rows that a resumed buffer needs of those written.
    pub fn rows_kept(&self, written: u64) -> u64 {
        written.min(self.capacity as u64)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Episodes of `length` steps; observation = number of the row.
    fn filled(transitions: usize, steps: usize, length: usize) -> ReplayBuffer {
        let mut buffer = ReplayBuffer::new(transitions, [1, 1]);
        let mut at = buffer.start(&[0.0]);
        for step in 1..=steps {
            let next = [buffer.written_count() as f32];
            let is_terminal = step % length == 0;
            at = buffer.step(&Transition { from: at, action: &[0.5], reward: 1.0, is_terminal, next: &next });
            if is_terminal {
                at = buffer.start(&[buffer.written_count() as f32]);
            }
        }
        buffer
    }

    #[test]
    fn draws_are_whole_transitions_and_cover_all() {
        let buffer = filled(64, 500, 9);
        let mut batch = TransitionBatch::new(2000, 1, 1);
        assert!(buffer.draw(&mut Rng::new(1, "buffer", "test"), &mut batch));
        let mut seen = std::collections::BTreeSet::new();
        for k in 0..2000 {
            let (from, to) = (batch.observations[k], batch.next_observations[k]);
            assert_eq!(to, from + 1.0);
            assert_eq!(batch.not_terminal[k] == 0.0, to as usize % 10 == 9);
            seen.insert(to as u64);
        }
        assert!(seen.iter().all(|row| *row > buffer.oldest()));
        assert!(seen.len() >= 60, "{}", seen.len());
    }

    #[test]
    fn rows_survive_a_log() {
        let buffer = filled(64, 500, 9);
        let mut bytes = Vec::new();
        let kept = buffer.rows_kept(buffer.written_count());
        buffer.write_rows(buffer.written_count() - kept, &mut bytes).expect("memory");
        let mut again = ReplayBuffer::new(64, [1, 1]);
        again.restart(buffer.written_count(), kept);
        again.read_rows(kept, &mut &bytes[..]).expect("the bytes just written");
        let draws = |buffer: &ReplayBuffer| {
            let mut batch = TransitionBatch::new(100, 1, 1);
            assert!(buffer.draw(&mut Rng::new(2, "buffer", "test"), &mut batch));
            batch
        };
        assert_eq!(draws(&buffer), draws(&again));
        bytes[4..8].copy_from_slice(&f32::NAN.to_le_bytes());
        again.restart(buffer.written_count(), kept);
        let error = again.read_rows(kept, &mut &bytes[..]).expect_err("NaN");
        assert!(error.to_string().contains("not finite"), "{error}");
    }

    #[test]
    fn an_empty_buffer_gives_no_batch() {
        let mut buffer = ReplayBuffer::new(10, [1, 1]);
        buffer.start(&[1.0]);
        let mut batch = TransitionBatch::new(1, 1, 1);
        assert!(!buffer.draw(&mut Rng::new(1, "buffer", "test"), &mut batch));
    }
}
