// What the page of a report lists: failures. Comes before list.js in one script.
function fields() {
  const inWords = (value) => words(value).replaceAll("_", " ");
  // Plainest first: what the UN R157 driver avoids, then what leaves most time to react.
  for (const f of items) f.plain = (f.avoidable_r157 === true ? 100 : 0) + (Number.isFinite(f.time_to_react) ? f.time_to_react : 0);
  return {
    label: "Failures",
    across: 35, // metres across a thumbnail, at least
    moment: "Top view, north up, at the contact",
    note: "A driver is at fault by nuPlan's rule: its own motion could have prevented the contact. That is no legal blame: a front that hits a car which cuts in counts too, and a side contact of an ego that is not wholly in one lane (lateral off lane). The list begins with failures that a UN R157 driver, careful and competent, avoids in the ego's place, then those with the most time to react.",
    facets: [
      ["driver", "Driver"], ["cluster", "Cluster"], ["collision", "Collision"], ["ego_does", "Ego does"], ["adversary_does", "Adversary does"], ["road", "Road"],
      ["at_fault", "Fault", answer("at fault", "not at fault")], ["fault", "Fault class", inWords], ["avoidable_r157", "Avoidable by R157", answer("yes", "no")], ["plan", "Plan"],
    ],
    groups: { key: "cluster", title: "Clusters" },
    ranges: [["lambda", "λ", 2, "and failures without λ"], ["time_to_react", "Time to react, s", 1, "and not measured"]],
    sorts: [
      ["plain", "plainest"], ["time_to_react", "time to react"], ["reward", "reward"], ["lambda", "λ"], ["contact_after", "contact after"], ["impact", "impact speed"],
      ["cluster", "cluster"], ["driver", "driver"], ["scene", "scene"],
    ],
    count: (shown, inScenes, inClusters) =>
      `${shown} of ${counted(items.length, "failure", "failures")} shown, in ${counted(inScenes, "scene", "scenes")}; ${counted(inClusters, "cluster", "clusters")}`,
    head: (f) => [words(f.name), words(f.driver)],
    values: (f) => [
      ["contact", measured(f.contact_after, 1, " s"), "Time from now, the start of the attack, to the contact"], ["impact", measured(f.impact, 1, " m/s")],
      ["reward", measured(f.reward, 1)], ["time to react", measured(f.time_to_react, 1, " s")], ["λ", measured(f.lambda, 2)],
    ],
    badge: (f) => [f.at_fault === true ? "at fault" : f.at_fault === false ? "not at fault" : "fault unknown", f.at_fault === true, `${inWords(f.fault)}; a UN R157 driver ${f.avoidable_r157 === true ? "avoids it" : f.avoidable_r157 === false ? "does not avoid it" : "was not tried"}`],
    none: (isEmpty) => (!isEmpty ? "No failure meets all filters." : data.without.length ? "The searches found no failure." : "There are no failures: no scene was searched."),
    build: (isEmpty) => isEmpty && (element("without").open = true),
    showMore: showWithout,
  };
}

// --- scenes without a failure ---

let withoutShown = "";
function showWithout(wanted) {
  const drivers = facets.find(({ key }) => key === "driver");
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
