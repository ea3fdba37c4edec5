//! The `sage` command.

use std::process::ExitCode;

/// Training and scoring often allocate and free large buffers. The system's allocator maps and
/// unmaps each of them.
#[global_allocator]
static ALLOCATOR: mimalloc::MiMalloc = mimalloc::MiMalloc;

fn main() -> ExitCode {
    experiments::run(experiments::Registries::shipped)
}
