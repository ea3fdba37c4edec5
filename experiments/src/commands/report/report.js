"use strict";
// Units of the data: metres, seconds, radians; decimetres in paths and roads, see thumbnails.js.
const data = JSON.parse(document.getElementById("data").textContent);
const element = (id) => document.getElementById(id);
const { scenes, failures } = data;
const STEP = 60, MOST_BARS = window.innerWidth > 940 ? 12 : 6;

// --- values and words ---

const isKnown = (value) => value !== null && value !== undefined && value !== "";
// Names come from strangers: characters that control the display or the direction of text are made visible.
const plain = (value) => String(value).replace(/[\u0000-\u001f\u007f-\u009f\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069]/g, "\ufffd");
const words = (value) => (isKnown(value) ? plain(value) : "–");
const measured = (value, digits, unit = "") => (Number.isFinite(value) ? value.toFixed(digits).replace("-", "−") + unit : "–");
const counted = (n, one, many) => `${n} ${n === 1 ? one : many}`;
const collator = new Intl.Collator("en", { numeric: true });

function make(tag, parent, name, content) {
  const e = document.createElement(tag);
  if (name) e.className = name;
  if (content !== undefined) e.textContent = content;
  parent.append(e);
  return e;
}

// A page beside this one; null for anything that could lead elsewhere or run a script.
function link(page) {
  return typeof page === "string" && /^[^:\\\u0000-\u001f]+$/.test(page) && !/^\s*\//.test(page) ? page : null;
}

// --- filters: choices and ranges ---

// The values of one field, in order, with those that are not known last; failures hold their positions.
function facet(key, label, name = words) {
  const values = [...new Set(failures.map((f) => (isKnown(f[key]) ? f[key] : null)))];
  values.sort((a, b) => (a === null) - (b === null) || collator.compare(name(a), name(b)));
  const position = new Map(values.map((v, k) => [v, k]));
  return { key, label, name, values, of: failures.map((f) => position.get(isKnown(f[key]) ? f[key] : null)), counts: values.map(() => 0), chosen: -1 };
}

const answer = (yes, no) => (value) => (value === true ? yes : value === false ? no : "unknown");
const facets = [
  facet("driver", "Driver"), facet("cluster", "Cluster"), facet("collision", "Collision"), facet("ego_does", "Ego does"), facet("adversary_does", "Adversary does"), facet("road", "Road"),
  facet("at_fault", "Fault", answer("at fault", "not at fault")), facet("fault", "Fault class", (value) => words(value).replaceAll("_", " ")),
  facet("avoidable_r157", "Avoidable by R157", answer("yes", "no")), facet("plan", "Plan"),
];
const [drivers, clusters] = facets;

const numbers = (key) => failures.map((f) => (Number.isFinite(f[key]) ? f[key] : NaN));
function range(key, label, digits) {
  const of = numbers(key), known = of.filter((v) => v === v);
  const ends = known.reduce(([low, high], v) => [Math.min(low, v), Math.max(high, v)], [Infinity, -Infinity]);
  return { key, label, digits, of, ends, isMeasured: known.length > 0, hasUnknown: known.length < of.length, low: null, high: null, unknown: true };
}

const ranges = [range("lambda", "λ", 2), range("time_to_react", "Time to react, s", 1)];
const isWithin = (r, k) => (r.of[k] === r.of[k] ? (r.low === null || r.of[k] >= r.low) && (r.high === null || r.of[k] <= r.high) : r.unknown);
const isSet = (r) => r.low !== null || r.high !== null || !r.unknown;

// --- order ---

