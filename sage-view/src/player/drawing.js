"use strict";
// Units of the data: centimetres, milliradians, centimetres per second. Numbers are differences to the one before.
const element = (id) => document.getElementById(id);
// Colours of six digits, to which two of opacity may be added.
const colour = {
  ego: "#0072b2", adversary: "#d55e00", vehicle: "#9aa2ac", pedestrian: "#cc79a7", cyclist: "#009e73", other: "#e6c229", ink: "#222222", escape: "#007a52", plan: "#783cc8", contact: "#b00020",
  paper: "#ffffff", faint: "#555555", grid: "#dddddd", outline: "#555d66",
  ground: "#eceae3", driveway: "#ddd3c0", sidewalk: "#cbb9a4", bike: "#c3dccd", lane: "#d3d7dc", white: "#ffffff", yellow: "#d9a300", median: "#8a6d4b", edge: "#4d4d4d",
};
// Candidates that were not selected, by what they do.
const kinds = { "no-contact": ["rgba(90,100,110,.45)", "no contact"], "infeasible-hit": ["rgba(204,121,167,.7)", "hit, not feasible"], "unbelievable-hit": ["rgba(230,159,0,.9)", "hit, not believable"], "believable-hit": ["rgba(165,15,21,.75)", "believable hit"] };

// --- decoding ---

function sums(differences, unit) {
  let sum = 0;
  return differences.map((d) => (sum += d) * unit);
}

// A body is given by runs of frames; between them it is absent, and its numbers are NaN.
function body({ runs, length, width, kind }) {
  const first = runs[0].first, b = { first, x: [], y: [], h: [], v: [], length: length / 100, width: width / 100, kind };
  for (const run of runs) {
    for (const [name, unit] of [["x", 1e-2], ["y", 1e-2], ["h", 1e-3], ["v", 1e-2]]) {
      while (b[name].length < run.first - first) b[name].push(NaN);
      b[name].push(...sums(run[name], unit));
    }
  }
  return b;
}

// Pose between two frames; null where the body is absent.
function pose(b, time) {
  const at = time - b.first;
  if (at < 0 || at > b.x.length - 1) return null;
  const k = Math.min(Math.floor(at), b.x.length - 1), next = Math.min(k + 1, b.x.length - 1), share = at - k;
  if (b.x[k] !== b.x[k] || b.x[next] !== b.x[next]) return null;
  const mix = (a) => a[k] + share * (a[next] - a[k]);
  return { x: mix(b.x), y: mix(b.y), h: mix(b.h), v: mix(b.v) };
}

function feature({ kind, width, x, y }) {
  const xs = sums(x, 1e-2), ys = sums(y, 1e-2), path = new Path2D();
  xs.forEach((px, k) => (k ? path.lineTo(px, ys[k]) : path.moveTo(px, ys[k])));
  const margin = (width || 100) / 200;
  const box = [Math.min(...xs) - margin, Math.min(...ys) - margin, Math.max(...xs) + margin, Math.max(...ys) + margin];
  return { kind, width: (width || 0) / 100, path, box };
}

// What the page shows.
let data, now, last, features, traffic, paths, panels;

function decode(next) {
  data = next;
  [now, last] = [data.now, data.frames - 1];
  features = data.map.map(feature);
  tileScale = 0;
  traffic = data.traffic.map(body);
  paths = data.paths.map(({ kind, x, y }) => ({ kind, x: sums(x, 1e-1), y: sums(y, 1e-1) }));
  decodePanels();
}

function decodePanels() {
  // In the order of `kinds`, so that the worst lie in front.
  const inFront = (others) => others && [...others].sort((a, b) => Object.keys(kinds).indexOf(paths[a].kind) - Object.keys(kinds).indexOf(paths[b].kind));
  panels = data.panels.map((p) => ({ ...p, drawn: inFront(p.others), ego: body(p.ego), adversary: p.adversary && body(p.adversary), ghost: p.ghost && body(p.ghost), escape: p.escape && body(p.escape), shown: p.shown.map((s) => ({ frame: s.frame, x: sums(s.x, 1e-2), y: sums(s.y, 1e-2), log: s.log })) }));
}

// What a page draws over each drive; its last argument is the size of a pixel in metres.
let overlay = null;

// --- state ---

const view = { time: 0, playing: false, rate: 1, scale: 0, isZoomed: false, follow: "ego", plot: "speed", centre: null, alone: null, ghost: true, others: true, all: false };

