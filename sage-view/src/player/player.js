// --- layout and controls ---

function start(next) {
  decode(next);
  group();
  view.time = now;
  if (panels.some((p) => p.adversary)) view.follow = element("follow").value = "both";
  else element("follow").querySelectorAll("[value=adversary],[value=both]").forEach((o) => o.remove());
  build();
  openLink() || alone(null);
}

let seen = null;
function build() {
  document.title = data.title;
  element("title").textContent = data.title;
  element("subtitle").textContent = data.subtitle;
  element("time").max = last;
  const has = { ghost: panels.some((p) => p.ghost), escape: panels.some((p) => p.escape), others: paths.length > 0 };
  element("ghost").parentElement.hidden = !has.ghost && !has.escape;
  element("ghost-legend").hidden = !has.ghost;
  const optional = [has.ghost && "drive without the attack", has.escape && "evasive manoeuvre"].filter(Boolean).join(", ");
  element("ghost-label").textContent = element("ghost-key").textContent = optional;
  element("others").parentElement.hidden = element("others-key").hidden = element("kinds").hidden = !has.others;
  element("kinds").querySelectorAll("span").forEach((e) => e.remove());
  for (const [kind, [tone, words]] of Object.entries(kinds).filter(([kind]) => paths.some((p) => p.kind === kind)).reverse()) {
    const entry = document.createElement("span"), stroke = document.createElement("i");
    stroke.className = "stroke";
    stroke.style.borderTopColor = tone;
    entry.append(stroke, words);
    element("kinds").append(" ", entry);
  }
  element("plan-legend").hidden = !panels.some((p) => p.shown.some((s) => s.x.length));
  element("escape-legend").hidden = !has.escape;
  if (!panels.some((p) => p.adversary)) element("adversary-legend").hidden = true;
  for (const kind of ["pedestrian", "cyclist", "other"]) element(`${kind}-legend`).hidden = !traffic.some((b) => b.kind === kind);
  element("contact-legend").hidden = !panels.some((p) => p.contact);
  const mark = (frame, name) => { const i = document.createElement("i"); i.className = name; i.style.left = `${(100 * frame) / last}%`; element("marks").append(i); return i; };
  for (const id of ["marks", "panels"]) element(id).replaceChildren();
  mark(now, "now");
  for (const panel of panels) {
    const make = (tag, parent, name) => { const e = document.createElement(tag); if (name) e.className = name; parent.append(e); return e; };
    panel.mark = panel.contact && mark(panel.contact.frame, "hit");
    panel.box = make("section", element("panels"), "panel");
    const head = make("h2", panel.box);
    head.title = "Show this drive alone, or all";
    make("b", head).textContent = title(panel);
    panel.badge_words = panel.badge || (panel.verdict ? "attack" : "no attack");
    panel.badge = make("em", head, panel.verdict || panel.failed ? "hit" : "");
    panel.badge.textContent = panel.failed ? "planner failed" : panel.badge_words;
    panel.live = make("span", head);
    panel.live.title = "Speed of the ego, and the gap between ego and adversary";
    panel.history = panel.verdict === null ? "Before now." : "Before now: the attack begins at 0 s.";
    const area = make("div", panel.box, "view");
    panel.canvas = make("canvas", area);
    panel.canvas.setAttribute("aria-label", `Drive of ${title(panel)} from above`);
    panel.strip = make("canvas", make("div", panel.box, "strip"));
    panel.status = make("p", panel.box);
    panel.log = make("pre", panel.box);
    panel.log.title = "What the planner wrote to its log";
    panel.log.hidden = !panel.shown.some((s) => s.log);
    head.addEventListener("click", () => alone(view.alone === null ? unit(panel) : null));
    panel.isVisible = true;
    drag(area, panel);
  }
  // Drives that are scrolled out of view are not drawn.
  seen?.disconnect();
  seen = new IntersectionObserver((changes) => {
    const changed = changes.map(({ target, isIntersecting }) => [panels.find((p) => p.box === target), isIntersecting]).filter(([p, isVisible]) => p && p.isVisible !== isVisible);
    changed.forEach(([p, isVisible]) => (p.isVisible = isVisible));
    if (changed.length) redraw();
  });
  panels.forEach((p) => seen.observe(p.box));
  if (groups.length) buildSweep();
  if (typeof data.back === "string" && /^[\w.][^:]*$/.test(data.back)) {
    const from = new URLSearchParams(location.search).get("from");
    element("index").href = from ? `${data.back}#${from}` : data.back;
    element("index").hidden = false;
  }
}

