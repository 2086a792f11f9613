// The player of topokit.view: a cloth, its loops, their diagram and their lifetimes, on three 2D canvases.
// Idea: unpack once; every change of frame, camera, size or theme redraws all three canvases from scratch.
(() => {
  const a = Object.fromEntries(Object.entries(data.arrays).map(([name, packed]) => [name, unpack(packed)]));
  const bent = data.plans && bending(a, data.plans); // plans.js: gives a.points and a.grippers, and loops by its own lights
  const frames = data.frames, N = a.points.length / 3 / frames, F = a.faces.length / 3;
  const [scene, diagram, strip] = [$("scene"), $("diagram"), $("strip")];
  const home = { az: (data.view[0] * Math.PI) / 180, el: (data.view[1] * Math.PI) / 180, zoom: 1 };
  const cam = { ...home };
  let frame = data.start, fit = null;

  // ---- the loops of a frame ----------------------------------------------------------------------------------
  const loopsOf = (t) => {
    const list = [];
    for (let i = a.first[t]; i < a.first[t + 1]; i++) list.push(i);
    return list;
  };
  const colour = (i) => paint(a.id[i]);
  const main = (i) => data.long.includes(a.id[i]);

  // ---- the cloth ---------------------------------------------------------------------------------------------
  function camera() {
    const [sa, ca, se, ce] = [Math.sin(cam.az), Math.cos(cam.az), Math.sin(cam.el), Math.cos(cam.el)];
    return (p, i, out) => { // right, up, towards the eye
      const x = p[i] - data.centre[0], y = p[i + 1] - data.centre[1], z = p[i + 2] - data.centre[2];
      out[0] = -sa * x + ca * y;
      out[1] = -se * (ca * x + sa * y) + ce * z;
      out[2] = ce * (ca * x + sa * y) + se * z;
    };
  }
  function measure(w, h) { // one scale for the whole run, so that playing does not make the picture breathe
    const see = camera(), q = [0, 0, 0], low = [1e9, 1e9], high = [-1e9, -1e9];
    const take = (p, i) => {
      see(p, i, q);
      for (const k of [0, 1]) [low[k], high[k]] = [Math.min(low[k], q[k]), Math.max(high[k], q[k])];
    };
    for (let i = 0; i < a.points.length; i += 9) take(a.points, i);
    for (let i = 0; i < a.line.length; i += 3) take(a.line, i);
    const scale = Math.min((w - 36) / (high[0] - low[0] || 1), (h - 52) / (high[1] - low[1] || 1));
    return { scale, x: (low[0] + high[0]) / 2, y: (low[1] + high[1]) / 2 };
  }
  const V = new Float32Array(3 * N), S = new Float32Array(2 * N), normal = new Float32Array(3 * N);
  const light = new Float32Array(N), lamp = [-0.45, 0.62, 0.64]; // above the eye's left shoulder
  const bright = (l) => clamp(Math.round(64 * (0.6 + 0.45 * l)), 8, 64);
  let tones = []; // colours of the outer side from dark to bright, and of the inner side
  function dye() {
    const sides = dark ? [[196, 191, 180], [146, 146, 158]] : [[240, 233, 218], [206, 207, 217]];
    tones = sides.map((base) => Array.from({ length: 65 }, (_, k) => `rgb(${base.map((c) => Math.round((c * k) / 64)).join()})`));
  }
  const marks = Array.from({ length: F }, () => []); // the check and the seams, face by face
  for (const { face, ends, bright } of data.marks) {
    const shares = unpack(ends);
    unpack(face).forEach((f, m) => marks[f].push([bright, shares.subarray(6 * m, 6 * m + 6)]));
  }
  function drawFace(g, f, thin) { // smooth: on a triangle light is linear, and so is a gradient
    const ids = a.faces.subarray(3 * f, 3 * f + 3), x = [0, 0, 0], y = [0, 0, 0];
    const [i, j, k] = ids;
    const [ex, ey, dx, dy] = [S[2 * j] - S[2 * i], S[2 * j + 1] - S[2 * i + 1], S[2 * k] - S[2 * i], S[2 * k + 1] - S[2 * i + 1]];
    const area = ex * dy - ey * dx, back = area > 0, l = [0, 0, 0], tone = tones[+back];
    const mx = (S[2 * i] + S[2 * j] + S[2 * k]) / 3, my = (S[2 * i + 1] + S[2 * j + 1] + S[2 * k + 1]) / 3;
    for (const c of [0, 1, 2]) { // a little larger than it is, so that no ground shows between neighbours
      const u = S[2 * ids[c]] - mx, v = S[2 * ids[c] + 1] - my, grow = 1 + 0.6 / (Math.hypot(u, v) || 1);
      [x[c], y[c], l[c]] = [mx + u * grow, my + v * grow, (back ? -1 : 1) * light[ids[c]]];
    }
    const low = Math.min(...l), high = Math.max(...l), mean = bright((l[0] + l[1] + l[2]) / 3);
    g.fillStyle = tone[mean];
    if (high - low > 0.06 && Math.abs(area) > 2) {
      const gx = ((l[1] - l[0]) * dy - (l[2] - l[0]) * ey) / area, gy = ((l[2] - l[0]) * ex - (l[1] - l[0]) * dx) / area;
      const at = l.indexOf(low), far = (high - low) / (gx * gx + gy * gy);
      const shades = g.createLinearGradient(x[at], y[at], x[at] + far * gx, y[at] + far * gy);
      shades.addColorStop(0, tone[bright(low)]);
      shades.addColorStop(1, tone[bright(high)]);
      g.fillStyle = shades;
    }
    g.beginPath();
    g.moveTo(x[0], y[0]);
    g.lineTo(x[1], y[1]);
    g.lineTo(x[2], y[2]);
    g.fill();
    for (const [share, ends] of marks[f]) {
      g.strokeStyle = tone[Math.round(share * mean)];
      g.lineWidth = thin;
      g.beginPath();
      for (const e of [0, 3]) g.lineTo(...[x, y].map((p) => ends[e] * p[0] + ends[e + 1] * p[1] + ends[e + 2] * p[2]));
      g.stroke();
    }
  }
  const heights = a.points.filter((_, i) => i % 3 === 2), floor = heights.reduce((m, z) => Math.min(m, z), 1e9) > -0.02 * data.radius;
  function drawShadow(g, place) { // a soft ellipse on z = 0 that follows the cloth, fainter and wider the higher it hangs
    let [n, mx, my, xx, xy, yy, low] = [0, 0, 0, 0, 0, 0, 1e9];
    for (let i = 3 * N * frame; i < 3 * N * (frame + 1); i += 3) {
      const [x, y] = [a.points[i], a.points[i + 1]];
      [n, mx, my, xx, xy, yy] = [n + 1, mx + x, my + y, xx + x * x, xy + x * y, yy + y * y];
      low = Math.min(low, a.points[i + 2]);
    }
    [mx, my] = [mx / n, my / n];
    const turn = 0.5 * Math.atan2(2 * (xy / n - mx * my), xx / n - mx * mx - yy / n + my * my), [c, s] = [Math.cos(turn), Math.sin(turn)];
    const wide = (u, v) => 2 * Math.sqrt(Math.max(0, (u * u * xx + 2 * u * v * xy + v * v * yy) / n - (u * mx + v * my) ** 2)) + 0.05 * data.radius + 0.3 * low;
    const [A, B] = [wide(c, s), wide(-s, c)], at = (u, v) => place([mx + u, my + v, 0], 0);
    const o = at(0, 0), p = at(A * c, A * s), q = at(-B * s, B * c), soft = g.createRadialGradient(0, 0, 0, 0, 0, 1);
    const strength = (dark ? 0.8 : 0.4) * Math.exp(-Math.max(0, low) / data.radius);
    soft.addColorStop(0, `rgba(0,0,0,${strength})`);
    soft.addColorStop(1, "rgba(0,0,0,0)");
    g.save();
    g.transform(p[0] - o[0], p[1] - o[1], q[0] - o[0], q[1] - o[1], o[0], o[1]);
    g.fillStyle = soft;
    g.fillRect(-1, -1, 2, 2);
    g.restore();
  }
  function drawScene() {
    const [g, w, h] = start(scene);
    fit = fit || measure(w, h);
    const see = camera(), q = [0, 0, 0], size = fit.scale * cam.zoom, far = 5 * data.radius;
    const place = (p, i) => {
      see(p, i, q);
      const k = size / (1 - q[2] / far);
      return [w / 2 + (q[0] - fit.x) * k, h / 2 + 8 - (q[1] - fit.y) * k, q[2], k];
    };
    for (let i = 0, o = 3 * N * frame; i < N; i++) {
      const s = place(a.points, o + 3 * i);
      V.set(q, 3 * i);
      S[2 * i] = s[0];
      S[2 * i + 1] = s[1];
    }
    const items = [], path = (list, close) => {
      g.beginPath();
      list.forEach(([x, y], n) => (n ? g.lineTo(x, y) : g.moveTo(x, y)));
      if (close) g.closePath();
    };
    if (F) dye();
    if (floor && N && cam.el > 0) drawShadow(g, place);
    const thin = clamp(0.005 * data.radius * size, 0.7, 3);
    normal.fill(0);
    for (let f = 0; f < F; f++) {
      const [i, j, k] = a.faces.subarray(3 * f, 3 * f + 3);
      const [e, d] = [0, 1].map((s) => [0, 1, 2].map((c) => V[3 * (s ? k : j) + c] - V[3 * i + c]));
      const n = [e[1] * d[2] - e[2] * d[1], e[2] * d[0] - e[0] * d[2], e[0] * d[1] - e[1] * d[0]];
      for (const v of [i, j, k]) for (const c of [0, 1, 2]) normal[3 * v + c] += n[c];
      items.push([(V[3 * i + 2] + V[3 * j + 2] + V[3 * k + 2]) / 3, () => drawFace(g, f, thin)]);
    }
    for (let i = 0; i < 3 * N; i += 3) {
      const length = Math.hypot(normal[i], normal[i + 1], normal[i + 2]) || 1;
      light[i / 3] = (normal[i] * lamp[0] + normal[i + 1] * lamp[1] + normal[i + 2] * lamp[2]) / length;
    }
    if (!F) for (let i = 0; i < N; i++) items.push([V[3 * i + 2], () => {
      g.fillStyle = fade(dark ? "#babac4" : "#5d6b7a", 0.8);
      g.fillRect(S[2 * i] - 1.5, S[2 * i + 1] - 1.5, 3, 3);
    }]);
    const rod = dark ? "#7f8fa1" : "#4a5868";
    for (let i = 0; i + 3 < a.line.length; i += 3) {
      const p = place(a.line, i), s = place(a.line, i + 3);
      items.push([(p[2] + s[2]) / 2, () => {
        g.strokeStyle = rod;
        g.lineWidth = Math.max(2, 2 * data.thickness * p[3]);
        path([p, s]);
        g.stroke();
      }]);
    }
    for (let i = 0; i < a.grippers.length / frames; i += 3) {
      const p = place(a.grippers, a.grippers.length / frames * frame + i);
      items.push([p[2] + 0.1 * data.radius, () => {
        g.strokeStyle = css("--ink");
        g.fillStyle = a.held[frame] ? css("--ink") : css("--panel");
        g.lineWidth = 1.5;
        g.beginPath();
        g.arc(p[0], p[1], 4.5, 0, 7);
        g.fill();
        g.stroke();
      }]);
    }
    items.sort((p, s) => p[0] - s[0]).forEach((item) => item[1]());
    if ($("truth").checked) data.truth.forEach((loop) => {
      for (const [style, width] of [[css("--panel"), 5], [css("--ink"), 2]]) {
        g.strokeStyle = style;
        g.lineWidth = width;
        path(loop.map((v) => [S[2 * v], S[2 * v + 1]]), true);
        g.stroke();
      }
    });
    for (const i of loopsOf(frame).reverse()) {
      const corner = (n) => place(a.killer, 24 * i + 3 * n), strong = main(i), ink = colour(i);
      for (const n of [5, 2]) {
        path([corner(n), corner(n + 1), corner(n + 2)], true);
        g.fillStyle = fade(ink, strong ? 0.42 : 0.13);
        g.strokeStyle = fade(ink, strong ? 0.95 : 0.35);
        g.lineWidth = strong ? 1.4 : 0.8;
        g.fill();
        g.stroke();
      }
      for (const [style, width] of strong ? [[css("--panel"), 6], [ink, 3.4]] : [[fade(ink, 0.45), 1.8]]) {
        g.strokeStyle = style;
        g.lineWidth = width;
        path([corner(0), corner(1)]);
        g.stroke();
      }
    }
    if (bent) bent.show(g, place, frame);
    const names = []; // last, above everything, and none above another
    for (const i of loopsOf(frame).filter(main)) {
      const corners = [2, 3, 4, 5, 6, 7].map((n) => place(a.killer, 24 * i + 3 * n));
      const x = Math.max(...corners.map((c) => c[0])) + 8, y = corners.reduce((s, c) => s + c[1], 0) / 6;
      names.push([Math.min(x, w - 58), y, i]);
    }
    names.sort((p, s) => p[1] - s[1]).forEach((name, n) => {
      const [x, y] = names[n - 1] || [-1e9, 0];
      if (Math.abs(name[0] - x) < 58) name[1] = Math.max(name[1], y + 21);
      tag(g, "loop " + a.id[name[2]], name[0], name[1], colour(name[2]));
    });
  }
  function tag(g, text, x, y, ink) {
    const width = g.measureText(text).width;
    g.fillStyle = css("--ground");
    g.strokeStyle = ink;
    g.lineWidth = 1.5;
    g.beginPath();
    g.rect(x - 4, y - 9, width + 8, 18);
    g.fill();
    g.stroke();
    g.fillStyle = css("--ink");
    g.textBaseline = "middle";
    g.fillText(text, x, y + 0.5);
  }

  // ---- the two charts ----------------------------------------------------------------------------------------
  const top = (1.06 * a.death.reduce((m, v) => Math.max(m, v), 0)) || 1;
  const tall = (1.1 * a.death.reduce((m, v, i) => Math.max(m, v - a.birth[i]), 0)) || 1;
  const find = (id, t) => loopsOf(t).find((i) => a.id[i] === id);
  function drawDiagram() {
    const wide = 1.5 * a.birth.reduce((m, v) => Math.max(m, v), top / 3);
    const [g, X, Y] = axes(diagram, wide, top, "diagram: death against birth (" + data.unit + ")", "birth");
    const end = Math.min(wide, top);
    g.strokeStyle = css("--soft");
    g.lineWidth = 1.2;
    line(g, X(0), Y(0), X(end), Y(end));
    const alpha = a.alpha[frame];
    if (alpha > 0 && alpha < top) {
      const stop = Math.min(wide, top - alpha);
      line(g, X(0), Y(alpha), X(stop), Y(stop + alpha), [4, 4]);
      g.fillStyle = css("--soft");
      word(g, "alpha", X(stop) - 40, Y(stop + alpha) + 18);
    }
    const list = loopsOf(frame).reverse();
    for (const i of list.filter(main)) for (let t = frame, now = i; t > Math.max(0, frame - 14); t--) { // where it came from
      const last = find(a.id[i], t - 1);
      if (last === undefined) break;
      g.strokeStyle = fade(colour(i), 0.5 * (1 - (frame - t) / 14));
      g.lineWidth = 3;
      line(g, X(a.birth[now]), Y(a.death[now]), X(a.birth[last]), Y(a.death[last]));
      now = last;
    }
    for (const i of list) {
      g.beginPath();
      g.arc(X(a.birth[i]), Y(a.death[i]), main(i) ? 6 : 3.5, 0, 7);
      g.fillStyle = fade(colour(i), main(i) ? 1 : 0.55);
      g.fill();
      g.strokeStyle = css("--panel");
      g.lineWidth = 1;
      g.stroke();
    }
    let free = Infinity; // names go upwards, each above the last
    for (const i of list.filter(main).sort((i, j) => a.death[i] - a.death[j])) {
      g.fillStyle = css("--ink");
      free = Math.min(Y(a.death[i]), free - 15);
      word(g, "loop " + a.id[i], X(a.birth[i]) + 11, free);
    }
  }
  const seconds = Math.max(data.dt * (frames - 1), 1e-9);
  const ids = [...new Set(a.id)].sort((p, s) => data.long.includes(p) - data.long.includes(s) || p - s);
  function drawStrip() {
    const [g, X, Y, box] = axes(strip, seconds, tall, "lifetime of every loop (" + data.unit + ")", "time (s)");
    const at = (t) => X(t * data.dt), released = a.held.indexOf(0);
    if (released > 0) {
      g.strokeStyle = g.fillStyle = css("--soft");
      line(g, at(released), box.y, at(released), box.y + box.h, [2, 3]);
      g.fillText("let go", at(released) + 4, box.y + 7);
    }
    for (const id of ids) {
      const strong = data.long.includes(id);
      g.strokeStyle = g.fillStyle = fade(paint(id), strong ? 1 : 0.4);
      g.lineWidth = strong ? 2.2 : 1.2;
      g.beginPath();
      for (let t = 0, on = false; t < frames; t++) {
        const i = find(id, t);
        if (i !== undefined) {
          const y = Y(a.death[i] - a.birth[i]);
          if (on) g.lineTo(at(t), y);
          else {
            g.moveTo(at(t) - 0.5, y);
            g.lineTo(at(t) + 0.5, y);
          }
        }
        on = i !== undefined;
      }
      g.stroke();
    }
    g.strokeStyle = css("--ink");
    g.lineWidth = 1.5;
    line(g, at(frame), box.y - 4, at(frame), box.y + box.h);
  }

  // ---- time --------------------------------------------------------------------------------------------------
  function draw() {
    drawScene();
    if (bent) bent.charts(frame);
    else if (!data.film) (drawDiagram(), drawStrip());
    const loops = loopsOf(frame), best = loops[0];
    const text = bent ? bent.text(frame) : `frame ${frame} of ${frames - 1} \u00b7 ${(frame * data.dt).toFixed(2)} s \u00b7 ${loops.length} loop${loops.length === 1 ? "" : "s"}`;
    $("status").textContent = text;
    $("time").value = frame;
    $("time").setAttribute("aria-valuetext", text);
    const word = best === undefined ? "no loops" : `the longest is loop ${a.id[best]}: born ${a.birth[best].toFixed(3)}, dies ${a.death[best].toFixed(3)}`;
    if (!bent) diagram.setAttribute("aria-label", `persistence diagram, ${text}; ${word} ${data.unit}`);
    if (!bent) strip.setAttribute("aria-label", `lifetimes of ${ids.length} loops over ${seconds.toFixed(1)} s; now ${text}`);
    scene.setAttribute("aria-label", `${data.title}, ${text}. Drag${bent ? " the ring to bend the plan; beside it drag" : ""} or use the arrow keys to turn it, plus and minus or two fingers to zoom; space plays.`);
  }
  const later = lazily(draw);
  const go = (t) => {
    frame = clamp(Math.round(t), 0, frames - 1);
    later();
  };
  // a run shorter than 8 s is shown slowed to 8 s
  const play = playback(() => frame, go, () => frames - 1, Math.max(seconds, 8));
  $("time").oninput = (e) => (play(false), go(+e.target.value));
  $("truth").onchange = later;
  scrub(strip, (share) => (play(false), go(share * (frames - 1))));

  // ---- camera ------------------------------------------------------------------------------------------------
  const turn = (dx, dy) => {
    cam.az -= dx;
    cam.el = clamp(cam.el + dy, -1.5, 1.5);
    later();
  };
  const zoom = (by) => ((cam.zoom = clamp(cam.zoom * by, 0.4, 8)), later());
  const hand = bent && bent.hands(scene, later, () => play(false));
  const fingers = new Map(); // one turns, two zoom by how far apart they are
  scene.onpointerdown = (e) => (scene.setPointerCapture(e.pointerId), (hand && hand.grasp(e)) || fingers.set(e.pointerId, [e.offsetX, e.offsetY]));
  scene.onpointerup = scene.onpointercancel = (e) => (fingers.delete(e.pointerId), hand && hand.release());
  scene.onpointermove = (e) => {
    if (hand && hand.pull(e)) return;
    const last = fingers.get(e.pointerId), here = [e.offsetX, e.offsetY];
    if (!last) return;
    const [other] = [...fingers].filter(([id]) => id !== e.pointerId).map(([, place]) => place);
    const apart = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]) || 1;
    if (other) zoom(apart(here) / apart(last));
    else turn((here[0] - last[0]) / 120, (here[1] - last[1]) / 120);
    fingers.set(e.pointerId, here);
  };
  onReset(() => (Object.assign(cam, home), hand && (hand.reset(), go(data.start)), later()));
  scene.ondblclick = $("reset").onclick;
  const act = { ArrowLeft: () => turn(0.1, 0), ArrowRight: () => turn(-0.1, 0), ArrowUp: () => turn(0, 0.1), ArrowDown: () => turn(0, -0.1),
    "+": () => zoom(1.15), "=": () => zoom(1.15), "-": () => zoom(0.87), " ": () => play() };
  keys(scene, () => act);
  scene.addEventListener("wheel", (e) => { // only once the picture was clicked: a reader who scrolls by is left in peace
    if (document.activeElement !== scene) return;
    e.preventDefault();
    zoom(Math.exp(-e.deltaY / 500));
  }, { passive: false });

  // ---- start -------------------------------------------------------------------------------------------------
  $("time").max = frames - 1;
  $("truth").checked = data.show_truth;
  $("truth").closest("label").hidden = !data.truth.length;
  watch(later, () => (fit = null));
  if (data.film) {
    document.body.classList.add("film");
    if (!matchMedia("(prefers-reduced-motion: reduce)").matches) play(true);
  }
})();
