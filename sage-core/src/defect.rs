//! Panics are defects of this program. One that a scene brings about costs that scene, not the run.
//!
//! Work on one scene goes through [`caught`] where a loop over scenes is; what it has changed is dropped with it. The hook
//! notes where it panicked. A defect must not pass unseen, so it has an exit status of its own. Where a library is known to
//! panic at damaged files, [`expected`] makes a panic an answer.

use std::{
    cell::{Cell, RefCell},
    panic::{self, AssertUnwindSafe, PanicHookInfo},
    sync::{
        Once,
        atomic::{AtomicUsize, Ordering},
    },
};

thread_local! {
    /// Whether a panic of this thread becomes a value, so that nothing is printed of it.
    static IS_CAUGHT: Cell<bool> = const { Cell::new(false) };
    /// Where this thread panicked last.
    static PLACE: RefCell<Option<String>> = const { RefCell::new(None) };
}

/// Number of defects that were caught.
static COUNT: AtomicUsize = AtomicUsize::new(0);

/// A panic of this program, as an error.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "a defect of this program, not of the scene: {message}{}; please report it with the scene and the command",
    place.as_ref().map_or(String::new(), |place| format!(" ({place})"))
)]
pub struct Defect {
    /// What the panic said.
    pub message: String,
    /// File and line; `None` if another thread panicked for this one.
    pub place: Option<String>,
}

/// The result of some work, or the defect that it met.
///
/// *Errors*: the work panics.
pub fn caught<T>(work: impl FnOnce() -> T) -> Result<T, Defect> {
    run(work).inspect_err(|_| {
        COUNT.fetch_add(1, Ordering::Relaxed);
    })
}

/// The result of a call that may panic at damaged input; `None` if it does.
pub fn expected<T>(call: impl FnOnce() -> T) -> Option<T> {
    run(call).ok()
}

/// Number of defects that [`caught`] met in this process.
pub fn count() -> usize {
    COUNT.load(Ordering::Relaxed)
}

fn run<T>(work: impl FnOnce() -> T) -> Result<T, Defect> {
    static HOOK: Once = Once::new();
    HOOK.call_once(|| {
        let print = panic::take_hook();
        panic::set_hook(Box::new(move |info| note(info, &print)));
    });
    let before = IS_CAUGHT.replace(true);
    let outcome = panic::catch_unwind(AssertUnwindSafe(work));
    IS_CAUGHT.set(before);
    outcome.map_err(|panic| {
        let text = panic.downcast_ref::<String>().map(String::as_str);
        let text = text.or_else(|| panic.downcast_ref::<&str>().copied()).unwrap_or("no message");
        Defect { message: text.to_owned(), place: PLACE.take() }
    })
}

/// Notes where a caught panic happens; others are printed.
fn note(info: &PanicHookInfo, print: &dyn Fn(&PanicHookInfo)) {
    if IS_CAUGHT.get() {
        PLACE.set(info.location().map(|place| format!("{}:{}", place.file(), place.line())));
    } else {
        print(info);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_panic_is_an_error_that_says_where_and_results_stay() {
        let before = count();
        assert_eq!(caught(|| 7), Ok(7));
        let defect = caught(|| {
            if IS_CAUGHT.get() {
                panic!("index {}", 80)
            }
        })
        .unwrap_err();
        assert_eq!(defect.message, "index 80");
        assert!(defect.place.as_deref().is_some_and(|place| place.contains("defect.rs:")), "{defect:?}");
        assert!(defect.to_string().contains("please report it"), "{defect}");
        assert!(count() > before && !IS_CAUGHT.get());
        assert_eq!(
            expected(|| if IS_CAUGHT.get() {
                panic!("damaged")
            }),
            None
        );
        // One inside another is told apart.
        let inner = caught(|| {
            caught(|| {
                if IS_CAUGHT.get() {
                    panic!("inner")
                }
            })
            .is_err()
                && IS_CAUGHT.get()
        });
        assert_eq!(inner, Ok(true));
    }
}
