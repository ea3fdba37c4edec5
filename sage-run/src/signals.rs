//! Clean-up on Ctrl-C and SIGTERM: unfinished files and locks are removed, planners end, complete files stay.

/// Handles Ctrl-C and SIGTERM on a separate thread. Without a handler the next run cleans up.
#[cfg(unix)]
pub fn clean_up_when_stopped() {
    use signal_hook::{
        consts::{SIGINT, SIGTERM},
        iterator::Signals,
        low_level::emulate_default_handler,
    };
    let Ok(mut signals) = Signals::new([SIGINT, SIGTERM]) else { return };
    std::thread::spawn(move || {
        if let Some(signal) = signals.forever().next() {
            sage_core::files::discard_unfinished();
            sage_sim::policy::kill_programs();
            // Ends the process as the signal would, so that a shell gets the signal's exit status.
            let _ = emulate_default_handler(signal);
        }
    });
}

#[cfg(not(unix))]
pub fn clean_up_when_stopped() {}
