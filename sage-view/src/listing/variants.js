// A page may list several variants of each scene, such as attacks at several λ. It shows one card a scene: a slider
// chooses the variant of all, and cells on a card that of one. Comes before list.js in one script.

const variants = Array.isArray(data.variants) ? data.variants.map(plain) : [];
const chosen = new Map(); // by scene, where a card differs from the slider
const ofScene = new Map(); // items by scene and variant
if (variants.length > 1) items.forEach((f, k) => ofScene.set(f.scene, (ofScene.get(f.scene) || new Map()).set(f.variant, k)));

const isChosen = (f) => variants.length < 2 || f.variant === (chosen.get(f.scene) ?? state.variant);

function buildSweep() {
  if (variants.length < 2) return;
  const [, slider] = element("sweep").children;
  element("sweep").hidden = false;
  slider.max = variants.length - 1;
  slider.addEventListener("input", () => {
    state.variant = Number(slider.value);
    showVariant();
    change();
  });
}

function showVariant() {
  chosen.clear();
  const [output, slider] = element("sweep").children;
  output.textContent = variants[state.variant] ?? "";
  slider.value = state.variant;
  slider.setAttribute("aria-valuetext", output.textContent);
}

// The cells of a card: what each variant of its scene is. A click shows that variant on this card.
function addCells(box, f, place) {
  const all = ofScene.get(f.scene);
  if (!all || all.size < 2) return;
  const cells = make("span", box, "cells");
  cells.setAttribute("aria-hidden", "true"); // the slider says the same
  for (const [variant, k] of [...all].sort((a, b) => a[0] - b[0])) {
    const cell = make("i", cells, page.tone(items[k]));
    cell.title = `${variants[variant]}: ${words(items[k][page.groups.key])}`;
    cell.classList.toggle("chosen", variant === f.variant);
    cell.addEventListener("click", (e) => {
      e.preventDefault();
      e.stopPropagation();
      chosen.set(f.scene, variant);
      shown[place] = k;
      const old = box.parentElement, item = card(k, place);
      thumbnailWatch.unobserve(old);
      visible.delete(old);
      old.replaceWith(item);
      thumbnailWatch.observe(item);
    });
  }
}
