// A closed curve that the reader bends by its handles, and a line that is closed far away: are they linked?
// Idea: numbers and distances for all places of the slider are computed at once; the picture shows one place, from one side.
(() => {
  const [scene, numbers, gaps] = [$("scene"), $("numbers"), $("gaps")], STEPS = 60, DRAGGED = 6, PIECES = 6, home = { az: -50, el: 18 };
  const far = data.line, tip = far.length - 5, cam = { ...home };
  let handles, vertex, step, rows;

  // ---- places --------------------------------------------------------------------------------------------------
  const legs = data.way.slice(1).map((p, k) => Math.hypot(...minus(p, data.way[k]))), whole = legs.reduce((a, b) => a + b, 0);
  function shift(k) { // how far the loop has come, at an even pace
    let left = (k / STEPS) * whole, leg = 0;
    while (leg < legs.length - 1 && left > legs[leg]) left -= legs[leg++];
    return along(data.way[leg], data.way[leg + 1], legs[leg] ? left / legs[leg] : 0);
  }
  const plus = (p, q) => p.map((v, k) => v + q[k]), at = (k) => handles.map((p) => plus(p, shift(k)));
  const curve = (k) => smooth(at(k), PIECES);
  const rowAt = (k) => ({ k, number: Math.round(linkingSum(curve(k), far)), gap: gapOf(curve(k), far) });
  function sweep(every = 1) { // all places, or while a handle is dragged some
    rows = Array.from({ length: STEPS / every + 1 }, (_, k) => rowAt(k * every));
    later();
  }
  const now = () => rows.find((row) => row.k === step) || rowAt(step);

  // ---- the eye: from far away, so that a crossing in the picture is a crossing of shadows ---------------------------
  const all = [...data.curve.flatMap((p) => data.way.map((q) => plus(p, q))), ...far.slice(Math.max(0, tip - 1), tip + 1)];
  const [low, high] = [Math.min, Math.max].map((f) => [0, 1, 2].map((k) => f(...all.map((p) => p[k]))));
  const middle = along(low, high, 0.5), size = Math.hypot(...minus(high, low));
  function axesOf() {
    const [a, e] = [cam.az, cam.el].map((v) => (v * Math.PI) / 180), [sa, ca, se, ce] = [Math.sin(a), Math.cos(a), Math.sin(e), Math.cos(e)];
    return [[-sa, ca, 0], [-se * ca, -se * sa, ce], [ce * ca, ce * sa, se]];
  }
  const see = (p) => axesOf().map((axis) => inner(axis, minus(p, middle)));
  function frame(w, h) {
    const scale = (1.2 * Math.min(w - 32, h - 56)) / size, [x, y] = [w / 2, h / 2 + 10], flat = ([r, u]) => [x + scale * r, y - scale * u];
    return { flat, to: (p) => flat(see(p)), back: (a, b) => [(a - x) / scale, (y - b) / scale] };
  }
  function put(v, [right, up], every) { // the handle goes there in the picture, as far from the eye as it was
    const [r, u] = see(at(step)[v]), [rightward, upward] = axesOf();
    handles[v] = handles[v].map((c, k) => c + (right - r) * rightward[k] + (up - u) * upward[k]);
    sweep(every);
  }

  // ---- the picture ---------------------------------------------------------------------------------------------
  const word = (n) => (n > 0 ? "+" : n < 0 ? "\u2212" : "") + Math.abs(n);
  function drawScene(a, b, found) {
    const [g, w, h] = start(scene), { flat, to } = frame(w, h), strands = [];
    const add = (p, q, ink, width, dash, alone) => strands.push({ depth: (p[2] + q[2]) / 2, one: flat(p), two: flat(q), ink, width, dash, alone });
    a.forEach((p, i) => add(p, a[(i + 1) % a.length], blue(), 3, [], true));
    const ends = [...b.slice(0, tip).map((p, i) => [p, b[i + 1], true]), [b[tip], b[tip + 1], false], [b[0], b[b.length - 1], false]];
    for (const [p, q, real] of ends) { // in short parts, so that each is drawn in front of what it runs in front of
      const length = Math.hypot(...minus(q, p)), part = (0.04 * size) / length;
      for (let s = 0; s < Math.min(1, (2 * size) / length); s += part) {
        const look = real ? [css("--soft"), 7, []] : [paint(0), 1.5, [5, 4]];
        add(along(p, q, s), along(p, q, Math.min(1, s + part)), ...look, s > 0 && s + part < 1); // not at a bend
      }
    }
    for (const s of strands.sort((p, q) => p.depth - q.depth)) { // what is in front interrupts what is behind
      g.lineCap = "butt";
      pen(g, css("--panel"), s.width + 7);
      if (s.alone) line(g, ...along(s.one, s.two, 0.15), ...along(s.one, s.two, 0.85));
      g.lineCap = "round";
      pen(g, s.ink, s.width);
      line(g, ...s.one, ...s.two, s.dash);
    }
    at(step).map(to).forEach((p, v) => dot(g, p, v === vertex ? 7 : 5, css("--ink"), css(v === vertex ? "--accent" : "--panel"), v === vertex ? 3 : 1));
    g.textAlign = "center";
    g.textBaseline = "middle";
    for (const { place, sign } of found) {
      const [x, y] = flat(place);
      dot(g, [x + 14, y - 14], 9, css("--ground"), sign > 0 ? blue() : paint(0), 2);
      g.fillStyle = css("--ink");
      g.fillText(sign > 0 ? "+" : "\u2212", x + 14, y - 13.5);
    }
  }
  function chart(canvas, title, high, value, marks, stepped) {
    const [g, X, Y, box] = axes(canvas, STEPS, high, title, "along its way", marks, []), places = [];
    rows.forEach((row, k) => {
      if (stepped && k) places.push([X(row.k), Y(value(rows[k - 1]))]);
      places.push([X(row.k), Y(value(row))]);
    });
    trace(g, places, blue(), 2.5);
    dot(g, [X(step), Y(value(now()))], 5, blue());
    pen(g, css("--ink"), 1.2);
    line(g, X(step), box.y, X(step), box.y + box.h, [3, 3]);
  }
  function draw() {
    const [a, b] = [curve(step).map(see), far.map(see)], found = crossingsOf(a, b), row = now();
    drawScene(a, b, found);
    const most = Math.max(1, ...rows.map((r) => Math.abs(r.number))), signs = found.map((c) => (c.sign > 0 ? "+" : "\u2212")).join(" ");
    chart(numbers, "size of the linking number", most + 0.5, (r) => Math.abs(r.number), Array.from({ length: most + 1 }, (_, k) => k), true);
    chart(gaps, "distance of the two curves", 1.1 * Math.max(...rows.map((r) => r.gap)), (r) => r.gap);
    const half = found.reduce((sum, c) => sum + c.sign, 0) / 2, text = `linking number ${word(row.number)}: `
      + (found.length ? `crossings ${signs}, half their sum ${word(half)}` : "no crossing from here") + ` \u00b7 distance ${row.gap.toFixed(3)}`;
    $("status").textContent = text;
    $("way").value = step;
    $("turn").value = cam.az;
    $("way").setAttribute("aria-valuetext", text);
    describe(numbers, "size of the linking number along the way; now " + text);
    describe(gaps, "distance of the two curves along the way; now " + text);
    describe(scene, text + ". Drag a handle, or beside them to turn the view; or choose a handle with the keys n and p and move it with "
      + "the arrow keys, which turn the view while none is chosen; Escape puts the loop back.");
  }
  const later = lazily(draw);
  const [go, play] = stepped($("way"), () => STEPS, (k) => {
    step = k;
    later();
  });

  // ---- hands ---------------------------------------------------------------------------------------------------
  function turn(az, el) {
    cam.az = ((cam.az + az + 540) % 360) - 180;
    cam.el = clamp(cam.el + el, -85, 85);
    later();
  }
  $("turn").oninput = (e) => turn(+e.target.value - cam.az, 0);
  function reset() {
    [handles, vertex] = [data.curve.map((p) => [...p]), -1];
    Object.assign(cam, home);
    play(false);
    go(0);
    sweep();
  }
  let from = null; // where the eye was when the drag began
  draggable(scene, {
    points: () => at(step),
    frame,
    all: true,
    press: (v) => (v >= 0 && (vertex = v), (from = { ...cam }), play(false), later()),
    move: (v, where, by) => {
      if (v >= 0) return put(v, where, DRAGGED);
      turn(from.az - (by[0] / size) * 180 - cam.az, from.el - (by[1] / size) * 120 - cam.el);
    },
    tap: (v) => ((vertex = v), later()),
    release: () => sweep(),
  });
  const arrow = (dx, dy) => () => (vertex < 0 ? turn(-5 * dx, 5 * dy) : put(vertex, beside(scene, frame, at(step)[vertex], dx, dy), DRAGGED));
  walk(scene, {
    count: () => handles.length,
    chosen: () => vertex,
    choose: (v) => ((vertex = v), later()),
    move: () => {},
    ArrowLeft: arrow(-1, 0), ArrowRight: arrow(1, 0), ArrowUp: arrow(0, -1), ArrowDown: arrow(0, 1),
    Escape: reset,
    " ": () => play(),
  });
  scene.onkeyup = () => rows.length <= STEPS && sweep();
  onReset(reset);
  reset();
  watch(later);
})();
