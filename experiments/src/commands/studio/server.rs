//! The server of the page: this machine alone, sessions, limits, one piece of work a session at a time.

use std::{
    convert::Infallible,
    net::TcpListener,
    panic::{AssertUnwindSafe, catch_unwind},
    sync::{Arc, Mutex, mpsc},
};

use anyhow::{Context as _, Result, bail};
use axum::{
    Json, Router,
    body::{Body, Bytes},
    extract::{DefaultBodyLimit, Request, State},
    http::{HeaderMap, HeaderValue, StatusCode, header},
    middleware::{self, Next},
    response::{Html, IntoResponse, Response},
    routing::{get, post},
};
use futures_util::stream;
use sage_run::progress;
use serde::{Deserialize, de::DeserializeOwned};
use serde_json::{Value, json};
use tokio::sync::{mpsc::unbounded_channel, oneshot};

use super::{
    choice::Choice,
    locked::locked,
    sessions::{Sessions, Superseded, Turn, secret},
    workshop::Workshop,
};

/// Largest body of a request, bytes.
const LARGEST_BODY: usize = 64 << 10;
/// Header with the session.
const SESSION: &str = "x-session";
/// Header with a number that grows from request to request of a page, which may arrive in another order.
const TURN: &str = "x-turn";
/// What that number stays below: whole numbers that a page can count.
const LAST_TURN: u64 = 1 << 53;

/// Work of a session, for one of the threads that have the workshop.
type Job = Box<dyn FnOnce(&Workshop) + Send>;

struct Server {
    jobs: mpsc::Sender<Job>,
    offered: Value,
    /// Address without the scheme, such as `127.0.0.1:4711`.
    address: String,
    sessions: Sessions,
}

/// Serves until the user interrupts it; opens the link if `opens`.
///
/// *Errors*: the system refuses the socket.
pub(super) fn serve(listener: TcpListener, workshop: &Workshop, opens: bool) -> Result<()> {
    let address = listener.local_addr()?.to_string();
    let (jobs, waiting) = mpsc::channel::<Job>();
    let waiting = Mutex::new(waiting);
    let server = Server { jobs, offered: workshop.offered(), address, sessions: Sessions::new()? };
    server.say_link("open");
    if opens && let Err(error) = open::that_detached(server.link()) {
        progress::say(&format!("note: no browser was opened: {error}"));
    }
    std::thread::scope(|scope| {
        for _ in 0..rayon::current_num_threads() {
            scope.spawn(|| {
                loop {
                    let job = locked(&waiting).recv();
                    // Without a server nobody sends any.
                    let Ok(job) = job else { break };
                    job(workshop);
                }
            });
        }
        run(listener, Arc::new(server))
    })
}

fn run(listener: TcpListener, server: Arc<Server>) -> Result<()> {
    listener.set_nonblocking(true)?;
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build()?;
    runtime.block_on(async {
        let routes = Router::new()
            .route("/", get(page))
            .route("/session", post(session))
            .route("/offered", post(offered))
            .route("/scene", post(scene))
            .route("/thumbnail", post(thumbnail))
            .route("/drive", post(drive))
            .route("/explain", post(explain))
            .route("/search", post(search))
            .route("/sweep", post(sweep))
            .route("/keep", post(keep))
            .layer(DefaultBodyLimit::max(LARGEST_BODY))
            .layer(middleware::from_fn_with_state(server.clone(), guard))
            .with_state(server);
        let listener = tokio::net::TcpListener::from_std(listener)?;
        let served = axum::serve(listener, routes);
        tokio::select! {
            ended = served => ended.context("the server"),
            interrupted = tokio::signal::ctrl_c() => interrupted.context("the signals"),
        }
    })
}

impl Server {
    fn link(&self) -> String {
        format!("http://{}/#key={}", self.address, self.sessions.key())
    }

    fn say_link(&self, words: &str) {
        progress::say(&format!("{words} {}", self.link()));
    }

    /// The secret of the session that a request carries.
    fn secret<'h>(&self, headers: &'h HeaderMap) -> Result<&'h str, Refused> {
        let secret = headers.get(SESSION).and_then(|value| value.to_str().ok());
        secret.filter(|secret| self.sessions.has(secret)).ok_or_else(Refused::unopened)
    }

    /// The turn of a request.
    fn turn(&self, headers: &HeaderMap) -> Result<Turn, Refused> {
        let secret = self.secret(headers)?;
        let number = headers.get(TURN).map(|number| {
            let number = number.to_str().ok().and_then(|number| number.parse().ok());
            number.filter(|number| *number < LAST_TURN).ok_or_else(|| {
                Refused(StatusCode::BAD_REQUEST, format!("`{TURN}` is not a number below {LAST_TURN}"))
            })
        });
        self.sessions.turn(secret, number.transpose()?).ok_or_else(Refused::unopened)
    }

    fn send(&self, job: impl FnOnce(&Workshop) + Send + 'static) -> Result<(), Refused> {
        Ok(self.jobs.send(Box::new(job)).map_err(|_| ended())?)
    }
}

