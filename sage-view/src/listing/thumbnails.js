// Thumbnails of items: drawn when they come into view; the newest are kept. Comes before list.js in one script.
const colour = { ego: "#0072b2", adversary: "#d55e00", ink: "#222", ground: "#eceae3" }, MOST_THUMBNAILS = 400;

const visible = new Set(), thumbnails = new Map();
let isDrawing = false, size = null;
const thumbnailWatch = new IntersectionObserver((changes) => {
  for (const { target, isIntersecting } of changes) isIntersecting ? visible.add(target) : visible.delete(target);
  drawSoon();
}, { rootMargin: "300px" });

function unwatch() {
  thumbnailWatch.disconnect();
  visible.clear();
}

// For places of another size.
function redrawThumbnails() {
  const place = document.querySelector(".thumbnail");
  if (!place || !size || Math.abs(place.clientWidth - size[0]) < 24) return;
  size = null;
  thumbnails.forEach((canvas) => canvas.remove());
  thumbnails.clear();
  drawSoon();
}

function drawSoon() {
  if (isDrawing) return;
  isDrawing = true;
  requestAnimationFrame(drawSome);
}

// As many as fit into a frame, so that scrolling stays smooth.
function drawSome() {
  isDrawing = false;
  const begin = performance.now();
  for (const item of visible) {
    const place = item.querySelector(".thumbnail"), k = Number(item.dataset.item);
    if (place.firstChild) continue;
    if (performance.now() - begin > 12) return drawSoon();
    size ||= [Math.max(80, place.clientWidth), Math.max(80, place.clientHeight)];
    const canvas = thumbnails.get(k) || thumbnail(items[k]);
    thumbnails.delete(k);
    thumbnails.set(k, canvas);
    place.append(canvas);
  }
  for (const [k, canvas] of thumbnails) {
    if (thumbnails.size <= MOST_THUMBNAILS) break;
    if (!visible.has(canvas.closest("li"))) { canvas.remove(); thumbnails.delete(k); }
  }
}

// Points in metres, of decimetres as differences to the point before.
function decode(points) {
  const out = [];
  for (let k = 0, x = 0, y = 0; k + 1 < points.length; k += 2) out.push([(x += points[k]) / 10, (y += points[k + 1]) / 10]);
  return out;
}

const bounds = (points) => points.reduce((b, [x, y]) => [Math.min(b[0], x), Math.min(b[1], y), Math.max(b[2], x), Math.max(b[3], y)], [Infinity, Infinity, -Infinity, -Infinity]);

// Ways of painting a road, in their order; width in metres, and the least in pixels.
const passes = [["lane", "#d3d7dc", 3.7, 0], ["crosswalk", "rgba(255,255,255,.65)"], ["line", "#fff", 0.15, 1], ["edge", "#4d4d4d", 0.2, 1.5]];
const roads = new Map();
function road(scene) {
  if (!roads.has(scene)) {
    roads.set(scene, scenes[scene].road.map(({ kind, points }) => {
      const at = decode(points), path = new Path2D();
      at.forEach(([x, y], k) => (k ? path.lineTo(x, y) : path.moveTo(x, y)));
      return { kind, path, box: bounds(at) };
    }));
  }
  return roads.get(scene);
}