// --- map tiles: drawn once for each zoom, shared by all panels ---

const TILE = 512, MOST_TILES = 128;
let tiles = new Map(), tileScale = 0;
const passes = () => [
  ["driveway", "fill", colour.driveway], ["sidewalk", "fill", colour.sidewalk], ["bike", "lane", colour.bike], ["lane", "lane", colour.lane], ["crosswalk", "fill", colour.white + "a6"], ["bump", "fill", colour.median + "59"],
  ["white", "line", colour.white], ["white-broken", "dash", colour.white], ["yellow", "line", colour.yellow], ["yellow-broken", "dash", colour.yellow],
  ["median", "edge", colour.median], ["edge", "edge", colour.edge],
];

function tile(column, row, scale) {
  if (scale !== tileScale) { tiles = new Map(); tileScale = scale; }
  const key = column + "," + row;
  let canvas = tiles.get(key);
  if (canvas) return canvas;
  if (tiles.size >= MOST_TILES) tiles.delete(tiles.keys().next().value);
  canvas = document.createElement("canvas");
  canvas.width = canvas.height = TILE;
  const c = canvas.getContext("2d"), size = TILE / scale, left = column * size, bottom = row * size;
  c.fillStyle = colour.ground;
  c.fillRect(0, 0, TILE, TILE);
  c.setTransform(scale, 0, 0, -scale, -left * scale, TILE + bottom * scale);
  c.lineJoin = c.lineCap = "round";
  const near = features.filter(({ box }) => box[2] >= left && box[0] <= left + size && box[3] >= bottom && box[1] <= bottom + size);
  for (const [kind, how, tone] of passes()) {
    for (const f of near) {
      if (f.kind !== kind) continue;
      c.setLineDash(how === "dash" ? [3, 3] : []);
      if (how === "fill") { c.fillStyle = tone; c.fill(f.path); continue; }
      c.strokeStyle = tone;
      c.lineWidth = how === "lane" ? f.width : Math.max(how === "edge" ? 0.2 : 0.15, (how === "edge" ? 2 : 1) / scale);
      c.stroke(f.path);
    }
  }
  tiles.set(key, canvas);
  return canvas;
}

// --- drawing ---

function car(c, p, b, tone, { stripes = false, outline = colour.outline, dashed = false } = {}) {
  c.save();
  c.translate(p.x, p.y);
  c.rotate(p.h);
  const l = b.length, w = b.width;
  c.lineWidth = 0.12;
  if (dashed) { c.setLineDash([0.5, 0.35]); c.strokeStyle = tone; c.lineWidth = 0.18; c.strokeRect(-l / 2, -w / 2, l, w); c.restore(); return; }
  c.fillStyle = tone;
  c.strokeStyle = outline;
  c.fillRect(-l / 2, -w / 2, l, w);
  if (stripes) { c.fillStyle = "#fff"; c.fillRect(-0.14 * l, -w / 2, 0.09 * l, w); c.fillRect(-0.35 * l, -w / 2, 0.09 * l, w); }
  c.fillStyle = "rgba(0,0,0,.35)"; // windscreen: shows where the front is
  if (l > 2.5) c.fillRect(0.16 * l, -0.42 * w, 0.1 * l, 0.84 * w);
  c.strokeRect(-l / 2, -w / 2, l, w);
  c.restore();
}

// A person seen from above: a round body (a long one on a bicycle) and a line ahead; `least` is the smallest radius to be seen.
function person(c, p, b, tone, least) {
  const wide = Math.max(b.width / 2, least), long = Math.max(b.length / 2, wide);
  c.save();
  c.translate(p.x, p.y);
  c.rotate(p.h);
  c.beginPath();
  c.ellipse(0, 0, long, wide, 0, 0, 7);
  c.fillStyle = tone;
  c.strokeStyle = colour.ink;
  c.lineWidth = 0.1;
  c.fill();
  c.stroke();
  c.beginPath();
  c.moveTo(0, 0);
  c.lineTo(1.6 * long, 0);
  c.stroke();
  c.restore();
}

