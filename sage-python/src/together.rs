//! Several drives of one planner in step: each drives in a thread of its own, and the planner, on the caller's thread, is asked
//! about all of them at once.
//!
//! So the simulation need not be turned inside out for a batch, and a scene that fails ends alone.

use std::{
    collections::HashMap,
    sync::{
        Arc,
        mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, channel, sync_channel},
    },
    time::Duration,
};

use pyo3::prelude::*;
use sage_run::outcome::caught;
use sage_sim::policy::planner::Answer;

use crate::{
    ahead::pool,
    errors::{keep_raised, take_raised, to_python},
    planner::{Asked, Planner},
};

/// Time between two looks for Ctrl-C.
const LOOK: Duration = Duration::from_millis(50);

/// Where a drive puts its questions.
#[derive(Clone)]
pub(crate) struct Questions {
    drive: usize,
    messages: Sender<Message>,
}

enum Message {
    Question(Box<Question>),
    Done,
}

/// A question of a drive.
struct Question {
    drive: usize,
    asked: Asked,
    /// Whether it is the first of a drive, so that the planner is told the scene.
    is_first: bool,
    answer: SyncSender<Result<Answer, String>>,
}

impl Questions {
    /// Asks, and waits for the answer.
    ///
    /// *Errors*: those of the planner, in words.
    pub(crate) fn ask(&self, asked: Asked, is_first: bool) -> Result<Answer, String> {
        let (answer, answered) = sync_channel(1);
        let question = Question { drive: self.drive, asked, is_first, answer };
        let gone = || "it was interrupted".to_owned();
        self.messages.send(Message::Question(Box::new(question))).map_err(|_| gone())?;
        answered.recv().map_err(|_| gone())?
    }
}

/// Drives several items at once. `drive` gets where its planner is reached. The outcomes are in the order of the items.
///
/// *Errors*: Ctrl-C, and what else stops the planner; the system starts no threads.
pub(crate) fn drive_together<T: Send, R: Send>(
    py: Python<'_>,
    planner: &Arc<Planner>,
    items: Vec<T>,
    drive: impl Fn(T, Questions) -> sage_run::Result<R> + Sync,
) -> PyResult<Vec<PyResult<R>>> {
    let (messages, received) = channel();
    let pool = pool(items.len().max(1))?;
    let mut results: Vec<Option<sage_run::Result<R>>> = Vec::new();
    results.resize_with(items.len(), || None);
    let live = items.len();
    let raised = pool.in_place_scope(|scope| {
        for ((number, item), result) in items.into_iter().enumerate().zip(&mut results) {
            let (questions, drive) = (Questions { drive: number, messages: messages.clone() }, &drive);
            scope.spawn(move |_| {
                let done = questions.messages.clone();
                *result = Some(caught(|| drive(item, questions)));
                // Nobody listens once the run was interrupted.
                let _ = done.send(Message::Done);
            });
        }
        answer_all(py, planner, received, live)
    })?;
    planner.raise_interrupt()?;
    let mut raised = raised;
    let outcome = |(drive, result): (usize, Option<sage_run::Result<R>>)| {
        if let Some(raised) = raised.remove(&drive) {
            keep_raised(Some(raised));
        }
        Some(result?.map_err(|error| to_python(py, &error)))
    };
    Ok(results.into_iter().enumerate().filter_map(outcome).collect())
}

/// Answers the questions of all drives until they are done. Returns what was raised for each.
///
/// *Errors*: Ctrl-C.
fn answer_all(
    py: Python<'_>,
    planner: &Planner,
    mut received: Receiver<Message>,
    mut live: usize,
) -> PyResult<HashMap<usize, PyErr>> {
    let (mut scenes, mut raised) = (HashMap::<usize, Py<PyAny>>::new(), HashMap::new());
    let mut waiting: Vec<Question> = Vec::new();
    while live > 0 {
        while waiting.len() < live {
            let messages = &mut received;
            match py.detach(move || messages.recv_timeout(LOOK)) {
                Ok(Message::Question(question)) => waiting.push(*question),
                Ok(Message::Done) => live -= 1,
                // Without anybody who listens, all drives end.
                Err(RecvTimeoutError::Timeout | RecvTimeoutError::Disconnected) => py.check_signals()?,
            }
        }
        waiting.sort_by_key(|question| question.drive);
        let (mut asked, mut askers) = (Vec::new(), Vec::new());
        for Question { drive, asked: about, is_first, answer } in waiting.drain(..) {
            if is_first {
                match planner.reset(py, &about.told, drive) {
                    Ok(scene) => drop(scenes.insert(drive, scene)),
                    Err(problem) => {
                        raised.extend(take_raised().map(|error| (drive, error)));
                        let _ = answer.send(Err(problem));
                        continue;
                    }
                }
            }
            if let Some(scene) = scenes.get(&drive) {
                asked.push((scene.clone_ref(py), about));
                askers.push((drive, answer));
            }
        }
        if asked.is_empty() {
            continue;
        }
        let answers = planner.act_many(py, asked);
        let error = take_raised();
        for ((drive, answer), answered) in askers.into_iter().zip(answers) {
            if answered.is_err() {
                raised.extend(error.as_ref().map(|error| (drive, error.clone_ref(py))));
            }
            let _ = answer.send(answered);
        }
    }
    Ok(raised)
}
