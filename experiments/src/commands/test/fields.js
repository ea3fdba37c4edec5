// What the page of tests lists: tests of one driver, or of two. Comes before list.js in one script.
function fields() {
  const drivers = items.length ? items[0].did.length : 1;
  return {
    label: "Tests",
    across: 35, // metres across a thumbnail, at least
    moment: "Top view, north up, at the first contact or the end of the drive",
    note: drivers > 1 ? "Fixed: the first fails and the second passes. New failure: the other way round. The thumbnails show the second driver." : "",
    facets: [["result", drivers > 1 ? "Change" : "Result"], ["cluster", "Cluster"]],
    groups: { key: "result", title: drivers > 1 ? "Changes" : "Results" },
    ranges: [],
    sorts: [["result", "result"], ["cluster", "cluster"], ["scene", "scene"]],
    count: (shown, inScenes) => `${shown} of ${counted(items.length, "test", "tests")} in ${counted(inScenes, "scene", "scenes")}`,
    head: (f) => [words(f.name)],
    sentence: (f) => (f.sentence ? words(f.sentence) : ""),
    values: (f) => f.did.map(([driver, did]) => [words(driver), words(did), words(did)]),
    badge: (f) => [words(f.result), f.is_failure, words(f.cluster)],
    none: () => "No test meets all filters.",
  };
}
