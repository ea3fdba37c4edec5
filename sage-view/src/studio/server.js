// --- the server: each request carries the session, never a path or a command ---

let session = sessionStorage.getItem("session");

async function send(path, body) {
  const headers = { "Content-Type": "application/json" };
  if (session) headers["X-Session"] = session;
  const reply = await fetch(path, { method: "POST", headers, body: JSON.stringify(body) });
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
