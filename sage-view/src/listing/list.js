// The list of a page: items as cards, with filters and an order. `fields()` of each page says what its items hold.

const STEP = 60, MOST_BARS = window.innerWidth > 940 ? 12 : 6;

// --- filters: choices and ranges ---

// The values of one field, in order, with those that are not known last; items hold their positions.
function facet(key, label, name = words) {
  const values = [...new Set(items.map((f) => (isKnown(f[key]) ? f[key] : null)))];
  values.sort((a, b) => (a === null) - (b === null) || collator.compare(name(a), name(b)));
  const position = new Map(values.map((v, k) => [v, k]));
  return { key, label, name, values, of: items.map((f) => position.get(isKnown(f[key]) ? f[key] : null)), counts: values.map(() => 0), chosen: -1 };
}

const answer = (yes, no) => (value) => (value === true ? yes : value === false ? no : "unknown");
const page = fields();
const facets = page.facets.map(([key, label, name]) => facet(key, label, name));
const grouped = facets.find(({ key }) => key === page.groups.key);

const numbers = (key) => items.map((f) => (Number.isFinite(f[key]) ? f[key] : NaN));
function range(key, label, digits) {
  const of = numbers(key), known = of.filter((v) => v === v);
  const ends = known.reduce(([low, high], v) => [Math.min(low, v), Math.max(high, v)], [Infinity, -Infinity]);
  return { key, label, digits, of, ends, isMeasured: known.length > 0, hasUnknown: known.length < of.length, low: null, high: null, unknown: true };
}

const ranges = page.ranges.map(([key, label, digits]) => range(key, label, digits));
const isWithin = (r, k) => (r.of[k] === r.of[k] ? (r.low === null || r.of[k] >= r.low) && (r.high === null || r.of[k] <= r.high) : r.unknown);
const isSet = (r) => r.low !== null || r.high !== null || !r.unknown;

// --- order ---

const ranks = ({ of, values }) => of.map((k) => (values[k] === null ? NaN : k));
const sceneNames = scenes.map(({ name }) => words(name)), foldedNames = sceneNames.map((name) => name.toLowerCase());
// By numbers, by a facet, or by the name of the scene.
const sorts = new Map(page.sorts.map(([key, label]) => [key, [label, () => {
  const f = facets.find((facet) => facet.key === key);
  if (f) return ranks(f);
  if (key !== "scene") return numbers(key);
  const sorted = [...new Set(sceneNames)].sort(collator.compare), rank = new Map(sorted.map((n, k) => [n, k]));
  return items.map((f) => rank.get(sceneNames[f.scene]));
}]]));
const firstSort = page.sorts[0][0];
const risesFirst = (key) => ["scene", "needed", "latest_start", "difference", "human_time"].includes(key) || facets.some((facet) => facet.key === key);
const state = { text: "", sort: firstSort, rises: risesFirst(firstSort), showsAll: false, showsEvery: false, variant: 0 };

