// Loops of the reader's own cloud: files, numbers or a sample in; the cloud in space, its diagram and a table of its loops out.
// Idea: a source is a film, of one frame for a cloud. Its frames come in the order of farthest points, so that any number of points is a
// prefix. The worker reads and tracks; each answer replaces `states`. All else draws `states` at a frame, a radius and a loop.
(() => {
  const [scene, diagram, strip] = [$("scene"), $("diagram"), $("strip")];
  const { cycle } = ripsKernel(), { thinned } = fileReaders(), worker = kernelWorker([fileReaders, cloudCuts]), later = lazily(draw);
  const eye = orbit(scene, [-60, 20], later, { n: () => step(1), p: () => step(-1), " ": () => isFilm() && play() });
  let source = null, clouds = [], states = []; // what was read; the points that are used, and the tracker's states, a frame each
  let frame = 0, radius = 0, chosen = { id: null, bar: 0 }; // what is shown
  let task = 0, seconds = 0;
  const isFilm = () => source !== null && source.frames.length > 1, last = () => source.frames.length - 1;
  const many = (count, what) => `${count.toLocaleString("en")} ${what}${count === 1 ? "" : "s"}`;
  const sum = (list) => list.reduce((total, value) => total + value, 0);
  function say(place, text) {
    place.textContent = text;
    place.hidden = !text;
  }

  // ---- the worker ------------------------------------------------------------------------------------------------
  async function working(what, run) { // with progress and a button that stops it; a later task ends an earlier one
    const mine = ++task, stands = () => mine === task;
    if (!$("busy").hidden) worker.stop();
    $("busy").hidden = false;
    $("stop").textContent = `stop ${what}`;
    $("done").value = 0;
    try {
      return await run((share) => stands() && ($("done").value = share), stands);
    } catch (error) {
      if (stands() && error.message !== "stopped") say($("errors"), error.message);
      return null;
    } finally {
      if (stands()) $("busy").hidden = true;
    }
  }
  function stop() {
    task++;
    worker.stop();
    $("busy").hidden = true;
  }
  const wanted = () => +$("points").value;
  const cut = ({ all, order, count }) => (all && wanted() >= count ? all : order.subarray(0, 3 * wanted()));
  function compute() { // the frame that is shown at once, then the film
    const began = performance.now();
    clouds = source.frames.map(cut);
    return working("tracking", async (report, stands) => {
      const [only] = await worker.run("track", [[clouds[frame]], 3, {}], isFilm() ? undefined : report);
      if (!stands()) return;
      states = [];
      states[frame] = only;
      arrived();
      if (isFilm()) {
        const all = await worker.run("track", [clouds, 3, {}], report);
        if (!stands()) return;
        states = all;
      }
      seconds = (performance.now() - began) / 1000;
      arrived();
    });
  }
  function arrived() {
    end = 1.1 * states.reduce((most, { diagram: { deaths } }) => deaths.reduce((m, death) => Math.max(m, death), most), 0) || size;
    radius = Math.min(radius, end);
    at(frame);
    hint();
  }

  // ---- in --------------------------------------------------------------------------------------------------------
  function open(given, view = {}) { // a film as `readFilm` returns it
    say($("errors"), given.errors.join("\n"));
    if (!given.frames.length) return;
    play(false);
    source = given;
    states = [];
    seconds = 0;
    say($("hint"), "");
    $("rows").replaceChildren();
    frame = clamp(view.frame ?? 0, 0, last());
    radius = 0;
    chosen = { id: null, bar: view.bar ?? 0 };
    if (view.points) $("points").value = view.points;
    $("points").disabled = Math.max(...given.frames.map(({ count }) => count)) <= +$("points").min;
    $("film").hidden = strip.parentElement.hidden = !isFilm();
    $("time").max = last();
    $("sample").selectedIndex = names.indexOf(given.sample);
    $("link").disabled = !given.sample || isCut();
    say($("address"), "");
    say($("told"), told());
    fillColumns();
    fillCuts();
    measure();
    eye.back();
    if (given.columns === 2) Object.assign(eye.cam, { az: -Math.PI / 2, el: 1.5 });
    Object.assign(eye.cam, view.cam);
    compute().then(() => {
      radius = clamp(view.radius ?? radius, 0, end);
      later();
    });
  }
  function told() { // what was read, and what of it was left out
    const { frames, names: files, sample: isSample } = source, total = (key) => sum(frames.map(({ left }) => left[key]));
    const reasons = { notFinite: "not finite", atZero: "at zero, where a camera saw nothing", repeats: "repeated", outside: "outside the box", onPlane: isFilm() || planes().length > 1 ? "on planes" : "on a plane" };
    const left = Object.keys(reasons).filter(total).map((key) => `${total(key).toLocaleString("en")} ${reasons[key]}`);
    const what = files.length > 1 ? `${files[0]} to ${files.at(-1)}` : files[0], sizes = [many(total("rows"), "point")];
    if (isFilm()) sizes.unshift(many(frames.length, "frame"));
    return `${isSample ? "sample: " : ""}${what}: ${sizes.join(", ")}${left.length ? `; left out: ${left.join(", ")}` : ""}`;
  }
  async function take(files, more = {}, options = {}, view = {}) {
    const list = [...files], given = list.length && (await working("reading", (report) => worker.run("readFilm", [list, options], report)));
    if (given) open(Object.assign(given, more, { files: list, options }), view);
  }
  const axisOf = (k) => $("columns").querySelector(`[data-axis="${k}"]`);
  function fillColumns() { // of a table: those that were taken, and the reader's choice
    const { table } = source;
    $("columns").hidden = !table;
    if (!table) return;
    const taken = table.kept.map((c) => c + 1).join(", ").replace(/, (\d+)$/, " and $1");
    $("taken").textContent = `${many(table.labels.length, "column")}${table.counts ? ", of which the first counts the rows" : ""}; the place is in ${taken}:`;
    for (const k of [0, 1, 2]) {
      axisOf(k).replaceChildren(...table.labels.map((label, c) => new Option(label, c)), ...(k === 2 ? [new Option("none: a plane", "")] : []));
      axisOf(k).value = table.kept[k] ?? "";
    }
  }
  function sample(name, view = {}, options = {}) { // computed here, or handed over with the page
    const packed = data.samples[name];
    let parts = [COMPUTED[name]?.()];
    if (packed) {
      const numbers = Float64Array.from(unpack(packed.ticks), (v, i) => (v + packed.low[i % 3]) / 1e4), wide = 3 * packed.ticks.shape.at(-2);
      parts = Array.from({ length: numbers.length / wide }, (_, t) => numbers.slice(wide * t, wide * (t + 1)));
    }
    try {
      const frames = parts.map((numbers) => thinned(numbers, 3, parts.length, "", options));
      open({ names: [name], frames, errors: [], columns: 3, sample: name, parts, options }, view);
    } catch (error) {
      say($("errors"), error.message);
    }
  }

  // ---- parts taken away --------------------------------------------------------------------------------------------
  const STEPS = 200, planes = () => source.options.planes ?? [], isCut = () => Boolean(source.options.crop) || planes().length > 0;
  const cropping = () => !$("box").hidden;
  let middle = [[0, 0, 0], [1, 1, 1]]; // of the whole cloud: what the sliders span
  const sliders = ["x", "y", "z"].map((axis, k) => {
    const [place, words] = [document.createElement("span"), document.createElement("output")], pair = [0, 1].map((side) => {
      const slider = Object.assign(document.createElement("input"), { type: "range", max: STEPS });
      slider.setAttribute("aria-label", `${axis}, ${side ? "highest" : "lowest"}`);
      slider.oninput = () => {
        slider.value = side ? Math.max(slider.value, +pair[0].value + 1) : Math.min(slider.value, pair[1].value - 1);
        tellLimits(k);
        later();
      };
      slider.onchange = () => again({ ...source.options, crop: boxNow() });
      return slider;
    });
    place.append(axis, ...pair, words);
    $("box").append(place);
    return { place, pair, words };
  });
  function limitOf(k, side) { // null at the end of a slider: no limit
    const value = +sliders[k].pair[side].value, wide = middle[1][k] - middle[0][k];
    if (value === side * STEPS || !wide) return null;
    return +(middle[0][k] + (wide * value) / STEPS).toFixed(clamp(1 - Math.floor(Math.log10(wide / STEPS)), 0, 15));
  }
  function boxNow() {
    const box = [0, 1].map((side) => [0, 1, 2].map((k) => limitOf(k, side)));
    return box.flat().some((limit) => limit !== null) ? box : undefined;
  }
  function tellLimits(k) {
    const [low, high] = [0, 1].map((side) => limitOf(k, side));
    sliders[k].words.textContent = low === null && high === null ? "all" : `${low ?? ""} to ${high ?? ""}`;
    sliders[k].pair.forEach((slider, side) => slider.setAttribute("aria-valuetext", limitOf(k, side) ?? "no limit"));
  }
  function fillCuts() {
    const { options: { crop }, frames, columns } = source;
    middle = [Math.min, Math.max].map((most, side) => [0, 1, 2].map((k) => frames.reduce((m, frame) => most(m, frame.middle[side][k]), side ? -Infinity : Infinity)));
    sliders.forEach(({ place, pair }, k) => {
      place.hidden = k >= columns;
      pair.forEach((slider, side) => {
        const limit = crop?.[side][k] ?? null, wide = middle[1][k] - middle[0][k];
        slider.value = limit === null ? side * STEPS : Math.round((STEPS * (limit - middle[0][k])) / wide);
      });
      tellLimits(k);
    });
    if (!isCut()) $("thickness").value = +(0.01 * Math.hypot(...[0, 1, 2].map((k) => middle[1][k] - middle[0][k]))).toPrecision(1);
    $("plane").disabled = $("thickness").disabled = columns < 3;
    $("whole").disabled = !isCut();
  }
  function again(options) { // the same source with other cuts, seen from where it was seen
    const view = { frame, points: wanted(), cam: { ...eye.cam } };
    if (source.sample) sample(source.sample, view, options);
    else take(source.files, { pasted: source.pasted }, options, view);
  }
  async function removePlane() { // of the frame that is shown; from all frames
    const { several, files, names: read, parts, options } = source, asked = { ...options, thickness: +$("thickness").value };
    let given = { numbers: parts?.[frame], columns: 3, at: 0 };
    if (files) given = { files, name: read[several ? frame : 0], at: several ? 0 : frame };
    const plane = await working("looking", () => worker.run("planeOf", [given, asked]));
    if (plane) again({ ...options, planes: [...planes(), plane] });
  }
  function hint() { // where the loops of a scene are likely hidden by what is around them
    const { count } = source.frames[frame], none = state()?.loops.length === 0 && count > clouds[frame].length / 3 && !source.sample;
    const words = isCut() ? "Still no loop? Take away the next plane, crop closer, or use more points." : "No loop? Crop, or remove the plane.";
    say($("hint"), none ? words : "");
  }
  function drawBox(g, place) {
    const ends = [0, 1].map((side) => [0, 1, 2].map((k) => limitOf(k, side) ?? middle[side][k]));
    const corners = Float64Array.from({ length: 24 }, (_, i) => ends[(Math.floor(i / 3) >> (i % 3)) & 1][i % 3]);
    pen(g, css("--accent"), 1.5);
    for (let v = 0; v < 8; v++) {
      for (const bit of [1, 2, 4]) if (!(v & bit)) line(g, ...place(corners, v).slice(0, 2), ...place(corners, v | bit).slice(0, 2));
    }
  }

  // ---- where things are seen ---------------------------------------------------------------------------------------
  let centre = [0, 0, 0], size = 1, end = 1, fit = null; // end: of the radii that are shown
  const seenPoints = () => source.frames.flatMap(({ order, off }) => (cropping() ? [order, off] : [order]));
  function measure() { // the ball around all frames
    const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
    for (const points of seenPoints()) {
      for (let i = 0; i < points.length; i++) {
        low[i % 3] = Math.min(low[i % 3], points[i]);
        high[i % 3] = Math.max(high[i % 3], points[i]);
      }
    }
    centre = low.map((v, k) => (v + high[k]) / 2);
    size = Math.hypot(...low.map((v, k) => high[k] - v)) / 2 || 1;
    fit = null;
  }
  function seen() { // from space to (right, up) in perspective, and the depth, each in the cloud's size
    const see = eye.see(centre), q = [0, 0, 0];
    return (p, i) => {
      see(p, i, q);
      const near = 1 / (size * (1 - q[2] / (5 * size)));
      return [near * q[0], near * q[1], q[2] / size];
    };
  }
  function fitted(w, h) { // one scale for the whole film, so that playing and turning do not make the picture breathe
    const low = [Infinity, Infinity], high = [-Infinity, -Infinity], to = seen();
    for (const points of seenPoints()) {
      for (let i = 0; i < points.length; i += 3) {
        const place = to(points, i);
        for (const k of [0, 1]) [low[k], high[k]] = [Math.min(low[k], place[k]), Math.max(high[k], place[k])];
      }
    }
    const scale = Math.min((w - 40) / Math.max(high[0] - low[0], 0.1), (h - 64) / Math.max(high[1] - low[1], 0.1));
    return { scale, x: (low[0] + high[0]) / 2, y: (low[1] + high[1]) / 2 };
  }
  function placing(w, h) { // from a cloud's point to the canvas
    fit ??= fitted(w, h);
    const scale = fit.scale * eye.cam.zoom, to = seen();
    return (cloud, v) => {
      const [x, y, depth] = to(cloud, 3 * v);
      return [w / 2 + scale * (x - fit.x), h / 2 + 8 - scale * (y - fit.y), depth];
    };
  }

  // ---- the loops of a frame --------------------------------------------------------------------------------------
  const state = () => states[frame], bars = () => Array.from(state()?.diagram.births ?? [], (_, bar) => bar), nameOf = (bar) => barName(state(), bar);
  const idOf = (bar) => state().loops.find((loop) => loop.bar === bar)?.id;
  const ink = (bar) => (idOf(bar) === undefined ? css("--soft").trim() : paint(idOf(bar)));
  function verdict(bar) { // the tracker's evidence, of this frame alone: log-odds between -3 and 2
    const e = state().evidence[bar], odds = Math.round(Math.exp(Math.abs(e)));
    let words = "no";
    if (e >= 2) words = "yes, clearly";
    else if (e > 0) words = `yes, ${odds} : 1`;
    else if (e > -3) words = `hardly, 1 : ${odds}`;
    if (!isFilm() || idOf(bar) === undefined) return words;
    return `${words}; since frame ${states.findIndex((s) => s?.loops.some(({ id }) => id === idOf(bar)))}`;
  }
  function choose(bar) {
    if (!(bar in bars())) return;
    chosen = { id: idOf(bar) ?? null, bar };
    const box = $("rows").closest("figure"), row = $("rows").children[bar]; // scrolled by hand: the page around stays where it is
    box.scrollTop = clamp(box.scrollTop, row.offsetTop + row.offsetHeight - box.clientHeight, row.offsetTop - row.offsetHeight);
    later();
  }
  const step = (by) => choose(clamp(chosen.bar + by, 0, bars().length - 1));
  function at(t) { // go to a frame; a loop that is followed stays chosen
    frame = clamp(Math.round(t), 0, last());
    const found = state()?.loops.find(({ id }) => id === chosen.id)?.bar;
    chosen.bar = found ?? clamp(chosen.bar, 0, Math.max(0, bars().length - 1));
    if (chosen.id === null && bars().length) chosen.id = idOf(chosen.bar) ?? null;
    edges = null;
    fillTable();
    later();
  }
  function fillTable() {
    const { births, deaths } = state()?.diagram ?? {}, digits = clamp(2 - Math.floor(Math.log10(end)), 0, 12);
    $("rows").replaceChildren(...bars().map((bar) => {
      const row = document.createElement("tr"), button = document.createElement("button");
      button.type = "button";
      button.textContent = nameOf(bar);
      button.style.setProperty("--dot", ink(bar));
      row.insertCell().append(button);
      for (const value of [deaths[bar] - births[bar], births[bar], deaths[bar]]) row.insertCell().textContent = value.toFixed(digits);
      row.insertCell().textContent = verdict(bar);
      row.onclick = () => choose(bar);
      return row;
    }));
  }
  function markRow() {
    [...$("rows").children].forEach((row, bar) => {
      const button = row.querySelector("button"), on = bar === chosen.bar;
      row.className = on ? "chosen" : "";
      button.style.setProperty("--dot", ink(bar)); // the theme may have changed
      button.setAttribute("aria-pressed", on);
      button.tabIndex = on ? 0 : -1; // one stop of the Tab key for the whole table
    });
  }
  const walks = new WeakMap();
  function cycleOf(bar) { // found when it is first asked for
    if (!walks.has(state())) walks.set(state(), []);
    return (walks.get(state())[bar] ??= cycle(clouds[frame], clouds[frame].length / 3, 3, state().diagram, bar));
  }

  // ---- the complex up to the radius ------------------------------------------------------------------------------
  const MOST_EDGES = 30000, MOST_TRIANGLES = 20000;
  let edges = null; // of the frame up to the end of the slider, the shortest first: [half length, i, j]
  function sortedEdges() {
    const cloud = clouds[frame], n = cloud.length / 3, list = [];
    for (let i = 0; i < n; i++) for (let j = i + 1; j < n; j++) {
      const value = Math.hypot(cloud[3 * i] - cloud[3 * j], cloud[3 * i + 1] - cloud[3 * j + 1], cloud[3 * i + 2] - cloud[3 * j + 2]) / 2;
      if (value <= end) list.push([value, i, j]);
    }
    return list.sort((p, q) => p[0] - q[0]);
  }
  function drawComplex(g, S) { // says how much of it is drawn
    edges ??= sortedEdges();
    const n = S.length, joined = new Uint8Array(n * n), triangles = [];
    let count = 0;
    for (const [value, i, j] of edges) {
      if (value > radius || count === MOST_EDGES) break;
      count++;
      for (let k = 0; k < n && triangles.length < MOST_TRIANGLES; k++) if (joined[i * n + k] && joined[j * n + k]) triangles.push([i, j, k]);
      joined[i * n + j] = joined[j * n + i] = 1;
    }

    // One path for fifty triangles, all turned the same way, so that none cuts a hole into another.
    g.fillStyle = fade(dark ? "#5b6b7b" : "#b9c5d1", triangles.length > 2000 ? 0.1 : 0.35);
    for (let from = 0; from < triangles.length; from += 50) {
      g.beginPath();
      for (const [i, j, k] of triangles.slice(from, from + 50)) {
        const left = (S[j][0] - S[i][0]) * (S[k][1] - S[i][1]) > (S[j][1] - S[i][1]) * (S[k][0] - S[i][0]);
        g.moveTo(S[i][0], S[i][1]);
        for (const v of left ? [j, k] : [k, j]) g.lineTo(S[v][0], S[v][1]);
        g.closePath();
      }
      g.fill();
    }
    pen(g, fade(dark ? "#9fadbc" : "#5d6b7a", clamp(1500 / count, 0.05, 0.45)), 0.8);
    g.beginPath();
    for (const [, i, j] of edges.slice(0, count)) {
      g.moveTo(S[i][0], S[i][1]);
      g.lineTo(S[j][0], S[j][1]);
    }
    g.stroke();
    const drawn = (number, most, what) => (number === most ? `the first ${many(number, what)}` : many(number, what));
    return `r = ${radius.toPrecision(3)}: ${drawn(count, MOST_EDGES, "edge")}, ${drawn(triangles.length, MOST_TRIANGLES, "triangle")}`;
  }

  // ---- pictures --------------------------------------------------------------------------------------------------
  function drawScene() {
    const [g, w, h] = start(scene), place = placing(w, h), cloud = clouds[frame], { around, off } = source.frames[frame];
    const S = Array.from({ length: cloud.length / 3 }, (_, v) => place(cloud, v));
    for (const [points, strength] of [[cropping() ? off : [], 0.12], [around.length > cloud.length ? around : [], 0.3]]) {
      g.fillStyle = fade(dark ? "#9fadbc" : "#5d6b7a", strength);
      for (let v = 0; v < points.length / 3; v++) {
        const [x, y] = place(points, v);
        g.fillRect(x - 0.7, y - 0.7, 1.4, 1.4);
      }
    }
    if (cropping()) drawBox(g, place);
    const complex = radius > 0 ? drawComplex(g, S) : "";
    for (const p of [...S].sort((a, b) => a[2] - b[2])) { // what is near is plainer
      dot(g, p, clamp(2.4 + 1.2 * p[2], 1.2, 4), fade(css("--ink").trim(), clamp(0.7 + 0.3 * p[2], 0.35, 1)));
    }
    drawLoops(g, w, S);
    return complex;
  }
  function drawLoops(g, w, S) { // killer triangles of all loops with names; of the chosen one the cycle and the killer edge too
    const places = (ids) => Array.from(ids, (v) => S[v].slice(0, 2)), tags = [];
    for (const bar of bars().reverse()) {
      const strong = bar === chosen.bar, colour = ink(bar), { killerTriangles, killerEdges } = state().diagram;
      if (!strong && idOf(bar) === undefined) continue;
      const panes = [6 * bar + 3, 6 * bar].map((k) => places(killerTriangles.subarray(k, k + 3)));
      for (const pane of panes) trace(g, pane, fade(colour, strong ? 0.95 : 0.5), strong ? 1.6 : 1, { close: true, fill: fade(colour, strong ? 0.42 : 0.15) });
      if (strong) {
        const killer = places(killerEdges.subarray(2 * bar, 2 * bar + 2)), around = places(cycleOf(bar));
        trace(g, around, css("--panel"), 6, { close: true });
        trace(g, around, colour, 3, { close: true });
        trace(g, killer, css("--panel"), 7);
        trace(g, killer, colour, 4.5, { dash: [7, 5] });
      }
      const corners = panes.flat();
      tags.push([Math.max(...corners.map((p) => p[0])) + 8, sum(corners.map((p) => p[1])) / 6, bar]);
    }
    let free = -Infinity; // names last, none above another
    for (const [x, y, bar] of tags.sort((a, b) => a[1] - b[1])) {
      free = Math.max(y, free + 17);
      g.fillStyle = css("--ink");
      g.font = `${bar === chosen.bar ? "bold " : ""}13px system-ui, sans-serif`;
      g.textBaseline = "middle";
      word(g, nameOf(bar), Math.min(x, w - 50), free);
    }
  }
  let dots = []; // places of the bars in the diagram
  function drawDiagram() {
    const { births = [], deaths = [] } = state()?.diagram ?? {}, latest = births.reduce((most, birth) => Math.max(most, birth), 0);
    const wide = Math.min(end, Math.max(end / 3, 1.4 * latest)), [g, X, Y] = axes(diagram, wide, end, "diagram: death against birth", "birth");
    pen(g, css("--soft"), 1.2);
    line(g, X(0), Y(0), X(wide), Y(wide));
    if (radius > 0) { // what is alive at the radius is in the corner above and to the left
      pen(g, css("--ink"), 1.2);
      line(g, X(0), Y(radius), X(Math.min(radius, wide)), Y(radius), [3, 3]);
      if (radius < wide) line(g, X(radius), Y(radius), X(radius), Y(end), [3, 3]);
    }
    dots = bars().map((bar) => [X(births[bar]), Y(deaths[bar])]);
    for (const bar of bars().reverse()) dot(g, dots[bar], idOf(bar) === undefined ? 3.5 : 5.5, ink(bar), css("--panel"), 1);
    if (!(chosen.bar in dots)) return;
    const [x, y] = dots[chosen.bar];
    dot(g, [x, y], 9, null, css("--ink"), 2);
    g.fillStyle = css("--ink");
    word(g, nameOf(chosen.bar), Math.min(x + 13, diagram.clientWidth - 55), Math.max(y, 36));
  }
  function drawStrip() { // the lifetime of each loop with a name, along the film
    const curves = new Map();
    states.forEach(({ loops, diagram: { births, deaths } }, t) => {
      for (const { id, bar } of loops) {
        if (!curves.has(id)) curves.set(id, []);
        curves.get(id).push([t, deaths[bar] - births[bar]]);
      }
    });
    const tall = Math.max(1e-12, ...[...curves.values()].flat().map(([, lifetime]) => lifetime));
    const [g, X, Y, box] = axes(strip, last(), 1.1 * tall, "lifetime of each loop", "frame");
    for (const [id, curve] of curves) {
      pen(g, paint(id), id === chosen.id ? 3.5 : 2);
      g.beginPath();
      curve.forEach(([t, lifetime], k) => {
        if (k === 0 || curve[k - 1][0] < t - 1) g.moveTo(X(t) - 1, Y(lifetime)); // it was lost for a while
        g.lineTo(X(t), Y(lifetime));
      });
      g.stroke();
    }
    pen(g, css("--ink"), 1.5);
    line(g, X(frame), box.y - 4, X(frame), box.y + box.h);
  }
  function draw() {
    if (!source) return;
    const complex = drawScene(), n = clouds[frame].length / 3, { count, radii } = source.frames[frame];
    drawDiagram();
    if (isFilm()) drawStrip();
    markRow();
    const parts = [`${n.toLocaleString("en")} of ${many(count, "point")}`];
    if (isFilm()) parts.unshift(`frame ${frame} of ${last()}`);
    if (n < count) parts.push(`covering radius ${radii[n - 1].toPrecision(3)}`);
    if (state()) parts.push(many(state().loops.length, "loop"), many(bars().length, "bar"));
    if (complex) parts.push(complex);
    if (seconds) parts.push(`computed in ${seconds.toFixed(2)} s`);
    const text = parts.join(" \u00b7 ");
    tell(text, $("radius"), Math.round((200 * radius) / end));
    $("radius").setAttribute("aria-valuetext", radius.toPrecision(3));
    $("time").value = frame;
    let best = "no bars";
    if (bars().length) {
      const { births, deaths } = state().diagram, bar = chosen.bar;
      best = `chosen is ${nameOf(bar)}: born ${births[bar].toPrecision(3)}, dies ${deaths[bar].toPrecision(3)}; a loop? ${verdict(bar)}`;
    }
    describe(scene, `The cloud: ${text}; ${best}. ${TURN}; n and p choose a loop${isFilm() ? "; space plays" : ""}.`);
    describe(diagram, `Persistence diagram: ${best}. Click a point, or use the arrow keys, to choose.`);
    describe(strip, `lifetimes of the loops over ${source.frames.length} frames; now frame ${frame}`);
    say($("python"), pythonLines(source, wanted(), clouds, states));
  }

  // ---- out -------------------------------------------------------------------------------------------------------
  function picture() { // the scene on its ground
    const copied = Object.assign(document.createElement("canvas"), { width: scene.width, height: scene.height }), g = copied.getContext("2d");
    g.fillStyle = css("--panel");
    g.fillRect(0, 0, copied.width, copied.height);
    g.drawImage(scene, 0, 0);
    copied.toBlob((blob) => save(`${stemOf(source)}.png`, blob));
  }
  function outside() { // the window whose address the reader sees
    try {
      return parent.document ? parent : window;
    } catch {
      return window; // the page around us is of another origin
    }
  }
  function address() {
    const view = new URLSearchParams({ sample: source.sample, points: wanted(), frame, bar: chosen.bar, radius, ...eye.cam });
    return `${outside().location.href.split("#")[0]}#${view}`;
  }
  function restore() { // the view of a link, or else the first sample
    const asked = new URLSearchParams(outside().location.hash.slice(1));
    if (!names.includes(asked.get("sample"))) return sample(names[0]);
    const limits = { points: [50, 800], frame: [0, 1e4], bar: [0, 1e4], radius: [0, 1e9], az: [-100, 100], el: [-1.5, 1.5], zoom: [0.4, 8] }, view = {};
    for (const [key, [low, high]] of Object.entries(limits)) {
      const value = parseFloat(asked.get(key));
      if (Number.isFinite(value)) view[key] = clamp(value, low, high);
    }
    const { az = eye.cam.az, el = eye.cam.el, zoom = 1 } = view;
    sample(asked.get("sample"), { ...view, cam: { az, el, zoom } });
  }
  async function copy(button, place) { // where the browser does not let a page write to the clipboard, the text is selected, to be copied by hand
    const label = (button.dataset.label ??= button.textContent); // two clicks in a row leave it as it was
    try {
      await navigator.clipboard.writeText(place.textContent);
      button.textContent = "copied";
      setTimeout(() => (button.textContent = label), 1500);
    } catch {
      getSelection().selectAllChildren(place);
    }
  }

  // ---- hands -----------------------------------------------------------------------------------------------------
  const packed = Object.keys(data.samples), films = packed.filter((name) => data.samples[name].ticks.shape.length > 2);
  const names = [...packed.filter((name) => !films.includes(name)), ...Object.keys(COMPUTED), ...films];
  $("sample").append(...names.map((name) => new Option(name)));
  $("sample").onchange = (e) => sample(e.target.value);
  $("choose").onclick = () => $("files").click();
  $("files").onchange = (e) => {
    take(e.target.files);
    e.target.value = ""; // so that the same file can be chosen again
  };
  $("paste").onclick = () => {
    $("pasting").hidden = !$("pasting").hidden;
    $("paste").setAttribute("aria-expanded", !$("pasting").hidden);
    if (!$("pasting").hidden) $("numbers").focus();
  };
  $("pasting").onsubmit = (e) => {
    e.preventDefault();
    take([new File([$("numbers").value], "pasted.txt")], { pasted: true });
  };
  $("columns").onchange = () => {
    const columns = [0, 1, 2].map((k) => axisOf(k).value).filter((value) => value !== "").map(Number);
    take(source.files, { pasted: source.pasted }, { columns });
  };
  $("plane").onclick = removePlane;
  $("crop").onclick = () => {
    $("box").hidden = !$("box").hidden;
    $("crop").setAttribute("aria-expanded", cropping());
    measure();
    later();
  };
  $("whole").onclick = () => again({ columns: source.options.columns });
  $("stop").onclick = stop;
  $("radius").oninput = (e) => {
    radius = (e.target.value / 200) * end;
    later();
  };
  $("points").oninput = () => compute();
  const play = playback(() => frame, at, last, 6), pause = (t) => (play(false), at(t));
  $("time").oninput = (e) => pause(+e.target.value);
  $("before").onclick = () => pause(frame - 1);
  $("next").onclick = () => pause(frame + 1);
  scrub(strip, (share) => pause(share * last()));
  diagram.onclick = (e) => {
    const away = dots.map(([x, y]) => Math.hypot(x - e.offsetX, y - e.offsetY)), nearestDot = away.indexOf(Math.min(...away));
    if (away[nearestDot] < 30) choose(nearestDot);
  };
  keys(diagram, () => ({ ArrowDown: () => step(1), ArrowRight: () => step(1), ArrowUp: () => step(-1), ArrowLeft: () => step(-1) }));
  const stepInTable = (by) => {
    step(by);
    $("rows").children[chosen.bar].querySelector("button").focus({ preventScroll: true });
  };
  keys($("rows"), () => ({ ArrowDown: () => stepInTable(1), ArrowUp: () => stepInTable(-1) }));
  onReset(() => {
    radius = 0;
    eye.back();
  });
  $("copy").onclick = () => copy($("copy"), $("python"));
  $("save-points").onclick = () => save(`${stemOf(source)}.npy`, pointsAsNpy(source, clouds, frame));
  $("save-json").onclick = () => save(`${stemOf(source)}.json`, loopsAsJson(source, clouds, states, frame, cycleOf));
  $("save-csv").onclick = () => save(`${stemOf(source)}.csv`, loopsAsCsv(states));
  $("save-png").onclick = picture;
  $("link").onclick = () => {
    say($("address"), address());
    copy($("link"), $("address"));
  };
  for (const place of new Set([document, outside().document])) { // a file may miss the frame
    place.addEventListener("dragover", (e) => {
      e.preventDefault();
      document.body.classList.add("over");
    });
    place.addEventListener("dragleave", () => document.body.classList.remove("over"));
    place.addEventListener("drop", (e) => {
      e.preventDefault();
      document.body.classList.remove("over");
      take(e.dataTransfer.files);
    });
  }

  // ---- start -----------------------------------------------------------------------------------------------------
  document.querySelector("main").prepend($("intake"));
  watch(later, () => { // the frame is as high as what is in it
    fit = null;
    try {
      if (frameElement) frameElement.style.height = document.querySelector("main").offsetHeight + "px";
    } catch { /* the page around us is of another origin */ }
  });
  restore();
})();
