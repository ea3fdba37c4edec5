"use strict";
// What the scripts of a list share: the data, words, elements. Comes first.
// Units of the data: metres, seconds, radians; decimetres in paths and roads, see thumbnails.js.
const data = JSON.parse(document.getElementById("data").textContent);
const element = (id) => document.getElementById(id);
const { scenes, items } = data;

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
