//! A planner's program: lines go to its standard input, lines come from its standard output, each within a time.
//!
//! The program leads a process group of its own, which is ended as a whole. If this process dies, the program reads the
//! end of its input.

use std::{
    collections::BTreeSet,
    fs::File,
    io::{ErrorKind, Read, Write},
    os::{fd::AsFd, unix::process::CommandExt},
    process::{Child, ChildStdin, ChildStdout, Command, Stdio},
    sync::{Mutex, PoisonError},
    time::{Duration, Instant},
};

use rustix::{
    event::{PollFd, PollFlags, Timespec, poll},
    io::Errno,
    process::{Pid, Signal, WaitId, WaitIdOptions, kill_process_group, waitid},
};

use super::log::{LARGEST, Watched};
use crate::policy::planner::shortened;

/// Longest line that a program may answer, bytes.
pub(super) const LONGEST_LINE: usize = 1 << 20;
/// Bytes read at once.
const CHUNK: usize = 1 << 16;
/// How many times as long as its time to compute a program may take in all: a loaded machine lets it wait.
const PATIENCE: u32 = 10;
/// Time between two looks at whether the program still runs, while nothing comes from it.
const LOOK: Duration = Duration::from_millis(50);
/// Time that a program has to end by itself once its input ends.
pub(super) const FAREWELL: Duration = Duration::from_millis(500);

/// Process groups of programs that run, for [`kill_all`].
static RUNNING: Mutex<BTreeSet<u32>> = Mutex::new(BTreeSet::new());

/// Kills all programs with their groups: for a process that is about to end by a signal, and does not drop them.
pub fn kill_all() {
    for group in RUNNING.lock().unwrap_or_else(PoisonError::into_inner).iter() {
        kill(*group);
    }
}

fn kill(group: u32) {
    if let Some(group) = i32::try_from(group).ok().and_then(Pid::from_raw) {
        // The group may be gone already.
        let _ = kill_process_group(group, Signal::KILL);
    }
}

/// A program that runs.
pub(super) struct Program {
    child: Child,
    /// Taken when it ends.
    input: Option<ChildStdin>,
    /// There while it runs.
    output: Option<ChildStdout>,
    /// What was read and not yet given out.
    read: Vec<u8>,
    is_late: bool,
}

/// Why there is no answer.
#[derive(Debug, PartialEq, Eq)]
pub(super) enum Failure {
    /// The program ended: its exit status in words.
    Ended(String),
    /// The program closed its output and still runs.
    Closed,
    /// Nothing came within so much time of computing, or [`PATIENCE`] times as much in all.
    Late(Duration),
    /// The line is longer than [`LONGEST_LINE`].
    TooLong,
    /// It wrote more to its standard error than a log may hold.
    LongLog,
    /// More than one line came for one message.
    Extra(String),
    /// The pipe failed.
    Pipe(String),
}

impl std::fmt::Display for Failure {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Ended(status) => write!(f, "it ended ({status})"),
            Self::Closed => f.write_str("it closed its standard output"),
            Self::Late(limit) => {
                let (limit, all) = (limit.as_secs_f64(), (PATIENCE * *limit).as_secs_f64());
                write!(
                    f,
                    "no answer within {limit} s of computing, or {all} s in all; --ego-timeout gives it more time"
                )
            }
            Self::TooLong => write!(
                f,
                "a line of more than {LONGEST_LINE} bytes; expected one short line of JSON for each message"
            ),
            Self::LongLog => {
                write!(f, "it wrote more than {} MiB to its standard error in one drive", LARGEST >> 20)
            }
            Self::Extra(line) => write!(
                f,
                "more than one line for a message, the second `{line}`; print to standard error what is not an answer"
            ),
            Self::Pipe(error) => write!(f, "the pipe to it failed: {error}"),
        }
    }
}