function show() {
  const order = units();
  for (const p of panels) {
    // The observer would report a box that appears one frame late.
    if (p.box.hidden && isShown(p)) p.isVisible = true;
    p.box.hidden = !isShown(p);
    if (groups.length) p.box.style.order = order.indexOf(unit(p));
    if (p.mark && (groups.length || hasLinks())) p.mark.hidden = p.box.hidden;
  }
  element("every").hidden = !hasLinks() || view.alone === null || units().length === 1;
  // The address must not name a drive that is no longer the one shown.
  const panel = linked();
  if (panel && (view.alone === null || panel.box.hidden)) history.replaceState(null, "", location.href.split("#")[0]);
  redraw();
}

function alone(chosen) {
  view.alone = chosen;
  view.isZoomed = false;
  show();
  arrange();
}

// A row of drives becomes a row of boxes; rows of one box each become one row.
function boxesInRow() {
  const wide = new Set(panels.slice(0, data.columns).map(unit)).size;
  return view.all ? data.columns : wide > 1 ? wide : units().length;
}

// Columns as in the data if there is room for them, else as many as fit.
function arrange() {
  const shown = panels.filter((p) => !p.box.hidden).length, room = Math.max(1, Math.floor(element("panels").clientWidth / 280));
  const wanted = shown === 1 ? 1 : Math.min(boxesInRow(), shown);
  // On a wide page each driver keeps its row, even if it has to be scrolled; on a narrow one rows wrap.
  const [columns, least] = wanted > room && room > 2 ? [wanted, "240px"] : [Math.min(wanted, room), "0"];
  element("panels").style.gridTemplateColumns = `repeat(${columns}, minmax(${least}, 1fr))`;
  if (!view.isZoomed) view.scale = 0;
  // Room for the longest text, so that the view keeps its size when the text changes.
  const tallest = (p) => {
    p.status.style.height = "auto";
    const members = unit(p).members || [p]; // the slider does not change the size either
    return Math.max(...[...new Set(members.flatMap((m) => [m.note, m.ending, m.history]))].map((words) => { p.status.textContent = words; return p.status.offsetHeight; }));
  };
  const height = Math.max(...panels.filter((p) => !p.box.hidden).map(tallest));
  panels.forEach((p) => (p.status.style.height = `${height}px`));
  redraw();
}

// Zooms about a point of a view, in pixels from its centre, or about the centre.
function zoom(factor, at = [0, 0]) {
  const before = view.scale;
  view.isZoomed = true;
  view.scale = Math.min(60, Math.max(0.6, view.scale * factor));
  if (view.follow === "free") {
    const shift = 1 / before - 1 / view.scale;
    view.centre = { x: view.centre.x + at[0] * shift, y: view.centre.y - at[1] * shift };
  }
  redraw();
}

function drag(area, panel) {
  let from = null;
  area.addEventListener("pointerdown", (e) => {
    if (e.button !== 0) return;
    from = [e.clientX, e.clientY];
    area.setPointerCapture(e.pointerId);
  });
  area.addEventListener("pointermove", (e) => {
    if (!from) return;
    view.centre = { x: panel.middle.x - (e.clientX - from[0]) / view.scale, y: panel.middle.y + (e.clientY - from[1]) / view.scale };
    from = [e.clientX, e.clientY];
    panel.middle = view.centre;
    follow("free");
  });
  for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) area.addEventListener(end, () => (from = null));
  area.addEventListener("wheel", (e) => {
    e.preventDefault();
    const box = area.getBoundingClientRect();
    zoom(Math.exp(-0.0015 * e.deltaY), [e.clientX - box.left - box.width / 2, e.clientY - box.top - box.height / 2]);
  }, { passive: false });
}

function follow(what) {
  if (what === "free" && !view.centre) {
    const panel = panels.find((p) => !p.box.hidden); // perhaps not drawn yet
    view.centre = { ...centre(panel, Math.min(view.time, panel.end)) };
  }
  if (what !== "free") view.centre = null;
  view.follow = element("follow").value = what;
  redraw();
}

function seek(frame) {
  view.time = Math.min(last, Math.max(0, frame));
  redraw();
}

// Nothing moves after the last drive that is shown has ended.
const end = () => Math.max(...panels.filter((p) => !p.box.hidden).map((p) => p.end));

