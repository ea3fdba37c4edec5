//! Work on all threads whose results come in order, with bounded memory.

use rayon::prelude::*;

/// Items that are worked on before their results go to the caller.
const WINDOW: usize = 64;
/// Bytes of scenes that wait for their turn at most, for each thread, besides those of one scene.
const WINDOW_BYTES: usize = 2 << 20;

/// Applies `work` to items on all threads and passes the results to `take` in the order of the items. Stops at the
/// first `Err` of `take` and returns it. `size` is the memory of an item, bytes; few large items are held at once.
pub fn map_in_order<I: Send, T: Send, E>(
    mut items: impl Iterator<Item = I> + Send,
    size: impl Fn(&I) -> usize + Send + Sync,
    work: impl Fn(I) -> T + Sync,
    mut take: impl FnMut(T) -> Result<(), E>,
) -> Result<(), E> {
    let limit = WINDOW_BYTES * rayon::current_num_threads();
    let mut fill = || {
        let (mut window, mut bytes) = (Vec::new(), 0);
        while window.len() < WINDOW && bytes < limit {
            let Some(item) = items.next() else { break };
            bytes += size(&item);
            window.push(item);
        }
        window
    };
    let mut window = fill();
    while !window.is_empty() {
        // The next window is read while this one is worked on.
        let (results, next) =
            rayon::join(|| window.into_par_iter().with_max_len(1).map(&work).collect::<Vec<_>>(), &mut fill);
        results.into_iter().try_for_each(&mut take)?;
        window = next;
    }
    Ok(())
}
