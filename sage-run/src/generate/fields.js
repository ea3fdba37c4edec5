// What the page of a data set lists: attacks. Comes before list.js in one script.
function fields() {
  const number = (digits, unit) => (value) => measured(value, digits, unit);
  // The first setting that attacks. A scene that the lowest one attacks says nothing of the dial, so it comes behind.
  const isAttack = (f, variant) => items[ofScene.get(f.scene)?.get(variant)]?.is_attack;
  const needed = (f) => { const first = variants.findIndex((_, variant) => isAttack(f, variant)); return first < 0 ? NaN : first || variants.length; };
  if (variants.length > 1) items.forEach((f) => { f.needed = needed(f); });
  return {
    label: "Attacked scenes",
    across: 60, // metres across a thumbnail, at least: enough to see what kind of place it is
    moment: `Top view, north up, at the contact, or where the cars are nearest.${variants.length > 1 ? " The strip of a card: one cell for each setting, red: believable attack, yellow: attack that is not, grey: none." : ""}`,
    facets: [["outcome", "Outcome"], ["avoidable", "Evasive manoeuvre", answer("exists, knowing the plan", "none found")], ["prevented_by_r157", "UN R157 driver", answer("prevents it", "does not")]],
    groups: { key: "outcome", title: "What came of the attacks" },
    ranges: [["contact_after", "Contact after, s", 1, "and without contact"], ["latest_start", "Latest start, s", 1, "and not measured"]],
    sorts: [...(variants.length > 1 ? [["needed", "setting that attacks"]] : []), ["scene", "scene"], ["reward", "reward"], ["contact_after", "contact after"], ["impact", "impact speed"], ["latest_start", "latest start"], ["realism", "P_real"], ["outcome", "outcome"]],
    count: (shown) => `${shown} of ${counted(scenes.length, "scene", "scenes")} shown`,
    head: (f) => [`adversary ${words(f.adversary_id)}`, ""],
    values: (f) => [
      ["contact", number(1, " s")(f.contact_after), "Time from now, the start of the attack, to the contact"], ["impact", number(1, " m/s")(f.impact)],
      ["reward", number(1, "")(f.reward), "Adversarial reward R_adv"], ["latest start", number(1, " s")(f.latest_start), "How late before the contact an evasive manoeuvre, knowing the plan, could begin"], ["P_real", number(1, "")(f.realism), "Realism penalty: P_kin + P_beh"],
    ],
    badge: (f) => [f.is_attack ? "attack" : "no attack", f.is_attack, f.why ? words(f.why) : ""],
    tone: (f) => (f.is_believable ? "attack" : f.is_attack ? "contact" : ""),
    none: (isEmpty) => (isEmpty ? "No scene was attacked." : "No scene meets all filters."),
  };
}