const ranks = ({ of, values }) => of.map((k) => (values[k] === null ? NaN : k));
const sceneNames = scenes.map(({ name }) => words(name)), foldedNames = sceneNames.map((name) => name.toLowerCase());
const sorts = {
  reward: ["reward", () => numbers("reward")], time_to_react: ["time to react", () => numbers("time_to_react")], lambda: ["λ", () => numbers("lambda")],
  contact_after: ["contact after", () => numbers("contact_after")], impact: ["impact speed", () => numbers("impact")],
  cluster: ["cluster", () => ranks(clusters)], driver: ["driver", () => ranks(drivers)],
  scene: ["scene", () => { const sorted = [...new Set(sceneNames)].sort(collator.compare), rank = new Map(sorted.map((n, k) => [n, k])); return failures.map((f) => rank.get(sceneNames[f.scene])); }],
};
const risesFirst = (key) => ["cluster", "driver", "scene"].includes(key);
const state = { text: "", sort: "reward", rises: false, showsAll: false };

const orders = new Map();
function order() {
  const key = state.sort + state.rises;
  if (!orders.has(key)) {
    const of = sorts[state.sort][1](), sign = state.rises ? 1 : -1;
    // Not measured comes last in both directions.
    orders.set(key, failures.map((_, k) => k).sort((a, b) => (of[a] !== of[a]) - (of[b] !== of[b]) || sign * (of[a] - of[b]) || a - b));
  }
  return orders.get(key);
}

// --- state in the address: a view can be kept as a bookmark, and Back comes back to it ---

function readAddress() {
  const given = new URLSearchParams(location.hash.slice(1));
  for (const f of facets) f.chosen = given.has(f.key) ? f.values.findIndex((v) => String(v ?? "") === given.get(f.key)) : -1;
  for (const r of ranges) {
    const ends = /^(-?[\d.]*)\.\.(-?[\d.]*)$/.exec(given.get(r.key) || "") || [];
    [r.low, r.high] = [ends[1], ends[2]].map((end) => (end && Number.isFinite(Number(end)) ? Number(end) : null));
    r.unknown = !r.hasUnknown || given.get(`${r.key}_unknown`) !== "no";
  }
  state.text = (given.get("scene") || "").slice(0, 200);
  state.sort = Object.hasOwn(sorts, given.get("sort") || "") ? given.get("sort") : "reward";
  state.rises = ["ascending", "descending"].includes(given.get("order")) ? given.get("order") === "ascending" : risesFirst(state.sort);
}

function address() {
  const given = new URLSearchParams();
  for (const f of facets) if (f.chosen >= 0) given.set(f.key, f.values[f.chosen] ?? "");
  for (const r of ranges) {
    if (r.low !== null || r.high !== null) given.set(r.key, `${r.low ?? ""}..${r.high ?? ""}`);
    if (!r.unknown) given.set(`${r.key}_unknown`, "no");
  }
  if (state.text) given.set("scene", state.text);
  if (state.sort !== "reward") given.set("sort", state.sort);
  if (state.rises !== risesFirst(state.sort)) given.set("order", state.rises ? "ascending" : "descending");
  return `#${given}`;
}

// Browsers refuse many changes of the address in a short time, so changes while one types are gathered.
let writing = 0;
function writeAddress(kept = null) {
  clearTimeout(writing);
  writing = 0;
  if (address() !== (location.hash || "#") || kept || history.state) history.replaceState(kept, "", address());
}

// --- update: filter, count, list ---

let shown = [], isWaiting = false;
function change() {
  clearTimeout(writing);
  writing = setTimeout(() => writeAddress(), 250);
  if (isWaiting) return;
  isWaiting = true;
  requestAnimationFrame(() => {
    isWaiting = false;
    update();
    if (element("cards").getBoundingClientRect().top < 0) element("cards").scrollIntoView();
  });
}

