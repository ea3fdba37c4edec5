//! One run of `sage` with a look at what it uses.

use std::{
    path::Path,
    process::{Command, Stdio},
    time::{Duration, Instant},
};

/// Files below this size are held to the limits, bytes.
const SMALL: u64 = 1_000_000;
/// Processor ticks in a second, as Linux reports them to programs.
const TICKS: f64 = 100.0;
/// Time between two looks.
const PAUSE: Duration = Duration::from_millis(2);
/// A run that takes longer hangs.
const HANGS: Duration = Duration::from_secs(120);
/// Most characters of a line of a message. There may be a line for each bad record.
const LONGEST_LINE: usize = 4000;
/// Most address space, kB: a run that needs more fails instead of using up the machine.
const ADDRESS_SPACE: u64 = 8 << 20;

/// Limits of a run.
pub struct Limits {
    pub megabytes: f64,
    pub seconds: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self { megabytes: 1000.0, seconds: 5.0 }
    }
}

/// What a run used.
pub struct Used {
    pub code: i32,
    pub seconds: f64,
    pub megabytes: f64,
}

/// Runs a command in a folder. `size` is the size of the file that it reads, `is_timed` whether its time is limited.
///
/// *Errors*: it did not end cleanly, or used more than the limits.
pub fn run(
    program: &Path,
    folder: &Path,
    arguments: &[&str],
    size: u64,
    is_timed: bool,
    limits: &Limits,
) -> Result<Used, String> {
    let told = |problem: String| format!("`sage {}` {problem}", arguments.join(" "));
    let said = folder.join("said");
    let mut command = Command::new("sh");
    command.arg("-c").arg(format!("ulimit -v {ADDRESS_SPACE}; exec \"$@\"")).arg("sh").arg(program);
    command.args(arguments).args(["--threads", "1"]).current_dir(folder);
    // Set, so that the program does not start itself again.
    command.env_remove("SAGE_WEIGHTS").envs([("RAYON_NUM_THREADS", "1"), ("CANDLE_NUM_THREADS", "1")]);
    command.stdin(Stdio::null()).stdout(Stdio::null());
    command.stderr(std::fs::File::create(&said).map_err(|error| error.to_string())?);
    let mut child = command.spawn().map_err(|error| error.to_string())?;
    let start = Instant::now();
    let mut used = Used { code: -1, seconds: 0.0, megabytes: 0.0 };
    let status = loop {
        look(child.id(), &mut used);
        if let Some(status) = child.try_wait().map_err(|error| error.to_string())? {
            break status;
        }
        if start.elapsed() > HANGS {
            let _ = child.kill();
            let _ = child.wait();
            return Err(told(format!("hangs: {} s", HANGS.as_secs())));
        }
        std::thread::sleep(PAUSE);
    };
    let message = String::from_utf8_lossy(&std::fs::read(&said).unwrap_or_default()).into_owned();
    used.code = status.code().unwrap_or(-1);
    let start: String = message.chars().take(2000).collect();
    if ![0, 1, 2, 65].contains(&used.code)
        || message.contains("panicked")
        || message.contains("memory allocation")
    {
        return Err(told(format!("ends with {status}: {start}")));
    }
    if let Some(long) = message.lines().find(|line| line.len() > LONGEST_LINE) {
        return Err(told(format!("says {} characters in a line: {start}", long.len())));
    }
    if used.code != 0 && message.trim().is_empty() {
        return Err(told("fails without a word".to_owned()));
    }
    if size < SMALL && used.megabytes > limits.megabytes {
        return Err(told(format!("takes {:.0} MB for a file of {size} bytes", used.megabytes)));
    }
    if size < SMALL && is_timed && used.seconds > limits.seconds {
        return Err(told(format!("takes {:.1} s for a file of {size} bytes", used.seconds)));
    }
    Ok(used)
}

/// Takes over what a process has used so far. A process that has ended keeps its time until it is waited for.
fn look(process: u32, used: &mut Used) {
    let read = |file: &str| std::fs::read_to_string(format!("/proc/{process}/{file}")).unwrap_or_default();
    if let Some(times) = read("stat").rsplit(") ").next() {
        let field =
            |k: usize| times.split(' ').nth(k).and_then(|text| text.parse::<f64>().ok()).unwrap_or(0.0);
        used.seconds = used.seconds.max((field(11) + field(12)) / TICKS);
    }
    let status = read("status");
    let peak = status.lines().find_map(|line| line.strip_prefix("VmHWM:"));
    let kilobytes = peak.and_then(|text| text.trim().strip_suffix(" kB")?.trim().parse::<f64>().ok());
    used.megabytes = used.megabytes.max(kilobytes.unwrap_or(0.0) / 1000.0);
}
