// One edge of a planar cloud, its lens, and the path that saves it or fails: whether it could be observed as a killer.
// Idea: the state is an edge, alpha and epsilon; the points stand still. The chart has all edges of about the killer's length.
(() => {
  const [scene, chart, strip] = [$("scene"), $("rivals"), $("path")];
  const points = data.points, table = distancesOf(points), [loop] = rips(points).loops, { death, killerEdge } = loop;
  const frame = framing(points, 0.12 * death), most = { alpha: 0.6 * death, epsilon: 0.1 * death };
  const span = Math.max(...table.flat()), show = (v) => v.toFixed(Math.max(0, 2 - Math.floor(Math.log10(death))));
  let ends, chosen, alpha, epsilon, near, farthest, found, limits;

  // ---- what follows from the state ---------------------------------------------------------------------------
  function compute() { // all rivals, when alpha or epsilon changes
    near = rivals(table, killerEdge, death, 2 * epsilon, alpha + 2 * epsilon);
    for (const edge of near) edge.critical = isCritical(table, edge.i, edge.j, alpha, epsilon);
    const critical = near.filter((edge) => edge.critical);
    farthest = critical.length ? critical.reduce((best, edge) => (edge.away > best.away ? edge : best)) : null;
    look();
  }
  function look() { // one edge
    limits = limitsOf(table, ...ends, alpha, epsilon);
    found = hardest(table, ...ends, alpha, epsilon);
    later();
  }
  const isIt = () => found !== null && found.excess >= 0;
  const inWindow = () => near.some(({ i, j }) => ends.includes(i) && ends.includes(j));
  function choose(i, j) {
    ends = [i, j];
    look();
  }
  function reset() {
    [chosen, alpha, epsilon] = [0, data.alpha, data.epsilon];
    ends = [...killerEdge];
    compute();
  }

  // ---- drawing -----------------------------------------------------------------------------------------------
  function lensPath(g, scale, radius) { // all places within a radius of both ends
    const [a, b] = ends.map((v) => frame(scene.clientWidth, scene.clientHeight).to(points[v])), half = apart(a, b) / 2;
    g.beginPath();
    if (scale * radius <= half) return;
    const opening = Math.acos(half / (scale * radius)), ahead = Math.atan2(b[1] - a[1], b[0] - a[0]);
    g.arc(...a, scale * radius, ahead - opening, ahead + opening);
    g.arc(...b, scale * radius, ahead + Math.PI - opening, ahead + Math.PI + opening);
    g.closePath();
  }
  function drawScene() {
    const [g, w, h] = start(scene), { scale, to } = frame(w, h), S = points.map(to), verdict = paint(isIt() ? 3 : 2);
    lensPath(g, scale, limits.end);
    g.fillStyle = fade(css("--soft"), 0.22);
    g.fill();
    lensPath(g, scale, limits.outer);
    g.setLineDash([6, 5]);
    pen(g, css("--soft"), 1.2);
    g.stroke();
    g.setLineDash([]);
    if ($("all").checked) for (const { i, j, critical } of near) if (critical) trace(g, [S[i], S[j]], fade(paint(3), 0.45), 1);
    limits.carriers.forEach((p, k) => limits.carriers.slice(k + 1).forEach((q) => table[p][q] < limits.step && trace(g, [S[p], S[q]], fade(css("--soft"), 0.16), 0.8)));
    trace(g, killerEdge.map((v) => S[v]), css("--soft"), 2, { dash: [3, 5] });
    S.forEach((p, v) => dot(g, p, limits.carriers.includes(v) ? 3.5 : 2.5, css(limits.carriers.includes(v) ? "--ink" : "--soft")));
    steps().filter(({ kind }) => kind === "step").forEach(({ ids, fits }) => trace(g, ids.map((v) => S[v]), fits ? paint(2) : paint(3), 3, { dash: fits ? [] : [5, 6] }));
    if (found) for (const v of [found.path[0], found.path.at(-1)]) dot(g, S[v], 7.5, verdict, css("--panel"), 1.5);
    trace(g, ends.map((v) => S[v]), paint(0), 4);
    ends.forEach((v, k) => dot(g, S[v], 7.5, paint(0), css(k === chosen ? "--accent" : "--panel"), k === chosen ? 3 : 1));
  }
  function steps() { // the steps of the path and, between them, its points: each with its limit
    if (!found) return [];
    const { path } = found, rows = [];
    path.slice(1).forEach((q, k) => {
      const last = k === path.length - 2, limit = k === 0 || last ? limits.end : limits.step;
      rows.push({ kind: "step", ids: [path[k], q], value: table[path[k]][q], limit });
      if (!last) rows.push({ kind: "point", ids: [q], value: limits.farther[q], limit: limits.end });
    });
    for (const row of rows) row.fits = row.value < row.limit;
    return rows;
  }
  const width = () => Math.max(alpha + 4 * epsilon, 0.02 * death); // of the window of half lengths
  function drawChart() {
    const high = 1.08 * Math.max(death, ...near.map(({ away }) => away)), low = death - 2 * epsilon, last = width();
    const [g, X, Y, box] = axes(chart, last, high, "each edge: distance from the killer", "half length", undefined, []);
    g.fillStyle = css("--soft");
    [[show(low), 0, "left"], [show(low + last), last, "right"]].forEach(([text, at, align]) => {
      g.textAlign = align;
      g.fillText(text, X(at), box.y + box.h + 12);
    });
    g.textAlign = "left";
    chart.places = near.map((edge) => [X(clamp(edge.half - low, 0, last)), Y(edge.away)]);
    near.forEach(({ critical }, k) => critical || dot(g, chart.places[k], 1.8, fade(css("--soft"), 0.6)));
    near.forEach(({ critical }, k) => critical && dot(g, chart.places[k], 3.5, paint(3)));
    const beta = Y(farthest?.away ?? 0);
    pen(g, paint(3), 1.5);
    line(g, box.x, beta, box.x + box.w, beta, [6, 4]);
    g.fillStyle = css("--ink");
    word(g, "\u03b2", box.x + 6, beta - 9);
    const k = near.findIndex(({ i, j }) => ends.includes(i) && ends.includes(j));
    if (k >= 0) dot(g, chart.places[k], 8, null, css("--ink"), 2);
  }
  function drawStrip() {
    const rows = steps(), high = 1.15 * Math.max(limits.length, ...rows.map(({ value }) => value)), wide = Math.max(1, rows.length);
    const title = found ? "path: each bar must be below its mark" : "no two points are far enough apart";
    const [g, X, Y, box] = axes(strip, wide, high, title, "steps, and points between them", undefined, []), half = Math.min(14, 0.35 * box.w / wide);
    g.lineCap = "butt";
    rows.forEach(({ kind, value, limit, fits }, k) => {
      const x = X(k + 0.5), colour = paint(fits ? 2 : 3);
      trace(g, [[x, Y(0)], [x, Y(value)]], kind === "step" ? colour : fade(colour, 0.4), 2 * half);
      trace(g, [[x - 1.3 * half, Y(Math.max(0, limit))], [x + 1.3 * half, Y(Math.max(0, limit))]], css("--ink"), 2.5);
    });
  }
  function draw() {
    drawScene();
    drawChart();
    drawStrip();
    const why = !found ? "not critical: its lens has no pair of points that far apart"
      : isIt() ? `critical: no path joins the two marked points, the best one is ${show(found.excess)} above a limit`
      : `not critical: a path joins every pair, the hardest is ${show(-found.excess)} below its limits`;
    const where = inWindow() ? `${show(edgesApart(table, killerEdge, ends))} from the killer` : "not of the killer's length";
    const text = `edge ${ends.join("\u2013")}, length ${show(limits.length)}, ${where} \u00b7 ${why} \u00b7 `
      + `\u03b2 = ${show(farthest?.away ?? 0)}: ${near.filter((e) => e.critical).length} of ${near.length} edges of these lengths are critical`;
    $("status").textContent = text;
    for (const [name, value] of [["alpha", alpha], ["epsilon", epsilon]]) {
      $(name).value = Math.round((100 * value) / most[name]);
      $(name).setAttribute("aria-valuetext", show(value));
      $(name + "-is").textContent = show(value);
    }
    describe(scene, `${text}. Drag an end of the edge to another point; or choose an end with the keys n and p and move it with the arrow keys; Escape goes back to the killer.`);
    describe(chart, `distance from the killer of all edges of its length, against half their length; critical ones are marked, the farthest at \u03b2; ${text}`);
    describe(strip, `the steps and points of the path, each with its limit; ${why}`);
  }
  const later = lazily(draw);

  // ---- hands -------------------------------------------------------------------------------------------------
  function move(k, where) { // an end is at the nearest point that is not the other end
    const other = ends[1 - k], away = points.map((p, v) => (v === other ? Infinity : apart(p, where)));
    const v = away.indexOf(Math.min(...away));
    if (v !== ends[k]) choose(...(k ? [other, v] : [v, other]));
  }
  function walked(k, dx, dy) { // to the nearest point in a direction
    const [x, y] = points[ends[k]];
    const ahead = (p) => dx * (p[0] - x) - dy * (p[1] - y), aside = (p) => Math.abs(dy * (p[0] - x) + dx * (p[1] - y));
    const places = points.filter((p, v) => v !== ends[1 - k] && ahead(p) > aside(p));
    if (places.length) move(k, places.reduce((best, p) => (apart(p, [x, y]) < apart(best, [x, y]) ? p : best)));
  }
  const hold = (k) => ((chosen = k), later());
  draggable(scene, { points: () => ends.map((v) => points[v]), frame, press: hold, move });
  walk(scene, { count: () => 2, chosen: () => chosen, choose: hold, move: walked, Escape: () => choose(...killerEdge) });
  chart.onpointerdown = (e) => {
    const k = nearest(chart.places, (p) => p, e.offsetX, e.offsetY, 20);
    if (k >= 0) choose(near[k].i, near[k].j);
  };
  $("farthest").onclick = () => {
    if (!farthest) return;
    const there = ends.includes(farthest.i) && ends.includes(farthest.j);
    choose(...(there ? killerEdge : [farthest.i, farthest.j]));
  };
  $("alpha").oninput = (e) => ((alpha = (e.target.value / 100) * most.alpha), compute());
  $("epsilon").oninput = (e) => ((epsilon = (e.target.value / 100) * most.epsilon), compute());
  $("all").onchange = later;
  onReset(reset);

  // ---- start -------------------------------------------------------------------------------------------------
  reset();
  watch(later);
})();