// Distance of two boxes: apart, a corner of one is nearest to the other.
function space(p, a, q, b) {
  const from = (p, a, q, b) => {
    const cos = Math.cos(q.h), sin = Math.sin(q.h), gaps = [];
    for (const i of [-1, 0, 1]) for (const j of [-1, 1]) {
      const x = p.x + (i * a.length * Math.cos(p.h) - j * a.width * Math.sin(p.h)) / 2 - q.x, y = p.y + (i * a.length * Math.sin(p.h) + j * a.width * Math.cos(p.h)) / 2 - q.y;
      gaps.push(Math.hypot(Math.max(0, Math.abs(x * cos + y * sin) - b.length / 2), Math.max(0, Math.abs(y * cos - x * sin) - b.width / 2)));
    }
    return Math.min(...gaps);
  };
  return Math.min(from(p, a, q, b), from(q, b, p, a));
}

// Outlines of boxes with a label beside the first, of one size on the screen; `pixel` is its size in metres.
function mark(c, { boxes, label }, pixel) {
  c.strokeStyle = colour.contact;
  c.lineWidth = 1.6 * pixel;
  for (const [x, y, h, l, w] of boxes) {
    c.save();
    c.translate(x / 100, y / 100);
    c.rotate(h / 1000);
    c.strokeRect(-l / 200, -w / 200, l / 100, w / 100);
    c.restore();
  }
  c.save();
  c.translate(boxes[0][0] / 100, boxes[0][1] / 100);
  c.scale(pixel, -pixel);
  c.font = "12px system-ui, sans-serif";
  c.strokeStyle = colour.paper;
  c.lineWidth = 3;
  c.strokeText(label, 12, 4);
  c.fillStyle = colour.ink;
  c.fillText(label, 12, 4);
  c.restore();
}

function trail(c, b, from, to, tone, width) {
  c.beginPath();
  for (let t = Math.max(0, from - b.first), drawn = false; t <= Math.min(b.x.length - 1, to - b.first); t++) {
    const isThere = b.x[t] === b.x[t];
    if (isThere) drawn ? c.lineTo(b.x[t], b.y[t]) : c.moveTo(b.x[t], b.y[t]);
    drawn = isThere;
  }
  c.strokeStyle = tone;
  c.lineWidth = width;
  c.stroke();
}

// What the driver showed last; its plan counts until the next one.
function planAt(panel, time) {
  return panel.shown.findLast((s) => s.frame <= time && s.x.length);
}

function line(c, { x, y }, tone, width) {
  c.beginPath();
  x.forEach((px, k) => (k ? c.lineTo(px, y[k]) : c.moveTo(px, y[k])));
  c.strokeStyle = tone;
  c.lineWidth = width;
  c.stroke();
}

function centre(panel, time) {
  const ego = pose(panel.ego, time), adversary = panel.adversary && pose(panel.adversary, time);
  if (view.follow === "free" && view.centre) return view.centre;
  if (view.follow === "adversary" && adversary) return adversary;
  if (view.follow === "both" && adversary) {
    // Half way, but never so far that the ego is out of view.
    const reach = (size) => (0.38 * size) / view.scale, half = (a, b, most) => Math.max(-most, Math.min(most, (b - a) / 2));
    return { x: ego.x + half(ego.x, adversary.x, reach(panel.canvas.clientWidth)), y: ego.y + half(ego.y, adversary.y, reach(panel.canvas.clientHeight)) };
  }
  return ego;
}

function fitted(canvas) {
  const ratio = window.devicePixelRatio || 1, box = canvas.parentElement.getBoundingClientRect();
  const width = Math.max(1, Math.round(box.width * ratio)), height = Math.max(1, Math.round(box.height * ratio));
  if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
  return ratio;
}

