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
  generate({ goal: [at.x + scene.data.origin[0], at.y + scene.data.origin[1]].map((x) => Math.round(100 * x) / 100) });
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
