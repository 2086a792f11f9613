// A small motion of a planar cloud: every point within epsilon of its home, the loops before and after.
// Idea: the state is where the points are and how far they may go. Loops are computed anew whenever a point moves.
(() => {
  const [scene, diagram, strip] = [$("scene"), $("diagram"), $("strip")];
  const home = data.points, most = 2 * data.epsilon, frame = framing(home, 1.35 * data.epsilon);
  const before = rips(home), high = 1.25 * Math.max(...before.loops.map((l) => l.death + data.epsilon), before.cone / 2);
  let points, after, match, epsilon = data.epsilon, way = 0, chosen = -1;

  // ---- motion ------------------------------------------------------------------------------------------------
  function leashed(v, [x, y]) { // as far towards (x, y) as the disc allows
    const [dx, dy] = [x - home[v][0], y - home[v][1]], share = Math.min(1, epsilon / (Math.hypot(dx, dy) || 1));
    return [home[v][0] + share * dx, home[v][1] + share * dy];
  }
  function room([x, y], [dx, dy]) { // the share of a step that ends on the edge of the disc
    const a = dx * dx + dy * dy, b = x * dx + y * dy, c = Math.min(0, x * x + y * y - epsilon * epsilon);
    return a ? (Math.sqrt(b * b - a * c) - b) / a : Infinity;
  }
  function compute() {
    after = rips(points);
    match = matchLoops(before.loops, after.loops);
    later();
  }
  function place(v, where) {
    points[v] = leashed(v, where);
    compute();
  }
  function along(share) { // a share of the way to the motion that was prepared
    way = clamp(share, 0, 1);
    points = home.map((p, v) => leashed(v, p.map((x, k) => x + way * (data.after[v][k] - x))));
    compute();
  }
  function reset() {
    chosen = -1;
    way = 0;
    points = home.map((p) => [...p]);
    compute();
  }
  const displacement = () => Math.max(...points.map((p, v) => Math.hypot(p[0] - home[v][0], p[1] - home[v][1])));
  function distortion() { // half the largest change of a distance
    const length = (cloud, i, j) => Math.hypot(cloud[i][0] - cloud[j][0], cloud[i][1] - cloud[j][1]);
    let largest = 0;
    for (let i = 0; i < home.length; i++) for (let j = 0; j < i; j++) largest = Math.max(largest, Math.abs(length(points, i, j) - length(home, i, j)));
    return largest / 2;
  }

  // ---- drawing -----------------------------------------------------------------------------------------------
  function drawScene() {
    const [g, w, h] = start(scene), { scale, to } = frame(w, h), H = home.map(to), S = points.map(to);
    for (const p of H) dot(g, p, scale * epsilon, fade(blue(), dark ? 0.17 : 0.12), fade(blue(), 0.45));
    before.loops.forEach((loop) => trace(g, loop.cycle.map((v) => H[v]), fade(css("--soft"), 0.6), 1.2, { close: true, dash: [4, 4] }));
    before.loops.forEach((loop, k) => {
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
      dot(g, p, 6, css("--ink"), v === chosen ? css("--accent") : css("--panel"), v === chosen ? 3 : 1.5);
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
    for (const [name, value] of [["\u03b5", epsilon], ["2\u03b5", 2 * epsilon]]) g.fillText(name, X(0.85 * high - value) + 7, Y(0.85 * high) + 4);
    before.loops.forEach((loop, k) => {
      const [x, y] = [X(loop.birth), Y(loop.death)], [a, b] = [X(epsilon) - X(0), Y(0) - Y(epsilon)];
      g.fillStyle = fade(paint(k), 0.12);
      g.fillRect(x - a, y - b, 2 * a, 2 * b);
      [g.strokeStyle, g.lineWidth] = [fade(paint(k), 0.5), 1];
      g.strokeRect(x - a, y - b, 2 * a, 2 * b);
      const there = after.loops[match.partner[k]];
      if (there) trace(g, [[x, y], [X(there.birth), Y(there.death)]], paint(k), 1.5);
      dot(g, [x, y], 5, css("--panel"), paint(k), 2);
    });
    after.loops.forEach((loop, j) => {
      const k = match.partner.indexOf(j);
      dot(g, [X(loop.birth), Y(loop.death)], k < 0 ? 3.5 : 5.5, k < 0 ? css("--soft") : paint(k), css("--panel"), 1);
    });
  }
  function drawStrip() {
    const [g, X, , box] = axes(strip, high, 1, "bars, before and after", "r", []), step = Math.min(26, box.h / Math.max(1, before.loops.length));
    g.lineCap = "butt";
    before.loops.forEach((loop, k) => {
      const there = after.loops[match.partner[k]], y = box.y + (k + 0.5) * step;
      trace(g, [[X(loop.birth), y - 0.2 * step], [X(loop.death), y - 0.2 * step]], fade(paint(k), 0.4), Math.min(7, 0.3 * step));
      if (there) trace(g, [[X(there.birth), y + 0.2 * step], [X(there.death), y + 0.2 * step]], paint(k), Math.min(7, 0.3 * step));
    });
  }
  function draw() {
    drawScene();
    drawDiagram();
    drawStrip();
    const digits = Math.max(0, 2 - Math.floor(Math.log10(data.epsilon))), show = (v) => v.toFixed(digits);
    const [loop] = before.loops, there = loop && after.loops[match.partner[0]], span = (l) => l.death - l.birth;
    const ratio = loop ? `, ${(span(loop) / epsilon).toFixed(2)} \u03b5` : "";
    const text = [`\u03b5 = ${show(epsilon)}`, `moved ${show(displacement())}`, `\u03b4 = ${show(distortion())}`,
      loop ? `lifetime ${show(span(loop))}${ratio}` : "no loop before", there ? `now ${show(span(there))}` : "now no loop"].join(" \u00b7 ");
    $("status").textContent = text;
    $("epsilon").value = Math.round((200 * epsilon) / most);
    $("epsilon").setAttribute("aria-valuetext", show(epsilon));
    scene.setAttribute("aria-label", `${text}. Drag a point within its disc, or beside all points to move them together; or choose one with the keys n and p and move it with the arrow keys; Escape puts the points back.`);
    diagram.setAttribute("aria-label", `diagrams before and after; ${text}`);
    strip.setAttribute("aria-label", `bars before and after; ${text}`);
  }
  const later = lazily(draw);

  // ---- hands -------------------------------------------------------------------------------------------------
  const still = () => play && play(false);
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
  });
  $("epsilon").oninput = (e) => {
    epsilon = Math.max(1, +e.target.value) * most / 200;
    points = points.map((p, v) => leashed(v, p));
    compute();
  };
  onReset(() => (still(), reset()));
  const play = data.after ? playback(() => way, along, () => 1, 3) : null;
  if (!play) $("play").remove();

  // ---- start -------------------------------------------------------------------------------------------------
  reset();
  watch(later, () => {});
})();
