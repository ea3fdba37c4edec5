//! What happens when the process is told to stop: unfinished files and locks go, what is whole stays.

/// Watches for Ctrl-C and SIGTERM on a thread of its own. Without it the next run cleans up.
#[cfg(unix)]
pub(crate) fn clean_up_when_stopped() {
    use signal_hook::{
        consts::{SIGINT, SIGTERM},
        iterator::Signals,
        low_level::emulate_default_handler,
    };
    let Ok(mut signals) = Signals::new([SIGINT, SIGTERM]) else { return };
    std::thread::spawn(move || {
        if let Some(signal) = signals.forever().next() {
            sage_core::files::discard_unfinished();
            // Ends the process as the signal would have, so that a shell sees it.
            let _ = emulate_default_handler(signal);
        }
    });
}

#[cfg(not(unix))]
pub(crate) fn clean_up_when_stopped() {}
