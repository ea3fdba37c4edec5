// --- the server: each request carries the session, never a path or a command ---

// The link that was printed holds a key, which opens one session and is worth nothing after.
const key = new URLSearchParams(location.hash.slice(1)).get("key");
let session = sessionStorage.getItem("session");

async function ask(path, body) {
  const headers = { "Content-Type": "application/json" };
  if (session) headers["X-Session"] = session;
  const reply = await fetch(path, { method: "POST", headers, body: JSON.stringify(body) });
  const answer = await reply.json().catch(() => ({ error: `the server answered ${reply.status}` }));
  if (!reply.ok) throw Object.assign(new Error(answer.error), { status: reply.status });
  return answer;
}

async function openSession() {
  if (!key) return;
  history.replaceState(null, "", location.pathname);
  session = null;
  session = (await ask("/session", { key })).session;
  sessionStorage.setItem("session", session);
}
