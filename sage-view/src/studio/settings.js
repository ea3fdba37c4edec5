// --- settings: every change attacks and drives again ---

let offered = null; // what the server offers
const wanted = { scene: 0, generator: 0, dial: "lambda", step: 0, drivers: [0], adversary: null, without: [], goal: null, found: null };
let scene = null; // as the server describes it

function option(select, value, text) {
  const one = document.createElement("option");
  one.value = value;
  one.textContent = text;
  select.append(one);
}

let listed = ""; // what the list shows
function listUsers() {
  const shows = JSON.stringify([wanted.scene, scene.adversary, wanted.without]);
  if (shows === listed) return;
  const list = element("users"), focused = document.activeElement?.closest("#users li")?.dataset.id;
  const top = JSON.parse(listed || "[]")[0] === wanted.scene ? list.scrollTop : 0;
  listed = shows;
  list.replaceChildren();
  for (const user of scene.users) {
    const row = document.createElement("li"), name = document.createElement("span"), isAway = wanted.without.includes(user.id);
    row.dataset.id = user.id;
    row.className = user.id === adversary() ? "adversary" : isAway ? "away" : "";
    name.textContent = `${user.id}, ${user.kind}${user.id === adversary() ? ", adversary" : ""}`;
    row.append(name);
    if (user.canAttack && !isAway && user.id !== adversary()) row.append(button("attack", () => attackWith(user.id), `Attack with ${user.id}`));
    row.append(button(isAway ? "back" : "away", () => toggle(user.id), `${isAway ? "Bring back" : "Take away"} ${user.id}`));
    list.append(row);
    // The keyboard stays with the road user.
    if (user.id === focused) row.lastChild.focus();
  }
  list.scrollTop = top;
}

function button(text, action, label = text) {
  const one = document.createElement("button");
  one.textContent = text;
  one.setAttribute("aria-label", label);
  one.addEventListener("click", action);
  return one;
}

const adversary = () => scene.adversary;
function attackWith(id) { wanted.adversary = id; wanted.goal = null; forgetFound(); closeMenu(); attackAgain(); }
function toggle(id) {
  wanted.without = wanted.without.includes(id) ? wanted.without.filter((other) => other !== id) : [...wanted.without, id];
  if (wanted.adversary === id) wanted.adversary = null;
  if (scene.adversary === id) { wanted.goal = null; forgetFound(); }
  closeMenu();
  attackAgain();
}

const openScene = (number) => openView({ scene: number, adversary: null, without: [], goal: null });

// A view from a link starts no program: a person does.
async function openView(next, isOfLink = false) {
  if (!next) return;
  clearTimeout(explaining);
  Object.assign(wanted, next);
  forgetFound();
  markScene()?.scrollIntoView({ block: "nearest" });
  for (const [id, k] of [["generator", wanted.generator], ["driver", wanted.drivers[0]], ["second", wanted.drivers[1] ?? ""]]) element(id).value = k;
  try {
    scene = await ask("/scene", { scene: wanted.scene });
  } catch (error) {
    return error.isReplaced ? null : say([{ error: error.message }]);
  }
  const isFirst = !data;
  decode(scene.data);
  scene.bodies = traffic.map((body, k) => ({ id: scene.data.ids[k], body }));
  if (isFirst) view.follow = element("follow").value = "both";
  view.time = now;
  view.isZoomed = false;
  element("start").hidden = !isOfLink || !wanted.drivers.some((k) => offered.drivers[k].isProgram);
  if (element("start").hidden) attackAgain();
  else showSettings();
}

// The newest setting is always computed; those between are left out while a drag goes on.
let pending = null, isNewer = false;
function attackAgain() {
  showSettings();
  saveView();
  clearTimeout(explaining);
  isNewer = true;
  return (pending ||= newest());
}
async function newest() {
  while (isNewer) {
    isNewer = false;
    const number = wanted.scene;
    try {
      const answer = await ask("/drive", wanted);
      if (number === wanted.scene) draw(answer);
    } catch (error) {
      if (!error.isReplaced) say([{ error: error.message }]);
    }
  }
  pending = null;
  explainSoon();
}

function draw(answer) {
  const isNew = !panels.length || panels.length !== answer.drives.panels.length;
  data.panels = answer.drives.panels;
  scene.adversary = answer.adversary;
  traffic = scene.bodies.filter(({ id }) => id !== answer.adversary && !wanted.without.includes(id)).map(({ body }) => body);
  const middles = panels.map((p) => p.middle), lone = panels.indexOf(view.alone);
  decodePanels();
  view.alone = panels[lone] || null;
  // Where the mouse is must be known before the next frame.
  panels.forEach((p, k) => (p.middle = middles[k]));
  group();
  build();
  if (isNew) alone(null);
  else { show(); arrange(); }
  // Nothing to wait for: the next frame shows it.
  drawNow();
  say(answer.words);
  showWhy([]);
  element("kept").textContent = "";
  element("command").textContent = answer.command;
  listUsers();
  document.body.dataset.drawn = String(Number(document.body.dataset.drawn || 0) + 1);
}

