// --- the list of scenes, with pictures of those in view ---

// Of many scenes the list shows the first that match.
const MOST_LISTED = 500;
const pictures = new Map(), wantedPictures = new Set();
let isPicturing = false;

function listScenes() {
  const words = element("filter").value.toLowerCase();
  const found = offered.scenes.map((name, k) => [name, k]).filter(([name]) => name.toLowerCase().includes(words));
  const list = element("scenes");
  pictureWatch.disconnect();
  wantedPictures.clear();
  list.replaceChildren(...found.slice(0, MOST_LISTED).map(([name, k]) => {
    const row = document.createElement("li"), picture = document.createElement("img"), text = document.createElement("span");
    row.setAttribute("role", "option");
    row.dataset.scene = k;
    picture.alt = "";
    if (pictures.has(k)) picture.src = pictures.get(k);
    text.textContent = name;
    row.append(picture, text);
    pictureWatch.observe(row);
    return row;
  }));
  markScene();
  element("count").textContent = found.length > MOST_LISTED ? `${MOST_LISTED} of ${found.length} that match are listed` : `${found.length} of ${offered.scenes.length}`;
}

// The keyboard reaches the list at the scene that is open.
function markScene() {
  const rows = [...element("scenes").children];
  const open = rows.find((row) => Number(row.dataset.scene) === wanted.scene);
  rows.forEach((row) => { row.setAttribute("aria-selected", String(row === open)); row.tabIndex = row === (open || rows[0]) ? 0 : -1; });
  return open;
}

const pictureWatch = new IntersectionObserver((changes) => {
  for (const { target, isIntersecting } of changes) isIntersecting ? wantedPictures.add(target) : wantedPictures.delete(target);
  drawPictures();
}, { rootMargin: "100px" });

// One at a time, so that a drive never waits for many.
async function drawPictures() {
  if (isPicturing) return;
  isPicturing = true;
  for (;;) {
    const row = [...wantedPictures].find((row) => !pictures.has(Number(row.dataset.scene)));
    if (!row) break;
    await (pending || null);
    const number = Number(row.dataset.scene);
    const picture = await ask("/thumbnail", { scene: number }).catch(() => null);
    pictures.set(number, picture ? `data:image/svg+xml,${encodeURIComponent(picture.svg)}` : "data:,");
    for (const other of element("scenes").children) if (Number(other.dataset.scene) === number) other.firstChild.src = pictures.get(number);
    if (pictures.size > 4 * MOST_LISTED) pictures.delete(pictures.keys().next().value);
  }
  isPicturing = false;
}

element("filter").addEventListener("input", listScenes);
element("scenes").addEventListener("click", (e) => { const row = e.target.closest("li"); if (row) openScene(Number(row.dataset.scene)); });
element("scenes").addEventListener("keydown", (e) => {
  const row = e.target.closest("li"), rows = [...element("scenes").children], at = rows.indexOf(row);
  const to = { ArrowDown: at + 1, ArrowUp: at - 1, Home: 0, End: rows.length - 1 }[e.key];
  if (e.key === "Enter" || e.key === " ") openScene(Number(row.dataset.scene));
  else if (to === undefined) return;
  else rows[to]?.focus();
  e.preventDefault();
  e.stopPropagation();
});
