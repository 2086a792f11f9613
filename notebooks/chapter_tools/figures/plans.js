// Plans that bend under the hand, in the player: of a grid of plans the one whose end is nearest to the hand, as it was forecast.
// Idea: all forecast clouds are sums of a few modes, and between the knots a forecast goes along straight lines.
function bending(a, { rows, columns, knots, cycle, target, vertices }) { // rows from low to high, columns from left to right
  const K = knots.length, frames = knots[K - 1] + 1, stride = a.shares.length / (rows * columns * K);
  const home = [(columns - 1) / 2, (rows - 1) / 2], numbers = new Map(), triples = (ids) => ids.flatMap((v) => [3 * v, 3 * v + 1, 3 * v + 2]);
  const width = 3 * (vertices + 2), ring = triples(cycle), tips = triples([vertices, vertices + 1]); // the grippers come after the vertices
  const rank = a.modes.length / width, plan = ([c, r]) => r * columns + c;
  const at = [...home], turned = { matrix: [1, 0, 0, 1], end: [0, 0] };
  let held = null;

  function sharesAt(p, t) {
    const k = Math.max(1, knots.findIndex((knot) => knot >= t)), s = (t - knots[k - 1]) / (knots[k] - knots[k - 1]), from = (p * K + k - 1) * stride;
    return Array.from({ length: rank }, (_, m) => (1 - s) * a.shares[from + m] + s * a.shares[from + stride + m]);
  }
  function coordinates(p, t, which = null) { // of all vertices, or these entries
    const shares = sharesAt(p, t), out = new Float32Array(which ? which.length : width);
    shares.forEach((share, m) => {
      for (let i = 0; i < out.length; i++) out[i] += share * a.modes[m * width + (which ? which[i] : i)];
    });
    return out;
  }
  function number(p, t) { // of the loop and the target, in the forecast
    const key = p * frames + t, flat = numbers.has(key) ? null : coordinates(p, t, ring);
    if (flat) numbers.set(key, Math.round(linkingSum(cycle.map((_, i) => [...flat.subarray(3 * i, 3 * i + 3)]), target)) + 0);
    return numbers.get(key);
  }
  const middle = (p, t) => ((q) => [0, 1, 2].map((k) => (q[k] + q[k + 3]) / 2))(coordinates(p, t, tips));
  const axis = (last, first, n) => minus(middle(last, frames - 1), middle(first, frames - 1)).map((v) => v / Math.max(1, n - 1));
  const steps = [axis(columns - 1, 0, columns), axis((rows - 1) * columns, 0, rows)], cm = (k) => Math.round(100 * Math.hypot(...steps[k]) * (at[k] - home[k]));
  function choose(c, r) {
    [at[0], at[1]] = [clamp(Math.round(c), 0, columns - 1), clamp(Math.round(r), 0, rows - 1)];
    [a.points, a.grippers] = [new Float32Array(frames * 3 * vertices), new Float32Array(frames * 6)];
    for (let t = 0; t < frames; t++) {
      const all = coordinates(plan(at), t);
      a.points.set(all.subarray(0, 3 * vertices), t * 3 * vertices);
      a.grippers.set(all.subarray(3 * vertices), t * 6);
    }
  }
  const ink = (linked) => (linked ? blue() : paint(0));
  const text = (t) => `t+${t} \u00b7 end ${cm(0)} cm to the right, ${cm(1)} cm up \u00b7 linking number ${number(plan(at), t)}`.replaceAll(" -", " \u2212");

  function show(g, place, t) { // the loop, and the way of the hands with its end
    const loop = cycle.map((v) => place(a.points, 3 * (t * vertices + v))), linked = number(plan(at), t) !== 0;
    trace(g, loop, css("--panel"), 6, { close: true });
    trace(g, loop, ink(linked), 3.4, { close: true });
    const way = Array.from({ length: frames }, (_, k) => place(middle(plan(at), k), 0)), there = middle(plan(at), frames - 1);
    trace(g, way, css("--ink"), 1.4, { dash: [3, 4] });
    const [end, ...beside] = [there, ...steps.map((step) => step.map((v, k) => v + there[k]))].map((p) => place(p, 0));
    dot(g, end, 9, fade(css("--panel").trim(), 0.5), css("--panel"), 6);
    dot(g, end, 9, null, css("--ink"), 2.5);
    Object.assign(turned, { end, matrix: beside.flatMap((p) => [p[0] - end[0], p[1] - end[1]]) });
  }
  const frame = framing([[0, 0], [columns - 1, rows - 1]], 0.9);
  function map(t) { // which plans have the loop around the target
    const [g, w, h] = start($("diagram")), { to, scale } = frame(w, h), s = scale - 2;
    g.fillStyle = css("--soft");
    g.fillText(`linked at t+${t}, by where the plan ends`, 10, 18);
    [g.textAlign, g.textBaseline] = ["center", "middle"];
    for (let r = 0; r < rows; r++) for (let c = 0; c < columns; c++) {
      const [x, y] = to([c, r]), n = Math.abs(number(plan([c, r]), t));
      g.fillStyle = n ? blue() : css("--line");
      g.fillRect(x - s / 2, y - s / 2, s, s);
      if (n) ((g.fillStyle = css("--ground")), g.fillText(n, x, y + 0.5));
    }
    const [x, y] = to(at);
    pen(g, css("--ink"), 3);
    g.strokeRect(x - s / 2, y - s / 2, s, s);
    g.fillStyle = css("--soft");
    g.fillText("right \u2192", w / 2, to([0, 0])[1] + 0.5 * scale + 10);
    g.fillText("up \u2191", to([0, 0])[0] - 0.5 * scale - 18, to([0, rows - 1])[1]);
    describe($("diagram"), `${text(t)}. A map of ${rows * columns} plans by where they end; the arrow keys move the end, Escape puts it back.`);
  }
  function chart(t) {
    const along = Array.from({ length: frames }, (_, k) => Math.abs(number(plan(at), k))), most = Math.max(1, ...along), free = a.held.indexOf(0);
    const [g, X, Y, box] = axes($("strip"), frames - 1, most + 0.4, "size of the linking number", "frames ahead", Array.from({ length: most + 1 }, (_, k) => k));
    trace(g, along.flatMap((n, k) => [[X(k - 0.5), Y(n)], [X(k + 0.5), Y(n)]]).slice(1, -1), blue(), 2.5);
    g.strokeStyle = css("--soft");
    if (free > 0) (line(g, X(free), box.y, X(free), box.y + box.h, [2, 3]), g.fillText("let go", X(free) + 4, box.y + 7));
    pen(g, css("--ink"), 1.5);
    line(g, X(t), box.y - 4, X(t), box.y + box.h);
    describe($("strip"), `linking number over ${frames - 1} frames; now ${text(t)}`);
  }
  function hands(scene, later, still) { // the end of the plan is moved in the map, and in the picture where it is grasped
    const pad = $("diagram"), go = (c, r) => (still(), choose(c, r), later()), by = (c, r) => () => go(at[0] + c, at[1] + r);
    const near = (x, y, reach) => Math.hypot(x - turned.end[0], y - turned.end[1]) < reach;
    Object.assign(pad, { tabIndex: 0, role: "application" }).style.touchAction = "none";
    pad.onpointerdown = pad.onpointermove = (e) => {
      if (!e.buttons) return;
      pad.setPointerCapture(e.pointerId);
      go(...frame(pad.clientWidth, pad.clientHeight).back(e.offsetX, e.offsetY));
    };
    const reset = () => go(...home);
    keys(pad, () => ({ ArrowLeft: by(-1, 0), ArrowRight: by(1, 0), ArrowUp: by(0, 1), ArrowDown: by(0, -1), Escape: reset }));
    scene.addEventListener("touchstart", (e) => { // a finger on the end moves it, one beside it scrolls the page
      const { left, top } = scene.getBoundingClientRect(), { clientX, clientY } = e.touches[0];
      if (near(clientX - left, clientY - top, 26)) e.preventDefault();
    }, { passive: false });
    const { onpointerdown: press, onpointermove: move, onpointerup: lift } = scene; // of the eye, which turns where no end is grasped
    scene.onpointerdown = (e) => {
      held = near(e.offsetX, e.offsetY, e.pointerType === "mouse" ? 16 : 26) ? { x: e.offsetX, y: e.offsetY, at: [...at], matrix: turned.matrix } : null;
      if (held) scene.setPointerCapture(e.pointerId);
      else press(e);
    };
    scene.onpointermove = (e) => { // what the hand moved in the picture, as steps of the grid
      if (!held) return move(e);
      const [x, y, [p, q, u, v]] = [e.offsetX - held.x, e.offsetY - held.y, held.matrix], det = p * v - q * u;
      if (Math.abs(det) > 4) go(held.at[0] + (x * v - y * u) / det, held.at[1] + (y * p - x * q) / det);
    };
    scene.onpointerup = scene.onpointercancel = (e) => ((held = null), lift(e));
    return reset;
  }
  choose(...home);
  return { coordinates, number, show, text, charts: (t) => (map(t), chart(t)), hands };
}