function drawPanel(panel) {
  const canvas = panel.canvas, c = canvas.getContext("2d"), ratio = fitted(canvas);
  const time = Math.min(view.time, panel.end), middle = centre(panel, time), scale = view.scale * ratio;
  const { width, height } = canvas;
  panel.middle = middle;
  // Whole pixels: tiles meet without gaps, and the map does not shake under the cars.
  const x0 = Math.round(middle.x * scale - width / 2), y0 = Math.round(middle.y * scale - height / 2);
  const left = x0 / scale, bottom = y0 / scale;
  c.setTransform(1, 0, 0, 1, 0, 0);
  for (let column = Math.floor(x0 / TILE); column * TILE < x0 + width; column++) {
    for (let row = Math.floor(y0 / TILE); row * TILE < y0 + height; row++) {
      c.drawImage(tile(column, row, scale), column * TILE - x0, height - (row * TILE - y0) - TILE);
    }
  }
  c.setTransform(scale, 0, 0, -scale, -x0, height + y0);
  c.lineJoin = c.lineCap = "round";
  for (const b of traffic) {
    const p = pose(b, time);
    if (!p || p.x < left - 20 || p.x > left + width / scale + 20 || p.y < bottom - 20 || p.y > bottom + height / scale + 20) continue;
    if (b.kind === "vehicle" || b.length > 2.5) car(c, p, b, colour[b.kind]);
    else { c.beginPath(); c.arc(p.x, p.y, Math.max(0.5, 4 * ratio / scale), 0, 7); c.fillStyle = colour[b.kind]; c.strokeStyle = colour.ink; c.lineWidth = 0.1; c.fill(); c.stroke(); }
  }
  const thin = Math.max(0.15, (1.5 * ratio) / scale);
  if (panel.ghost && view.ghost) {
    c.setLineDash([0.8, 0.8]);
    trail(c, panel.ghost, now, last, colour.ego + "8c", thin);
    c.setLineDash([]);
  }
  if (panel.others && view.others) for (const k of panel.drawn) line(c, paths[k], kinds[paths[k].kind][0], 0.7 * thin);
  if (panel.escape && view.ghost) {
    c.setLineDash([0.8, 0.8]);
    trail(c, panel.escape, now, last, colour.escape, 1.5 * thin);
    c.setLineDash([]);
  }
  if (panel.adversary) {
    const isAmong = panel.others && view.others; // candidates: the selected path must stand out
    trail(c, panel.adversary, now, last, colour.adversary + (isAmong ? "e6" : "59"), isAmong ? 1.8 * thin : thin);
    trail(c, panel.adversary, 0, Math.floor(time), colour.adversary + "e6", 1.5 * thin);
  }
  trail(c, panel.ego, 0, Math.floor(time), colour.ego + "e6", 1.5 * thin);
  const plan = planAt(panel, time);
  if (plan) line(c, plan, colour.plan + "99", 2 * thin);
  const ghost = panel.ghost && view.ghost && pose(panel.ghost, time);
  const own = pose(panel.ego, time);
  if (ghost && Math.hypot(ghost.x - own.x, ghost.y - own.y) > 0.3) car(c, ghost, panel.ego, colour.ego, { dashed: true });
  const escape = panel.escape && view.ghost && pose(panel.escape, time);
  if (escape) car(c, escape, panel.ego, colour.escape, { dashed: true });
  if (panel.marks && view.others) for (const m of panel.marks) mark(c, m, ratio / scale);
  const adversary = panel.adversary && pose(panel.adversary, time);
  const isPerson = adversary && ["pedestrian", "cyclist"].includes(panel.adversary.kind);
  if (isPerson) person(c, adversary, panel.adversary, colour.adversary, (5 * ratio) / scale);
  else if (adversary) car(c, adversary, panel.adversary, colour.adversary, { stripes: true, outline: colour.ink });
  car(c, own, panel.ego, colour.ego, { outline: colour.ink });
  if (panel.contact && time >= panel.contact.frame) burst(c, panel.contact.x / 100, panel.contact.y / 100, Math.max(1, (7 * ratio) / scale));
  if (overlay) overlay(c, panel, ratio / scale);
  scaleBar(c, ratio, scale, height);
  const gap = adversary ? `, gap ${space(own, panel.ego, adversary, panel.adversary).toFixed(1)} m` : "";
  panel.live.textContent = `ego ${own.v.toFixed(1)} m/s${gap}`;
  const over = view.time >= panel.end;
  panel.box.classList.toggle("over", Boolean(over && panel.contact));
  panel.badge.hidden = !over || (panel.verdict === null && !panel.failed);
  panel.status.className = over && (panel.contact || panel.failed) ? "over" : "";
  const said = panel.shown.findLast((s) => s.frame <= time && s.log);
  panel.log.textContent = said ? `${((said.frame - now) / 10).toFixed(1)} s: ${said.log}` : "";
  panel.status.textContent = over ? panel.ending : view.time < now ? panel.history : panel.note;
  drawStrip(panel, time, ratio);
}

