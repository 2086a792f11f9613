// The growing complex of topokit.view: balls, edges, triangles and loops of a planar cloud, its diagram and its bars.
// Idea: the state is the points and one radius. A moved point computes all loops anew, a new radius only draws.
(() => {
  const [scene, diagram, strip] = [$("scene"), $("diagram"), $("strip")];
  const home = data.points, low = [0, 1].map((k) => Math.min(...home.map((p) => p[k])));
  const size = [0, 1].map((k) => Math.max(...home.map((p) => p[k])) - low[k]), extent = Math.max(...size) || 1;
  let points, complex, end, radius, chosen = -1, held = false;

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
      loop.strong = loop.death - loop.birth >= 0.2 * longest;
    }
  }
  function fitEnd() { // only when no point is held: a scale that moves under the hand is no scale
    const last = complex.loops.reduce((m, l) => Math.max(m, l.death), 0);
    end = data.end || 1.15 * (last || complex.cone) || 1;
  }
  const paint = (loop) => data.palette[loop.colour % data.palette.length];
  const born = () => complex.loops.filter((l) => l.birth <= radius).reverse();
  const just = (value) => radius >= value && radius < value + 0.035 * end; // a flash, in radii

  // ---- the complex -------------------------------------------------------------------------------------------
  function view(w, h) {
    const scale = Math.min((w - 56) / (size[0] || extent), (h - 76) / (size[1] || extent)) * 0.94;
    const x = w / 2 - scale * (low[0] + size[0] / 2), y = h / 2 + 8 + scale * (low[1] + size[1] / 2);
    return { scale, to: (p) => [x + scale * p[0], y - scale * p[1]], back: (u, v) => [(u - x) / scale, (y - v) / scale] };
  }
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
    const [g, w, h] = start(scene), { scale, to } = view(w, h), S = points.map(to);
    const path = (ids, close) => {
      ids.forEach((v, k) => (k ? g.lineTo(...S[v]) : g.moveTo(...S[v])));
      if (close) g.closePath();
    };
    const stroke = (ids, style, width, close) => {
      [g.strokeStyle, g.lineWidth] = [style, width];
      g.beginPath();
      path(ids, close);
      g.stroke();
    };
    // One path for many triangles, all turned the same way so that none cuts a hole into another; not one for all,
    // since a browser takes time for what overlaps.
    let turned = 0;
    g.fillStyle = dark ? "#3d4955" : "#d0d8e1";
    g.beginPath();
    counts = triangles((i, j, k) => {
      const left = (S[j][0] - S[i][0]) * (S[k][1] - S[i][1]) > (S[j][1] - S[i][1]) * (S[k][0] - S[i][0]);
      path(left ? [i, j, k] : [i, k, j], true);
      if (++turned % 50) return;
      g.fill();
      g.beginPath();
    });
    g.fill();
    if ($("balls").checked) { // above the triangles: where they miss a place inside one, it shows
      g.beginPath(); // one path, so that the union of the balls has one tint
      for (const [x, y] of S) (g.moveTo(x + scale * radius, y), g.arc(x, y, scale * radius, 0, 7));
      g.fillStyle = fade(dark ? "#56b4e9" : "#0072b2", dark ? 0.17 : 0.13);
      g.fill();
      g.strokeStyle = fade(dark ? "#56b4e9" : "#0072b2", 0.3);
      g.lineWidth = 1;
      for (const [x, y] of S) {
        g.beginPath();
        g.arc(x, y, scale * radius, 0, 7);
        g.stroke();
      }
    }
    g.strokeStyle = fade(dark ? "#9fadbc" : "#5d6b7a", 0.75);
    g.lineWidth = 1;
    g.beginPath();
    for (const e of complex.edges) if (e.value <= radius) path([e.i, e.j]);
    g.stroke();
    for (const loop of born()) {
      const colour = paint(loop), weight = loop.strong ? 1 : 0.6;
      if (radius < loop.death) {
        const [first] = loop.cycle, cycle = loop.cycle;
        if (loop.strong) stroke(cycle, css("--panel"), 6, true);
        stroke(cycle, colour, 3 * weight, true);
        stroke([first, cycle[cycle.length - 1]], colour, just(loop.birth) ? 8 : 5.5 * weight);
      } else {
        const flash = just(loop.death);
        for (const ids of loop.triangles) {
          g.fillStyle = fade(colour, flash ? 0.8 : loop.strong ? 0.42 : 0.2);
          g.beginPath();
          path(ids, true);
          g.fill();
          stroke(ids, fade(colour, loop.strong ? 0.9 : 0.4), flash ? 2 : 1.2 * weight, true);
        }
        stroke(loop.killerEdge, css("--panel"), flash ? 9 : 7 * weight);
        stroke(loop.killerEdge, colour, flash ? 6 : 4 * weight);
      }
    }
    S.forEach(([x, y], v) => {
      g.beginPath();
      g.arc(x, y, 4, 0, 7);
      g.fillStyle = css("--ink");
      g.fill();
      [g.strokeStyle, g.lineWidth] = v === chosen ? [css("--accent"), 2.5] : [css("--panel"), 1];
      g.beginPath();
      g.arc(x, y, v === chosen ? 8 : 4.5, 0, 7);
      g.stroke();
    });
  }

  // ---- diagram and bars --------------------------------------------------------------------------------------
  function drawDiagram() {
    const wide = Math.min(end, Math.max(end / 3, 1.3 * complex.loops.reduce((m, l) => Math.max(m, l.birth), 0)));
    const [g, X, Y] = axes(diagram, wide, end, "diagram: death against birth", "birth");
    g.strokeStyle = css("--soft");
    line(g, X(0), Y(0), X(wide), Y(wide));
    [g.strokeStyle, g.lineWidth] = [css("--ink"), 1.2];
    line(g, X(0), Y(radius), X(Math.min(radius, wide)), Y(radius), [3, 3]);
    g.fillStyle = css("--ink");
    g.fillText("r", X(0) + 5, Y(radius) + (radius < 0.9 * end ? -9 : 10));
    for (const loop of born()) {
      const dead = radius >= loop.death, flash = dead && just(loop.death), x = X(loop.birth), y = Y(dead ? loop.death : radius);
      if (loop.death > end && dead) continue;
      [g.strokeStyle, g.lineWidth] = [fade(paint(loop), 0.45), 1.5];
      if (!dead) line(g, x, Y(loop.birth), x, y);
      g.beginPath();
      g.arc(x, y, (loop.strong ? 5.5 : 3.5) + (flash ? 2.5 : 0), 0, 7);
      g.fillStyle = dead ? paint(loop) : css("--panel");
      g.fill();
      [g.strokeStyle, g.lineWidth] = dead ? [css("--panel"), 1] : [paint(loop), 2];
      g.stroke();
    }
  }
  function drawStrip() {
    const [g, X, , box] = axes(strip, end, 1, "bars: from birth to death", "r", []);
    const rows = [...complex.loops].sort((a, b) => a.birth - b.birth), step = Math.min(16, box.h / (rows.length || 1));
    strip.box = box;
    [g.strokeStyle, g.lineWidth] = [css("--line"), 1];
    line(g, box.x, box.y + box.h, box.x + box.w, box.y + box.h);
    g.lineCap = "butt";
    rows.forEach((loop, k) => {
      if (loop.birth > radius) return;
      const y = box.y + (k + 0.5) * step;
      [g.strokeStyle, g.lineWidth] = [fade(paint(loop), loop.strong ? 1 : 0.55), Math.max(1.5, Math.min(8, 0.6 * step))];
      line(g, X(loop.birth), y, Math.max(X(Math.min(radius, loop.death, end)), X(loop.birth) + 2), y);
    });
    [g.strokeStyle, g.lineWidth] = [css("--ink"), 1.5];
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
    const text = [`r = ${show(radius)}`, many(counts[0], "edge"), many(counts[1], "triangle"), many(pieces, "component"), many(alive, "loop")].join(" \u00b7 ");
    $("status").textContent = text;
    $("radius").value = Math.round((200 * radius) / end);
    $("radius").setAttribute("aria-valuetext", text);
    const dead = born().filter((l) => l.death <= radius).reverse();
    const word = dead.map((l) => `born ${show(l.birth)}, died ${show(l.death)}`).join("; ") || "no loop has died";
    diagram.setAttribute("aria-label", `persistence diagram at ${text}; ${word}`);
    strip.setAttribute("aria-label", `a bar for every loop, from birth to death, at r = ${show(radius)}`);
    scene.setAttribute("aria-label", `Rips complex at ${text}. Drag a point, or choose one with the keys n and p and move it with the arrow keys; Escape puts the points back.`);
  }
  const later = lazily(draw);
  const go = (r) => {
    radius = Math.max(0, Math.min(end, r));
    later();
  };
  const play = playback(() => radius, go, () => end, 10);
  $("radius").oninput = (e) => (play(false), go((e.target.value / 200) * end));
  $("next").onclick = () => {
    play(false);
    go(Math.min(...complex.loops.flatMap((l) => [l.birth, l.death]).filter((v) => v > radius), end));
  };
  $("balls").onchange = later;
  strip.onpointerdown = strip.onpointermove = (e) => {
    if (!e.buttons) return;
    strip.setPointerCapture(e.pointerId);
    play(false);
    go(((e.offsetX - strip.box.x) / strip.box.w) * end);
  };

  // ---- points ------------------------------------------------------------------------------------------------
  const here = () => view(scene.clientWidth, scene.clientHeight);
  function near(x, y, reach) {
    const { to } = here(), away = points.map((p) => Math.hypot(to(p)[0] - x, to(p)[1] - y));
    const best = away.indexOf(Math.min(...away));
    return away[best] < reach ? best : -1;
  }
  function place(v, x, y) { // inside the picture, where it can be found again
    const inside = (value, high) => Math.max(8, Math.min(high - 8, value));
    points[v] = here().back(inside(x, scene.clientWidth), inside(y, scene.clientHeight));
    compute();
    later();
  }
  function drop() {
    held = false;
    fitEnd();
    go(radius);
  }
  function reset() {
    points = home.map((p) => [...p]);
    chosen = -1;
    compute();
    drop();
  }
  scene.addEventListener("touchstart", (e) => { // a finger on a point drags it, a finger beside one scrolls the page
    const { left, top } = scene.getBoundingClientRect(), { clientX, clientY } = e.touches[0];
    if (near(clientX - left, clientY - top, 24) >= 0) e.preventDefault();
  }, { passive: false });
  scene.onpointerdown = (e) => {
    chosen = near(e.offsetX, e.offsetY, e.pointerType === "mouse" ? 14 : 24);
    held = chosen >= 0;
    if (held) scene.setPointerCapture(e.pointerId);
    later();
  };
  scene.onpointermove = (e) => {
    if (held) place(chosen, e.offsetX, e.offsetY);
    else scene.style.cursor = near(e.offsetX, e.offsetY, 14) >= 0 ? "grab" : "";
  };
  scene.onpointerup = scene.onpointercancel = () => held && drop();
  scene.onkeydown = (e) => {
    const n = points.length, move = (dx, dy) => () => {
      if (chosen < 0) return;
      const [x, y] = here().to(points[chosen]);
      place(chosen, x + dx, y + dy);
      drop();
    };
    const choose = (v) => () => ((chosen = v), later());
    const act = { n: choose((chosen + 1) % n), p: choose((Math.max(chosen, 0) + n - 1) % n), Escape: reset, " ": () => play(),
      ArrowLeft: move(-4, 0), ArrowRight: move(4, 0), ArrowUp: move(0, -4), ArrowDown: move(0, 4) }[e.key];
    if (act) (e.preventDefault(), act());
  };
  $("reset").onclick = reset;

  // ---- start -------------------------------------------------------------------------------------------------
  $("balls").checked = data.balls;
  radius = 0;
  reset();
  const [longest] = complex.loops;
  go(data.start ?? (longest ? (longest.birth + longest.death) / 2 : end / 2));
  watch(later, () => {});
})();
