// What the page of a report lists: failures. Comes before list.js in one script.
function fields() {
  const inWords = (value) => words(value).replaceAll("_", " ");
  // Plainest first: what a reference driver prevents and leaves people time, then what could still be avoided latest.
  const isShort = (f) => Number.isFinite(f.human_time) && f.human_time < 0.75;
  for (const f of items) f.plain = (f.prevented_by ? 100 : 0) - (isShort(f) ? 75 : 0) - (Number.isFinite(f.latest_start) ? f.latest_start : 50);
  return {
    label: "Failures",
    across: 35, // metres across a thumbnail, at least
    moment: "Top view, north up, at the contact",
    note: "A card stands for an event, and shows its mildest drive. The list begins with one event of each cluster, first what a reference driver prevents, those with a human time of less than 0.75 s last, then the smallest latest start. Verdicts assume perfect perception without latency; others replay their recordings; 8 s, one adversary.",
    facets: [
      ["driver", "Driver"], ["cluster", "Cluster"], ["collision", "Collision"], ["ego_does", "Ego does"], ["adversary_does", "Adversary does"], ["road", "Road"],
      ["at_fault", "Fault", answer("at fault", "not at fault")], ["fault", "Fault class", inWords], ["right_of_way", "Right of way"], ["adversary_from", "Adversary from"], ["violation", "Adversary: lights, lines"], ["prevented_by", "Prevented by"], ["braking", "The driver"], ["needs", "It takes"], ["plan", "Plan"],
    ],
    groups: { key: "cluster", title: "Clusters" },
    // Drives of one event share a card, that of the mildest one.
    event: (f) => [f.scene, f.driver, f.cluster].join("\n"),
    rank: "difference",
    ranges: [["difference", "Difference, m/s²", 1, "and not measured"], ["lambda", "λ", 2, "and failures without λ"], ["latest_start", "Latest start, s", 1, "and not measured"], ["human_time", "Human time, s", 1, "and not measured"]],
    sorts: [
      ["plain", "plainest"], ["difference", "difference from the recording"], ["probability", "probability"], ["human_time", "human time"], ["latest_start", "latest start"], ["reward", "reward"], ["lambda", "λ"], ["contact_after", "contact after"], ["impact", "impact speed"],
      ["cluster", "cluster"], ["driver", "driver"], ["scene", "scene"],
    ],
    count: (shown, inScenes, inClusters, listed) => {
      const events = new Set(listed.map(page.event)).size;
      return `${counted(inScenes, "scene", "scenes")} with ${counted(events, "event", "events")} (a cluster in a scene), ${shown} of ${counted(items.length, "failing drive", "failing drives")}; ${counted(inClusters, "cluster", "clusters")}`;
    },
    head: (f) => [words(f.name) + (f.role ? ` (${words(f.role)})` : ""), words(f.driver)],
    values: (f) => [
      ["difference", measured(f.difference, 1, " m/s²"), "How differently from its recording the adversary is driven: largest difference of the accelerations"], ["contact", measured(f.contact_after, 1, " s"), "Time from now, the start of the attack, to the contact"], ["impact", measured(f.impact, 1, " m/s")], ["probability", measured(f.probability, 2, " %"), "That the adversary stays within 2 m of this plan up to the contact, if it moves as an untuned motion prior says"],
      ["latest start", measured(f.latest_start, 1, " s before"), "How late before the contact an evasive manoeuvre, knowing the plan, could begin: the smaller, the longer a driver could wait"],
      ["human time", measured(f.human_time, 1, " s") + (isShort(f) ? " (short)" : ""), "From the onset of the plan to the latest start; people need 0.75 s"], ["λ", measured(f.lambda, 2)],
    ],
    badge: (f) => [f.at_fault === true ? "at fault" : f.at_fault === false ? "not at fault" : "fault unknown", f.at_fault === true, `${inWords(f.fault)}; ${f.prevented_by ? `${words(f.prevented_by)} prevents it` : "no reference driver prevents it"}${f.not_prevented_by.length ? `, not ${f.not_prevented_by.map(words).join(", ")}` : ""}${f.without_attack ? `; ${words(f.without_attack)}` : ""}`],
    sentence: (f) => (f.sentence ? words(f.sentence) : ""),
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
    const further = (w) => [...(isOne ? [] : [words(w.driver)]), ...(w.note ? [words(w.note)] : [])];
    const names = of.map((w) => words(w.scene) + (further(w).length ? ` (${further(w).join(": ")})` : "")).sort(collator.compare);
    details.addEventListener("toggle", () => { if (details.children.length < 2) make("p", details, "", names.join(", ")); });
  }
}
