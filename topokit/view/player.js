// The player of topokit.view: a cloth, its loops, their diagram and their lifetimes, on three 2D canvases.
// Idea: unpack once; every change of frame, camera, size or theme redraws all three canvases from scratch.
(() => {
  const a = Object.fromEntries(Object.entries(data.arrays).map(([name, packed]) => [name, unpack(packed)]));
  const bent = data.plans && bending(a, data.plans); // plans.js: gives a.points and a.grippers, and loops by its own lights
  const [scene, diagram, strip] = [$("scene"), $("diagram"), $("strip")];
  const frames = data.frames, later = lazily(draw), eye = orbit(scene, data.view, later, { " ": () => play() }), body = cloth(data, a, eye);
  let frame = data.start;

  // ---- the loops of a frame ----------------------------------------------------------------------------------
  const loopsOf = (t) => {
    const list = [];
    for (let i = a.first[t]; i < a.first[t + 1]; i++) list.push(i);
    return list;
  };
  const colour = (i) => paint(a.id[i]);
  const main = (i) => data.long.includes(a.id[i]);

  // ---- the cloth ---------------------------------------------------------------------------------------------
  function drawScene() {
    const [g, w, h] = start(scene);
    const { place, items, S } = body.draw(g, w, h, frame, $("cloth").checked);
    const path = (list, close) => {
      g.beginPath();
      list.forEach(([x, y], n) => (n ? g.lineTo(x, y) : g.moveTo(x, y)));
      if (close) g.closePath();
    };
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
    let free = -Infinity; // names go downwards, each below the last: above there is the title
    for (const i of list.filter(main).sort((i, j) => a.death[j] - a.death[i])) {
      g.fillStyle = css("--ink");
      free = Math.max(Y(a.death[i]), free + 15);
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
    tell(text, $("time"), frame);
    const word = best === undefined ? "no loops" : `the longest is loop ${a.id[best]}: born ${a.birth[best].toFixed(3)}, dies ${a.death[best].toFixed(3)}`;
    if (!bent) describe(diagram, `persistence diagram, ${text}; ${word} ${data.unit}`);
    if (!bent) describe(strip, `lifetimes of ${ids.length} loops over ${seconds.toFixed(1)} s; now ${text}`);
    describe(scene, `${data.title}, ${text}. ${bent ? "Drag the ring to bend the plan. " : ""}${TURN}; space plays.`);
  }
  const go = (t) => {
    frame = clamp(Math.round(t), 0, frames - 1);
    later();
  };
  // a run shorter than 8 s is shown slowed to 8 s
  const play = playback(() => frame, go, () => frames - 1, Math.max(seconds, 8));
  $("time").oninput = (e) => (play(false), go(+e.target.value));
  $("truth").onchange = $("cloth").onchange = later;
  scrub(strip, (share) => (play(false), go(share * (frames - 1))));

  const unbend = bent && bent.hands(scene, later, () => play(false));
  onReset(() => (bent && (unbend(), go(data.start)), eye.back()));

  // ---- start -------------------------------------------------------------------------------------------------
  $("time").max = frames - 1;
  $("truth").checked = data.show_truth;
  $("cloth").checked = !data.film; // the film begins with the points, which are all that the tracker sees
  $("cloth").closest("label").hidden = !a.faces.length;
  $("truth").closest("label").hidden = !data.truth.length;
  watch(later, body.refit);
  if (data.film) {
    document.body.classList.add("film");
    if (!matchMedia("(prefers-reduced-motion: reduce)").matches) play(true);
  }
})();
