// A stray point and two rules: which bars are loops by a guessed alpha, and which by evidence.
// Idea: the state is where the points are; the stray one is the last. Both rules are asked anew whenever a point moves.
(() => {
  const [scene, ...charts] = [$("scene"), $("paper"), $("evidence")], STEPS = 200, SHOWN = 7;
  const home = [...data.points, data.start], last = home.length - 1, frame = framing([...home, data.end], 0);
  const between = (share) => data.start.map((x, k) => x + share * (data.end[k] - x));
  let points, rules, way, chosen;

  // One scale for the whole way, since a scale that moves under the hand is no scale.
  const ends = [home, [...data.points, data.end]].flatMap((cloud) => [byAlpha(cloud), byEvidence(cloud)]).flatMap(({ loops }) => loops.slice(0, 1));
  const high = 1.12 * Math.max(...ends.flatMap((l) => [l.death, l.needed]), 0) || 1;
  const show = (v) => v.toFixed(Math.max(0, 2 - Math.floor(Math.log10(high)))), ink = (k) => (k ? blue() : paint(0));
  const count = (n, word) => `${n || "no"} ${word}${n === 1 ? "" : "s"}`;

  // ---- points ------------------------------------------------------------------------------------------------
  function compute() {
    const complex = rips(points);
    rules = [byAlpha(points, complex), byEvidence(points, complex)];
    later();
  }
  function place(v, where) {
    points[v] = where;
    if (v === last) way = clamp(share(where), 0, 1);
    compute();
  }
  function share([x, y]) { // of the way from start to end
    const [u, v] = [0, 1].map((k) => data.end[k] - data.start[k]);
    return ((x - data.start[0]) * u + (y - data.start[1]) * v) / (u * u + v * v || 1);
  }
  function go(to) {
    way = clamp(to, 0, 1);
    points[last] = between(way);
    compute();
  }
  function reset() {
    points = home.map((p) => [...p]);
    [way, chosen] = [0, last];
    compute();
  }

  // ---- drawing -----------------------------------------------------------------------------------------------
  function drawScene() {
    const [g, w, h] = start(scene), { scale, to } = frame(w, h), [paper, evidence] = rules;
    if ($("balls").checked) balls(g, points.map(to), scale * paper.alpha, dark ? 0.17 : 0.13, 0.25);
    const around = ({ kept, cloud }, style, width) => kept.forEach((loop) => trace(g, loop.cycle.map((v) => to(cloud[v])), style, width, { close: true }));
    around(evidence, fade(ink(1), 0.4), 11);
    around(paper, ink(0), 3.5);
    const alone = paper.loneliest, next = points.reduce((best, p) => (p !== alone && apart(p, alone) && apart(p, alone) < apart(best, alone) ? p : best), [Infinity, 0]);
    const [a, b] = [alone, next].map(to);
    trace(g, [a, b], css("--ink"), 1.5);
    g.fillStyle = css("--ink");
    if (apart(a, b) > 50) g.fillText("2\u03b1", 0.35 * a[0] + 0.65 * b[0], 0.35 * a[1] + 0.65 * b[1] - 12);
    points.forEach((p, v) => {
      const at = to(p);
      if (evidence.cloud.includes(p)) dot(g, at, v === last ? 6 : 4.5, css("--ink"), css("--panel"), 1);
      else dot(g, at, 6, css("--panel"), css("--ink"), 1.5);
      if (v === chosen) dot(g, at, 10, null, css("--accent"), 2.5);
    });
  }
  function drawRule(k, title) {
    const [g, X, , box] = axes(charts[k], high, 1, title, "r", []), step = Math.min(24, box.h / SHOWN), { loops } = rules[k];
    loops.slice(0, SHOWN).forEach((loop, row) => {
      const y = box.y + 6 + (row + 0.5) * step, is = rules[k].kept.includes(loop), colour = is ? ink(k) : css("--soft"), mark = Math.min(loop.needed, high);
      g.lineCap = "butt";
      trace(g, [[X(loop.birth), y], [X(mark), y]], css("--soft"), 1, { dash: [2, 3] });
      trace(g, [[X(loop.birth), y], [X(loop.death), y]], colour, Math.min(9, 0.45 * step));
      if (loop.needed <= high) trace(g, [[X(mark), y - 0.4 * step], [X(mark), y + 0.4 * step]], css("--ink"), 2);
      else trace(g, [[X(mark) - 5, y - 4], [X(mark), y], [X(mark) - 5, y + 4]], css("--ink"), 2);
      g.fillStyle = is ? css("--ink") : css("--soft");
      g.textAlign = "right";
      g.fillText(loop.strength.toFixed(2), box.x - 5, y);
      g.textAlign = "left";
    });
  }
  function draw() {
    const [paper, evidence] = rules, out = points.length - evidence.cloud.length;
    const far = Math.min(...data.points.map((_, v) => apart(points[v], points[last])));
    const said = [`the paper's rule, \u03b1 guessed (lifetime / \u03b1): ${count(paper.kept.length, "loop")}`,
      `evidence (significance): ${count(evidence.kept.length, "loop")}` + (out ? `, ${count(out, "point")} left out` : "")];
    drawScene();
    [0, 1].forEach((k) => drawRule(k, said[k]));
    const strengths = rules.map(({ loops }) => (loops.length ? loops[0].strength.toFixed(2) : "0"));
    const text = `the stray point is ${show(far)} from its nearest \u00b7 by the paper's rule with a guessed \u03b1 ${count(paper.kept.length, "loop")}: \u03b1 = ${show(paper.alpha)}, the longest bar lives ${strengths[0]} \u03b1 \u00b7 `
      + `by evidence ${count(evidence.kept.length, "loop")}: significance of the longest ${strengths[1]}, \u03b1 = ${show(evidence.alpha)}, ${count(out, "point")} left out`;
    tell(text, $("away"), Math.round(STEPS * way));
    describe(scene, `${text}. Drag the stray point or any other, or ${KEYS}`);
    charts.forEach((canvas, k) => describe(canvas, `bars, each with a mark that a loop's bar must reach; ${said[k]}`));
  }
  const later = lazily(draw);

  // ---- hands -------------------------------------------------------------------------------------------------
  const play = playback(() => way, go, () => 1, 6), still = () => play(false);
  hands(scene, {
    points: () => points,
    frame,
    chosen: () => chosen,
    press: (v) => (still(), (chosen = v), later()),
    put: (v, where) => (still(), place(v, where)),
    Escape: () => (still(), reset()),
    " ": () => play(),
  });
  $("away").oninput = (e) => (still(), go(+e.target.value / STEPS));
  $("balls").onchange = later;
  onReset(() => (still(), reset()));

  // ---- start -------------------------------------------------------------------------------------------------
  reset();
  watch(later);
})();
