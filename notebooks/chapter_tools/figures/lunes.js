// The lune of one edge after another: the points in it, the components they form, and what the edge does when it arrives.
// Idea: the state is the points and the rank of an edge. One edge's lune is drawn twice, the second
// time alone and upright, as the suspension of which the proof speaks.
(() => {
  const [scene, upright, strip] = [$("scene"), $("suspension"), $("strip")], hue = (k) => (k ? paint(k + 1) : blue());
  let home, points, complex, rank, frame, chosen, mark; // the mark is the first end of an edge that is being chosen
  const edge = () => complex.edges[rank];

  // ---- what the edge does --------------------------------------------------------------------------------------
  const ink = { kills: 0, begins: 5, joins: 4, void: 3 };
  const loop = (e) => complex.loops.find((l) => [l.birthEdge, l.killerEdge].some(([i, j]) => i === e.i && j === e.j));
  function explanation(e) {
    const found = loop(e), act = complex.does(rank), c = e.parts.length, inside = e.parts.flat().length;
    const words = { joins: "joins two components", nothing: "kills nothing", void: "kills nothing: the dashed walk was filled before, so a void is created",
      begins: found ? `creates a loop, which dies at ${found.death.toFixed(3)}` : "creates a loop, which dies at once",
      kills: found ? `kills the loop born at ${found.birth.toFixed(3)}` : "kills a loop that was born at the same radius" };
    return [`edge ${e.i}\u2013${e.j}, ${rank + 1} of ${complex.edges.length}`, `r = ${e.value.toFixed(3)}`,
      inside ? `lune: ${inside} point${inside > 1 ? "s" : ""}, ${c === 1 ? "connected" : c + " components"}` : "lune empty", words[act]].join(" \u00b7 ");
  }

  // ---- the lune, in the cloud and alone ------------------------------------------------------------------------
  function drawLune(g, to, large) {
    const e = edge(), S = points.map(to), [x, y] = [S[e.i], S[e.j]], length = apart(x, y), ahead = Math.atan2(y[1] - x[1], y[0] - x[0]), third = Math.PI / 3;
    g.beginPath();
    g.arc(...x, length, ahead - third, ahead + third);
    g.arc(...y, length, ahead + Math.PI - third, ahead + Math.PI + third);
    [g.fillStyle, g.strokeStyle, g.lineWidth] = [fade(css("--soft"), 0.13), css("--soft"), 1];
    g.setLineDash([5, 4]);
    g.fill();
    g.stroke();
    g.setLineDash([]);
    const all = e.parts, apexes = all.map(([z]) => S[z]);
    all.forEach((part, k) => {
      if (large) for (const z of part) trace(g, [x, S[z], y], fade(hue(k), 0.35), 1);
      part.forEach((z, a) => part.slice(a + 1).forEach((v) => complex.joined(z, v, rank) && trace(g, [S[z], S[v]], fade(hue(k), 0.8), 1.6)));
      trace(g, [x, apexes[k], y], hue(k), 1.5, { close: true, fill: fade(hue(k), 0.3) });
    });
    if (all.length > 1) trace(g, [x, apexes[0], y, apexes[1]], css("--ink"), 2.5, { close: true, dash: [7, 5] });
    trace(g, [x, y], paint(0), 4.5);
    all.forEach((part, k) => part.forEach((z) => dot(g, S[z], large ? 6.5 : 5.5, hue(k), css("--panel"), 1)));
    for (const p of [x, y]) dot(g, p, 6.5, paint(0), css("--panel"), 1);
    if (!large) return;
    g.fillStyle = css("--ink");
    [x, y, ...apexes].forEach((p, k) => word(g, "xyz"[Math.min(k, 2)] + (k > 1 && all.length > 1 ? "\u2081\u2082\u2083"[k - 2] || "" : ""), p[0] + (k < 2 || p[0] < x[0] ? -20 : 10), p[1] + 2));
  }
  function drawScene() {
    const [g, w, h] = start(scene), { to } = frame(w, h), S = points.map(to), found = loop(edge());
    for (const e of complex.edges.slice(0, rank)) trace(g, [S[e.i], S[e.j]], fade(css("--soft"), dark ? 0.45 : 0.35), 1);
    if (found) trace(g, found.cycle.map((v) => S[v]), paint(ink[complex.does(rank)]), 4, { close: true });
    S.forEach((p) => dot(g, p, 4, css("--ink"), css("--panel"), 1));
    drawLune(g, to);
    for (const v of [chosen, mark]) if (v >= 0) dot(g, S[v], v === mark ? 13 : 10, null, css("--accent"), 2.5);
  }
  function drawUpright() {
    const [g, w, h] = start(upright), e = edge(), [p, q] = [points[e.i], points[e.j]], length = apart(p, q) || 1;
    const middle = mean([p, q]), [a, b] = [(q[0] - p[0]) / length, (q[1] - p[1]) / length], scale = Math.min((h - 64) / length, (w - 70) / (1.74 * length));
    drawLune(g, ([u, v]) => { // turned, not mirrored
      const [dx, dy] = [u - middle[0], v - middle[1]];
      return [w / 2 + scale * (a * dy - b * dx), h / 2 + 10 + scale * (a * dx + b * dy)];
    }, true);
    g.fillStyle = css("--soft");
    word(g, "the lune alone: x and y over its points", 10, 14);
  }
  function drawStrip() {
    const last = complex.edges.at(-1).value || 1, [g, X, Y, box] = axes(strip, last, 3, "all edges: components of their lunes", "r", [0, 1, 2]);
    const place = (e) => [X(e.value), Y(Math.min(3, e.parts.length))];
    complex.edges.forEach((e, k) => {
      const act = complex.does(k);
      dot(g, place(e), act === "nothing" ? 1.5 : 4, act === "nothing" ? css("--soft") : paint(ink[act]));
    });
    dot(g, place(edge()), 8, null, css("--ink"), 2);
    pen(g, css("--ink"), 1.2);
    line(g, X(edge().value), box.y, X(edge().value), box.y + box.h, [3, 3]);
    ["joins", "begins", "kills", "void"].forEach((act, k) => {
      const [x, y] = [box.x + box.w - (k % 2 ? 50 : 110), Y(k < 2 ? 0.5 : 2.5)];
      dot(g, [x, y], 4, paint(ink[act]));
      g.fillStyle = css("--soft");
      word(g, act, x + 9, y);
    });
  }
  function draw() {
    drawScene();
    drawUpright();
    drawStrip();
    const text = explanation(edge());
    $("status").textContent = text;
    [$("edge").max, $("edge").value] = [complex.edges.length - 1, rank];
    $("edge").setAttribute("aria-valuetext", text);
    describe(upright, `the lune drawn alone; ${text}`);
    describe(strip, `the number of components of every edge's lune against half its length; now ${text}`);
    describe(scene, `${text}. Drag a point; click two points to choose the edge between them. Or choose a point with the keys n and p, mark it as an end with Enter, move it with the arrow keys; Escape puts the points back.`);
  }
  const later = lazily(draw);

  // ---- edges ---------------------------------------------------------------------------------------------------
  const [go, play] = stepped($("edge"), () => complex.edges.length - 1, (k) => ((rank = k), later()), 30);
  function choose(i, j) {
    const [low, high] = [Math.min(i, j), Math.max(i, j)];
    go(complex.edges.findIndex((e) => e.i === low && e.j === high));
  }
  function end(v) {
    play(false);
    if (mark >= 0 && mark !== v) choose(mark, v);
    mark = mark < 0 ? v : -1;
    later();
  }
  $("next").onclick = () => { // round and round
    play(false);
    const busy = [...complex.edges.keys()].filter((k) => ["kills", "void"].includes(complex.does(k)));
    if (busy.length) go(busy.find((k) => k > rank) ?? busy[0]);
  };
  scrub(strip, (share) => {
    play(false);
    const value = share * complex.edges.at(-1).value;
    go(Math.max(0, complex.edges.findLastIndex((e) => e.value <= value)));
  });

  // ---- points --------------------------------------------------------------------------------------------------
  function put(v, where) { // the same edge is shown, wherever it stands in the order now
    const { i, j } = edge();
    points[v] = where;
    complex = rips(points);
    choose(i, j);
  }
  function reset() {
    play(false);
    points = home.map((p) => [...p]);
    [complex, chosen, mark] = [rips(points), -1, -1];
    const [longest] = complex.loops;
    if (longest) choose(...longest.killerEdge);
    else go(0);
  }
  const hold = (v) => (play(false), (chosen = v), later());
  hands(scene, {
    points: () => points,
    frame: (w, h) => frame(w, h),
    chosen: () => chosen,
    press: hold,
    put,
    tap: end,
    miss: () => ((mark = -1), hold(-1)),
    Enter: () => chosen >= 0 && end(chosen),
    Escape: reset,
    " ": () => play(),
  });
  onReset(reset);
  shapes((cloud) => {
    home = cloud;
    frame = framing(home, 0.06 * Math.max(...home.map((p) => apart(p, home[0]))));
    reset();
  });
  watch(later);
})();
