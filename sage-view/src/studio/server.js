// --- the server: each request carries the session, never a path or a command ---

let session = sessionStorage.getItem("session");
// Requests may arrive in another order than they were sent, so each has a number: of the time, since a tab may be loaded again or doubled.
let newestRequest = 0;

async function send(path, body) {
  const headers = { "Content-Type": "application/json" };
  if (session) headers["X-Session"] = session;
  if (path !== "/thumbnail") {
    headers["X-Turn"] = newestRequest = Math.max(newestRequest + 1, Date.now());
  }
  const reply = await fetch(path, { method: "POST", headers, body: JSON.stringify(body) });
  // A newer request took its place.
  if (reply.status === 204) throw Object.assign(new Error("another request came"), { isReplaced: true });
  if (reply.ok) return reply;
  const answer = await reply.json().catch(() => ({ error: `the server answered ${reply.status}` }));
  throw Object.assign(new Error(answer.error), { status: reply.status });
}

const ask = async (path, body) => (await send(path, body)).json();

// Calls `tell` with each line of an answer; the last one is returned.
async function askLines(path, body, tell) {
  const reader = (await send(path, body)).body.pipeThrough(new TextDecoderStream()).getReader();
  let rest = "", last = null;
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return last;
    const lines = (rest + value).split("\n");
    rest = lines.pop();
    for (const line of lines) tell((last = JSON.parse(line)));
  }
}

// The link that was printed holds a key, which opens one session and is worth nothing after. It does not stay in the address.
async function openSession() {
  const parts = new URLSearchParams(location.hash.slice(1)), key = parts.get("key");
  if (!key) return;
  parts.delete("key");
  history.replaceState(null, "", parts.size ? `#${parts}` : location.pathname);
  session = null;
  session = (await ask("/session", { key })).session;
  sessionStorage.setItem("session", session);
}
