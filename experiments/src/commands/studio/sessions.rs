//! Sessions of the page: each is opened by a link, and works on its newest request alone.

use std::{
    collections::HashMap,
    sync::{
        Arc, Mutex,
        atomic::{AtomicU64, Ordering},
    },
};

use anyhow::{Result, ensure};

use super::locked::locked;

/// Most sessions at a time; the oldest ends.
const MOST_SESSIONS: usize = 32;

/// A random text that nobody can guess.
pub(super) fn secret() -> Result<String> {
    let mut bytes = [0; 16];
    getrandom::fill(&mut bytes).map_err(|error| anyhow::anyhow!("no random numbers: {error}"))?;
    Ok(bytes.iter().map(|byte| format!("{byte:02x}")).collect())
}

/// All sessions, and the key of the link that was printed last.
pub(super) struct Sessions(Mutex<State>);

struct State {
    key: String,
    /// Number of the newest request of each session by its secret.
    by_secret: HashMap<String, Arc<AtomicU64>>,
    oldest_first: Vec<String>,
}

impl Sessions {
    /// No session, and a first key.
    pub(super) fn new() -> Result<Self> {
        let (by_secret, oldest_first) = (HashMap::new(), Vec::new());
        Ok(Self(Mutex::new(State { key: secret()?, by_secret, oldest_first })))
    }

    /// The key that opens the next session.
    pub(super) fn key(&self) -> String {
        locked(&self.0).key.clone()
    }

    /// Opens a session for the key, which is then another one, and returns its secret.
    ///
    /// *Errors*: the key was used before.
    pub(super) fn open(&self, key: &str) -> Result<String> {
        let mut state = locked(&self.0);
        ensure!(state.key == key, "this link was used before; the terminal of `sage studio` has a new one");
        state.key = secret()?;
        let secret = secret()?;
        state.by_secret.insert(secret.clone(), Arc::default());
        state.oldest_first.push(secret.clone());
        if state.oldest_first.len() > MOST_SESSIONS {
            let oldest = state.oldest_first.remove(0);
            state.by_secret.remove(&oldest);
        }
        Ok(secret)
    }

    /// Whether a session is open.
    pub(super) fn has(&self, secret: &str) -> bool {
        locked(&self.0).by_secret.contains_key(secret)
    }

    /// The turn of a request in its session, which ends turns before; without a number the next one. `None` without such a session.
    pub(super) fn turn(&self, secret: &str, number: Option<u64>) -> Option<Turn> {
        let newest = locked(&self.0).by_secret.get(secret)?.clone();
        let own = number.unwrap_or_else(|| newest.load(Ordering::SeqCst) + 1);
        newest.fetch_max(own, Ordering::SeqCst);
        Some(Turn { newest, own })
    }
}

/// A request of a session among its others.
pub(super) struct Turn {
    newest: Arc<AtomicU64>,
    own: u64,
}

impl Turn {
    /// *Errors*: [`Superseded`].
    pub(super) fn check(&self) -> Result<()> {
        if self.newest.load(Ordering::SeqCst) == self.own { Ok(()) } else { Err(Superseded.into()) }
    }
}

/// A newer request of the session made this one pointless.
#[derive(Debug)]
pub(super) struct Superseded;

impl std::fmt::Display for Superseded {
    fn fmt(&self, f: &mut std::fmt::Formatter) -> std::fmt::Result {
        f.write_str("a newer request took its place")
    }
}

impl std::error::Error for Superseded {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_opens_one_session_and_a_newer_turn_ends_the_one_before() {
        let sessions = Sessions::new().unwrap();
        let key = sessions.key();
        let secret = sessions.open(&key).unwrap();
        assert!(sessions.open(&key).is_err() && sessions.has(&secret) && !sessions.has(&key));
        let first = sessions.turn(&secret, Some(7)).unwrap();
        assert!(first.check().is_ok());
        // One that was sent before and comes after.
        let late = sessions.turn(&secret, Some(3)).unwrap();
        assert!(first.check().is_ok() && late.check().is_err());
        let next = sessions.turn(&secret, None).unwrap();
        assert!(first.check().is_err() && next.check().is_ok());
        for _ in 0..MOST_SESSIONS {
            sessions.open(&sessions.key()).unwrap();
        }
        assert!(!sessions.has(&secret) && sessions.turn(&secret, None).is_none());
    }
}