function update() {
  const wanted = state.text.trim().toLowerCase(), isNamed = foldedNames.map((name) => name.includes(wanted)), inScenes = new Set();
  facets.forEach((f) => f.counts.fill(0));
  const total = facets.map(() => 0);
  shown = [];
  for (const k of order()) {
    if (!isNamed[failures[k].scene] || !ranges.every((r) => isWithin(r, k))) continue;
    // Each choice is counted under all other filters: what one would see by changing it alone.
    let misses = 0, missed = 0;
    facets.forEach((f, n) => { if (f.chosen >= 0 && f.of[k] !== f.chosen) { misses++; missed = n; } });
    if (misses > 1) continue;
    if (misses) { facets[missed].counts[facets[missed].of[k]]++; total[missed]++; continue; }
    facets.forEach((f, n) => { f.counts[f.of[k]]++; total[n]++; });
    shown.push(k);
    inScenes.add(failures[k].scene);
  }
  const inClusters = clusters.chosen >= 0 ? Math.min(1, shown.length) : clusters.counts.filter(Boolean).length;
  element("count").textContent = `${shown.length} of ${counted(failures.length, "failure", "failures")} shown, in ${counted(inScenes.size, "scene", "scenes")}; ${counted(inClusters, "cluster", "clusters")}`;
  element("none").hidden = shown.length > 0;
  element("legend").hidden = !shown.length;
  showControls(total);
  showBars();
  showWithout(wanted);
  unwatch();
  built = 0;
  element("cards").replaceChildren();
  addCards();
}

function showControls(total) {
  const put = (e, content) => { if (e.textContent !== content) e.textContent = content; };
  facets.forEach((f, n) => {
    if (!f.select) return;
    put(f.select.options[0], `all (${total[n]})`);
    f.values.forEach((value, k) => put(f.select.options[k + 1], `${f.name(value)} (${f.counts[k]})`));
    f.select.value = f.chosen;
    f.row.classList.toggle("set", f.chosen >= 0);
  });
  for (const r of ranges.filter((r) => r.box)) {
    // A field that one is typing into is left alone: "0." is a number on its way.
    for (const end of ["low", "high"]) if (document.activeElement !== r.inputs[end]) r.inputs[end].value = r[end] ?? "";
    r.inputs.unknown.checked = r.unknown;
    r.box.classList.toggle("set", isSet(r));
  }
  if (document.activeElement !== element("scene")) element("scene").value = state.text;
  element("scene").parentElement.classList.toggle("set", state.text !== "");
  element("sort").value = state.sort;
  element("order").textContent = state.rises ? "↑" : "↓";
  element("order").title = state.rises ? "Ascending; press for descending" : "Descending; press for ascending";
  element("order").setAttribute("aria-label", element("order").title);
  const set = facets.filter((f) => f.chosen >= 0).length + ranges.filter(isSet).length + (state.text ? 1 : 0);
  element("open").textContent = set ? `Filters (${set})` : "Filters";
  // Not disabled: that would take the keyboard from it once pressed.
  element("reset").setAttribute("aria-disabled", String(!set && state.sort === "reward" && !state.rises));
}

// --- clusters ---

const bars = new Map();
function bar(k) {
  if (!bars.has(k)) {
    const item = document.createElement("li"), button = make("button", item);
    make("span", button, "", words(clusters.values[k]));
    make("b", button);
    button.title = words(clusters.values[k]);
    button.addEventListener("click", () => { clusters.chosen = clusters.chosen === k ? -1 : k; change(); });
    bars.set(k, item);
  }
  return bars.get(k);
}

function showBars() {
  const { counts, chosen } = clusters, held = document.activeElement;
  const found = counts.map((_, k) => k).filter((k) => counts[k] || k === chosen).sort((a, b) => counts[b] - counts[a] || a - b);
  const listed = found.filter((k, place) => state.showsAll || place < MOST_BARS || k === chosen);
  for (const k of listed) {
    const button = bar(k).firstChild;
    button.lastChild.textContent = counts[k];
    button.style.setProperty("--share", `${(100 * counts[k]) / Math.max(1, counts[found[0]])}%`);
    button.setAttribute("aria-pressed", String(k === chosen));
  }
  element("bars").replaceChildren(...listed.map(bar));
  if (held && element("bars").contains(held)) held.focus({ preventScroll: true });
  element("clusters").hidden = !found.length;
  element("all").hidden = found.length <= MOST_BARS;
  element("all").textContent = state.showsAll ? `Show the largest ${MOST_BARS}` : `Show all ${found.length}`;
  element("all").setAttribute("aria-expanded", String(state.showsAll));
}