let before = 0, ticking = 0;
function play(start) {
  if (start && view.time >= end()) view.time = 0;
  view.playing = start;
  before = performance.now();
  cancelAnimationFrame(ticking);
  if (start) ticking = requestAnimationFrame(tick);
  redraw();
}

function tick(at) {
  if (!view.playing) return;
  // A frame may have begun before the key was pressed.
  view.time = Math.min(end(), view.time + (Math.max(0, at - before) / 100) * view.rate);
  before = at;
  redraw();
  if (view.time >= end()) play(false);
  else ticking = requestAnimationFrame(tick);
}

const step = (frames) => { play(false); seek(Math.round(view.time) + frames); };
const next = (list) => { play(false); seek(list.length ? list.find((f) => f > view.time + 0.01) ?? list[0] : view.time); };
const keys = {
  " ": (e) => e.repeat || play(!view.playing), ArrowLeft: (e) => step(e.shiftKey ? -10 : -1), ArrowRight: (e) => step(e.shiftKey ? 10 : 1),
  Home: () => step(-last), End: () => step(last), "+": () => zoom(1.25), "=": () => zoom(1.25), "-": () => zoom(0.8), "−": () => zoom(0.8),
  c: () => next(panels.filter((p) => p.contact && !p.box.hidden).map((p) => p.contact.frame).sort((a, b) => a - b)), g: () => element("ghost").click(), o: () => element("others").click(), "?": () => element("help").click(),
  p: () => { const options = [...element("plot").options].map((o) => o.value); choosePlot(options[(options.indexOf(view.plot) + 1) % options.length]); },
  f: () => { const options = [...element("follow").options].map((o) => o.value); follow(options[(options.indexOf(view.follow) + 1) % options.length]); },
  0: () => alone(null),
};

element("play").addEventListener("click", () => play(!view.playing));
element("back").addEventListener("click", () => step(-1));
element("forward").addEventListener("click", () => step(1));
element("time").addEventListener("input", (e) => { play(false); seek(Number(e.target.value)); });
element("rate").addEventListener("change", (e) => (view.rate = Number(e.target.value)));
element("follow").addEventListener("change", (e) => follow(e.target.value));
element("plot").addEventListener("change", (e) => choosePlot(e.target.value));
element("in").addEventListener("click", () => zoom(1.25));
element("out").addEventListener("click", () => zoom(0.8));
element("ghost").addEventListener("change", (e) => { view.ghost = e.target.checked; redraw(); });
element("others").addEventListener("change", (e) => { view.others = e.target.checked; redraw(); });
element("more").addEventListener("click", (e) => { e.target.setAttribute("aria-expanded", String(document.body.classList.toggle("open"))); arrange(); });
element("help").addEventListener("click", (e) => { element("keys").hidden = !element("keys").hidden; e.target.setAttribute("aria-expanded", String(!element("keys").hidden)); arrange(); });
element("every").addEventListener("click", () => alone(null));
window.addEventListener("hashchange", () => {
  if (!openLink() && hasLinks() && location.hash.length < 2 && view.alone !== null) alone(null);
});
document.addEventListener("keydown", (e) => {
  // Some keyboards type brackets with AltGr or Option.
  const isBracket = e.altKey && !e.metaKey && (e.key === "[" || e.key === "]");
  if (((e.ctrlKey || e.metaKey || e.altKey) && !isBracket) || (e.target.tagName === "SELECT" && e.key !== "Escape")) return;
  const key = e.key.length === 1 ? e.key.toLowerCase() : e.key;
  // Space also presses the button and ticks the box that the keyboard is on.
  if (e.key === " " && ((e.target.tagName === "BUTTON" && e.target.id !== "play") || e.target.type === "checkbox")) return;
  // A slider beside that of the time has its own keys, and a text field has all.
  if (e.target.type === "range" && e.target.id !== "time" && /^(Arrow|Home|End|Page)/.test(e.key)) return;
  if (e.target.type === "search") return;
  const digit = Number(key), boxes = units();
  const action = keys[key] || (digit >= 1 && digit <= boxes.length && key !== " " ? () => alone(boxes[digit - 1]) : null);
  if (action) { e.preventDefault(); action(e); }
});
// What the mouse used does not keep the keyboard, except the slider of a sweep.
document.querySelectorAll("nav button, nav input:not(#value)").forEach((e) => e.addEventListener("click", (event) => event.detail && e.blur()));
document.querySelectorAll("nav select").forEach((e) => e.addEventListener("change", () => e.blur()));
window.addEventListener("resize", arrange);