impl Program {
    /// Starts a command, without a shell. Its standard error goes into `log`.
    pub(super) fn start(command: &[String], log: &File) -> std::io::Result<Self> {
        let [program, arguments @ ..] = command else {
            return Err(std::io::Error::new(ErrorKind::InvalidInput, "the command is empty"));
        };
        let mut child = Command::new(program)
            .args(arguments)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::from(log.try_clone()?))
            .env("SAGE_PLANNER", "1")
            .process_group(0)
            .spawn()?;
        RUNNING.lock().unwrap_or_else(PoisonError::into_inner).insert(child.id());
        let (input, output) = (child.stdin.take(), child.stdout.take());
        // From here on, an error drops the program, and so ends it.
        let program = Self { child, input, output, read: Vec::new(), is_late: false };
        let (Some(input), Some(output)) = (&program.input, &program.output) else {
            return Err(std::io::Error::other("no pipe to it"));
        };
        rustix::io::ioctl_fionbio(input, true)?;
        rustix::io::ioctl_fionbio(output, true)?;
        Ok(program)
    }

    /// Sends a line, which ends with a line feed, and waits for one: its bytes without the line feed. Meanwhile the log may not
    /// grow beyond its size.
    ///
    /// *Errors*: why there is no answer. The program is of no use then.
    pub(super) fn ask(&mut self, line: &[u8], limit: Duration, log: Watched) -> Result<Vec<u8>, Failure> {
        let start = Instant::now();
        let mut computed_before = None;
        let mut sent = 0;
        let mut seen = 0;
        loop {
            if log.is_full() {
                return Err(Failure::LongLog);
            }
            // A program may answer before it has read all of the message, which is sent all the same.
            let is_sent = sent == line.len();
            let found = self.read[seen..].iter().position(|byte| *byte == b'\n');
            if let Some(end) = found.filter(|_| is_sent).map(|found| seen + found) {
                let rest = self.read.split_off(end + 1);
                let mut answer = std::mem::replace(&mut self.read, rest);
                answer.truncate(end);
                return Ok(answer);
            }
            if found.is_none() {
                seen = self.read.len();
            }
            if self.read.len() > LONGEST_LINE {
                return Err(Failure::TooLong);
            }
            let ready = self.wait(!is_sent, LOOK.min(limit))?;
            if ready.output {
                if self.receive()? == 0 {
                    return Err(self.ended_or(Failure::Closed, limit));
                }
            } else if ready.input {
                sent += self.send(&line[sent..])?;
            } else if let Some(status) = self.status() {
                return Err(Failure::Ended(status));
            } else {
                let computed = self.computed();
                let before = *computed_before.get_or_insert(computed);
                let elapsed = start.elapsed();
                // Where the time of computing cannot be known, that in all counts.
                let computing =
                    computed.zip(before).map_or(elapsed, |(now, before)| now.saturating_sub(before));
                if computing >= limit || elapsed >= PATIENCE * limit {
                    self.is_late = true;
                    return Err(Failure::Late(limit));
                }
            }
        }
    }

    /// Whether an answer did not come in time.
    pub(super) fn is_late(&self) -> bool {
        self.is_late
    }

    /// Time that its group has computed since it started; `None` if the system does not say.
    fn computed(&self) -> Option<Duration> {
        #[cfg(target_os = "linux")]
        return super::computing::of_group(self.child.id());
        #[cfg(not(target_os = "linux"))]
        None
    }

    /// What came besides the answer, which it must not. Asked after the answer is understood: a banner before it is told as
    /// a wrong answer.
    pub(super) fn no_more(&self) -> Result<(), Failure> {
        if self.read.is_empty() { Ok(()) } else { Err(Failure::Extra(shortened(&self.read))) }
    }

    /// Waits until the program reads, if something is to be sent, or writes.
    fn wait(&self, sends: bool, time: Duration) -> Result<Ready, Failure> {
        let flag = if sends { PollFlags::OUT } else { PollFlags::empty() };
        let Some(output) = &self.output else { return Err(Failure::Closed) };
        let mut fds = vec![PollFd::from_borrowed_fd(output.as_fd(), PollFlags::IN)];
        if let Some(input) = self.input.as_ref().filter(|_| sends) {
            fds.push(PollFd::from_borrowed_fd(input.as_fd(), flag));
        }
        let time = Timespec { tv_sec: 0, tv_nsec: i64::from(time.subsec_nanos().max(1)) };
        match poll(&mut fds, Some(&time)) {
            Ok(_) | Err(Errno::INTR) => {}
            Err(error) => return Err(Failure::Pipe(error.to_string())),
        }
        let is_ready = |k: usize| fds.get(k).is_some_and(|fd| !fd.revents().is_empty());
        Ok(Ready { output: is_ready(0), input: is_ready(1) })
    }

    /// Reads what is there; 0 at the end of the output.
    fn receive(&mut self) -> Result<usize, Failure> {
        let Some(output) = &mut self.output else { return Err(Failure::Closed) };
        let before = self.read.len();
        self.read.resize(before + CHUNK, 0);
        let result = output.read(&mut self.read[before..]);
        self.read.truncate(before + *result.as_ref().unwrap_or(&0));
        match result {
            Ok(count) => Ok(count),
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => Ok(1),
            Err(error) => Err(Failure::Pipe(error.to_string())),
        }
    }

    fn send(&mut self, bytes: &[u8]) -> Result<usize, Failure> {
        let Some(input) = &mut self.input else { return Err(Failure::Closed) };
        match input.write(bytes) {
            Ok(count) => Ok(count),
            Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => Ok(0),
            Err(error) if error.kind() == ErrorKind::BrokenPipe => {
                Err(self.ended_or(Failure::Pipe("it closed its standard input".to_owned()), FAREWELL))
            }
            Err(error) => Err(Failure::Pipe(error.to_string())),
        }
    }

    /// How it ended, if it ends shortly: a program closes its pipes just before.
    fn ended_or(&self, failure: Failure, limit: Duration) -> Failure {
        self.wait_until_ended(Instant::now() + limit.min(FAREWELL));
        self.status().map_or(failure, Failure::Ended)
    }

    /// Exit status in words, once the program has ended. It is not reaped, so that its group keeps its number.
    fn status(&self) -> Option<String> {
        let options = WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
        let status = waitid(WaitId::Pid(self.pid()?), options).ok()??;
        Some(match (status.exit_status(), status.terminating_signal()) {
            (Some(code), _) => format!("exit status {code}"),
            (None, Some(signal)) => format!("signal {signal}"),
            (None, None) => "stopped".to_owned(),
        })
    }

    fn pid(&self) -> Option<Pid> {
        Pid::from_raw(i32::try_from(self.child.id()).ok()?)
    }

    /// Ends the input, so that the program can end by itself.
    pub(super) fn dismiss(&mut self) {
        self.input = None;
    }

    /// Waits until the program has ended by itself, at most until a time.
    pub(super) fn wait_until_ended(&self, end: Instant) {
        while self.status().is_none() && Instant::now() < end {
            std::thread::sleep(Duration::from_millis(2));
        }
    }
}

impl Drop for Program {
    /// Kills the whole group.
    fn drop(&mut self) {
        self.dismiss();
        // The number may belong to another group once the program is waited for.
        RUNNING.lock().unwrap_or_else(PoisonError::into_inner).remove(&self.child.id());
        kill(self.child.id());
        let _ = self.child.wait();
    }
}

/// Which pipes can be used.
struct Ready {
    output: bool,
    input: bool,
}