function scaleBar(c, ratio, scale, height) {
  const length = [5, 10, 20, 50, 100, 200, 500].find((l) => l * scale >= 50 * ratio) || 500;
  c.setTransform(1, 0, 0, 1, 0, 0);
  c.fillStyle = colour.paper + "bf";
  c.fillRect(6 * ratio, height - 24 * ratio, length * scale + 12 * ratio, 19 * ratio);
  c.strokeStyle = c.fillStyle = colour.ink;
  c.lineWidth = 2 * ratio;
  c.beginPath();
  c.moveTo(12 * ratio, height - 9 * ratio);
  c.lineTo(12 * ratio + length * scale, height - 9 * ratio);
  c.stroke();
  c.font = `${10 * ratio}px system-ui, sans-serif`;
  c.fillText(`${length} m`, 12 * ratio, height - 13 * ratio);
}

// What the strip shows over time, of each body at its frames; differences are over 0.4 s. Distance is that of the two boxes.
const change = (of, t, differs = (a, b) => b - a) => {
  const from = Math.max(0, t - 2), to = Math.min(of.length - 1, t + 2);
  return to > from ? differs(of[from], of[to]) / ((to - from) / 10) : NaN;
};
const turn = (a, b) => (Math.atan2(Math.sin(b - a), Math.cos(b - a)) * 180) / Math.PI;
// Of ego and adversary at the frames of the ego.
const between = (of) => (b, panel) => {
  if (b !== panel.ego || !panel.adversary) return [];
  return b.x.map((_, t) => { const p = pose(b, b.first + t), q = pose(panel.adversary, b.first + t); return p && q ? of(p, b, q, panel.adversary) : NaN; });
};
// Angle of the front wheels that gives the turning of the path; a wheelbase is about 0.6 of a length.
const steering = (b) => b.h.map((h, t) => (b.v[t] < 1 ? NaN : (Math.atan((0.6 * b.length * change(b.h, t, turn) * Math.PI) / 180 / b.v[t]) * 180) / Math.PI));
// Seconds until the boxes meet if both go on as they do, up to 8. A gap can close no faster than both are.
function timeToContact(p, a, q, b) {
  const at = ({ x, y, h, v }, t) => ({ x: x + v * t * Math.cos(h), y: y + v * t * Math.sin(h), h });
  for (let t = 0, gap; t <= 8; t += Math.max(0.02, gap / (p.v + q.v + 1e-3))) {
    gap = space(at(p, t), a, at(q, t), b);
    if (gap < 0.02) return t;
  }
  return NaN;
}
// The blow of a contact is no acceleration of a driver.
const beforeContact = (of) => (b, panel) => {
  const end = panel.contact ? Math.max(0, panel.contact.frame - b.first) : Infinity, cut = (list) => list.slice(0, end);
  return of({ ...b, v: cut(b.v), h: cut(b.h) });
};
// Unit, least top of the axis, values, and whether they may be below 0.
const plots = {
  speed: ["m/s", 5, (b) => b.v, false],
  acceleration: ["m/s²", 2, beforeContact(({ v }) => v.map((_, t) => change(v, t))), true],
  steering: ["°", 5, beforeContact(steering), true],
  turning: ["°/s", 10, beforeContact(({ h }) => h.map((_, t) => change(h, t, turn))), true],
  distance: ["m", 5, between(space), false],
  "time to contact": ["s", 4, between(timeToContact), false],
};
// Turning is what steering does at a speed.
const shownPlots = () => (view.plot === "all" ? Object.keys(plots).filter((name) => name !== "turning") : [view.plot]);
function plotted(panel, name) {
  panel.plotted ||= {};
  if (!panel.plotted[name]) {
    const [unit, least, of, isSigned] = plots[name];
    const lines = [panel.ghost, panel.adversary, panel.ego].map((b) => (b ? of(b, panel) : []));
    const known = lines.flat().filter((v) => v === v);
    // Standing still is in every plot: 0.
    panel.plotted[name] = { unit, lines, top: Math.max(least, ...known), bottom: isSigned ? Math.min(-least, ...known) : 0 };
  }
  return panel.plotted[name];
}
function choosePlot(name) {
  view.plot = element("plot").value = name;
  document.documentElement.style.setProperty("--plots", shownPlots().length);
  if (panels) redraw();
}

