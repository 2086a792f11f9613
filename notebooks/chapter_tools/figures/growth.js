// The growing complex of topokit.view: balls, edges, triangles and loops of a cloud, its diagram and its bars.
// Idea: the state is the points and one radius. A moved point or another frame computes all
// loops anew. A new radius only draws.
(() => {
  const [scene, diagram, strip] = [$("scene"), $("diagram"), $("strip")];
  const film = data.film && unpack(data.film), frames = data.film?.shape[0], later = lazily(draw);
  const eye = film && orbit(scene, data.view, later, { " ": () => play() });
  const n = film?.length / 3 / frames, cloud = (t) => Array.from({ length: n }, (_, v) => [...film.subarray(3 * (n * t + v), 3 * (n * t + v + 1))]);
  const home = film ? Array.from({ length: frames }, (_, t) => cloud(t).map(onto(cloud(t)))).flat() : data.points;
  const widths = [0, 1].map((k) => Math.max(...home.map((p) => p[k])) - Math.min(...home.map((p) => p[k])));
  const frame = framing(home, 0.06 * (Math.max(...widths) || 1));
  let points, complex, end, radius, time = 0, chosen = -1;
  function onto(them) { // the plane of the picture: as it is, or as the eye sees the points around their middle
    const see = eye?.see([0, 1, 2].map((k) => them.reduce((sum, p) => sum + p[k], 0) / n));
    return see ? (p) => see(p).map((v) => eye.cam.zoom * v) : (p) => p;
  }

  // ---- loops -------------------------------------------------------------------------------------------------
  // A loop keeps its colour while its birth edge or its killer edge stays the same: dragging does not reshuffle.
  function compute() {
    const old = complex ? [...complex.loops] : [], free = (k) => !complex.loops.some((l) => l.colour === k);
    const same = (a, b) => a.killerEdge.join() === b.killerEdge.join() || a.birthEdge.join() === b.birthEdge.join();
    complex = rips(points);
    for (const loop of complex.loops) {
      const k = old.findIndex((l) => same(l, loop));
      if (k >= 0) loop.colour = old.splice(k, 1)[0].colour;
    }
    const longest = complex.loops.length ? complex.loops[0].death - complex.loops[0].birth : 0;
    for (const loop of complex.loops) {
      for (let k = 0; loop.colour === undefined; k++) if (k > 60 || free(k)) loop.colour = k;
      loop.strong = loop.death - loop.birth >= (film ? 0.6 * data.longest : 0.2 * longest);
    }
  }
  function fitEnd() { // only when no point is held: a scale that moves under the hand is no scale
    const last = complex.loops.reduce((m, l) => Math.max(m, l.death), 0);
    end = data.end || 1.15 * (last || complex.cone) || 1;
  }
  const born = () => complex.loops.filter((l) => l.birth <= radius).reverse();
  const just = (value) => radius >= value && radius < value + 0.035 * end; // a flash, in radii

  const grey = () => (dark ? "#9fadbc" : "#5d6b7a"), inkOf = (loop) => (film && !loop.strong ? grey() : paint(loop.colour)); // on cloth most are gaps of the sampling

  // ---- the complex -------------------------------------------------------------------------------------------
  function triangles(visit) { // all of the complex at this radius, each once
    const n = points.length, after = points.map(() => []), joined = new Uint8Array(n * n);
    let edges = 0, count = 0;
    for (const e of complex.edges) {
      if (e.value > radius) break;
      after[e.i].push(e.j);
      joined[e.i * n + e.j] = 1;
      edges++;
    }
    after.forEach((list, i) => list.forEach((j) => list.forEach((k) => {
      if (j < k && joined[j * n + k]) (count++, visit(i, j, k));
    })));
    return [edges, count];
  }
  let counts = [0, 0];
  function drawScene() {
    const [g, w, h] = start(scene), { scale, to } = frame(w, h), flat = points.map(onto(points)), S = flat.map(to), zoom = eye?.cam.zoom ?? 1;
    const stroke = (ids, style, width, close = false, dash = []) => trace(g, ids.map((v) => S[v]), style, width, { close, dash });
    // One path for many triangles, all turned the same way so that none cuts a hole into another; not one for all,
    // since a browser takes time for what overlaps.
    let turned = 0;
    g.fillStyle = fade(dark ? "#3d4955" : "#d0d8e1", film ? 0.5 : 1);
    g.beginPath();
    counts = triangles((i, j, k) => {
      const left = (S[j][0] - S[i][0]) * (S[k][1] - S[i][1]) > (S[j][1] - S[i][1]) * (S[k][0] - S[i][0]);
      (left ? [i, j, k] : [i, k, j]).forEach((v, n) => (n ? g.lineTo(...S[v]) : g.moveTo(...S[v])));
      g.closePath();
      if (++turned % (film ? 1 : 50)) return; // in space, one upon another
      g.fill();
      g.beginPath();
    });
    g.fill();
    if ($("balls").checked) balls(g, S, scale * zoom * radius, dark ? 0.17 : 0.13, 0.3); // above the triangles: where they miss a place inside one, it shows
    const depth = flat.map((p) => p[2] ?? 0), [far, near] = [Math.min, Math.max].map((f) => f(...depth));
    const nearness = (d) => (near > far ? (d - far) / (near - far) : 1);
    for (const level of film ? [0, 1, 2] : [2]) { // what is near is plainer
      g.strokeStyle = fade(grey(), 0.25 * (level + 1));
      g.lineWidth = 1;
      g.beginPath();
      for (const { i, j, value } of complex.edges)
        if (value <= radius && (!film || Math.round(nearness(depth[i]) + nearness(depth[j])) === level)) (g.moveTo(...S[i]), g.lineTo(...S[j]));
      g.stroke();
    }
    for (const loop of born()) {
      const ink = inkOf(loop), weight = loop.strong ? 1 : 0.6;
      if (radius < loop.death) {
        const [first] = loop.cycle, cycle = loop.cycle;
        if (loop.strong) stroke(cycle, css("--panel"), 6, true);
        stroke(cycle, ink, 3 * weight, true, loop.colour % 2 ? [2, 7] : []); // neighbours differ by more than their colour
        stroke([first, cycle[cycle.length - 1]], ink, just(loop.birth) ? 8 : 5.5 * weight);
      } else {
        const flash = just(loop.death), tint = fade(ink, flash ? 0.8 : loop.strong ? 0.42 : 0.2);
        if (film && !flash && !loop.strong) continue;
        for (const ids of loop.triangles)
          trace(g, ids.map((v) => S[v]), fade(ink, loop.strong ? 0.9 : 0.4), flash ? 2 : 1.2 * weight, { close: true, fill: tint });
        stroke(loop.killerEdge, css("--panel"), flash ? 9 : 7 * weight);
        stroke(loop.killerEdge, ink, flash ? 6 : 4 * weight);
      }
    }
    const { birthEdge, killerEdge, cycle, triangles: panes } = complex.loops[0] ?? {}; // of the longest, whatever the radius
    for (const ids of { birth: [birthEdge], killer: [killerEdge], cycle: [cycle], panes }[birthEdge && $("parts").querySelector(".lit")?.id] ?? [])
      for (const [ink, width] of [[css("--ink"), 11], ["#f0e442", 7]]) stroke(ids, ink, width, true);
    S.forEach((p, v) => {
      dot(g, p, film ? 1.5 + 2 * nearness(depth[v]) : 4, css("--ink"));
      if (film) return;
      if (v === chosen) dot(g, p, 8, null, css("--accent"), 2.5);
      else dot(g, p, 4.5, null, css("--panel"));
    });
  }

  // ---- diagram and bars --------------------------------------------------------------------------------------
  function drawDiagram() {
    const wide = Math.min(end, Math.max(end / 3, 1.3 * complex.loops.reduce((m, l) => Math.max(m, l.birth), 0)));
    const [g, X, Y] = axes(diagram, wide, end, "diagram: death against birth", "birth");
    g.strokeStyle = css("--soft");
    line(g, X(0), Y(0), X(wide), Y(wide));
    pen(g, css("--ink"), 1.2);
    line(g, X(0), Y(radius), X(Math.min(radius, wide)), Y(radius), [3, 3]);
    g.fillStyle = css("--ink");
    g.fillText("r", X(0) + 5, Y(radius) + (radius < 0.9 * end ? -9 : 10));
    for (const loop of born()) {
      const dead = radius >= loop.death, flash = dead && just(loop.death), x = X(loop.birth), y = Y(dead ? loop.death : radius);
      if (loop.death > end && dead) continue;
      pen(g, fade(inkOf(loop), 0.45), 1.5);
      if (!dead) line(g, x, Y(loop.birth), x, y);
      const size = (loop.strong ? 5.5 : 3.5) + (flash ? 2.5 : 0), [ink, ground] = [inkOf(loop), css("--panel")];
      if (dead) dot(g, [x, y], size, ink, ground, 1);
      else dot(g, [x, y], size, ground, ink, 2);
    }
  }
  function drawStrip() {
    const [g, X, , box] = axes(strip, end, 1, "bars: from birth to death", "r", []);
    const rows = [...complex.loops].sort((a, b) => a.birth - b.birth), step = Math.min(16, box.h / (rows.length || 1));
    pen(g, css("--line"), 1);
    line(g, box.x, box.y + box.h, box.x + box.w, box.y + box.h);
    g.lineCap = "butt";
    rows.forEach((loop, k) => {
      if (loop.birth > radius) return;
      const y = box.y + (k + 0.5) * step;
      pen(g, fade(inkOf(loop), loop.strong ? 1 : 0.55), Math.max(1.5, Math.min(8, 0.6 * step)));
      line(g, X(loop.birth), y, Math.max(X(Math.min(radius, loop.death, end)), X(loop.birth) + 2), y);
    });
    pen(g, css("--ink"), 1.5);
    line(g, X(Math.min(radius, end)), box.y - 4, X(Math.min(radius, end)), box.y + box.h);
  }

  // ---- radius ------------------------------------------------------------------------------------------------
  const many = (count, what) => `${count} ${what}${count === 1 ? "" : "s"}`;
  function draw() {
    drawScene();
    drawDiagram();
    drawStrip();
    const digits = Math.max(0, 2 - Math.floor(Math.log10(end))), show = (v) => v.toFixed(digits);
    const pieces = points.length - complex.merges.filter((v) => v <= radius).length;
    const alive = complex.loops.filter((l) => l.birth <= radius && radius < l.death).length;
    const text = [...(film ? [`frame ${time} of ${frames - 1}`] : []), `r = ${show(radius)}`, many(counts[0], "edge"), many(counts[1], "triangle"), many(pieces, "component"), many(alive, "loop")].join(" \u00b7 ");
    tell(text, $("radius"), Math.round((200 * radius) / end));
    const dead = born().filter((l) => l.death <= radius).reverse();
    const word = dead.map((l) => `born ${show(l.birth)}, died ${show(l.death)}`).join("; ") || "no loop has died";
    describe(diagram, `persistence diagram at ${text}; ${word}`);
    describe(strip, `a bar for every loop, from birth to death, at r = ${show(radius)}`);
    describe(scene, `Rips complex at ${text}. ${film ? `${TURN}; space plays.` : `Drag a point, or ${KEYS}`}`);
    $("time").value = time;
  }
  const go = (r) => {
    radius = clamp(r, 0, end);
    later();
  };
  const play = playback(() => radius, go, () => end, 10);
  $("radius").oninput = (e) => (play(false), go((e.target.value / 200) * end));
  $("next").onclick = () => {
    play(false);
    go(Math.min(...complex.loops.flatMap((l) => [l.birth, l.death]).filter((v) => v > radius), end));
  };
  $("balls").onchange = later;
  scrub(strip, (share) => (play(false), go(share * end)));

  // ---- points ------------------------------------------------------------------------------------------------
  function place(v, where) {
    points[v] = where;
    compute();
    later();
  }
  function drop() {
    fitEnd();
    go(radius);
  }
  function reset() {
    points = home.map((p) => [...p]);
    chosen = -1;
    compute();
    drop();
  }
  function at(t) {
    time = t;
    points = cloud(t);
    compute();
    later();
  }
  const choose = (v) => ((chosen = v), later());
  if (!film) draggable(scene, { points: () => points, frame, press: choose, miss: () => choose(-1), move: place, release: drop });
  if (!film) walk(scene, {
    count: () => points.length,
    chosen: () => chosen,
    choose,
    move: (v, dx, dy) => (place(v, beside(scene, frame, points[v], dx, dy)), drop()),
    Escape: reset,
    " ": () => play(),
  });
  onReset(film ? () => (eye.back(), at(data.frame)) : reset);
  $("time").closest("label").hidden = !film;
  $("time").oninput = (e) => at(+e.target.value);

  // ---- start -------------------------------------------------------------------------------------------------
  radius = 0;
  if (film) ($("time").max = frames - 1), at(data.frame), (end = data.end);
  else reset();
  const [longest] = complex.loops;
  go(data.start ?? (longest ? (longest.birth + longest.death) / 2 : end / 2));
  new MutationObserver(later).observe($("parts"), { attributes: true, subtree: true }); // a word of the page around points at one
  watch(later);
})();
