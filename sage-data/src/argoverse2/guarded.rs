//! Calls of the Parquet library, which panics at some damaged files.

use std::{
    cell::Cell,
    panic::{AssertUnwindSafe, catch_unwind, set_hook, take_hook},
    sync::Once,
};

thread_local! {
    /// Whether a panic of this thread is expected.
    static EXPECTED: Cell<bool> = const { Cell::new(false) };
}

/// The result of a call; `None` if it panics. Nothing is printed then.
pub(super) fn guarded<T>(call: impl FnOnce() -> T) -> Option<T> {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let print = take_hook();
        set_hook(Box::new(move |info| {
            if !EXPECTED.get() {
                print(info);
            }
        }));
    });
    let was = EXPECTED.replace(true);
    // What the call has changed is dropped with it.
    let result = catch_unwind(AssertUnwindSafe(call));
    EXPECTED.set(was);
    result.ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_nothing_and_a_result_stays() {
        assert_eq!(guarded(|| 7), Some(7));
        assert_eq!(
            guarded(|| if EXPECTED.get() {
                panic!("damaged")
            }),
            None
        );
        assert!(!EXPECTED.get());
    }
}
