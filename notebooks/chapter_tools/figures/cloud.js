// Loops of the reader's own cloud: files, numbers or a sample in; the cloud in space, its diagram and a table of its loops out.
// Idea: a source is a film, of one frame for a cloud. Its frames come in the order of farthest points, so that any number of points is a
// prefix. The worker reads and tracks; each answer replaces `states`. Everything else only draws `states` at a frame, a radius, a loop.
(() => {
  const [scene, diagram, strip] = [$("scene"), $("diagram"), $("strip")], { cycle } = ripsKernel(), { thinned } = fileReaders();
  const worker = kernelWorker([fileReaders]), later = lazily(draw), eye = orbit(scene, [-60, 20], later, { n: () => step(1), p: () => step(-1), " ": () => film() && play() });
  const many = (count, what) => `${count.toLocaleString("en")} ${what}${count === 1 ? "" : "s"}`, escaped = (name) => JSON.stringify(name);
  let source = null, clouds = [], states = [], frame = 0, radius = 0, chosen = { id: null, bar: 0 }, busy = 0, took = 0;
  const film = () => source !== null && source.frames.length > 1, state = () => states[frame];

  // ---- in --------------------------------------------------------------------------------------------------------
  const wanted = () => +$("points").value;
  const cut = ({ all, order, count }) => (all && wanted() >= count ? all : order.subarray(0, 3 * Math.min(wanted(), order.length / 3)));
  function say(place, text) {
    place.textContent = text;
    place.hidden = !text;
  }
  async function working(what, task) { // with progress and a button that stops it; what is asked for later goes before
    const mine = ++busy;
    if (!$("busy").hidden) worker.stop();
    $("busy").hidden = false;
    $("stop").textContent = `stop ${what}`;
    $("done").value = 0;
    try {
      return await task((share) => mine === busy && ($("done").value = share), () => mine === busy);
    } catch (error) {
      if (mine === busy && error.message !== "stopped") say($("errors"), error.message);
    } finally {
      if (mine === busy) $("busy").hidden = true;
    }
  }
  async function compute() { // the first frame at once, then all
    const began = performance.now();
    clouds = source.frames.map(cut);
    await working("tracking", async (report, still) => {
      const first = Math.min(frame, clouds.length - 1), [only] = await worker.run("track", [[clouds[first]], 3, {}], film() ? undefined : report);
      if (!still()) return;
      states = [];
      states[first] = only;
      if (film()) {
        arrived();
        states = await worker.run("track", [clouds, 3, {}], report);
      }
      if (!still()) return;
      took = performance.now() - began;
      arrived();
    });
  }
  function arrived() {
    const last = states.reduce((most, s) => s.diagram.deaths.reduce((m, death) => Math.max(m, death), most), 0);
    end = 1.1 * last || size;
    at(frame);
  }
  function open(given, view = {}) { // a film as `readFilm` returns it
    say($("errors"), given.errors.join("\n"));
    if (!given.frames.length) return;
    source = given;
    [frame, radius, states, chosen] = [clamp(view.frame ?? 0, 0, given.frames.length - 1), 0, [], { id: view.id ?? null, bar: view.bar ?? 0 }];
    const most = Math.max(...given.frames.map((f) => f.count));
    if (view.points) $("points").value = view.points;
    $("points").disabled = most <= +$("points").min;
    $("film").hidden = strip.parentElement.hidden = !film();
    $("time").max = given.frames.length - 1;
    $("link").disabled = !given.sample;
    $("sample").selectedIndex = names.indexOf(given.sample);
    say($("told"), told());
    measure();
    if (given.columns === 2) Object.assign(eye.cam, { az: -Math.PI / 2, el: 1.5 });
    compute().then(() => {
      radius = clamp(view.radius ?? 0, 0, end);
      later();
    });
  }
  function told() { // what was read, and what of it was left out
    const { frames, names, sample } = source, total = (key) => frames.reduce((sum, f) => sum + (f.left[key] ?? f[key]), 0);
    const left = [[total("notFinite"), "not finite"], [total("atZero"), "at zero, where a camera saw nothing"], [total("repeats"), "repeated"]].filter(([count]) => count);
    const what = names.length > 1 ? `${names[0]} to ${names.at(-1)}` : names[0], ends = left.map(([count, why]) => `${count.toLocaleString("en")} ${why}`);
    return `${sample ? "sample: " : ""}${what}: ${film() ? many(frames.length, "frame") + ", " : ""}${many(total("rows"), "point")}${ends.length ? `; left out: ${ends.join(", ")}` : ""}`;
  }
  async function take(files) {
    if (!files.length) return;
    const given = await working("reading", (report) => worker.run("readFilm", [[...files], {}], report));
    if (given) open(given);
  }
  async function paste() {
    const given = await working("reading", () => worker.run("readFilm", [[new File([$("numbers").value], "pasted.txt")], {}]));
    if (given) open(Object.assign(given, { pasted: true }));
  }
  function sample(name, view = {}) { // computed here, or handed over with the page
    const packed = data.samples[name], ticks = packed && unpack(packed.ticks), wide = packed && packed.ticks.shape.at(-2) * 3;
    const numbers = packed ? Float64Array.from(ticks, (v, i) => (v + packed.low[i % 3]) / 1e4) : COMPUTED[name]();
    const frames = Array.from({ length: packed ? ticks.length / wide : 1 }, (_, t) => thinned(packed ? numbers.slice(wide * t, wide * (t + 1)) : numbers, 3));
    eye.back();
    open({ names: [name], frames, errors: [], columns: 3, sample: name, python: "" }, view);
    Object.assign(eye.cam, view.cam);
  }

  // ---- where things are seen ---------------------------------------------------------------------------------------
  let centre = [0, 0, 0], size = 1, end = 1, fit = null;
  function measure() { // the ball around all frames
    const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    for (const { order } of source.frames) order.forEach((v, i) => ([low[i % 3], high[i % 3]] = [Math.min(low[i % 3], v), Math.max(high[i % 3], v)]));
    centre = low.map((v, k) => (v + high[k]) / 2);
    size = Math.hypot(...low.map((v, k) => high[k] - v)) / 2 || 1;
    fit = null;
  }
  function fitted(w, h) { // one scale for the whole film, so that playing and turning do not make the picture breathe
    const see = eye.see(centre), low = [Infinity, Infinity], high = [-Infinity, -Infinity], q = [0, 0, 0];
    for (const { order } of source.frames) for (let i = 0; i < order.length; i += 3) {
      see(order, i, q);
      for (const k of [0, 1]) [low[k], high[k]] = [Math.min(low[k], near(q) * q[k]), Math.max(high[k], near(q) * q[k])];
    }
    const scale = Math.min((w - 40) / (high[0] - low[0]), (h - 64) / (high[1] - low[1]));
    return { scale: Number.isFinite(scale) ? scale : 0.4 * Math.min(w, h) / size, x: (low[0] + high[0]) / 2, y: (low[1] + high[1]) / 2 };
  }
  const near = (q) => 1 / (1 - q[2] / (5 * size)); // perspective
  function placing(w, h) {
    fit ??= fitted(w, h);
    const see = eye.see(centre), scale = fit.scale * eye.cam.zoom, q = [0, 0, 0];
    return (p, i) => {
      see(p, 3 * i, q);
      return [w / 2 + scale * (near(q) * q[0] - fit.x), h / 2 + 8 - scale * (near(q) * q[1] - fit.y), q[2] / size];
    };
  }

  // ---- the loops of a frame --------------------------------------------------------------------------------------
  const bars = () => Array.from(state()?.diagram.births ?? [], (_, bar) => bar), idOf = (bar, s = state()) => s.loops.find((loop) => loop.bar === bar)?.id;
  const ink = (bar) => (idOf(bar) === undefined ? css("--soft") : paint(idOf(bar))), nameOf = (bar, s = state()) => (idOf(bar, s) === undefined ? `bar ${bar}` : `loop ${idOf(bar, s)}`);
  const odds = (e) => (e > 0 ? `${Math.round(Math.exp(e))} : 1` : `1 : ${Math.round(Math.exp(-e))}`);
  function verdict(bar) { // of the tracker's evidence, which for one frame is between -3 and 2
    const e = state().evidence[bar], since = film() && states.findIndex((s) => s?.loops.some((loop) => loop.id === idOf(bar)));
    const alone = e >= 2 ? "yes, clearly" : e > -3 ? `${e > 0 ? "yes" : "hardly"}, ${odds(e)}` : "no";
    return idOf(bar) !== undefined && film() ? `${alone}; since frame ${since}` : alone;
  }
  function choose(bar) {
    if (!(bar in bars())) return;
    chosen = { id: idOf(bar) ?? null, bar };
    $("rows").children[bar]?.scrollIntoView({ block: "nearest" });
    later();
  }
  const step = (by) => choose(clamp(chosen.bar + by, 0, bars().length - 1));
  function at(t) { // go to a frame; the chosen loop stays chosen
    frame = clamp(Math.round(t), 0, source.frames.length - 1);
    const found = state()?.loops.find((loop) => loop.id === chosen.id)?.bar;
    chosen.bar = found ?? clamp(chosen.bar, 0, Math.max(0, bars().length - 1));
    if (chosen.id === null && state()?.diagram.births.length) chosen.id = idOf(chosen.bar) ?? null;
    edges = null;
    rows();
    later();
  }
  function rows() {
    const digits = clamp(2 - Math.floor(Math.log10(end)), 0, 12), show = (v) => v.toFixed(digits);
    $("rows").replaceChildren(...bars().map((bar) => {
      const { births, deaths } = state().diagram, row = document.createElement("tr"), button = document.createElement("button");
      [button.type, button.textContent] = ["button", nameOf(bar)];
      button.style.setProperty("--dot", ink(bar));
      for (const text of ["", show(deaths[bar] - births[bar]), show(births[bar]), show(deaths[bar]), verdict(bar)]) row.insertCell().textContent = text;
      row.cells[0].append(button);
      row.onclick = () => choose(bar);
      return row;
    }));
  }

  // ---- the complex up to the radius ------------------------------------------------------------------------------
  const MOST_EDGES = 30000, MOST_TRIANGLES = 20000;
  let edges = null;
  function sorted() { // the edges of the frame, the shortest first, up to the end of the slider
    const cloud = clouds[frame], n = cloud.length / 3, list = [];
    for (let i = 0; i < n; i++) for (let j = i + 1; j < n; j++) {
      const value = Math.hypot(cloud[3 * i] - cloud[3 * j], cloud[3 * i + 1] - cloud[3 * j + 1], cloud[3 * i + 2] - cloud[3 * j + 2]) / 2;
      if (value <= end) list.push([value, i, j]);
    }
    return list.sort((p, q) => p[0] - q[0]);
  }
  function drawComplex(g, S, n) {
    edges ??= sorted();
    const joined = new Uint8Array(n * n), drawn = [], counts = { edges: 0, triangles: 0 };
    for (const [value, i, j] of edges) {
      if (value > radius || counts.edges === MOST_EDGES) break;
      counts.edges++;
      for (let k = 0; k < n && counts.triangles < MOST_TRIANGLES; k++) if (joined[i * n + k] && joined[j * n + k]) (counts.triangles++, drawn.push([i, j, k]));
      joined[i * n + j] = joined[j * n + i] = 1;
    }
    g.fillStyle = fade(dark ? "#5b6b7b" : "#b9c5d1", counts.triangles > 2000 ? 0.1 : 0.35);
    for (let from = 0; from < drawn.length; from += 50) { // one path for many, all turned the same way, so that none cuts a hole into another
      g.beginPath();
      for (const [i, j, k] of drawn.slice(from, from + 50)) {
        const left = (S[j][0] - S[i][0]) * (S[k][1] - S[i][1]) > (S[j][1] - S[i][1]) * (S[k][0] - S[i][0]);
        (left ? [i, j, k] : [i, k, j]).forEach((v, m) => (m ? g.lineTo(S[v][0], S[v][1]) : g.moveTo(S[v][0], S[v][1])));
        g.closePath();
      }
      g.fill();
    }
    pen(g, fade(dark ? "#9fadbc" : "#5d6b7a", clamp(1500 / counts.edges, 0.05, 0.45)), 0.8);
    g.beginPath();
    for (const [, i, j] of edges.slice(0, counts.edges)) (g.moveTo(S[i][0], S[i][1]), g.lineTo(S[j][0], S[j][1]));
    g.stroke();
    const more = (count, most) => (count === most ? "the first " : "") + count.toLocaleString("en");
    return `r = ${radius.toPrecision(3)}: ${more(counts.edges, MOST_EDGES)} edges, ${more(counts.triangles, MOST_TRIANGLES)} triangles`;
  }

  // ---- pictures --------------------------------------------------------------------------------------------------
  function drawScene() {
    const [g, w, h] = start(scene), place = placing(w, h), { around } = source.frames[frame], cloud = clouds[frame], n = cloud.length / 3;
    const S = Array.from({ length: n }, (_, i) => place(cloud, i)), grey = dark ? "#9fadbc" : "#5d6b7a";
    if (around.length > cloud.length) {
      g.fillStyle = fade(grey, 0.3);
      for (let i = 0; i < around.length / 3; i++) {
        const [x, y] = place(around, i);
        g.fillRect(x - 0.7, y - 0.7, 1.4, 1.4);
      }
    }
    const counted = radius > 0 ? drawComplex(g, S, n) : "";
    for (const p of [...S].sort((a, b) => a[2] - b[2])) dot(g, p, clamp(2.4 + 1.2 * p[2], 1.2, 4), fade(css("--ink").trim(), clamp(0.7 + 0.3 * p[2], 0.35, 1)));
    const flat = (ids) => Array.from(ids, (v) => S[v]), names = [];
    for (const bar of bars().reverse()) {
      const strong = bar === chosen.bar, colour = ink(bar), { killerTriangles, killerEdges } = state().diagram;
      if (!strong && idOf(bar) === undefined) continue;
      const panes = [6 * bar + 3, 6 * bar].map((k) => flat(killerTriangles.subarray(k, k + 3)));
      for (const pane of panes) trace(g, pane, fade(colour.trim(), strong ? 0.95 : 0.5), strong ? 1.6 : 1, { close: true, fill: fade(colour.trim(), strong ? 0.42 : 0.15) });
      if (strong) {
        const way = flat(walkOf(bar));
        for (const [style, width] of [[css("--panel"), 6], [colour, 3]]) trace(g, way, style, width, { close: true });
        for (const [style, width] of [[css("--panel"), 7], [colour, 4.5]]) trace(g, flat(killerEdges.subarray(2 * bar, 2 * bar + 2)), style, width, { dash: [7, 5] });
      }
      names.push([Math.max(...panes.flat().map((p) => p[0])) + 8, sumOf(panes.flat().map((p) => p[1])) / 6, bar]);
    }
    let free = -Infinity;
    for (const [x, y, bar] of names.sort((a, b) => a[1] - b[1])) { // none above another
      free = Math.max(y, free + 17);
      g.fillStyle = css("--ink");
      g.font = `${bar === chosen.bar ? "bold " : ""}13px system-ui, sans-serif`;
      g.textBaseline = "middle";
      word(g, nameOf(bar), Math.min(x, w - 50), free);
    }
    return counted;
  }
  const sumOf = (list) => list.reduce((total, v) => total + v, 0), walks = new WeakMap();
  function walkOf(bar) { // the cycle of a bar, found when it is first asked for
    const known = walks.get(state()) ?? walks.set(state(), []).get(state());
    return (known[bar] ??= cycle(clouds[frame], clouds[frame].length / 3, 3, state().diagram, bar));
  }
  let dots = [];
  function drawDiagram() {
    const { births = [], deaths = [] } = state()?.diagram ?? {}, wide = Math.min(end, Math.max(end / 3, 1.4 * births.reduce((m, v) => Math.max(m, v), 0)));
    const [g, X, Y] = axes(diagram, wide, end, "diagram: death against birth", "birth");
    pen(g, css("--soft"), 1.2);
    line(g, X(0), Y(0), X(wide), Y(wide));
    if (radius > 0) {
      pen(g, css("--ink"), 1.2);
      line(g, X(0), Y(radius), X(Math.min(radius, wide)), Y(radius), [3, 3]);
      if (radius < wide) line(g, X(radius), Y(radius), X(radius), Y(end), [3, 3]);
    }
    dots = bars().map((bar) => [X(births[bar]), Y(deaths[bar])]);
    for (const bar of bars().reverse()) dot(g, dots[bar], idOf(bar) === undefined ? 3.5 : 5.5, ink(bar), css("--panel"), 1);
    if (!(chosen.bar in dots)) return;
    dot(g, dots[chosen.bar], 9, null, css("--ink"), 2);
    g.fillStyle = css("--ink");
    word(g, nameOf(chosen.bar), Math.min(dots[chosen.bar][0] + 13, diagram.clientWidth - 55), Math.max(dots[chosen.bar][1], 36));
  }
  function drawStrip() { // the lifetime of each loop with a name, along the film
    const lifetime = (loop, s) => s.diagram.deaths[loop.bar] - s.diagram.births[loop.bar], all = states.flatMap((s) => s.loops.map((loop) => lifetime(loop, s)));
    const [g, X, Y, box] = axes(strip, source.frames.length - 1, 1.1 * Math.max(...all, 1e-12), "lifetime of each loop", "frame");
    for (const id of new Set(states.flatMap((s) => s.loops.map((loop) => loop.id)))) {
      pen(g, paint(id), id === chosen.id ? 3.5 : 2);
      g.beginPath();
      let on = false;
      states.forEach((s, t) => {
        const loop = s.loops.find((each) => each.id === id);
        if (loop) on ? g.lineTo(X(t), Y(lifetime(loop, s))) : (g.moveTo(X(t) - 1, Y(lifetime(loop, s))), g.lineTo(X(t), Y(lifetime(loop, s))));
        on = loop !== undefined;
      });
      g.stroke();
    }
    pen(g, css("--ink"), 1.5);
    line(g, X(frame), box.y - 4, X(frame), box.y + box.h);
  }
  function draw() {
    if (!source) return;
    const counted = drawScene(), loops = state()?.loops.length ?? 0, n = clouds[frame].length / 3, whole = source.frames[frame];
    drawDiagram();
    if (film()) drawStrip();
    [...$("rows").children].forEach((row, bar) => {
      row.className = bar === chosen.bar ? "chosen" : "";
      const button = row.querySelector("button");
      button.setAttribute("aria-pressed", bar === chosen.bar);
      button.tabIndex = bar === chosen.bar ? 0 : -1; // one stop of the Tab key for the whole table
    });
    const covering = n < whole.count ? [`covering radius ${whole.radii[n - 1].toPrecision(3)}`] : [], found = state() ? [many(loops, "loop"), many(bars().length, "bar")] : [];
    const text = [...(film() ? [`frame ${frame} of ${source.frames.length - 1}`] : []), `${n.toLocaleString("en")} of ${many(whole.count, "point")}`, ...covering, ...found, ...(counted ? [counted] : []), ...(took ? [`computed in ${(took / 1000).toFixed(2)} s`] : [])].join(" \u00b7 ");
    tell(text, $("radius"), Math.round((200 * radius) / end));
    $("radius").setAttribute("aria-valuetext", radius.toPrecision(3));
    $("time").value = frame;
    const best = bars().length ? `chosen is ${nameOf(chosen.bar)}: born ${state().diagram.births[chosen.bar].toPrecision(3)}, dies ${state().diagram.deaths[chosen.bar].toPrecision(3)}, ${verdict(chosen.bar)}` : "no bars";
    describe(scene, `The cloud: ${text}; ${best}. ${TURN}; n and p choose a loop${film() ? "; space plays" : ""}.`);
    describe(diagram, `Persistence diagram: ${best}. Click a point, or use the arrow keys, to choose.`);
    describe(strip, `lifetimes of the loops over ${source.frames.length} frames; now frame ${frame}`);
    say($("python"), python());
  }
  // ---- out -------------------------------------------------------------------------------------------------------
  const stem = () => source.names[0].replace(/\.\w+$/, "").replace(/\W+/g, "_");
  function python() { // lines that give the same loops
    const name = `${stem()}.npy`, own = !source.sample && !source.pasted, several = own && source.several && film(), whole = film() && !several;
    const total = (key) => source.frames.some((f) => f.left[key]), least = Math.min(...source.frames.map((f) => f.count)), most = Math.max(...source.frames.map((f) => f.count));
    const steps = [];
    if (own && total("notFinite")) steps.push("points[np.isfinite(points).all(axis=1)]");
    if (own && total("atZero")) steps.push("points[points.any(axis=1)]");
    if (own && total("repeats")) steps.push("points[np.sort(np.unique(points, axis=0, return_index=True)[1])]");
    const cap = Math.min(wanted(), MOST), few = least < cap ? `min(${cap}, len(points))` : cap;
    if (own ? cap < most : false) steps.push(`points[tk.farthest_point_sample(points, ${few})[0]]`);
    if (!film() && state() && state().used.length < clouds[0].length / 3) steps.push("points[inliers(points)]");
    const read = own ? source.python : `np.load(${escaped(name)})`, lines = [];
    if (!own) lines.push(`# "points (.npy)" below saves ${name}`);
    if (several) lines.push(`names = [${source.names.map(escaped).join(", ")}]`, `film = [${read.replaceAll(escaped(source.names.at(-1)), "name").replaceAll(escaped(source.names[0]), "name")} for name in names]`);
    else lines.push(`${whole ? "film" : "points"} = ${read}${!whole && source.whole ? "[0]" : ""}`);
    for (const each of steps) lines.push(film() ? `film = [${each} for points in film]` : `points = ${each}`);
    lines.push(film() ? "states = tk.track(film)" : "diagram = tk.rips_persistence(points)");
    const code = lines.join("\n"), imports = [["np.", "import numpy as np"], ["", "import topokit as tk"], ["trimesh.", "import trimesh"], ["load_episode", "from topokit.io import load_episode"],
      ["inliers", "from topokit.sampling import inliers"], ["read_clouds", "from topokit.sensors import read_clouds"]];
    return [...imports.filter(([word]) => code.includes(word)).map(([, text]) => text), code].join("\n");
  }
  const MOST = 800;
  function loopsOf(t) { // as plain values; ids are rows of the points that are used
    const s = states[t], { births, deaths, birthEdges, killerEdges, killerTriangles } = s.diagram;
    return Array.from(births, (birth, bar) => ({ name: nameOf(bar, s), birth, death: deaths[bar], lifetime: deaths[bar] - birth, evidence: s.evidence[bar],
      birth_edge: [...birthEdges.slice(2 * bar, 2 * bar + 2)], killer_edge: [...killerEdges.slice(2 * bar, 2 * bar + 2)],
      killer_triangles: [0, 3].map((k) => [...killerTriangles.slice(6 * bar + k, 6 * bar + k + 3)]) }));
  }
  const ready = () => Object.keys(states).map(Number), rowsOf = (cloud) => Array.from({ length: cloud.length / 3 }, (_, i) => [...cloud.slice(3 * i, 3 * i + 3)]);
  function asJson() {
    const frames = ready().map((t) => ({ frame: t, points: rowsOf(clouds[t]), loops: loopsOf(t) }));
    for (const loop of frames.find((each) => each.frame === frame)?.loops ?? []) loop.cycle = [...walkOf(frames.find((each) => each.frame === frame).loops.indexOf(loop))];
    return JSON.stringify({ source: source.names, left_out: source.frames.map((f) => f.left), frames }, null, 1);
  }
  function asCsv() {
    const lines = ready().flatMap((t) => loopsOf(t).map((l) => [t, l.name, l.birth, l.death, l.lifetime, l.evidence].join()));
    return ["frame,name,birth,death,lifetime,evidence", ...lines, ""].join("\n");
  }
  function asNpy() { // (n, 3), or (T, n, 3) for a film; each frame in full where a sample is saved
    const parts = source.sample || source.pasted ? clouds : [clouds[frame]], columns = source.columns, rows = parts[0].length / 3;
    const same = parts.every((cloud) => cloud.length === parts[0].length) ? parts : [clouds[frame]];
    const shape = same.length > 1 ? `(${same.length}, ${rows}, ${columns})` : `(${rows}, ${columns})`, head = `{'descr': '<f8', 'fortran_order': False, 'shape': ${shape}, }`;
    const text = head.padEnd(Math.ceil((head.length + 11) / 64) * 64 - 11) + "\n", room = text.length;
    const bytes = [0x93, ...[..."NUMPY"].map((c) => c.charCodeAt(0)), 1, 0, room & 255, room >> 8, ...[...text].map((c) => c.charCodeAt(0))];
    return new Blob([Uint8Array.from(bytes), ...same.map((cloud) => cloud.filter((_, i) => i % 3 < columns))]);
  }
  function save(name, content) {
    const address = URL.createObjectURL(content instanceof Blob ? content : new Blob([content])), link = Object.assign(document.createElement("a"), { href: address, download: name });
    link.click();
    setTimeout(() => URL.revokeObjectURL(address), 10000);
  }
  function picture() { // the scene on its ground
    const copy = Object.assign(document.createElement("canvas"), { width: scene.width, height: scene.height }), g = copy.getContext("2d");
    g.fillStyle = css("--panel");
    g.fillRect(0, 0, copy.width, copy.height);
    g.drawImage(scene, 0, 0);
    copy.toBlob((blob) => save(`${stem()}.png`, blob));
  }
  const outside = () => { // the window whose address a reader sees
    try {
      return parent.document ? parent : window;
    } catch {
      return window; // the page around us is of another origin
    }
  };
  function address() {
    const view = { sample: source.sample, points: wanted(), frame, bar: chosen.bar, radius, ...eye.cam };
    return `${outside().location.href.split("#")[0]}#${new URLSearchParams(view)}`;
  }
  function restore() { // the view of a link, or else the first sample
    const asked = new URLSearchParams(outside().location.hash.slice(1)), number = (key, low, high) => (Number.isFinite(parseFloat(asked.get(key))) ? clamp(parseFloat(asked.get(key)), low, high) : undefined);
    const known = names.includes(asked.get("sample")), cam = Object.fromEntries([["az", -100, 100], ["el", -1.5, 1.5], ["zoom", 0.4, 8]].map(([key, low, high]) => [key, number(key, low, high)]).filter(([, v]) => v !== undefined));
    if (!known) return sample(names[0]);
    sample(asked.get("sample"), { points: number("points", 50, MOST), frame: number("frame", 0, 1e6), bar: number("bar", 0, 1e6), radius: number("radius", 0, 1e9), cam });
  }

  // ---- hands -----------------------------------------------------------------------------------------------------
  async function copy(text, button, was = button.textContent) {
    try {
      await navigator.clipboard.writeText(text);
      button.textContent = "copied";
      setTimeout(() => (button.textContent = was), 1500);
    } catch { // where the browser does not let a page write there, the text is chosen, to be copied by hand
      getSelection().selectAllChildren(button.id === "copy" ? $("python") : $("address"));
    }
  }
  const packed = Object.keys(data.samples), films = packed.filter((name) => data.samples[name].ticks.shape.length > 2);
  const names = [...packed.filter((name) => !films.includes(name)), ...Object.keys(COMPUTED), ...films];
  $("sample").append(...names.map((name) => new Option(name)));
  $("sample").onchange = (e) => sample(e.target.value);
  $("choose").onclick = () => $("files").click();
  $("files").onchange = (e) => (take(e.target.files), (e.target.value = ""));
  $("paste").onclick = () => {
    $("pasting").hidden = !$("pasting").hidden;
    $("paste").setAttribute("aria-expanded", !$("pasting").hidden);
    if (!$("pasting").hidden) $("numbers").focus();
  };
  $("pasting").onsubmit = (e) => (e.preventDefault(), paste());
  $("stop").onclick = () => (busy++, worker.stop(), ($("busy").hidden = true));
  $("radius").oninput = (e) => ((radius = (e.target.value / 200) * end), later());
  $("points").oninput = () => source && compute();
  const play = playback(() => frame, at, () => source.frames.length - 1, 6);
  $("time").oninput = (e) => (play(false), at(+e.target.value));
  $("before").onclick = () => (play(false), at(frame - 1));
  $("next").onclick = () => (play(false), at(frame + 1));
  scrub(strip, (share) => (play(false), at(share * (source.frames.length - 1))));
  diagram.onclick = (e) => {
    const away = dots.map(([x, y]) => Math.hypot(x - e.offsetX, y - e.offsetY)), nearest = away.indexOf(Math.min(...away));
    if (away[nearest] < 30) choose(nearest);
  };
  keys(diagram, () => ({ ArrowDown: () => step(1), ArrowRight: () => step(1), ArrowUp: () => step(-1), ArrowLeft: () => step(-1) }));
  const walk = (by) => (step(by), $("rows").children[chosen.bar].querySelector("button").focus());
  keys($("rows"), () => ({ ArrowDown: () => walk(1), ArrowUp: () => walk(-1) }));
  onReset(() => (eye.back(), (radius = 0), later()));
  $("copy").onclick = () => copy(python(), $("copy"));
  $("save-points").onclick = () => save(`${stem()}.npy`, asNpy());
  $("save-json").onclick = () => save(`${stem()}.json`, asJson());
  $("save-csv").onclick = () => save(`${stem()}.csv`, asCsv());
  $("save-png").onclick = picture;
  $("link").onclick = () => {
    say($("address"), address());
    copy(address(), $("link"));
  };
  for (const place of new Set([document, outside().document])) { // a file may miss the frame
    place.addEventListener("dragover", (e) => (e.preventDefault(), document.body.classList.add("over")));
    place.addEventListener("dragleave", () => document.body.classList.remove("over"));
    place.addEventListener("drop", (e) => {
      e.preventDefault();
      document.body.classList.remove("over");
      take(e.dataTransfer.files);
    });
  }

  // ---- start -----------------------------------------------------------------------------------------------------
  document.querySelector("main").prepend($("intake"));
  watch(later, () => {
    fit = null;
    try {
      if (frameElement) frameElement.style.height = document.querySelector("main").offsetHeight + "px";
    } catch { /* the page around us is of another origin */ }
  });
  restore();
})();
