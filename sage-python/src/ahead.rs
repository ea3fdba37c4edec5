//! Work on many items in threads of their own, with results in order, while the caller's thread waits for them and for Ctrl-C.
//! So it can call planners: no other thread ever does, and a planner that calls the package back cannot wait for itself.

use std::{
    collections::BTreeMap,
    sync::{
        Arc, Mutex, MutexGuard,
        atomic::{AtomicBool, Ordering},
        mpsc::{Receiver, RecvTimeoutError, Sender, channel},
    },
    time::Duration,
};

use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};
use sage_run::{Result, outcome::caught};

use crate::errors::{OptionError, to_python};

/// Time between two looks for Ctrl-C.
const LOOK: Duration = Duration::from_millis(50);
/// Items in work or done for each thread.
const FOR_EACH_THREAD: usize = 4;

/// A number of threads; all processors if it is not given.
///
/// *Errors*: 0, or more than 1024.
pub(crate) fn threads(given: Option<usize>) -> PyResult<usize> {
    match given {
        None => Ok(std::thread::available_parallelism().map_or(1, usize::from)),
        Some(count @ 1..=1024) => Ok(count),
        Some(count) => Err(OptionError::new_err(format!("threads is {count}; expected 1 to 1024"))),
    }
}

/// The turn of one thread to take from an iterator. Taken by two at once, results would belong to the scenes of the other.
#[derive(Default)]
pub(crate) struct Turn(Mutex<()>);

impl Turn {
    /// The turn of this thread. Looks for Ctrl-C first: a function of C that takes all of an iterator never does.
    ///
    /// *Errors*: Ctrl-C; another thread takes from this iterator.
    pub(crate) fn take(&self, py: Python<'_>) -> PyResult<MutexGuard<'_, ()>> {
        py.check_signals()?;
        self.0.try_lock().map_err(|_| {
            OptionError::new_err(
                "another thread takes from this iterator; give each thread an iterator of its own",
            )
        })
    }
}

/// The only place that starts threads. Nothing keeps a pool longer than its work, so a process that forks between two calls has
/// no thread that its child would wait for. The threads of a vector environment do stay, but a forked child starts its own.
/// candle's own pool is kept away by two variables, which `advsage/_threads.py` sets before the first use.
pub(crate) fn pool(threads: usize) -> PyResult<ThreadPool> {
    let pool = ThreadPoolBuilder::new().num_threads(threads).thread_name(|k| format!("advsage-{k}")).build();
    pool.map_err(|error| OptionError::new_err(format!("cannot start {threads} threads: {error}")))
}

/// A result with the number of its item.
type Numbered<R> = (usize, Result<R>);

type Work<T, R> = dyn Fn(T) -> Result<R> + Send + Sync;

/// Items in work, a few ahead of the one that is asked for.
pub(crate) struct Ahead<T, R> {
    pool: ThreadPool,
    work: Arc<Work<T, R>>,
    results: (Sender<Numbered<R>>, Receiver<Numbered<R>>),
    ready: BTreeMap<usize, PyResult<R>>,
    /// Number of items that were given, and of results that were taken.
    given: usize,
    taken: usize,
    most: usize,
    is_cancelled: Arc<AtomicBool>,
    /// The process that has the threads.
    process: u32,
}

impl<T: Send + 'static, R: Send + 'static> Ahead<T, R> {
    /// No work yet.
    ///
    /// *Errors*: the system starts no threads.
    pub(crate) fn new(
        threads: usize,
        work: impl Fn(T) -> Result<R> + Send + Sync + 'static,
    ) -> PyResult<Self> {
        Ok(Self {
            pool: pool(threads)?,
            work: Arc::new(work),
            results: channel(),
            ready: BTreeMap::new(),
            given: 0,
            taken: 0,
            most: FOR_EACH_THREAD * threads,
            is_cancelled: Arc::default(),
            process: std::process::id(),
        })
    }

    /// Whether another item should be given before the next result is taken.
    pub(crate) fn wants_more(&self) -> bool {
        self.given - self.taken < self.most
    }

    /// Starts the work on an item.
    pub(crate) fn give(&mut self, item: T) {
        let (number, work, sender) = (self.given, self.work.clone(), self.results.0.clone());
        let is_cancelled = self.is_cancelled.clone();
        self.given += 1;
        self.pool.spawn(move || {
            if !is_cancelled.load(Ordering::Relaxed) {
                // Nobody waits for the result of a cancelled run.
                let _ = sender.send((number, caught(|| work(item))));
            }
        });
    }

    /// Takes an exception in place of an item, as its result.
    pub(crate) fn give_failed(&mut self, error: PyErr) {
        self.ready.insert(self.given, Err(error));
        self.given += 1;
    }

    /// The next result in the order of the items; `None` after the last one that was given.
    ///
    /// *Errors*: those of the result; Ctrl-C; a child that was forked, which has no threads.
    pub(crate) fn take(&mut self, py: Python<'_>) -> PyResult<Option<R>> {
        if self.taken == self.given {
            return Ok(None);
        }
        if self.process != std::process::id() {
            return Err(OptionError::new_err(
                "this iterator was begun in another process; begin one in each process",
            ));
        }
        loop {
            if let Some(result) = self.ready.remove(&self.taken) {
                self.taken += 1;
                return result.map(Some);
            }
            let receiver = &mut self.results.1;
            match py.detach(move || receiver.recv_timeout(LOOK)) {
                Ok((number, result)) => {
                    self.ready.insert(number, result.map_err(|error| to_python(py, &error)));
                }
                Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => py.check_signals()?,
            }
        }
    }
}

impl<T, R> Drop for Ahead<T, R> {
    /// What has not begun does not begin.
    fn drop(&mut self) {
        self.is_cancelled.store(true, Ordering::Relaxed);
    }
}
