// --- failures: what a drive is, at which places of the slider, a search for others, and the suite that keeps them ---

let isSearching = false, found = [], foundWithout = [], explaining = 0;

function showWhy(lines) {
  element("why").replaceChildren(...lines.map(({ error, driver, text, failure }) => {
    const line = document.createElement("p");
    line.className = failure ? "failure" : "";
    line.textContent = error || `${driver}: ${text}`;
    return line;
  }));
}

// Once nothing changes any more, except where it would start programs.
const isProgram = () => wanted.drivers.some((k) => offered.drivers[k].isProgram);
function explainSoon() {
  clearTimeout(explaining);
  if (!isProgram()) explaining = setTimeout(explain, 300);
}

async function explain() {
  clearTimeout(explaining);
  if (pending || isSearching) return;
  const asked = JSON.stringify(wanted);
  try {
    const { words } = await ask("/explain", wanted);
    if (asked !== JSON.stringify(wanted)) return;
    showWhy(words);
    if (!isProgram() && element("start").hidden) await sweep();
  } catch (error) {
    if (!error.isReplaced) showWhy([{ error: error.message }]);
  }
}

// What becomes of each place of the slider, for the left driver.
let places = new Map(), placesOf = "";
const placesKey = () => JSON.stringify([wanted.scene, wanted.generator, wanted.dial, wanted.drivers[0], wanted.adversary, wanted.without]);
function showPlaces() {
  if (placesOf !== placesKey()) { places = new Map(); placesOf = placesKey(); }
  const hasDial = offered.generators[wanted.generator].dials.length > 0, name = offered.drivers[wanted.drivers[0]].name;
  element("places").replaceChildren(...Array.from({ length: hasDial ? offered.steps : 0 }, (_, step) => {
    const cell = document.createElement("i"), becomes = places.get(step);
    cell.className = `${becomes || ""} ${step === wanted.step && wanted.found === null ? "chosen" : ""}`;
    cell.title = `${(step / (offered.steps - 1)).toFixed(2)}${becomes ? `: ${becomes}` : ""}`;
    cell.addEventListener("click", () => generate({ step }));
    return cell;
  }));
  const count = (kind) => [...places.values()].filter((becomes) => becomes === kind).length;
  const at = [...places].filter(([, becomes]) => becomes === "failure").map(([step]) => step).sort((a, b) => a - b);
  const range = at.length ? ` (${(at[0] / (offered.steps - 1)).toFixed(2)} to ${(at.at(-1) / (offered.steps - 1)).toFixed(2)})` : "";
  element("places-legend").textContent = !hasDial || !places.size ? "" : `${name}: red, ${count("failure")} failures${range}; pale, ${count("attack")} other attacks`;
}

async function sweep() {
  if (!offered.generators[wanted.generator].dials.length || places.size === offered.steps) return;
  const of = placesKey();
  await askLines("/sweep", wanted, ({ step, becomes }) => {
    if (becomes && of === placesKey()) { places.set(step, becomes); showPlaces(); }
  });
}

function showFound() {
  element("found").replaceChildren(...found.map(({ text, words }, k) => {
    const row = document.createElement("li"), one = button(`failure ${k + 1}: ${text}`, () => openFound(k));
    one.setAttribute("aria-pressed", String(wanted.found?.number === k));
    if (words) one.title = words;
    row.append(one);
    return row;
  }));
}

function openFound(k) {
  wanted.found = { number: k, without: foundWithout };
  wanted.goal = null;
  showFound();
  attackAgain();
}

// Another driver, scene or adversary: what was found was of another search.
function forgetFound() {
  wanted.found = null;
  found = [];
  showFound();
  element("searched").textContent = "";
  element("search").textContent = `Search for failures of ${offered.drivers[wanted.drivers[0]].name}`;
}

async function search() {
  clearTimeout(explaining);
  forgetFound();
  foundWithout = [...wanted.without];
  isSearching = true;
  element("progress").hidden = false;
  element("progress").max = offered.budget;
  let drives = 0;
  const tell = (line) => {
    drives = line.drives ?? drives;
    element("progress").value = drives;
    if (line.found && line.found.length !== found.length) { found = line.found; showFound(); }
    element("searched").textContent = `${drives} of ${offered.budget} drives`;
  };
  try {
    const last = await askLines("/search", { ...wanted, goal: null, found: null }, tell);
    if (last?.words) {
      found = last.found;
      showFound();
      element("searched").textContent = last.words;
    } else element("searched").textContent = `stopped after ${drives} drives`;
  } catch (error) {
    element("searched").textContent = error.message;
  }
  element("progress").hidden = true;
  isSearching = false;
}

async function keep() {
  element("kept").textContent = "";
  try {
    const { kept, tests, folder } = await ask("/keep", wanted);
    element("kept").textContent = `kept as ${kept.join(", ")}. Suite of ${tests}: sage test ${folder} --ego ${offered.drivers[wanted.drivers[0]].name}`;
  } catch (error) {
    element("kept").textContent = error.message;
  }
}

element("explain").addEventListener("click", explain);
element("search").addEventListener("click", search);
element("keep").addEventListener("click", keep);