const orders = new Map();
function order() {
  const key = state.sort + state.rises;
  if (!orders.has(key)) {
    const of = sorts.get(state.sort)[1](), sign = state.rises ? 1 : -1;
    // Not measured comes last in both directions.
    orders.set(key, items.map((_, k) => k).sort((a, b) => (of[a] !== of[a]) - (of[b] !== of[b]) || sign * (of[a] - of[b]) || a - b));
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
  state.showsEvery = given.get("every") === "yes";
  state.variant = variants.includes(given.get("at")) ? variants.indexOf(given.get("at")) : variants.length - 1;
  showVariant();
  state.sort = sorts.has(given.get("sort")) ? given.get("sort") : firstSort;
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
  if (state.showsEvery) given.set("every", "yes");
  if (variants.length > 1 && state.variant < variants.length - 1) given.set("at", variants[state.variant]);
  if (state.sort !== firstSort) given.set("sort", state.sort);
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

// --- events: items that share a card ---

const behind = new Map(); // by the item of a card, how many others it stands for
function gathered(listed) {
  behind.clear();
  if (!page.event || state.showsEvery) return listed;
  const heads = new Map(), of = (k) => page.event(items[k]), rank = (k) => (Number.isFinite(items[k][page.rank]) ? items[k][page.rank] : Infinity);
  for (const k of listed) {
    const head = heads.get(of(k));
    if (head === undefined || rank(k) < rank(head)) heads.set(of(k), k);
  }
  for (const k of listed) if (heads.get(of(k)) !== k) behind.set(heads.get(of(k)), (behind.get(heads.get(of(k))) || 0) + 1);
  const cards = listed.filter((k) => heads.get(of(k)) === k);
  if (state.sort !== firstSort) return cards;
  // In the first order one card of each group comes before the second of any.
  const seen = new Map(), turn = new Map();
  for (const k of cards) {
    const group = grouped.of[k], before = seen.get(group) || 0;
    seen.set(group, before + 1);
    turn.set(k, before);
  }
  return cards.sort((a, b) => turn.get(a) - turn.get(b));
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
    if (!isChosen(items[k]) || !isNamed[items[k].scene] || !ranges.every((r) => isWithin(r, k))) continue;
    // Each choice is counted under all other filters: what one would see by changing it alone.
    let misses = 0, missed = 0;
    facets.forEach((f, n) => { if (f.chosen >= 0 && f.of[k] !== f.chosen) { misses++; missed = n; } });
    if (misses > 1) continue;
    if (misses) { facets[missed].counts[facets[missed].of[k]]++; total[missed]++; continue; }
    facets.forEach((f, n) => { f.counts[f.of[k]]++; total[n]++; });
    shown.push(k);
    inScenes.add(items[k].scene);
  }
  const inGroups = grouped.chosen >= 0 ? Math.min(1, shown.length) : grouped.counts.filter(Boolean).length;
  element("count").textContent = page.count(shown.length, inScenes.size, inGroups, shown.map((k) => items[k]));
  shown = gathered(shown);
  element("none").hidden = shown.length > 0;
  element("legend").hidden = !shown.length;
  showControls(total);
  showBars();
  page.showMore?.(wanted);
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
  element("every").setAttribute("aria-pressed", String(state.showsEvery));
  const set = facets.filter((f) => f.chosen >= 0).length + ranges.filter(isSet).length + (state.text ? 1 : 0);
  element("open").textContent = set ? `Filters (${set})` : "Filters";
  // Not disabled: that would take the keyboard from it once pressed.
  element("reset").setAttribute("aria-disabled", String(!set && state.sort === firstSort && state.rises === risesFirst(firstSort)));
}

// --- bars: how many items of each group ---

const bars = new Map();
function bar(k) {
  if (!bars.has(k)) {
    const item = document.createElement("li"), button = make("button", item);
    make("span", button, "", words(grouped.values[k]));
    make("b", button);
    button.title = words(grouped.values[k]);
    button.addEventListener("click", () => { grouped.chosen = grouped.chosen === k ? -1 : k; change(); });
    bars.set(k, item);
  }
  return bars.get(k);
}

function showBars() {
  const { counts, chosen } = grouped, held = document.activeElement;
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
  element("groups").hidden = !found.length;
  element("all").hidden = found.length <= MOST_BARS;
  element("all").textContent = state.showsAll ? `Show the largest ${MOST_BARS}` : `Show all ${found.length}`;
  element("all").setAttribute("aria-expanded", String(state.showsAll));
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
  const f = items[k], item = element("card").content.firstElementChild.cloneNode(true), box = item.firstChild;
  const [, head, group, sentence, values, verdict] = box.children, target = link(f.page);
  if (target) box.href = target;
  item.dataset.item = k;
  item.dataset.place = place;
  const [badge, isHit, further] = page.badge(f);
  [sceneNames[f.scene], ...page.head(f)].forEach((text, n) => (head.children[n].textContent = head.children[n].title = text));
  group.textContent = group.title = words(f[page.groups.key]) + (behind.has(k) ? ` (+ ${counted(behind.get(k), "drive like it", "drives like it")})` : "");
  sentence.textContent = sentence.title = page.sentence?.(f) || "";
  sentence.hidden = !sentence.textContent;
  for (const [label, value, title] of page.values(f)) {
    const pair = make("span", values);
    make("small", pair, "", label);
    pair.append(value);
    if (title) pair.title = title;
  }
  verdict.children[0].textContent = badge;
  if (isHit) verdict.children[0].className = "hit";
  verdict.children[1].textContent = verdict.children[1].title = further;
  addCells(box, f, place);
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
    label.append(page.ranges[ranges.indexOf(r)][3]);
    r.inputs.unknown.addEventListener("change", () => { r.unknown = r.inputs.unknown.checked; change(); });
  }
  for (const [key, [label]] of sorts) make("option", element("sort"), "", label).value = key;
  element("groups-title").textContent = page.groups.title;
  element("cards").setAttribute("aria-label", page.label);
  element("moment").textContent = page.moment;
  element("note").textContent = page.note || "";
  element("note").hidden = !page.note;
  const isEmpty = !items.length;
  element("filters").hidden = element("bar").hidden = isEmpty;
  element("every").hidden = !page.event;
  element("none").textContent = page.none(isEmpty);
  if (isEmpty) element("page").style.display = "block";
  buildSweep();
  page.build?.(isEmpty);
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
    const [file, id] = link(items[item.dataset.item].page).split("#"), from = address().slice(1);
    a.href = `${file}${from ? `?from=${encodeURIComponent(from)}` : ""}#${id}`;
    if (press === "click") writeAddress({ place: Number(item.dataset.place) });
  });
}
element("scene").addEventListener("input", (e) => { state.text = e.target.value.slice(0, 200); change(); });
element("sort").addEventListener("change", (e) => { state.sort = e.target.value; state.rises = risesFirst(state.sort); change(); });
element("order").addEventListener("click", () => { state.rises = !state.rises; change(); });
element("all").addEventListener("click", () => { state.showsAll = !state.showsAll; showBars(); });
element("every").addEventListener("click", () => { state.showsEvery = !state.showsEvery; change(); });
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
