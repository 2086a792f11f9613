// A planar scene and what is observed of it: the covering radius, the loops of both, and where each loop must be seen.
// Idea: the state is the points, a flag for each, whether it is observed, and a hand, a disc that hides what is below it. Both
// diagrams are computed anew at every change.
(() => {
  const [scene, diagram, strip] = [$("scene"), $("diagram"), $("strip")];
  const n = data.points.length, frame = framing(data.points, 0);
  let points, seen, all, some, match, alpha, worst, spread, hand, reach, from, chosen = -1; // the hand is chosen as point n

  // ---- what follows from the state ---------------------------------------------------------------------------
  const away = (i, j) => Math.hypot(points[i][0] - points[j][0], points[i][1] - points[j][1]);
  const within = ([x, y], far) => data.hand && Math.hypot(x - hand[0], y - hand[1]) < far;
  const ids = () => [...points.keys()].filter((v) => seen[v] && !within(points[v], reach));
  function compute() {
    const observed = ids();
    worst = [0, observed[0]];
    alpha = 0;
    for (let v = 0; v < n; v++) {
      const next = observed.reduce((best, o) => (away(v, o) < away(v, best) ? o : best), observed[0]);
      if (away(v, next) > alpha) [alpha, worst] = [away(v, next), [v, next]];
    }
    some = rips(observed.map((v) => points[v]));
    for (const loop of some.loops) { // ids in the scene
      const whole = (list) => list.map((v) => observed[v]);
      [loop.edge, loop.walk] = [whole(loop.killerEdge), whole(loop.cycle)];
    }
    match = matchLoops(all.loops, some.loops, true);
    later();
  }
  function change() { // the scene itself
    all = rips(points);
    spread = farthestPoints(flatOf(points), n, 2, n);
    compute();
  }
  function attempt(what) { // nothing observed has no covering radius
    const before = [seen, hand, reach];
    what();
    if (!ids().length) [seen, hand, reach] = before;
    compute();
  }
  const observe = (flags) => attempt(() => (seen = flags));
  const first = (count) => observe(points.map((_, v) => spread.ids.indexOf(v) < count));
  function reset() {
    points = data.points.map((p) => [...p]);
    seen = points.map((_, v) => data.observed.includes(v));
    if (data.hand) [hand, reach] = [data.hand.slice(0, 2), data.hand[2]];
    chosen = -1;
    change();
  }

  // ---- drawing -----------------------------------------------------------------------------------------------
  const life = (l) => l.death - l.birth;
  const promised = (l) => life(l) > alpha * (1 + 1e-9);
  const strong = (l) => promised(l) || life(l) >= 0.2 * life(all.loops[0]);
  function drawScene() {
    const [g, w, h] = start(scene), { scale, to } = frame(w, h), S = points.map(to);
    if ($("balls").checked && alpha > 0) balls(g, ids().map((v) => S[v]), scale * alpha, dark ? 0.17 : 0.13, 0.25);
    all.loops.forEach((loop, k) => strong(loop) && trace(g, loop.cycle.map((v) => S[v]), fade(paint(k), 0.75), 1.4, { close: true, dash: [3, 4] }));
    all.loops.forEach((loop, k) => {
      const there = some.loops[match.partner[k]];
      if (!there || !strong(loop)) return;
      trace(g, there.walk.map((v) => S[v]), paint(k), 3, { close: true });
      trace(g, there.edge.map((v) => S[v]), paint(k), 3, { dash: [9, 7] });
    });
    if (alpha > 0) {
      trace(g, worst.map((v) => S[v]), css("--ink"), 2);
      const [a, b] = worst.map((v) => S[v]);
      g.fillStyle = css("--ink");
      g.fillText("\u03b1", (a[0] + b[0]) / 2 + 6, (a[1] + b[1]) / 2 - 8);
    }
    const there = ids();
    S.forEach((p, v) => {
      if (there.includes(v)) dot(g, p, 5, css("--ink"), css("--panel"), 1.5);
      else dot(g, p, 4, css("--panel"), css("--soft"), 1.5);
      if (v === chosen) dot(g, p, 9, null, css("--accent"), 2.5);
    });
    if (data.hand) dot(g, to(hand), scale * reach, fade(dark ? "#9fadbc" : "#5d6b7a", 0.4), css(chosen === n ? "--accent" : "--soft"), chosen === n ? 3 : 1.5);
  }
  function drawDiagram() {
    const high = 1.1 * Math.max(all.cone, ...all.loops.map((l) => l.death + Math.min(alpha, life(l)))) || 1;
    const [g, X, Y] = axes(diagram, high, high, "all points (ring), observed (dot): death", "birth");
    g.strokeStyle = css("--soft");
    line(g, X(0), Y(0), X(high), Y(high));
    if (alpha > 0 && alpha < 0.8 * high) {
      line(g, X(0), Y(alpha), X(high - alpha), Y(high), [4, 4]);
      g.fillStyle = css("--soft");
      g.textAlign = "right";
      g.fillText("lifetime \u03b1", X(0.8 * high - alpha) - 9, Y(0.8 * high));
      g.textAlign = "left";
    }
    all.loops.forEach((loop, k) => {
      const [x, y] = [X(loop.birth), Y(loop.death)], there = some.loops[match.partner[k]];
      if (promised(loop)) {
        const [a, b] = [X(alpha) - X(0), Y(0) - Y(alpha)];
        g.fillStyle = fade(paint(k), 0.14);
        g.fillRect(x, y - b, a, b);
        pen(g, fade(paint(k), 0.6), 1);
        g.strokeRect(x, y - b, a, b);
      }
      if (there) trace(g, [[x, y], [X(there.birth), Y(there.death)]], fade(paint(k), strong(loop) ? 1 : 0.4), 1.5);
      dot(g, [x, y], strong(loop) ? 5 : 3, css("--panel"), fade(paint(k), strong(loop) ? 1 : 0.4), strong(loop) ? 2 : 1.2);
    });
    some.loops.forEach((loop, j) => {
      const k = match.partner.indexOf(j), weighty = k >= 0 && strong(all.loops[k]);
      dot(g, [X(loop.birth), Y(loop.death)], weighty ? 5.5 : 3, weighty ? paint(k) : css("--soft"), css("--panel"), 1);
    });
  }
  function drawStrip() {
    const high = 1.05 * Math.max(spread.radii[0], alpha) || 1, [g, X, Y] = axes(strip, n, high, "\u03b1 against the number of points", "points");
    all.loops.forEach((loop, k) => {
      if (life(loop) < 0.2 * life(all.loops[0])) return;
      g.strokeStyle = paint(k);
      line(g, X(0), Y(life(loop)), X(n), Y(life(loop)), [5, 4]);
    });
    trace(g, [...spread.radii].map((r, k) => [X(k + 1), Y(r)]), css("--soft"), 1.8);
    dot(g, [X(ids().length), Y(alpha)], 5.5, css("--ink"), css("--panel"), 1.5);
  }
  function draw() {
    drawScene();
    drawDiagram();
    drawStrip();
    const size = Math.max(all.cone, 1e-9), digits = Math.max(0, 2 - Math.floor(Math.log10(size))), show = (v) => v.toFixed(digits);
    const [loop] = all.loops, there = loop && some.loops[match.partner[0]], count = ids().length;
    const text = [`${count} of ${n} points`, `\u03b1 = ${show(alpha)}`];
    if (data.hand) text.push(`guessed ${show(Math.max(...placeGaps(flatOf(ids().map((v) => points[v])), ids().length, 2)) / 2)}`);
    if (data.hand) $("hand").value = 100 * reach / data.hand[2];
    if (loop) {
      text.push(`longest lifetime ${show(life(loop))}` + (alpha > 0 ? `, ${(life(loop) / alpha).toFixed(alpha < life(loop) && life(loop) < 1.01 * alpha ? 4 : 2)} \u03b1` : ""));
      text.push(there ? `observed: birth ${show(there.birth - loop.birth)} later, death ${show(there.death - loop.death)} later` : "not observed");
    }
    $("status").textContent = text.join(" \u00b7 ");
    $("count").value = count;
    $("count").setAttribute("aria-valuetext", $("status").textContent);
    describe(scene, `A scene of ${n} points; ${$("status").textContent}. ${data.hand ? "Drag the hand, which the key p chooses. " : ""}Click a point to hide or show it, drag it to move it; or choose one with the keys n and p, hide or show it with Enter, and move it with the arrow keys; Escape begins anew.`);
    describe(diagram, `diagrams of all and of the observed points; ${$("status").textContent}`);
    describe(strip, `covering radius of farthest-point samples, and of the present one: ${show(alpha)} with ${count} points`);
  }
  const later = lazily(draw);

  // ---- hands -------------------------------------------------------------------------------------------------
  const toggle = (v) => observe(seen.map((flag, i) => (i === v ? !flag : flag)));
  const choose = (v) => ((chosen = v), (from = hand), later());
  function place(v, where, by) {
    if (v === n) return attempt(() => (hand = by ? from.map((c, k) => c + by[k]) : where));
    points[v] = where;
    change();
  }
  draggable(scene, {
    points: () => points,
    frame,
    grab: (where, scale) => within(where, Math.max(reach, 12 / scale)) && n,
    press: choose,
    move: place,
    tap: toggle,
  });
  walk(scene, {
    count: () => n + !!data.hand,
    chosen: () => chosen,
    choose,
    move: (v, dx, dy) => place(v, beside(scene, frame, points[v] || hand, dx, dy)),
    Escape: reset,
    Enter: () => chosen >= 0 && toggle(chosen),
  });
  scrub(strip, (share) => first(clamp(Math.round(share * n), 1, n)));
  $("count").max = n;
  $("count").oninput = (e) => first(+e.target.value);
  $("dice").onclick = () => {
    const drawn = [...points.keys()].map((v) => [Math.random(), v]).sort((a, b) => a[0] - b[0]).slice(0, ids().length).map(([, v]) => v);
    observe(points.map((_, v) => drawn.includes(v)));
  };
  $("balls").onchange = later;
  $("hand").closest("label").hidden = !data.hand;
  $("hand").oninput = (e) => attempt(() => (reach = (e.target.value / 100) * data.hand[2]));
  onReset(reset);

  // ---- start -------------------------------------------------------------------------------------------------
  reset();
  watch(later);
})();
