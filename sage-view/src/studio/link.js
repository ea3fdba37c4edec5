// --- the view in the address: names, so that it holds after a start with other scenes ---

let saving = 0;
function saveView() {
  clearTimeout(saving);
  saving = setTimeout(() => history.replaceState(null, "", `#${viewParts()}`), 300);
}

function viewParts() {
  const parts = new URLSearchParams({ scene: offered.scenes[wanted.scene], generator: offered.generators[wanted.generator].name, dial: wanted.dial, step: wanted.step });
  wanted.drivers.forEach((k) => parts.append("ego", offered.drivers[k].name));
  if (wanted.adversary) parts.set("adversary", wanted.adversary);
  wanted.without.forEach((id) => parts.append("without", id));
  if (wanted.goal) parts.set("goal", wanted.goal.join(","));
  return parts;
}

// The view of an address; what is not offered here stays as it is.
function viewOf(hash) {
  const parts = new URLSearchParams(hash.slice(1)), number = (list, name) => list.findIndex((one) => (one.name ?? one) === name);
  const scene = number(offered.scenes, parts.get("scene"));
  if (scene < 0) return null;
  const generator = Math.max(0, number(offered.generators, parts.get("generator"))), step = Number(parts.get("step"));
  const drivers = parts.getAll("ego").map((name) => number(offered.drivers, name)).filter((k) => k >= 0).slice(0, 2);
  const goal = (parts.get("goal") || "").split(",").map(Number);
  return {
    scene, generator, dial: parts.get("dial") === "aggression" ? "aggression" : "lambda",
    step: Number.isInteger(step) && step >= 0 && step < offered.steps ? step : offered.steps - 1,
    drivers: drivers.length ? drivers : wanted.drivers,
    adversary: parts.get("adversary"), without: parts.getAll("without"), goal: goal.length === 2 && goal.every(Number.isFinite) ? goal : null, found: null,
  };
}

window.addEventListener("hashchange", async () => {
  const isKey = new URLSearchParams(location.hash.slice(1)).has("key");
  if (isKey) await begin();
  else if (offered) await openView(viewOf(location.hash), true);
});