// --- scenes without a failure ---

let withoutShown = "";
function showWithout(wanted) {
  const driver = drivers.chosen >= 0 ? drivers.values[drivers.chosen] : null, key = `${wanted}\n${driver}`;
  if (key === withoutShown) return;
  withoutShown = key;
  const rows = data.without.filter((w) => (driver === null || w.driver === driver) && words(w.scene).toLowerCase().includes(wanted));
  const isOne = new Set(data.without.map((w) => w.driver)).size < 2, reasons = new Map();
  for (const row of rows) reasons.set(words(row.reason), [...(reasons.get(words(row.reason)) || []), row]);
  const [summary, list] = element("without").children;
  element("without").hidden = !data.without.length;
  summary.textContent = `Searched without a failure (${rows.length === data.without.length ? rows.length : `${rows.length} of ${data.without.length}`})`;
  list.replaceChildren();
  for (const [reason, of] of [...reasons].sort((a, b) => b[1].length - a[1].length || collator.compare(a[0], b[0]))) {
    const details = make("details", list);
    make("summary", details, "", `${reason} (${of.length})`);
    const names = of.map((w) => (isOne ? words(w.scene) : `${words(w.scene)} (${words(w.driver)})`)).sort(collator.compare);
    details.addEventListener("toggle", () => { if (details.children.length < 2) make("p", details, "", names.join(", ")); });
  }
}

// --- cards, built as one scrolls ---

let built = 0;
function addCards(least = 0) {
  const items = shown.slice(built, Math.max(built + STEP, least)).map((k, place) => card(k, built + place));
  element("cards").append(...items);
  items.forEach((item) => thumbnailWatch.observe(item));
  built += items.length;
  const left = shown.length - built;
  element("more").hidden = !left;
  element("more").textContent = `Show ${Math.min(left, STEP)} more of ${left}`;
  // An observer reports changes only: a new start reports whether the end is still near.
  endWatch.disconnect();
  endWatch.observe(element("more"));
}

const endWatch = new IntersectionObserver(([{ isIntersecting }]) => { if (isIntersecting && !element("more").hidden) addCards(); }, { rootMargin: "1200px" });

function card(k, place) {
  const f = failures[k], item = element("card").content.firstElementChild.cloneNode(true), box = item.firstChild;
  const [, head, cluster, values, fault] = box.children, page = link(f.page);
  if (page) box.href = page;
  item.dataset.failure = k;
  item.dataset.place = place;
  head.children[0].textContent = head.children[0].title = sceneNames[f.scene];
  head.children[1].textContent = head.children[1].title = words(f.name);
  head.children[2].textContent = head.children[2].title = words(f.driver);
  cluster.textContent = cluster.title = words(f.cluster);
  const pairs = [["contact", measured(f.contact_after, 1, " s")], ["impact", measured(f.impact, 1, " m/s")], ["reward", measured(f.reward, 1)], ["time to react", measured(f.time_to_react, 1, " s")], ["λ", measured(f.lambda, 2)]];
  for (const [label, value] of pairs) {
    const pair = make("span", values);
    make("small", pair, "", label);
    pair.append(value);
  }
  values.firstChild.title = "Time from now, the start of the attack, to the contact";
  fault.children[0].textContent = f.at_fault === true ? "at fault" : f.at_fault === false ? "not at fault" : "fault unknown";
  if (f.at_fault === true) fault.children[0].className = "hit";
  fault.children[1].textContent = words(f.fault).replaceAll("_", " ");
  return item;
}

// --- build ---

