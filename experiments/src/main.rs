//! The `sage` command.

use std::process::ExitCode;

/// Training and scoring allocate and free large buffers all the time; the system's allocator maps
/// and unmaps each of them.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    experiments::run(experiments::Registries::shipped)
}
