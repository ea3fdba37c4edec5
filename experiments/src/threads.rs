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
    let mut command = Command::new(std::env::current_exe().ok()?);
    #[cfg(unix)]
    {
        use std::os::unix::process::CommandExt;
        command.arg0(arguments.next()?);
    }
    #[cfg(not(unix))]
    arguments.next();
    command.args(arguments).envs(VARIABLES.map(|name| (name, "1")));
    replace(command)
}

#[cfg(unix)]
fn replace(mut command: Command) -> Option<ExitCode> {
    use std::os::unix::process::CommandExt;
    // Returns only on failure; this process then continues with candle's threads, which is slower.
    let _ = command.exec();
    None
}

#[cfg(not(unix))]
fn replace(mut command: Command) -> Option<ExitCode> {
    let status = command.status().ok()?;
    Some(status.code().and_then(|code| u8::try_from(code).ok()).map_or(ExitCode::FAILURE, ExitCode::from))
}