/// An answer that is an error.
struct Refused(StatusCode, String);

impl Refused {
    fn unopened() -> Self {
        Self(StatusCode::UNAUTHORIZED, "open the link that `sage studio` printed".to_owned())
    }
}

impl IntoResponse for Refused {
    fn into_response(self) -> Response {
        let content = Json(json!({"error": self.1}));
        // No error: a browser would list it as one.
        if self.0 == StatusCode::NO_CONTENT {
            self.0.into_response()
        } else {
            (self.0, content).into_response()
        }
    }
}

impl From<anyhow::Error> for Refused {
    fn from(error: anyhow::Error) -> Self {
        let status = match error.downcast_ref::<Superseded>() {
            Some(_) => StatusCode::NO_CONTENT,
            None => StatusCode::UNPROCESSABLE_ENTITY,
        };
        Self(status, format!("{error:#}"))
    }
}

/// Whether a request may be one of this page: by its host, against names that lead here from elsewhere, and by its origin, which a
/// browser names in every request that is no plain visit.
fn is_of_page(headers: &HeaderMap, address: &str) -> bool {
    let port = address.rsplit(':').next().unwrap_or_default();
    let is_known = |host: &str| host == address || host.strip_prefix("localhost:") == Some(port);
    let text = |name| headers.get(name).map(|value| value.to_str().unwrap_or_default());
    let is_origin = |origin: &str| origin.strip_prefix("http://").is_some_and(is_known);
    text(header::HOST).is_some_and(is_known) && text(header::ORIGIN).is_none_or(is_origin)
}

async fn guard(State(server): State<Arc<Server>>, request: Request, next: Next) -> Response {
    if !is_of_page(request.headers(), &server.address) {
        return Refused(StatusCode::FORBIDDEN, "this is no request of the page".to_owned()).into_response();
    }
    let mut response = next.run(request).await;
    let headers = response.headers_mut();
    for (name, value) in [
        (header::CACHE_CONTROL, "no-store"),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::X_FRAME_OPTIONS, "DENY"),
    ] {
        headers.insert(name, HeaderValue::from_static(value));
    }
    response
}

