//! Access to what threads share.

use std::sync::{Mutex, MutexGuard, PoisonError};

/// The content of a mutex: it is whole, whatever its last user met.
pub(super) fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
