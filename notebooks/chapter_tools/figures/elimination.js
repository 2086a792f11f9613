// A boundary matrix and its cloud, reduced one sum of columns at a time; pairs enter the diagram as they are found.
// Idea: all steps are computed when a point moves; the slider shows one of them, in the matrix, in the picture and in the diagram.
(() => {
  const [scene, matrix, diagram] = [$("scene"), $("matrix"), $("diagram")], home = data.points, frame = framing(home, 0.08 * Math.max(...home.map((p) => apart(p, home[0]))));
  const PIVOT = 0, REST = 2; // colours
  let points, all, step, chosen = -1;
  const name = (ids) => ids.join(points.length > 10 ? "\u2009" : ""), edge = (k) => `${all.rows[k].i}\u2013${all.rows[k].j}`;
  const last = () => all.steps.filter((s, k) => k <= step && s.next < 0), now = () => all.steps[step];
  const columnOf = (k) => (now() && k === now().k ? now() : last().find((s) => s.k === k)) || { column: all.columns[k].boundary };

  // ---- words -------------------------------------------------------------------------------------------------
  function explanation() {
    if (!now()) return "no triangle";
    const { k, column, chain, next } = now(), sum = [k, ...bits(chain).filter((t) => t !== k)].map((t) => name(all.columns[t].ids)).join(" + ");
    if (!column) return `${sum}: nothing is left, the triangles close a surface`;
    const at = pivot(column), birth = all.rows[at], killer = all.rows[all.columns[k].latest];
    if (next >= 0) return `${sum}: the pivot ${edge(at)} belongs to column ${name(all.columns[next].ids)}, which is added next`;
    const life = birth.value < killer.value ? `with edge ${edge(all.columns[k].latest)}, having lived from ${birth.value.toFixed(2)} to ${killer.value.toFixed(2)}` : "at once";
    return `${sum}: the pivot ${edge(at)} is new; its loop dies ${life}`;
  }

  // ---- drawing -----------------------------------------------------------------------------------------------
  function drawScene() {
    const [g, w, h] = start(scene), { to } = frame(w, h), S = points.map(to), e = (k) => [S[all.rows[k].i], S[all.rows[k].j]];
    if (now()) for (const t of bits(now().chain)) trace(g, all.columns[t].ids.map((v) => S[v]), null, 0, { close: true, fill: fade(t === now().k ? paint(PIVOT) : blue(), 0.25) });
    all.rows.forEach((_, k) => trace(g, e(k), fade(css("--soft"), 0.6), 1.2));
    if (now()?.column) {
      for (const k of bits(now().column)) trace(g, e(k), paint(REST), 4);
      trace(g, e(pivot(now().column)), paint(PIVOT), 6.5);
    }
    S.forEach((p, v) => {
      dot(g, p, 4.5, css("--ink"), css("--panel"), 1);
      if (v === chosen) dot(g, p, 9, null, css("--accent"), 2.5);
      g.fillStyle = css("--ink");
      word(g, v, p[0] + 9, p[1] - 11);
    });
  }
  function drawMatrix() {
    const [g, w, h] = start(matrix), [n, m] = [all.rows.length || 1, all.columns.length || 1], box = (matrix.box = { x: 44, y: 50, w: w - 54, h: h - 58 });
    const [a, b] = [Math.min(box.w / m, 56), Math.min(box.h / n, 28)], size = 0.42 * Math.min(a, b), X = (t) => box.x + (t + 0.5) * a, Y = (k) => box.y + (k + 0.5) * b;
    box.w = a * m;
    const band = (t, ink) => t >= 0 && ((g.fillStyle = fade(ink, 0.2)), g.fillRect(X(t) - a / 2, box.y - 20, a, b * n + 22));
    g.fillStyle = css("--soft");
    g.fillText("edges \u00d7 triangles, modulo 2", 10, 18);
    if (now()) (band(now().k, paint(PIVOT)), band(now().next, blue()));
    [g.textBaseline, g.fillStyle] = ["middle", css("--ink")];
    g.textAlign = "right";
    if (b > 9) all.rows.forEach((_, k) => g.fillText(edge(k), box.x - 5, Y(k)));
    g.textAlign = "center";
    if (a > 20) all.columns.forEach(({ ids }, t) => g.fillText(name(ids), X(t), box.y - 10));
    pen(g, css("--line"), 1);
    all.rows.forEach((_, k) => line(g, box.x, Y(k), box.x + a * m, Y(k)));
    all.columns.forEach((_, t) => {
      const { column, next } = columnOf(t), here = t === now()?.k;
      bits(column).forEach((k) => {
        const low = k === pivot(column);
        g.fillStyle = low && next < 0 ? paint(PIVOT) : here ? paint(REST) : css("--soft"); // a pivot of its own is found
        g.fillRect(X(t) - size, Y(k) - size, 2 * size, 2 * size);
        if (low && here) trace(g, [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([p, q]) => [X(t) + p * (size + 2), Y(k) + q * (size + 2)]), css("--ink"), 2, { close: true });
      });
    });
  }
  function drawDiagram() {
    const high = 1.1 * data.radius, [g, X, Y] = axes(diagram, high, high, "pairs: death against birth", "birth");
    g.strokeStyle = css("--soft");
    line(g, X(0), Y(0), X(high), Y(high));
    for (const s of last()) if (s.column) {
      const [birth, death] = [pivot(s.column), all.columns[s.k].latest].map((k) => all.rows[k].value);
      dot(g, [X(birth), Y(death)], s === now() ? 7 : 5, birth < death ? paint(PIVOT) : css("--panel"), paint(PIVOT), 2);
    }
  }
  function draw() {
    drawScene();
    drawMatrix();
    drawDiagram();
    const text = `step ${step + 1} of ${all.steps.length} \u00b7 ${explanation()}`;
    $("status").textContent = text;
    [$("step").max, $("step").value] = [Math.max(0, all.steps.length - 1), step];
    $("step").setAttribute("aria-valuetext", text);
    const ones = now() ? bits(now().column).map(edge).join(", ") || "no edge" : "none";
    describe(matrix, `boundary matrix of ${all.rows.length} edges and ${all.columns.length} triangles; in the present column ${ones}; ${text}`);
    describe(diagram, `the pairs that have been found, ${last().length} of ${all.columns.length} columns done`);
    describe(scene, `${text}. Drag a point, or choose one with the keys n and p and move it with the arrow keys; click a column to go to its end; Escape puts the points back.`);
  }
  const later = lazily(draw);

  // ---- steps and points --------------------------------------------------------------------------------------
  const [go, play] = stepped($("step"), () => Math.max(0, all.steps.length - 1), (k) => ((step = k), later()), 12);
  const by = (d) => () => (play(false), go(step + d));
  [$("back").onclick, $("next").onclick] = [by(-1), by(1)];
  scrub(matrix, (share) => {
    play(false);
    const k = clamp(Math.floor(share * all.columns.length), 0, all.columns.length - 1);
    if (k >= 0) go(all.steps.findLastIndex((s) => s.k === k));
  });
  function put(v, where) {
    points[v] = where;
    all = eliminate(points, data.radius);
    go(step);
  }
  function reset() {
    play(false);
    points = home.map((p) => [...p]);
    [all, chosen] = [eliminate(points, data.radius), -1];
    go(Math.max(0, all.steps.findIndex((s) => s.added >= 0)));
  }
  const choose = (v) => (play(false), (chosen = v), later());
  hands(scene, { points: () => points, frame, chosen: () => chosen, press: choose, put, miss: () => choose(-1), Escape: reset, " ": () => play() });
  onReset(reset);
  reset();
  watch(later);
})();
