// Points that are hidden one at a time, and the killer edge that jumps: how far apart two observers see it, and two bounds.
// Idea: one observer misses the points that the reader hides. The chart compares it with each observer who misses one point or none.
(() => {
  const [scene, chart, strip] = [$("scene"), $("others"), $("lunes")], home = data.points, frame = framing(home, 0.1);
  let points, hidden, chosen, whole, mine, others, far;

  // ---- what follows from the state ---------------------------------------------------------------------------
  function compute() {
    whole = scenery(points);
    if (!whole.loops.length) return later();
    mine = observer(whole, hidden);
    others = [[], ...points.map((_, v) => [v])].map((missed) => {
      const other = observer(whole, missed);
      return { other, ...compared(whole, mine, other) };
    });
    const seen = others.filter(({ distance, paper }) => paper !== null && distance < Infinity);
    far = seen.reduce((best, row) => (row.distance > (best?.distance ?? -1) ? row : best), null);
    later();
  }
  function hide(missed) { // an observer sees three points at least
    if (points.length - missed.length >= 3) hidden = missed;
    compute();
  }
  const toggle = (v) => hide(hidden.includes(v) ? hidden.filter((u) => u !== v) : [...hidden, v]);
  function put(v, where) {
    points[v] = where;
    compute();
  }
  function reset() {
    points = home.map((p) => [...p]);
    [hidden, chosen] = [[...data.hidden], -1];
    compute();
  }
  const name = (missed) => (missed.length ? `without ${missed.join(", ")}` : "all points"), edge = (ids) => ids.join("\u2013");
  const broken = ({ distance, paper }) => paper !== null && distance > paper * (1 + 1e-9);

  // ---- drawing -----------------------------------------------------------------------------------------------
  function drawScene() {
    const [g, w, h] = start(scene), { to } = frame(w, h), S = points.map(to), at = (ids) => ids.map((v) => S[v]), [loop] = whole.loops;
    if (loop) {
      trace(g, at(loop.cycle), fade(css("--soft"), 0.7), 1.2, { close: true, dash: [4, 4] });
      trace(g, at(loop.killerEdge), css("--soft"), 3, { dash: [3, 6] });
      if (far?.other.killer && far.distance > 0) trace(g, at(far.other.killer), blue(), 3.5, { dash: [10, 7] });
      if (mine.killer) trace(g, at(mine.killer), paint(0), 5);
    }
    const [x, y] = [0, 1].map((k) => S.reduce((sum, p) => sum + p[k], 0) / S.length);
    S.forEach((p, v) => {
      const missed = hidden.includes(v), out = Math.hypot(p[0] - x, p[1] - y) || 1;
      const close = S.findIndex((q, u) => u !== v && apart(p, q) < 16), aside = close < 0 ? 0 : 11 * Math.sign(close - v); // two labels side by side
      const label = [p[0] + (17 * (p[0] - x) + aside * (p[1] - y)) / out, p[1] + (17 * (p[1] - y) - aside * (p[0] - x)) / out + 4];
      dot(g, p, 6, css(missed ? "--panel" : "--ink"), css(missed ? "--ink" : "--panel"), 1.5);
      if (v === chosen) dot(g, p, 10, null, css("--accent"), 2.5);
      g.fillStyle = css("--ink");
      g.textAlign = "center";
      word(g, v, ...label);
      g.textAlign = "left";
    });
  }
  function drawChart() { // a bar for each other observer, with the marks of both bounds
    const rows = whole.loops.length ? others : [], finite = rows.flatMap(({ distance, paper, corrected }) => [distance, paper, corrected]).filter((v) => v !== null && v < Infinity);
    const high = 1.15 * Math.max(...finite, 1e-9), n = points.length + 1;
    const [g, X, Y, box] = axes(chart, n, high, "distance to another observer's killer", "the other misses", undefined, []), half = Math.min(13, 0.3 * box.w / n);
    g.lineCap = "butt";
    rows.forEach((row, k) => {
      const x = X(k + 0.5), mark = (value, style, dash) => value !== null && trace(g, [[x - 1.4 * half, Y(value)], [x + 1.4 * half, Y(value)]], style, 2.5, { dash });
      const colour = broken(row) ? paint(0) : row.paper === null ? fade(css("--soft"), 0.5) : css("--soft");
      if (row.distance < Infinity) trace(g, [[x, Y(0)], [x, Y(row.distance)]], colour, 2 * half);
      mark(row.paper, css("--ink"), []);
      mark(row.corrected, paint(2), [4, 3]);
      g.fillStyle = css(row === far ? "--ink" : "--soft");
      g.textAlign = "center";
      g.fillText(k ? k - 1 : "none", x, box.y + box.h + 12);
      g.textAlign = "left";
    });
  }
  function drawStrip() { // the lunes of the longest edges that this observer sees
    const edges = mine && whole.loops.length ? mine.complex.edges : [], kills = edges.map((_, k) => mine.complex.does(k) === "kills");
    const [loop] = whole.loops, low = loop ? 0.9 * loop.death - 0.5 * (loop.death - loop.birth) : 0, last = Math.max(low + 1e-9, ...edges.map(({ value }) => value));
    const [g, X, Y, box] = axes(strip, 1, 2.6, "components of the lunes seen here", "half length", [0, 1, 2], []), place = (v) => X(0.03 + (0.94 * (v - low)) / (last - low));
    edges.forEach((e, k) => {
      if (e.value < low) return;
      const at = [place(e.value), Y(Math.min(2, e.parts.length))];
      dot(g, at, kills[k] ? 6 : 3, kills[k] ? paint(0) : css("--soft"));
      if (!kills[k]) return;
      g.fillStyle = css("--ink");
      word(g, edge([mine.ids[e.i], mine.ids[e.j]]), Math.min(at[0] + 9, box.x + box.w - 26), at[1] - 9);
    });
  }
  function draw() {
    drawScene();
    drawChart();
    drawStrip();
    const text = explanation();
    $("status").textContent = text;
    describe(scene, `${points.length} points; ${text}. Click a point to hide or show it, drag it to move it; or choose one with the keys n and p, hide or show it with Enter, and move it with the arrow keys; Escape begins anew.`);
    describe(chart, `the distance from this killer to the killer that each other observer sees, with two bounds; ${text}`);
    describe(strip, `the number of components of the lunes of the longest edges; an edge whose lune has two may kill; ${text}`);
  }
  function explanation() {
    if (!whole.loops.length) return "these points have no loop";
    const seen = `${name(hidden)}: ${mine.killer ? `killer ${edge(mine.killer)}` : "the loop is not seen"}, all points: ${edge(whole.loops[0].killerEdge)}`;
    if (!far || far.distance === 0) return seen;
    const show = (v) => v.toFixed(3), fails = broken(far) ? "more than" : "at most";
    return `${seen} \u00b7 farthest: ${name(far.other.hidden)}, killer ${edge(far.other.killer)}, ${show(far.distance)} away, `
      + `${fails} 2\u03b1 + \u03b2 = ${show(far.paper)} and at most 2\u03b2 over critical edges = ${show(far.corrected)}`;
  }
  const later = lazily(draw);

  // ---- hands -------------------------------------------------------------------------------------------------
  const hold = (v) => ((chosen = v), later());
  hands(scene, { points: () => points, frame, chosen: () => chosen, press: hold, put, tap: toggle, Enter: () => chosen >= 0 && toggle(chosen), Escape: reset });
  chart.onpointerdown = (e) => { // become the other observer
    const k = Math.floor(((e.offsetX - chart.box.x) / chart.box.w) * (points.length + 1));
    if (k >= 0 && k <= points.length) hide(k ? [k - 1] : []);
  };
  $("swap").onclick = () => hide(far && far.distance > 0 ? far.other.hidden : []);
  onReset(reset);

  // ---- start -------------------------------------------------------------------------------------------------
  reset();
  watch(later);
})();
