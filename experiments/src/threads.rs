//! How many threads work, and on what.
//!
//! Scenes are spread over threads; within a scene one thread computes. candle would split each
//! product and each large sum over threads of its own, and wait for them. It reads how many from two
//! variables of the environment, which a running process cannot set safely: so a command that needs
//! networks starts itself anew with them.

use std::process::{Command, ExitCode};

use anyhow::{Context as _, Result};

/// candle's variables.
const VARIABLES: [&str; 2] = ["RAYON_NUM_THREADS", "CANDLE_NUM_THREADS"];

/// Builds the pool that scenes are spread over.
///
/// *Errors*: the system refuses so many threads.
pub(crate) fn build_pool(threads: Option<u16>) -> Result<()> {
    let all = || std::thread::available_parallelism().map_or(1, usize::from);
    let threads = threads.map_or_else(all, usize::from);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build_global();
    pool.with_context(|| format!("cannot work with {threads} threads"))
}

/// Runs this very command with candle's threads switched off, if they are not; the exit code is that
/// command's. `None` if there is no need for it or no way to do it.
pub(crate) fn run_anew() -> Option<ExitCode> {
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
    // Returns only if it failed; the slow way still works then.
    let _ = command.exec();
    None
}

#[cfg(not(unix))]
fn replace(mut command: Command) -> Option<ExitCode> {
    let status = command.status().ok()?;
    Some(status.code().and_then(|code| u8::try_from(code).ok()).map_or(ExitCode::FAILURE, ExitCode::from))
}
