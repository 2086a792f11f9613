// What a reader takes home from the page: lines of Python that give the same loops, the loops as JSON and CSV, the points as .npy.
// Idea: these are functions of the source (as `readFilm` returns it), of the clouds that are used, and of the tracker's states.
function barName(state, bar) { // of a bar of a frame: "loop 0" once the tracker has named it
  const loop = state.loops.find((each) => each.bar === bar);
  return loop ? `loop ${loop.id}` : `bar ${bar}`;
}
const stemOf = (source) => source.names[0].replace(/\.\w+$/, "").replace(/\W+/g, "_");
const isHanded = (source) => Boolean(source.sample || source.pasted); // no file has these points until they are saved

// ---- Python --------------------------------------------------------------------------------------------------------
const IMPORTS = [
  [/\bjson\.loads/, "import json"],
  [/\bPath\(/, "from pathlib import Path"],
  [/\bnp\./, "import numpy as np"],
  [/\btk\./, "import topokit as tk"],
  [/\btrimesh\./, "import trimesh"],
  [/\bload_episode\(/, "from topokit.io import load_episode"],
  [/\binliers\(/, "from topokit.sampling import inliers"],
  [/\bPointCloud\./, "from pypcd4 import PointCloud"],
  [/\bread_clouds\(/, "from topokit.sensors import read_clouds"],
];
function pythonLines(source, wanted, clouds, states) {
  const film = source.frames.length > 1, lines = [];
  if (isHanded(source)) {
    const name = `${stemOf(source)}.npy`;
    lines.push(`# "points (.npy)" below saves ${name}`, `${film ? "film" : "points"} = np.load(${JSON.stringify(name)})`);
  } else if (film && source.several) {
    const read = source.names.reduce((code, name) => code.replaceAll(JSON.stringify(name), "name"), source.python);
    lines.push(`names = [${source.names.map((name) => JSON.stringify(name)).join(", ")}]`, `film = [${read} for name in names]`);
  } else {
    lines.push(`${film ? "film" : "points"} = ${source.python}${source.whole && !film ? "[0]" : ""}`);
  }
  if (source.zips?.length) lines.unshift(`# where ${source.zips.join(", ")} ${source.zips.length > 1 ? "are" : "is"} unpacked`);
  const steps = isHanded(source) ? [] : stepsOf(source, wanted);
  if (!film && states[0]?.used.length < clouds[0].length / 3) steps.push("points[inliers(points)]");
  for (const step of steps) lines.push(film ? `film = [${step} for points in film]` : `points = ${step}`);
  lines.push(film ? "states = tk.track(film)" : "diagram = tk.rips_persistence(points)");
  const code = lines.join("\n");
  return [...IMPORTS.filter(([use]) => use.test(code)).map(([, line]) => line), code].join("\n");
}
function stepsOf({ frames, columns, options: { crop, planes = [] } }, wanted) { // from the points of a file to those that are used
  const some = (key) => frames.some((frame) => frame.left[key]), counts = frames.map((frame) => frame.count), steps = [];
  if (some("notFinite")) steps.push("points[np.isfinite(points).all(axis=1)]");
  if (some("atZero")) steps.push("points[points.any(axis=1)]");
  if (some("repeats")) steps.push("points[np.sort(np.unique(points, axis=0, return_index=True)[1])]");
  const limits = (side) => `[${crop[side].slice(0, columns).map((limit) => limit ?? (side ? "np.inf" : "-np.inf")).join(", ")}]`;
  if (crop) steps.push(`points[((points >= ${limits(0)}) & (points <= ${limits(1)})).all(axis=1)]`);
  for (const { normal, offset, thickness } of planes) steps.push(`points[abs(points @ [${normal.join(", ")}] - ${offset}) > ${thickness}]`);
  const fewest = Math.min(...counts), number = fewest < wanted ? `min(${wanted}, len(points))` : wanted;
  if (wanted < Math.max(...counts)) steps.push(`points[tk.farthest_point_sample(points, ${number})[0]]`);
  return steps;
}

// ---- files ---------------------------------------------------------------------------------------------------------
function loopsAsValues(state) { // ids are rows of the points that are used
  const { births, deaths, birthEdges, killerEdges, killerTriangles } = state.diagram;
  return Array.from(births, (birth, bar) => ({
    name: barName(state, bar),
    birth,
    death: deaths[bar],
    lifetime: deaths[bar] - birth,
    evidence: state.evidence[bar],
    birth_edge: [...birthEdges.subarray(2 * bar, 2 * bar + 2)],
    killer_edge: [...killerEdges.subarray(2 * bar, 2 * bar + 2)],
    killer_triangles: [0, 3].map((k) => [...killerTriangles.subarray(6 * bar + k, 6 * bar + k + 3)]),
  }));
}
function loopsAsJson(source, clouds, states, frame, cycleOf) { // cycles of the frame that is shown: those of a film would take long
  const frames = [];
  states.forEach((state, t) => {
    const points = Array.from({ length: clouds[t].length / 3 }, (_, i) => [...clouds[t].subarray(3 * i, 3 * i + 3)]), loops = loopsAsValues(state);
    if (t === frame) loops.forEach((loop, bar) => (loop.cycle = [...cycleOf(bar)]));
    frames.push({ frame: t, points, loops });
  });
  return JSON.stringify({ source: source.names, left_out: source.frames.map(({ left }) => left), frames }, null, 1);
}
function loopsAsCsv(states) {
  const keys = ["name", "birth", "death", "lifetime", "evidence"], lines = [["frame", ...keys].join()];
  states.forEach((state, t) => {
    for (const loop of loopsAsValues(state)) lines.push([t, ...keys.map((key) => loop[key])].join());
  });
  return lines.join("\n") + "\n";
}
function pointsAsNpy(source, clouds, frame) { // (n, 3), or (n, 2) as they came; a sample's film (T, n, 3); of the reader's own film the frame that is shown
  const parts = isHanded(source) ? clouds : [clouds[frame]], rows = parts[0].length / 3, columns = source.columns;
  const shape = parts.length > 1 ? [parts.length, rows, columns] : [rows, columns];
  const head = `{'descr': '<f8', 'fortran_order': False, 'shape': (${shape.join(", ")}), }`;
  const line = head.padEnd(64 * Math.ceil((head.length + 11) / 64) - 11) + "\n"; // the numbers begin at a multiple of 64
  const start = Uint8Array.from([0x93, ...new TextEncoder().encode("NUMPY"), 1, 0, line.length & 255, line.length >> 8]);
  return new Blob([start, line, ...parts.map((cloud) => cloud.filter((_, i) => i % 3 < columns))]);
}
function save(name, content) {
  const address = URL.createObjectURL(content instanceof Blob ? content : new Blob([content]));
  Object.assign(document.createElement("a"), { href: address, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(address), 10000);
}
