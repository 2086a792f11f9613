// A small motion of a planar cloud: every point within epsilon of its home, the loops before and after, and what none can undo.
// Idea: the state is where the points are and how far they may go. Loops are computed anew whenever a point moves.
(() => {
  const [scene, diagram, strip] = [$("scene"), $("diagram"), $("strip")];
  const ROUNDS = 150, home = data.points, most = 2 * data.epsilon, frame = framing(home, 1.35 * data.epsilon);
  const before = rips(home), high = 1.25 * Math.max(...before.loops.map((l) => l.death + data.epsilon), before.cone / 2);
  const seen = data.observed && data.observed.map((v) => home[v]), [inView] = seen ? rips(seen).loops : [];
  const alpha = seen && Math.max(...home.map((p) => Math.min(...seen.map((q) => apart(p, q))))), span = (loop) => (loop ? loop.death - loop.birth : 0);
  const strong = before.loops.filter((loop) => span(loop) >= 0.3 * span(before.loops[0])); // they have colours; many a cloud has a weave
  let points, after, match, best, epsilon = data.epsilon, round = 0, chosen = -1; // best: what left the longest loop the shortest life

  // ---- motion ------------------------------------------------------------------------------------------------
  const leashed = (v, where) => leash(home[v], where, epsilon);
  function room([x, y], [dx, dy]) { // the share of a step that ends on the edge of the disc
    const a = dx * dx + dy * dy, b = x * dx + y * dy, c = Math.min(0, x * x + y * y - epsilon * epsilon);
    return a ? (Math.sqrt(b * b - a * c) - b) / a : Infinity;
  }
  function compute() {
    after = rips(points);
    if (!(span(after.loops[0]) >= best.life)) best = { life: span(after.loops[0]), points };
    match = matchLoops(before.loops, after.loops);
    later();
  }
  function place(v, where) {
    points = points.map((p, u) => (u === v ? leashed(v, where) : p));
    compute();
  }
  function attack(to) { // up to a round; at the end the points stand where they left the longest loop the shortest life
    if (to < round) round = 0;
    while (round < Math.floor(to) && after.loops.length) {
      points = push(points, home, after.loops[0], epsilon, 1 - round++ / ROUNDS);
      compute();
    }
    if (!after.loops.length) round = ROUNDS;
    if (round >= ROUNDS) points = best.points;
    compute();
  }
  function reset() {
    chosen = -1;
    round = 0;
    best = { life: Infinity };
    points = home.map((p) => [...p]);
    compute();
  }
  const displacement = () => Math.max(...points.map((p, v) => apart(p, home[v])));
  function distortion() { // half the largest change of a distance
    let largest = 0;
    for (let i = 0; i < home.length; i++) for (let j = 0; j < i; j++) largest = Math.max(largest, Math.abs(apart(points[i], points[j]) - apart(home[i], home[j])));
    return largest / 2;
  }

  // ---- drawing -----------------------------------------------------------------------------------------------
  function drawScene() {
    const [g, w, h] = start(scene), { scale, to } = frame(w, h), H = home.map(to), S = points.map(to), small = home.length > 20;
    for (const p of H) dot(g, p, scale * epsilon, fade(blue(), dark ? 0.17 : 0.12), fade(blue(), 0.45));
    strong.forEach((loop) => trace(g, loop.cycle.map((v) => H[v]), fade(css("--soft"), 0.6), 1.2, { close: true, dash: [4, 4] }));
    strong.forEach((loop, k) => {
      const there = after.loops[match.partner[k]];
      const [born, kills] = there ? [there.birthEdge, there.killerEdge] : [loop.birthEdge, loop.killerEdge];
      if (there) {
        for (const ids of there.triangles) trace(g, ids.map((v) => S[v]), null, 0, { close: true, fill: fade(paint(k), 0.14) });
        trace(g, there.cycle.map((v) => S[v]), paint(k), 2.2, { close: true });
      }
      trace(g, born.map((v) => S[v]), there ? paint(k) : css("--soft"), there ? 5 : 2.5);
      trace(g, kills.map((v) => S[v]), there ? paint(k) : css("--soft"), there ? 4 : 2.5, { dash: [9, 7] });
    });
    S.forEach((p, v) => {
      trace(g, [H[v], p], css("--ink"), 1.2);
      dot(g, H[v], 2.5, css("--panel"), css("--soft"), 1);
      if (seen && !seen.includes(home[v])) dot(g, p, 6, css("--panel"), css("--ink"), 1.5);
      else dot(g, p, small ? 4 : 6, css("--ink"), css("--panel"), 1.5);
      if (v === chosen) dot(g, p, 7, null, css("--accent"), 3);
    });
  }
  function drawDiagram() {
    const [g, X, Y] = axes(diagram, high, high, "before (ring), after (dot): death", "birth");
    const level = (lifetime, dash) => line(g, X(0), Y(lifetime), X(high - lifetime), Y(high), dash);
    g.strokeStyle = css("--soft");
    line(g, X(0), Y(0), X(high), Y(high));
    level(epsilon, [2, 3]);
    level(2 * epsilon, [7, 4]);
    g.fillStyle = css("--soft");
    for (const [name, value] of [["\u03b5", epsilon], ["2\u03b5", 2 * epsilon]]) word(g, name, X(0.85 * high - value) + 9, Y(0.85 * high) + 6);
    strong.forEach((loop, k) => {
      const [x, y] = [X(loop.birth), Y(loop.death)], [a, b] = [X(epsilon) - X(0), Y(0) - Y(epsilon)];
      g.fillStyle = fade(paint(k), 0.12);
      g.fillRect(x - a, y - b, 2 * a, 2 * b);
      pen(g, fade(paint(k), 0.5), 1);
      g.strokeRect(x - a, y - b, 2 * a, 2 * b);
      const there = after.loops[match.partner[k]];
      if (there) trace(g, [[x, y], [X(there.birth), Y(there.death)]], paint(k), 1.5);
      dot(g, [x, y], 5, css("--panel"), paint(k), 2);
    });
    after.loops.forEach((loop, j) => {
      const k = match.partner.indexOf(j);
      dot(g, [X(loop.birth), Y(loop.death)], strong[k] ? 5.5 : 3.5, strong[k] ? paint(k) : css("--soft"), css("--panel"), 1);
    });
  }
  function drawStrip() { // bars before and after, and between them what no motion can take
    const [g, X, , box] = axes(strip, high, 1, "bars; thin: what every motion leaves", "r", []), rows = strong.length + (seen ? 1 : 0), step = Math.min(30, box.h / Math.max(1, rows));
    const bar = (from, to, y, style, width) => to > from && trace(g, [[X(from), y], [X(to), y]], style, width);
    g.lineCap = "butt";
    strong.forEach((loop, k) => {
      const there = after.loops[match.partner[k]], y = box.y + (k + 0.5) * step;
      bar(loop.birth, loop.death, y - 0.2 * step, fade(paint(k), 0.4), Math.min(7, 0.3 * step));
      if (there) bar(there.birth, there.death, y + 0.2 * step, paint(k), Math.min(7, 0.3 * step));
      bar(loop.birth + epsilon, loop.death - epsilon, y, css("--ink"), Math.min(3, 0.15 * step));
    });
    if (!inView) return;
    const y = box.y + (rows - 0.5) * step, mark = X(inView.birth + alpha);
    bar(inView.birth, inView.death, y, css("--soft"), 7);
    trace(g, [[mark, y - 9], [mark, y + 9]], css("--ink"), 2);
    g.fillStyle = css("--soft");
    g.textAlign = "right";
    word(g, "seen, and \u03b1", X(inView.birth) - 8, y);
  }
  function draw() {
    drawScene();
    drawDiagram();
    drawStrip();
    const digits = Math.max(0, 2 - Math.floor(Math.log10(data.epsilon))), show = (v) => v.toFixed(digits);
    const [loop] = before.loops, left = after.loops[0];
    const text = [`\u03b5 = ${show(epsilon)}`, `moved ${show(displacement())}`, `\u03b4 = ${show(distortion())}`,
      ...(seen ? [`\u03b1 = ${show(alpha)}`, `seen lifetime ${show(span(inView))}, ${span(inView) < alpha ? "dropped" : "kept"} by the filter`] : []),
      loop ? `lifetime ${show(span(loop))} = ${(span(loop) / epsilon).toFixed(2)} \u03b5` : "no loop before", left ? `now ${show(span(left))}` : "now no loop",
      `least so far ${show(best.life)}; no motion leaves less than ${show(Math.max(0, span(loop) - 2 * epsilon))}`].join(" \u00b7 ");
    $("status").textContent = text;
    $("epsilon").value = Math.round((200 * epsilon) / most);
    $("epsilon").setAttribute("aria-valuetext", show(epsilon));
    describe(scene, `${text}. Drag a point within its disc, or beside all points to move them together; or ${KEYS}`);
    describe(diagram, `diagrams before and after; ${text}`);
    describe(strip, `bars before and after; ${text}`);
  }
  const later = lazily(draw);

  // ---- hands -------------------------------------------------------------------------------------------------
  const play = playback(() => round, attack, () => ROUNDS, 6), still = () => play(false);
  let grabbed = []; // where all points were when the hand came down
  draggable(scene, {
    points: () => points,
    frame,
    all: true,
    press: (v) => {
      still();
      grabbed = points.map((p) => [...p]);
      if (v >= 0) chosen = v;
      later();
    },
    move: (v, where, by) => {
      if (v >= 0) return place(v, where);
      // All together, as far as every leash allows: what is rigid stays rigid.
      const share = Math.min(1, ...grabbed.map((p, i) => room([p[0] - home[i][0], p[1] - home[i][1]], by)));
      points = grabbed.map((p) => [p[0] + share * by[0], p[1] + share * by[1]]);
      compute();
    },
  });
  walk(scene, {
    count: () => home.length,
    chosen: () => chosen,
    choose: (v) => (still(), (chosen = v), later()),
    move: (v, dx, dy) => (still(), place(v, [points[v][0] + 0.1 * epsilon * dx, points[v][1] - 0.1 * epsilon * dy])),
    Escape: () => (still(), reset()),
    " ": () => play(),
  });
  $("epsilon").oninput = (e) => {
    still();
    epsilon = Math.max(1, +e.target.value) * most / 200;
    [points, best] = [points.map((p, v) => leashed(v, p)), { life: Infinity }];
    compute();
  };
  onReset(() => (still(), reset()));

  // ---- start -------------------------------------------------------------------------------------------------
  reset();
  watch(later);
})();
