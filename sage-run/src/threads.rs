//! The threads that work on scenes.

use std::io;

use advsage::WithContext as _;

use crate::Result;

/// Builds the thread pool that processes scenes; all cores without a number.
///
/// *Errors*: the system cannot start so many threads.
pub fn build_pool(threads: Option<u16>) -> Result<()> {
    let all = || std::thread::available_parallelism().map_or(1, usize::from);
    let threads = threads.map_or_else(all, usize::from);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build_global();
    Ok(pool.map_err(io::Error::other).with_context(|| format!("cannot start {threads} threads"))?)
}
