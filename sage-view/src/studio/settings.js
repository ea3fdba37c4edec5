// --- settings: every change attacks and drives again ---

let offered = null; // what the server offers
const wanted = { scene: 0, generator: 0, dial: "lambda", step: 0, drivers: [0], adversary: null, without: [], goal: null };
let scene = null; // as the server describes it

function option(select, value, text) {
  const one = document.createElement("option");
  one.value = value;
  one.textContent = text;
  select.append(one);
}

// Of many scenes a list shows the first that match.
const MOST_LISTED = 500;
function listScenes() {
  const words = element("filter").value.toLowerCase();
  const found = offered.scenes.map((name, k) => [name, k]).filter(([name]) => name.toLowerCase().includes(words));
  const list = element("scenes");
  list.replaceChildren();
  found.slice(0, MOST_LISTED).forEach(([name, k]) => option(list, k, name));
  list.value = wanted.scene;
  element("count").textContent = found.length > MOST_LISTED ? `${MOST_LISTED} of ${found.length} that match are listed` : `${found.length} of ${offered.scenes.length}`;
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
function attackWith(id) { wanted.adversary = id; wanted.goal = null; closeMenu(); attackAgain(); }
function toggle(id) {
  wanted.without = wanted.without.includes(id) ? wanted.without.filter((other) => other !== id) : [...wanted.without, id];
  if (wanted.adversary === id) wanted.adversary = null;
  if (scene.adversary === id) wanted.goal = null;
  closeMenu();
  attackAgain();
}

async function openScene(number) {
  Object.assign(wanted, { scene: number, adversary: null, without: [], goal: null });
  element("scenes").value = number;
  try {
    scene = await ask("/scene", { scene: number });
  } catch (error) {
    return say([{ error: error.message }]);
  }
  const isFirst = !data;
  decode(scene.data);
  scene.bodies = traffic.map((body, k) => ({ id: scene.data.ids[k], body }));
  if (isFirst) view.follow = element("follow").value = "both";
  view.time = now;
  view.isZoomed = false;
  attackAgain();
}

// The newest setting is always computed; those between are left out while a drag goes on.
let isAsking = false, isNewer = false;
async function attackAgain() {
  showSettings();
  isNewer = true;
  if (isAsking) return;
  isAsking = true;
  while (isNewer) {
    isNewer = false;
    const number = wanted.scene;
    try {
      const answer = await ask("/drive", wanted);
      if (number === wanted.scene) draw(answer);
    } catch (error) {
      if (error.status !== 409) say([{ error: error.message }]);
    }
  }
  isAsking = false;
}

function draw(answer) {
  const isNew = !panels.length || panels.length !== answer.drives.panels.length;
  data.panels = answer.drives.panels;
  data.paths = answer.drives.paths;
  scene.adversary = answer.adversary;
  traffic = scene.bodies.filter(({ id }) => id !== answer.adversary && !wanted.without.includes(id)).map(({ body }) => body);
  paths = data.paths.map(({ kind, x, y }) => ({ kind, x: sums(x, 1e-1), y: sums(y, 1e-1) }));
  const middles = panels.map((p) => p.middle), lone = panels.indexOf(view.alone);
  decodePanels();
  view.alone = panels[lone] || null;
  // Where the mouse is must be known before the next frame.
  panels.forEach((p, k) => (p.middle = middles[k]));
  group();
  build();
  if (isNew) alone(null);
  else { show(); arrange(); }
  say(answer.words);
  element("command").textContent = answer.command;
  listUsers();
  document.body.dataset.drawn = String(Number(document.body.dataset.drawn || 0) + 1);
}

function say(lines) {
  element("words").replaceChildren(...lines.map(({ error, driver, text, attack }) => {
    const line = document.createElement("p");
    line.className = error ? "error" : attack ? "attack" : "";
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
  element("dial-value").textContent = `${wanted.dial === "lambda" ? "λ" : wanted.dial} ${value}`;
  element("dial").setAttribute("aria-valuetext", `${wanted.dial} ${value}`);
  if (!generator.aims) wanted.goal = null;
  element("goal").parentElement.hidden = !generator.aims;
  element("no-goal").hidden = !wanted.goal;
}

// --- the map: a click on a road user, a drag of the end of the plan ---

// Where a point of the screen lies in a panel, metres from the origin of the page.
function placeIn(panel, event) {
  const box = panel.canvas.getBoundingClientRect();
  panel.middle ||= centre(panel, Math.min(view.time, panel.end));
  return { x: panel.middle.x + (event.clientX - box.left - box.width / 2) / view.scale, y: panel.middle.y - (event.clientY - box.top - box.height / 2) / view.scale };
}
// While the mouse is down the view has its events, else the picture in it.
const panelOf = (event) => panels.find((p) => p.canvas === event.target || p.canvas.parentElement === event.target);
const endOf = (panel) => panel.adversary && offered.generators[wanted.generator].aims && { x: panel.adversary.x.at(-1), y: panel.adversary.y.at(-1) };
const REACH = 9; // of a handle, pixels

overlay = (c, panel, pixel) => {
  const end = endOf(panel);
  if (!end) return;
  if (wanted.goal) {
    const [x, y] = wanted.goal.map((value, axis) => value - scene.data.origin[axis]), reach = 5 * pixel;
    c.beginPath();
    for (const side of [-1, 1]) {
      c.moveTo(x - reach, y - side * reach);
      c.lineTo(x + reach, y + side * reach);
    }
    c.strokeStyle = colour.adversary;
    c.lineWidth = 2 * pixel;
    c.stroke();
  }
  c.beginPath();
  c.arc(end.x, end.y, 6 * pixel, 0, 7);
  c.fillStyle = "#fff";
  c.strokeStyle = colour.adversary;
  c.lineWidth = 2.5 * pixel;
  c.fill();
  c.stroke();
};

let dragged = null, pressed = null;
element("panels").addEventListener("pointerdown", (event) => {
  const panel = panelOf(event);
  closeMenu();
  if (!panel || event.button !== 0) return;
  pressed = [event.clientX, event.clientY];
  const at = placeIn(panel, event), end = endOf(panel);
  if (!end || Math.hypot(at.x - end.x, at.y - end.y) * view.scale > REACH) return;
  dragged = panel.name;
  element("panels").setPointerCapture(event.pointerId);
  event.stopPropagation();
}, true);
element("panels").addEventListener("pointermove", (event) => {
  const panel = dragged && panels.find((p) => p.name === dragged);
  if (!panel) return;
  event.stopPropagation();
  const at = placeIn(panel, event);
  wanted.goal = [at.x + scene.data.origin[0], at.y + scene.data.origin[1]].map((x) => Math.round(100 * x) / 100);
  attackAgain();
}, true);
element("panels").addEventListener("pointerup", (event) => {
  const isClick = pressed && Math.hypot(event.clientX - pressed[0], event.clientY - pressed[1]) < 4, panel = panelOf(event);
  pressed = null;
  if (dragged) { dragged = null; return; }
  if (!isClick || !panel) return;
  const at = placeIn(panel, event), time = Math.min(view.time, panel.end);
  const near = ({ body: b }) => { const p = pose(b, time); return p ? Math.hypot(p.x - at.x, p.y - at.y) - b.length / 2 : Infinity; };
  const hit = scene.bodies.filter(({ id }) => id !== scene.adversary && !wanted.without.includes(id)).sort((a, b) => near(a) - near(b))[0];
  if (hit && near(hit) * view.scale < REACH) openMenu(hit.id, event);
});

function openMenu(id, event) {
  const user = scene.users.find((user) => user.id === id), menu = element("menu");
  if (!user) return;
  menu.replaceChildren();
  if (user.canAttack) menu.append(button(`attack with ${id}`, () => attackWith(id)));
  menu.append(button(`take ${id} away`, () => toggle(id)));
  menu.style.left = `${event.clientX}px`;
  menu.style.top = `${event.clientY}px`;
  menu.hidden = false;
  menu.firstChild.focus();
}
function closeMenu() { element("menu").hidden = true; }

// --- controls ---

element("filter").addEventListener("input", listScenes);
element("scenes").addEventListener("change", (e) => openScene(Number(e.target.value)));
element("generator").addEventListener("change", (e) => { wanted.generator = Number(e.target.value); attackAgain(); });
element("dial").addEventListener("input", (e) => { wanted.step = Number(e.target.value); attackAgain(); });
document.querySelectorAll("[name=dial]").forEach((e) => e.addEventListener("change", () => { wanted.dial = e.value; attackAgain(); }));
for (const id of ["driver", "second"]) element(id).addEventListener("change", () => {
  wanted.drivers = [element("driver").value, element("second").value].filter((x) => x !== "").map(Number);
  attackAgain();
});
element("no-goal").addEventListener("click", () => { wanted.goal = null; attackAgain(); });
element("copy").addEventListener("click", async () => {
  await navigator.clipboard.writeText(element("command").textContent).then(() => (element("said").textContent = "copied"), () => (element("said").textContent = "select it below"));
});
document.addEventListener("keydown", (e) => { if (e.key === "Escape") closeMenu(); });

function offer() {
  wanted.step = offered.steps - 1;
  offered.generators.forEach(({ name }, k) => option(element("generator"), k, name));
  offered.drivers.forEach((name, k) => ["driver", "second"].forEach((id) => option(element(id), k, name)));
  option(element("second"), "", "none");
  element("second").value = offered.drivers.length > 1 ? 1 : "";
  wanted.drivers = offered.drivers.length > 1 ? [0, 1] : [0];
  listScenes();
}

(async () => {
  try {
    await openSession();
    offered = await ask("/offered", {});
    offer();
    await openScene(0);
  } catch (error) {
    say([{ error: error.message }]);
  }
})();
