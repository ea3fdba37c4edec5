// --- failures: what a drive is, a search for others, and the suite that keeps them ---

let isSearching = false, found = [], explaining = 0;

function showWhy(lines) {
  element("why").replaceChildren(...lines.map(({ error, driver, text, failure }) => {
    const line = document.createElement("p");
    line.className = failure ? "failure" : "";
    line.textContent = error || `${driver}: ${text}`;
    return line;
  }));
}

// Once nothing changes any more, except where it would start programs.
function explainSoon() {
  clearTimeout(explaining);
  const isProgram = wanted.drivers.some((k) => offered.drivers[k].isProgram);
  if (!isProgram) explaining = setTimeout(explain, 300);
}

async function explain() {
  clearTimeout(explaining);
  if (pending || isSearching) return;
  const asked = JSON.stringify(wanted);
  try {
    const { words } = await ask("/explain", wanted);
    if (asked === JSON.stringify(wanted)) showWhy(words);
  } catch (error) {
    if (!error.isReplaced) showWhy([{ error: error.message }]);
  }
}

function showFound() {
  element("found").replaceChildren(...found.map(({ text, words }, k) => {
    const row = document.createElement("li"), one = button(text, () => openFound(k));
    one.setAttribute("aria-pressed", String(wanted.found === k));
    if (words) one.title = words;
    row.append(one);
    return row;
  }));
}

function openFound(k) {
  wanted.found = k;
  wanted.goal = null;
  showFound();
  attackAgain();
}

// Another driver, scene or road user: what was found was of another search.
function forgetFound() {
  wanted.found = null;
  found = [];
  showFound();
  element("searched").textContent = "";
}

async function search() {
  clearTimeout(explaining);
  forgetFound();
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
    element("kept").textContent = `${kept.join(", ")}: ${tests} in ${folder}`;
  } catch (error) {
    element("kept").textContent = error.message;
  }
}

element("explain").addEventListener("click", explain);
element("search").addEventListener("click", search);
element("keep").addEventListener("click", keep);
