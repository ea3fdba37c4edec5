//! The threads of candle.
//!
//! Scenes are distributed over threads, and one thread computes one scene. By default candle also
//! splits each product and each large sum over its own threads and waits for them. candle reads its
//! number of threads from two environment variables, which a running process cannot set safely.
//! Therefore a command that needs networks sets them and restarts itself.

use std::process::{Command, ExitCode};

/// Environment variables of candle's number of threads.
const VARIABLES: [&str; 2] = ["RAYON_NUM_THREADS", "CANDLE_NUM_THREADS"];

/// Restarts this command with one candle thread and returns its exit code. `None` if candle has one
/// thread already, or if the restart is impossible.
pub(crate) fn restart_without_candle_threads() -> Option<ExitCode> {
    if VARIABLES.iter().all(|name| std::env::var(name).as_deref() == Ok("1")) {
        return None;
    }
    let mut arguments = std::env::args_os();
    let _name = arguments.next()?;
    let mut command = Command::new(std::env::current_exe().ok()?);
    command.args(arguments).envs(VARIABLES.map(|name| (name, "1")));
    #[cfg(unix)]
    {
        // Returns only on failure; this process then continues with candle's threads, which is slower.
        use std::os::unix::process::CommandExt as _;
        let _ = command.arg0(_name).exec();
        None
    }
    #[cfg(not(unix))]
    let code = command.status().ok()?.code().and_then(|code| u8::try_from(code).ok());
    #[cfg(not(unix))]
    Some(code.map_or(ExitCode::FAILURE, ExitCode::from))
}