async fn page() -> Result<Response, Refused> {
    let nonce = secret()?;
    let page = sage_view::studio::page("sage studio", &nonce);
    let page = page.map_err(anyhow::Error::from)?;
    let policy = format!(
        "default-src 'none'; script-src 'nonce-{nonce}'; style-src 'nonce-{nonce}'; connect-src 'self'; img-src data:; \
         base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    );
    Ok(([(header::CONTENT_SECURITY_POLICY, policy)], Html(page)).into_response())
}

/// The content of a request.
fn content<T: DeserializeOwned>(body: &Bytes) -> Result<T, Refused> {
    serde_json::from_slice(body).map_err(|error| Refused(StatusCode::BAD_REQUEST, error.to_string()))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Key {
    key: String,
}

async fn session(State(server): State<Arc<Server>>, body: Bytes) -> Result<Json<Value>, Refused> {
    let Key { key } = content(&body)?;
    let session = server.sessions.open(&key);
    let session = session.map_err(|error| Refused(StatusCode::UNAUTHORIZED, error.to_string()))?;
    server.say_link("for another tab or browser, open");
    Ok(Json(json!({"session": session})))
}

async fn offered(State(server): State<Arc<Server>>, headers: HeaderMap) -> Result<Json<Value>, Refused> {
    server.secret(&headers)?;
    Ok(Json(server.offered.clone()))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SceneNumber {
    scene: usize,
}

async fn scene(
    State(server): State<Arc<Server>>,
    headers: HeaderMap,
    body: Bytes,
) -> Result<Json<Value>, Refused> {
    let SceneNumber { scene } = content(&body)?;
    work(server, &headers, move |workshop, _| workshop.describe(scene)).await
}

/// A picture of the list; many are asked for at once, and none takes the place of another.
async fn thumbnail(
    State(server): State<Arc<Server>>,
    headers: HeaderMap,
    body: Bytes,
) -> Result<Json<Value>, Refused> {
    server.secret(&headers)?;
    let SceneNumber { scene } = content(&body)?;
    answer_of(&server, move |workshop| workshop.thumbnail(scene)).await
}

async fn drive(
    State(server): State<Arc<Server>>,
    headers: HeaderMap,
    body: Bytes,
) -> Result<Json<Value>, Refused> {
    let choice: Choice = content(&body)?;
    let turn = server.turn(&headers)?;
    let (done, answer) = oneshot::channel();
    server.send(move |workshop| {
        let check = || turn.check();
        let _ = done.send(guarded(|| check().and_then(|()| workshop.drive(&choice, &check))));
        // Nobody waits for this; what is wrong with it is said once somebody does.
        let _ = guarded(|| check().and_then(|()| workshop.plan_ahead(&choice, &check)).map(|()| Value::Null));
    })?;
    Ok(Json(answer.await.map_err(|_| ended())??))
}

async fn explain(
    State(server): State<Arc<Server>>,
    headers: HeaderMap,
    body: Bytes,
) -> Result<Json<Value>, Refused> {
    let choice: Choice = content(&body)?;
    work(server, &headers, move |workshop, check| workshop.explain(&choice, check)).await
}

async fn keep(
    State(server): State<Arc<Server>>,
    headers: HeaderMap,
    body: Bytes,
) -> Result<Json<Value>, Refused> {
    let choice: Choice = content(&body)?;
    work(server, &headers, move |workshop, _| workshop.keep(&choice)).await
}

async fn search(
    State(server): State<Arc<Server>>,
    headers: HeaderMap,
    body: Bytes,
) -> Result<Response, Refused> {
    let choice: Choice = content(&body)?;
    lines_of(&server, &headers, move |workshop, tell| workshop.search(&choice, tell))
}

async fn sweep(
    State(server): State<Arc<Server>>,
    headers: HeaderMap,
    body: Bytes,
) -> Result<Response, Refused> {
    let choice: Choice = content(&body)?;
    lines_of(&server, &headers, move |workshop, tell| workshop.sweep(&choice, tell))
}

/// Answers with a line of JSON for each that some work tells, and one for its result.
fn lines_of(
    server: &Server,
    headers: &HeaderMap,
    work: impl FnOnce(&Workshop, &dyn Fn(Value) -> Result<()>) -> Result<Value> + Send + 'static,
) -> Result<Response, Refused> {
    let turn = server.turn(headers)?;
    let (lines, waiting) = unbounded_channel::<Bytes>();
    server.send(move |workshop| {
        let tell = |said: Value| {
            turn.check()?;
            // A tab that was closed hears nothing more.
            lines.send(line(&said)).map_err(|_| Superseded.into())
        };
        let result = guarded(|| turn.check().and_then(|()| work(workshop, &tell)));
        let last = result.unwrap_or_else(|error| json!({"error": format!("{error:#}")}));
        let _ = lines.send(line(&last));
    })?;
    let lines = stream::unfold(waiting, async |mut waiting| {
        let line = waiting.recv().await?;
        Some((Ok::<_, Infallible>(line), waiting))
    });
    Ok(([(header::CONTENT_TYPE, "application/x-ndjson")], Body::from_stream(lines)).into_response())
}

fn line(value: &Value) -> Bytes {
    Bytes::from(format!("{value}\n"))
}

/// Does the newest work of a session. `check` says to older work that it may end.
async fn work(
    server: Arc<Server>,
    headers: &HeaderMap,
    work: impl FnOnce(&Workshop, &dyn Fn() -> Result<()>) -> Result<Value> + Send + 'static,
) -> Result<Json<Value>, Refused> {
    let turn = server.turn(headers)?;
    answer_of(&server, move |workshop| {
        turn.check()?;
        work(workshop, &|| turn.check())
    })
    .await
}

/// Does some work in the workshop.
async fn answer_of(
    server: &Server,
    work: impl FnOnce(&Workshop) -> Result<Value> + Send + 'static,
) -> Result<Json<Value>, Refused> {
    let (done, answer) = oneshot::channel();
    server.send(move |workshop| {
        // Nobody waits for the answer of a tab that was closed.
        let _ = done.send(guarded(|| work(workshop)));
    })?;
    Ok(Json(answer.await.map_err(|_| ended())??))
}

fn ended() -> anyhow::Error {
    anyhow::anyhow!("the server ends")
}

/// The result of some work, or that it failed in a way that it should not.
fn guarded(work: impl FnOnce() -> Result<Value>) -> Result<Value> {
    catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|_| bail!("the scene could not be worked on"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn requests_of_other_hosts_and_pages_are_refused() {
        let is_of_page = |host: Option<&str>, origin: Option<&str>| {
            let mut headers = HeaderMap::new();
            let pairs = [(header::HOST, host), (header::ORIGIN, origin)];
            for (name, value) in pairs.into_iter().filter_map(|(name, value)| Some((name, value?))) {
                headers.insert(name, HeaderValue::from_str(value).unwrap_or(HeaderValue::from_static("")));
            }
            super::is_of_page(&headers, "127.0.0.1:4711")
        };
        assert!(is_of_page(Some("127.0.0.1:4711"), None));
        assert!(is_of_page(Some("localhost:4711"), Some("http://localhost:4711")));
        for host in [None, Some("attacker.example:4711"), Some("127.0.0.1"), Some("localhost:47110")] {
            assert!(!is_of_page(host, None), "{host:?}");
        }
        for origin in ["null", "http://attacker.example", "https://127.0.0.1:4711", "http://127.0.0.1:47", ""]
        {
            assert!(!is_of_page(Some("127.0.0.1:4711"), Some(origin)), "{origin}");
        }
    }
}
