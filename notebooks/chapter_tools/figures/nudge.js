// The nudge of topokit.view: one point of a planar cloud moves a little, and three places of a loop follow it or leap.
// Idea: all positions of the slider are computed at once, so that the charts show what the reader is about to meet.
(() => {
  const [scene, moves, sizes] = [$("scene"), $("moves"), $("sizes")], STEPS = 120, DRAGGED = 12;
  const NAMES = ["killer edge", "barycentre of the thick triangle", "centroid of the cycle"], colour = (k) => paint(dark && k === 1 ? 5 : k); // its blue is too dark on black
  let home, points, frame, vertex, step, rows;

  // ---- what the slider does ------------------------------------------------------------------------------------
  const reach = () => +$("reach").value, along = () => $("way").value === "along";
  const shift = (k) => reach() * ((2 * k) / STEPS - 1), cloud = (k) => nudged(points, vertex, along(), shift(k));
  const now = () => rows.reduce((best, row) => (Math.abs(row.k - step) < Math.abs(best.k - step) ? row : best));
  function sweep(count = STEPS) {
    rows = Array.from({ length: count + 1 }, (_, i) => ({ k: (i * STEPS) / count, at: places(cloud((i * STEPS) / count)) }));
    const first = rows.find((row) => row.at);
    for (const row of rows) if (row.at) row.moved = moved(first.at, row.at);
    later();
  }
  function signed(s) {
    const size = Math.abs(s), digits = size && size < 1e-3 ? size.toExponential(1) : size.toFixed(3);
    return (s < 0 ? "\u2212" : s > 0 ? "+" : "") + digits;
  }

  // ---- the cloud and its loop ----------------------------------------------------------------------------------
  function arrows(g, from, [u, v]) { // both ways, (u, v) of length one
    pen(g, css("--accent"), 2);
    for (const side of [-1, 1]) {
      const at = (ahead, aside) => [from[0] + ahead * side * u - aside * v, from[1] + ahead * side * v + aside * u];
      line(g, ...at(11, 0), ...at(28, 0));
      for (const aside of [-5, 5]) line(g, ...at(28, 0), ...at(21, aside));
    }
  }
  function drawScene() {
    const [g, w, h] = start(scene), { to } = frame(w, h), S = cloud(step).map(to), { at } = now();
    if (at) {
      at.triangles.forEach((t, k) => trace(g, t.map(to), null, 0, { close: true, fill: fade(colour(k ? 0 : 1), k ? 0.16 : 0.28) }));
      trace(g, at.cycle.map(to), colour(2), 2, { close: true });
      trace(g, at.edge.map(to), colour(0), 5);
      const [x, y] = to(at.centroid);
      trace(g, [[x + 11, y], [x, y + 11], [x - 11, y], [x, y - 11]], css("--panel"), 1.5, { close: true, fill: colour(2) });
      dot(g, to(at.thick), 6, colour(1), css("--panel"), 1.5);
    }
    const ahead = nudged(points, vertex, along(), 1)[vertex];
    arrows(g, S[vertex], [ahead[0] - points[vertex][0], points[vertex][1] - ahead[1]]);
    S.forEach((p, v) => dot(g, p, v === vertex ? 6.5 : 4, css("--ink"), css(v === vertex ? "--accent" : "--panel"), v === vertex ? 3 : 1));
  }

  // ---- charts over the slider ----------------------------------------------------------------------------------
  function chart(canvas, title, high, lines) {
    const [g, X, Y, box] = axes(canvas, STEPS, high, title, "nudge", undefined, []), far = reach() < 1e-3 ? reach().toExponential(0) : reach();
    g.fillStyle = css("--soft");
    ["\u2212" + far, "0", "+" + far].forEach((text, k) => {
      g.textAlign = ["left", "center", "right"][k];
      g.fillText(text, X((k * STEPS) / 2), box.y + box.h + 12);
    });
    g.textAlign = "left";
    lines.forEach(({ name, ink, value }, k) => {
      trace(g, rows.filter((row) => row.at).map((row) => [X(row.k), Y(value(row))]), ink, 2.5);
      if (now().at) dot(g, [X(now().k), Y(value(now()))], 5, ink);
      g.fillStyle = ink;
      g.fillText(name, box.x + 10, box.y + 9 + 17 * k);
    });
    pen(g, css("--ink"), 1.2);
    line(g, X(step), box.y, X(step), box.y + box.h, [3, 3]);
  }
  function draw() {
    drawScene();
    const there = rows.filter((row) => row.at), large = Math.max(...there.map((row) => row.at.death), 1e-12), { at, moved: by } = now();
    // Three names stand above the lines; and no scale so small that a billionth looks like a leap.
    const high = Math.max(1.6 * Math.max(...there.flatMap((row) => row.moved), 0), 0.3 * large);
    chart(moves, "distance from its place at the left end", high, NAMES.map((name, k) => ({ name, ink: colour(k), value: (row) => row.moved[k] })));
    chart(sizes, "size: death above, birth below", 1.3 * large, ["death", "birth"].map((key) => ({ name: "", ink: css("--soft"), value: (row) => row.at[key] })));
    const text = `point ${vertex} nudged by ${signed(shift(step))}: ` + (at ? `killer edge ${at.ids.join("\u2013")}, moved ${by[0].toFixed(3)} \u00b7 `
      + `barycentre moved ${by[1].toFixed(3)} \u00b7 centroid moved ${by[2].toFixed(3)} \u00b7 born ${at.birth.toFixed(3)}, dies ${at.death.toFixed(3)}` : "no loop");
    tell(text, $("nudge"), step);
    describe(moves, "how far three places of the loop move over the range of the nudge; now " + text);
    describe(sizes, "birth and death over the range of the nudge; now " + text);
    describe(scene, text + `. Drag a point, or ${KEYS}`);
  }
  const later = lazily(draw);
  const [go, play] = stepped($("nudge"), () => STEPS, (k) => {
    step = k;
    later();
  });
  $("reach").onchange = $("way").onchange = () => sweep();

  // ---- points --------------------------------------------------------------------------------------------------
  function put(where, count) { // the chosen point, there, with the slider in the middle
    points[vertex] = where;
    go(STEPS / 2);
    sweep(count);
  }
  function reset() {
    points = home.map((p) => [...p]);
    vertex = 0;
    go(0);
    sweep();
  }
  function choose(cloud) {
    home = cloud;
    frame = framing(home, 0.3 * reach() + 0.12 * Math.max(...[0, 1].map((k) => Math.max(...home.map((p) => Math.abs(p[k] - home[0][k]))))));
    reset();
  }
  draggable(scene, {
    points: () => points,
    frame: (w, h) => frame(w, h),
    press: (v) => ((vertex = v), sweep(DRAGGED)),
    move: (v, where) => put(where, DRAGGED),
    tap: () => sweep(),
    release: () => sweep(),
  });
  walk(scene, {
    count: () => points.length,
    chosen: () => vertex,
    choose: (v) => ((vertex = v), sweep()),
    move: (v, dx, dy) => put(beside(scene, frame, points[v], dx, dy)),
    Escape: reset,
    " ": () => play(),
  });
  onReset(reset);

  // ---- start ---------------------------------------------------------------------------------------------------
  $("reach").append(...data.reaches.map((r) => new Option(r < 1e-3 ? r.toExponential(0) : r, r)));
  shapes(choose);
  watch(later);
})();