function say(lines) {
  element("words").replaceChildren(...lines.map(({ error, driver, text, attack, isError }) => {
    const line = document.createElement("p");
    line.className = error || isError ? "error" : attack ? "attack" : "";
    line.textContent = error || `${driver}: ${text}`;
    return line;
  }));
}

function showSettings() {
  const generator = offered.generators[wanted.generator];
  if (!generator.dials.includes(wanted.dial)) wanted.dial = generator.dials[0] || "lambda";
  element("dials").hidden = generator.dials.length < 2;
  element("dial").parentElement.hidden = !generator.dials.length;
  document.querySelectorAll("[name=dial]").forEach((e) => (e.checked = e.value === wanted.dial));
  element("dial").max = offered.steps - 1;
  element("dial").value = wanted.step;
  element("dial").setAttribute("aria-label", wanted.dial);
  const value = (wanted.step / (offered.steps - 1)).toFixed(2);
  element("dial-value").textContent = wanted.found === null ? `${wanted.dial === "lambda" ? "λ" : wanted.dial} ${value}` : `failure ${wanted.found.number + 1}`;
  element("dial").setAttribute("aria-valuetext", `${wanted.dial} ${value}`);
  element("explain").hidden = !isProgram();
  element("own-way").hidden = wanted.drivers.length < 2 || wanted.found !== null;
  showPlaces();
  if (!generator.aims) wanted.goal = null;
  element("goal").parentElement.hidden = !generator.aims;
  element("no-goal").hidden = !wanted.goal;
}

// --- controls ---

// A plan of the generator takes the place of one that was found.
function generate(change) {
  Object.assign(wanted, change, { found: null });
  element("found").querySelectorAll("[aria-pressed=true]").forEach((e) => e.setAttribute("aria-pressed", "false"));
  attackAgain();
}
element("generator").addEventListener("change", (e) => {
  // Another generator may have other weights, and a search has those.
  forgetFound();
  generate({ generator: Number(e.target.value) });
});
element("dial").addEventListener("input", (e) => generate({ step: Number(e.target.value) }));
document.querySelectorAll("[name=dial]").forEach((e) => e.addEventListener("change", () => generate({ dial: e.value })));
for (const id of ["driver", "second"]) element(id).addEventListener("change", () => {
  wanted.drivers = [element("driver").value, element("second").value].filter((x) => x !== "").map(Number);
  if (id === "driver") forgetFound();
  attackAgain();
});
element("run").addEventListener("click", () => { element("start").hidden = true; attackAgain(); });
element("no-goal").addEventListener("click", () => { wanted.goal = null; attackAgain(); });
element("copy").addEventListener("click", async () => {
  await navigator.clipboard.writeText(element("command").textContent).then(() => (element("said").textContent = "copied"), () => (element("said").textContent = "select it below"));
});
document.addEventListener("keydown", (e) => { if (e.key === "Escape") closeMenu(); });

function offer() {
  wanted.step = offered.steps - 1;
  for (const id of ["generator", "driver", "second"]) element(id).replaceChildren();
  offered.generators.forEach(({ name }, k) => option(element("generator"), k, name));
  offered.drivers.forEach(({ name }, k) => ["driver", "second"].forEach((id) => option(element(id), k, name)));
  option(element("second"), "", "none");
  wanted.drivers = offered.drivers.length > 1 ? [0, 1] : [0];
  element("keep").disabled = !offered.keeps;
  if (!offered.keeps) element("keep").title = "Start `sage studio` with --out FOLDER to keep failures in a test suite";
  if (innerWidth > 640) choosePlot("all");
  listScenes();
}

// By night the map is dark too.
const night = matchMedia("(prefers-color-scheme: dark)"), day = { ...colour };
const dark = { ego: "#4fa8e0", adversary: "#ff8d3a", vehicle: "#78818b", ink: "#e6e8ea", escape: "#3cc48d", plan: "#b58cf2", contact: "#ff6b7a", paper: "#16181a", faint: "#a9b0b7", grid: "#3d4349", outline: "#c3c9cf", ground: "#202326", driveway: "#3a352b", sidewalk: "#3b342c", bike: "#2c3d34", lane: "#3a3f45", white: "#8b9299", yellow: "#b08a1a", median: "#7a6040", edge: "#aab0b6" };
function paint() {
  Object.assign(colour, night.matches ? dark : day);
  tiles.clear();
  if (panels) redraw();
}
night.addEventListener("change", paint);
paint();

async function begin() {
  try {
    await openSession();
    offered = await ask("/offered", {});
    offer();
    const linked = viewOf(location.hash);
    await openView(linked || { scene: 0 }, Boolean(linked));
  } catch (error) {
    say([{ error: error.message }]);
  }
}

begin();
