// --- sweeps: drives that differ in one value share a box, and a slider chooses which of them it shows ---

let groups, values, axes, digits;
function group() {
  groups = [];
  for (const panel of panels.filter((p) => p.sweep)) {
    let group = groups.find((g) => g.number === panel.sweep.group);
    if (!group) groups.push((group = { number: panel.sweep.group, axis: { lambda: "λ", mu: "μ" }[panel.sweep.axis] || panel.sweep.axis, members: [] }));
    group.members.push(panel);
    panel.group = group;
  }
  for (const { members } of groups) members.sort((a, b) => a.sweep.value - b.sweep.value);
  values = [...new Set(panels.filter((p) => p.sweep).map((p) => p.sweep.value))].sort((a, b) => a - b);
  axes = [...new Set(groups.map((g) => g.axis))].join("/");
  digits = [2, 3, 4, 5].find((n) => values.every((v) => Math.abs(v - v.toFixed(n)) < 1e-9)) || 6;
  view.all = !groups.length;
}
const setting = (axis, value) => `${axis} ${value.toFixed(digits)}`;

// What has a box: a drive, or a group. The key of a digit chooses one of them.
const unit = (panel) => (!view.all && panel.group) || panel;
const units = () => [...new Set(panels.map(unit))];
// Drives of one name, such as those of two drivers in one test, are shown together.
const isAlone = (panel) => unit(panel) === view.alone || (!!panel.id && !panel.group && panel.id === view.alone.id);
const isShown = (panel) => (view.alone === null || isAlone(panel)) && (view.all || !panel.group || panel.group.chosen === panel);

function title(panel) {
  const own = panel.sweep && setting(panel.group.axis, panel.sweep.value);
  return own && !panel.name.endsWith(own) ? `${panel.name}, ${own}` : panel.name;
}

function outcome({ verdict, contact, failed }) {
  if (failed) return ["failed", "planner failed"];
  if (verdict) return ["attack", "attack"];
  if (contact) return ["contact", verdict === null ? "contact" : "contact, no attack"];
  return ["", verdict === null ? "no contact" : "no attack"];
}

function buildSweep() {
  ["sweep", "sweep-keys", "sweep-legend"].forEach((id) => (element(id).hidden = false));
  element("value").max = values.length - 1;
  element("value").setAttribute("aria-label", axes);
  element("axis").textContent = axes;
  element("all-label").textContent = axes.length === 1 ? `all ${axes} at once` : "all values at once";
  for (const group of groups) {
    group.cells = document.createElement("div");
    group.cells.className = "cells";
    group.cells.setAttribute("aria-hidden", "true"); // the slider says the same
    for (const panel of group.members) {
      const [name, words] = outcome(panel), i = document.createElement("i");
      i.className = name;
      i.title = `${setting(group.axis, panel.sweep.value)}: ${words}`;
      i.style.setProperty("--place", `${(100 * values.indexOf(panel.sweep.value)) / Math.max(1, values.length - 1)}%`);
      i.style.setProperty("--width", `${100 / Math.max(1, values.length - 1)}%`);
      i.addEventListener("click", () => pick(panel.sweep.value, panel));
      group.cells.append(i);
      panel.cell = i;
    }
  }
  // The marks of one group belong to the slider; several groups have theirs in their boxes.
  if (groups.length === 1) element("value").after(groups[0].cells);
  choose(values.at(-1));
  element("value").addEventListener("input", (e) => pick(values[e.target.value]));
  element("all").addEventListener("change", (e) => {
    const lone = view.alone;
    showAll(e.target.checked);
    if (!view.all && lone?.group) choose(lone.sweep.value, lone);
    alone(lone && !view.all ? unit(lone) : null);
  });
  keys["["] = () => stepValue(-1);
  keys["]"] = () => stepValue(1);
}

// Each group shows the drive whose value is nearest, or the given one.
function choose(value, panel) {
  element("value").value = values.indexOf(value);
  element("at").textContent = setting(axes, value);
  for (const group of groups) {
    const gap = (p) => Math.abs(p.sweep.value - value);
    group.chosen = panel?.group === group ? panel : group.members.reduce((best, p) => (gap(p) < gap(best) ? p : best));
    group.members.forEach((p) => p.cell.classList.toggle("chosen", p === group.chosen));
    if (groups.length > 1) group.chosen.box.children[0].after(group.cells);
  }
  element("value").setAttribute("aria-valuetext", groups.map(({ chosen }) => `${title(chosen)}: ${outcome(chosen)[1]}`).join("; "));
}

function pick(value, panel) {
  choose(value, panel);
  show();
}

const stepValue = (steps) => view.all || pick(values[Math.min(values.length - 1, Math.max(0, Number(element("value").value) + steps))]);

function showAll(all) {
  view.all = element("all").checked = element("value").disabled = all;
  if (groups.length > 1) groups.forEach((g) => (g.cells.hidden = all));
}

// --- links: `#failure3` opens that drive alone ---

const hasLinks = () => panels.some((p) => p.id);
const linked = () => panels.find((p) => p.id && location.hash === `#${p.id}`);

function openLink() {
  const panel = linked();
  if (!panel) return false;
  if (groups.length) showAll(false);
  if (panel.group) choose(panel.sweep.value, panel);
  alone(unit(panel));
  return true;
}