// The plots over time, one above the other: ego, adversary, and the ego without the attack.
function drawStrip(panel, time, ratio) {
  const canvas = panel.strip, c = canvas.getContext("2d"), names = shownPlots();
  fitted(canvas);
  c.setTransform(1, 0, 0, 1, 0, 0);
  c.clearRect(0, 0, canvas.width, canvas.height);
  const height = canvas.height / names.length;
  names.forEach((name, k) => {
    c.setTransform(1, 0, 0, 1, 0, Math.round(k * height));
    drawPlot(c, panel, name, canvas.width, height, ratio, names.length > 1);
  });
  c.setTransform(1, 0, 0, 1, 0, 0);
  c.fillStyle = colour.ink;
  c.fillRect(plotX(time, canvas.width, ratio) - 0.5 * ratio, 0, ratio, canvas.height);
}

const plotX = (frame, width, ratio) => 40 * ratio + (frame / last) * (width - 48 * ratio);

function drawPlot(c, panel, name, width, height, ratio, isNamed) {
  const { unit, lines, top, bottom } = plotted(panel, name);
  const bodies = [panel.ghost && view.ghost && panel.ghost, panel.adversary, panel.ego];
  const x = (frame) => plotX(frame, width, ratio), y = (v) => height - 5 * ratio - ((v - bottom) / (top - bottom)) * (height - 12 * ratio);
  c.font = `${9.5 * ratio}px system-ui, sans-serif`;
  c.fillStyle = colour.faint;
  c.textBaseline = "middle";
  c.fillText(`${top.toFixed(0)} ${unit}`, 3 * ratio, y(top) + 3 * ratio);
  c.fillText(bottom.toFixed(0), 3 * ratio, y(bottom) - 1 * ratio);
  c.strokeStyle = colour.grid;
  c.lineWidth = ratio;
  c.strokeRect(x(now), y(top), 0, y(bottom) - y(top));
  c.strokeRect(x(0), y(0), x(last) - x(0), 0);
  const tones = [[colour.ego + "99", [4, 3]], [colour.adversary, []], [colour.ego, []]];
  bodies.forEach((b, k) => {
    if (!b) return;
    c.beginPath();
    // A value that is not there ends a line.
    let isDrawn = false;
    lines[k].forEach((v, t) => {
      const isThere = v === v;
      if (isThere) isDrawn ? c.lineTo(x(b.first + t), y(v)) : c.moveTo(x(b.first + t), y(v));
      isDrawn = isThere;
    });
    c.strokeStyle = tones[k][0];
    c.setLineDash(tones[k][1].map((d) => d * ratio));
    c.lineWidth = 1.4 * ratio;
    c.stroke();
  });
  c.setLineDash([]);
  if (panel.contact) { c.fillStyle = colour.contact; c.fillRect(x(panel.contact.frame) - ratio, y(top), 2 * ratio, y(bottom) - y(top)); }
  if (!isNamed) return;
  // Lines go on behind the name.
  c.strokeStyle = colour.paper;
  c.lineWidth = 3 * ratio;
  c.strokeText(name, x(0) + 2 * ratio, y(top) + 3 * ratio);
  c.fillStyle = colour.faint;
  c.fillText(name, x(0) + 2 * ratio, y(top) + 3 * ratio);
}

let waiting = 0;
function redraw() {
  waiting ||= requestAnimationFrame(drawNow);
}
function drawNow() {
  cancelAnimationFrame(waiting);
  waiting = 0;
  if (!view.scale) view.scale = firstScale();
  panels.filter((p) => !p.box.hidden && p.isVisible).forEach(drawPanel);
  element("time").value = view.time;
  element("clock").textContent = `${((view.time - now) / 10).toFixed(1)} s`;
  element("play").textContent = view.playing ? "Pause" : "Play";
}

// About 45 m across the smaller side of a view, or 90 m across the larger one, and both cars at *now*.
function firstScale() {
  const shown = panels.find((p) => !p.box.hidden), box = shown.canvas.parentElement.getBoundingClientRect();
  const near = Math.min(Math.min(box.width, box.height) / 45, Math.max(box.width, box.height) / 90);
  const ego = pose(shown.ego, Math.min(now, shown.end)), adversary = shown.adversary && pose(shown.adversary, Math.min(now, shown.end));
  const apart = view.follow === "both" && ego && adversary ? [Math.abs(ego.x - adversary.x), Math.abs(ego.y - adversary.y)] : [0, 0];
  return Math.max(1.5, Math.min(near, box.width / (apart[0] + 20), box.height / (apart[1] + 20)));
}