function build() {
  document.title = plain(data.title);
  element("title").textContent = plain(data.title);
  element("subtitle").textContent = plain(data.subtitle);
  for (const f of facets.filter((f) => f.values.length > 1)) {
    f.row = make("label", element("filters"), "row");
    make("span", f.row, "", f.label);
    f.select = make("select", f.row);
    f.select.autocomplete = "off";
    ["", ...f.values].forEach((_, k) => (make("option", f.select).value = k - 1));
    f.select.addEventListener("change", () => { f.chosen = Number(f.select.value); change(); });
  }
  for (const r of ranges.filter((r) => r.isMeasured)) {
    r.box = make("fieldset", element("filters"), "range");
    make("legend", r.box, "", r.label);
    r.inputs = {};
    for (const [end, name] of [["low", "from"], ["high", "to"]]) {
      if (end === "high") make("span", r.box, "", "to");
      const input = (r.inputs[end] = make("input", r.box));
      Object.assign(input, { type: "number", step: "any", autocomplete: "off", placeholder: r.ends[end === "low" ? 0 : 1].toFixed(r.digits) });
      input.setAttribute("aria-label", `${r.label} ${name}`);
      input.addEventListener("input", () => { r[end] = Number.isFinite(input.valueAsNumber) ? input.valueAsNumber : null; change(); });
    }
    const label = make("label", r.box);
    label.hidden = !r.hasUnknown;
    r.inputs.unknown = make("input", label);
    Object.assign(r.inputs.unknown, { type: "checkbox", autocomplete: "off" });
    label.append(r.key === "lambda" ? "and failures without λ" : "and not measured");
    r.inputs.unknown.addEventListener("change", () => { r.unknown = r.inputs.unknown.checked; change(); });
  }
  for (const [key, [label]] of Object.entries(sorts)) make("option", element("sort"), "", label).value = key;
  const isEmpty = !failures.length;
  element("filters").hidden = element("bar").hidden = isEmpty;
  element("none").textContent = !isEmpty ? "No failure meets all filters." : data.without.length ? "The searches found no failure." : "There are no failures: no scene was searched.";
  if (isEmpty) { element("page").style.display = "block"; element("without").open = true; }
}

// What is scrolled to stops below the bar.
const measureBar = () => document.documentElement.style.setProperty("--bar", `${element("bar").offsetHeight}px`);

// The list as it was left, and the keyboard on the card that was opened.
function comeBack() {
  const place = history.state?.place;
  if (!Number.isInteger(place) || place < 0 || place >= shown.length) return;
  history.scrollRestoration = "manual";
  if (place >= built) addCards(place + 1);
  const item = element("cards").children[place];
  item.scrollIntoView({ block: "center" });
  item.firstChild.focus({ preventScroll: true });
}

for (const press of ["click", "auxclick"]) {
  element("cards").addEventListener(press, (e) => {
    const item = e.target.closest("li"), a = item?.querySelector("a[href]");
    if (!a) return;
    // The page of the scene links back to this view.
    const [file, id] = link(failures[item.dataset.failure].page).split("#"), from = address().slice(1);
    a.href = `${file}${from ? `?from=${encodeURIComponent(from)}` : ""}#${id}`;
    if (press === "click") writeAddress({ place: Number(item.dataset.place) });
  });
}
element("scene").addEventListener("input", (e) => { state.text = e.target.value.slice(0, 200); change(); });
element("sort").addEventListener("change", (e) => { state.sort = e.target.value; state.rises = risesFirst(state.sort); change(); });
element("order").addEventListener("click", () => { state.rises = !state.rises; change(); });
element("all").addEventListener("click", () => { state.showsAll = !state.showsAll; showBars(); });
element("more").addEventListener("click", () => addCards());
element("open").addEventListener("click", () => {
  const isOpen = element("filters").classList.toggle("open");
  element("open").setAttribute("aria-expanded", String(isOpen));
  if (isOpen) element("filters").scrollIntoView();
});
element("reset").addEventListener("click", () => { history.replaceState(null, "", "#"); readAddress(); change(); });
window.addEventListener("hashchange", () => { readAddress(); update(); });
window.addEventListener("pagehide", () => { if (writing) writeAddress(); });
window.addEventListener("resize", () => { measureBar(); redrawThumbnails(); });

build();
readAddress();
update();
measureBar();
comeBack();