function thumbnail(f) {
  const canvas = document.createElement("canvas"), ratio = Math.min(2, window.devicePixelRatio || 1), c = canvas.getContext("2d", { alpha: false });
  const width = (canvas.width = Math.round(size[0] * ratio)), height = (canvas.height = Math.round(size[1] * ratio));
  c.fillStyle = colour.ground;
  c.fillRect(0, 0, width, height);
  const cars = ["adversary", "ego"].filter((who) => f[who]?.path?.length > 1).map((who) => ({ ...f[who], at: decode(f[who].path), tone: colour[who], isEgo: who === "ego" }));
  if (!cars.length) return canvas;
  // The last 25 m of each path, and as much around as the page wants: near enough to tell the cars apart.
  const needed = bounds(cars.flatMap(({ at }) => at.filter(([x, y]) => Math.hypot(x - at.at(-1)[0], y - at.at(-1)[1]) < 25)));
  const scale = Math.min(width / Math.max(page.across, needed[2] - needed[0] + 8), height / Math.max(0.7 * page.across, needed[3] - needed[1] + 8));
  const left = (needed[0] + needed[2]) / 2 - width / scale / 2, bottom = (needed[1] + needed[3]) / 2 - height / scale / 2;
  c.setTransform(scale, 0, 0, -scale, -left * scale, height + bottom * scale);
  c.lineJoin = c.lineCap = "round";
  const near = road(f.scene).filter(({ box }) => box[2] > left - 2 && box[0] < left + width / scale + 2 && box[3] > bottom - 2 && box[1] < bottom + height / scale + 2);
  for (const [kind, tone, metres, pixels] of passes) {
    c.fillStyle = c.strokeStyle = tone;
    c.lineWidth = Math.max(metres || 0, (pixels * ratio) / scale);
    for (const { path } of near.filter((r) => r.kind === kind)) metres ? c.stroke(path) : c.fill(path);
  }
  for (const { at, isEgo } of cars) {
    c.beginPath();
    at.forEach(([x, y]) => c.lineTo(x, y));
    c.strokeStyle = isEgo ? "rgba(0,114,178,.9)" : "rgba(213,94,0,.9)";
    c.lineWidth = (2 * ratio) / scale;
    c.stroke();
  }
  cars.forEach((b) => car(c, b, ratio / scale));
  const contact = cars.length > 1 && Number.isFinite(f.contact_after) ? meeting(...cars) : null;
  if (contact) burst(c, ...contact, Math.max(0.9, (5 * ratio) / scale));
  scaleBar(c, ratio, scale, height);
  return canvas;
}

function car(c, { at, heading, length: l, width: w, tone, isEgo }, pixel) {
  c.save();
  c.translate(...at.at(-1));
  c.rotate(heading);
  c.fillStyle = tone;
  c.fillRect(-l / 2, -w / 2, l, w);
  if (!isEgo) { c.fillStyle = "#fff"; c.fillRect(-0.14 * l, -w / 2, 0.09 * l, w); c.fillRect(-0.35 * l, -w / 2, 0.09 * l, w); }
  c.fillStyle = "rgba(0,0,0,.35)"; // windscreen: shows where the front is
  if (l > 2.5) c.fillRect(0.16 * l, -0.42 * w, 0.1 * l, 0.84 * w);
  c.strokeStyle = colour.ink;
  c.lineWidth = Math.max(0.12, pixel);
  c.strokeRect(-l / 2, -w / 2, l, w);
  c.restore();
}

// Where two boxes meet: the middle of the points of either in the other, or nearest to it; null if they are apart.
function meeting(a, b) {
  const found = [];
  for (const [one, other] of [[a, b], [b, a]]) {
    const [x, y] = one.at.at(-1), [ox, oy] = other.at.at(-1), cos = Math.cos(one.heading), sin = Math.sin(one.heading), c = Math.cos(other.heading), s = Math.sin(other.heading);
    for (let i = -8; i <= 8; i++) {
      for (let j = -4; j <= 4; j++) {
        const u = (i / 16) * one.length, v = (j / 8) * one.width, px = x + u * cos - v * sin, py = y + u * sin + v * cos;
        const dx = px - ox, dy = py - oy;
        found.push([Math.max(0, Math.abs(dx * c + dy * s) - other.length / 2, Math.abs(dy * c - dx * s) - other.width / 2), px, py]);
      }
    }
  }
  const nearest = Math.min(...found.map(([gap]) => gap)), at = found.filter(([gap]) => gap <= nearest + 0.05);
  return nearest > 1 ? null : [1, 2].map((k) => at.reduce((sum, p) => sum + p[k], 0) / at.length);
}

function scaleBar(c, ratio, scale, height) {
  c.setTransform(ratio, 0, 0, ratio, 0, 0);
  const length = (10 * scale) / ratio, y = height / ratio;
  c.fillStyle = "rgba(255,255,255,.75)";
  c.fillRect(3, y - 18, Math.max(length, 26) + 8, 15);
  c.fillStyle = colour.ink;
  c.fillRect(7, y - 6, length, 1.5);
  c.font = "9px system-ui, sans-serif";
  c.fillText("10 m", 7, y - 8);
}
