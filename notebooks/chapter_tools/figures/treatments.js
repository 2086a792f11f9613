// The hull measure on one garment: a frame with the means of some forecasters, and for each treatment the share of frames that it counts.
// Idea: in an orthographic picture the outline of a hull with a margin is the hull of the outline, drawn with a wide pen.
(() => {
  const [scene, shares, course] = [$("scene"), $("shares"), $("course")], names = data.names, cloth = unpack(data.cloth), K = data.frames.length;
  const each = cloth.length / K, triple = (array, i) => [array[3 * i], array[3 * i + 1], array[3 * i + 2]];
  const means = unpack(data.means), seen = unpack(data.seen), S = data.slots;
  const ink = (m) => (m ? paint(m === 1 ? 0 : 2) : blue());

  // ---- what is measured: of each loop its curves at each frame --------------------------------------------------
  const loops = data.loops.map(({ curve, closing, tight, first, present }) => {
    const [a, b, c] = [curve, closing, tight].map(unpack), n = a.length / (3 * K), many = (array, from, to) => Array.from({ length: to - from }, (_, i) => triple(array, from + i));
    return Array.from({ length: K }, (_, t) => ({ curve: many(a, t * n, (t + 1) * n), closing: many(b, 2 * t, 2 * t + 2), tight: many(c, first[t], first[t + 1]), present: present[t] }));
  });
  const placesOf = (m, t) => Array.from({ length: S }, (_, s) => (m * K + t) * S + s).filter((i) => seen[i]).map((i) => triple(means, i));
  const table = new Map();
  function offOf(treatment, m, t) { // of the nearest mean; computed once
    const key = [which, treatment, m, t].join();
    if (!table.has(key)) {
      const found = placesOf(m, t).map((p) => judged(treatment, loops[which][t], p, 0));
      table.set(key, found.reduce((best, one) => (one.off < best.off ? one : best), { off: Infinity, most: 0 }));
    }
    const { off, most } = table.get(key);
    return { off, most: most || tolerance };
  }
  const isIn = (treatment, m, t) => (({ off, most }) => off <= most + 1e-6)(offOf(treatment, m, t));
  const counted = () => Array.from({ length: K }, (_, t) => t).filter((t) => flat || loops[which][t].present);
  const share = (treatment, m, steps = counted()) => (steps.length ? steps.filter((t) => isIn(treatment, m, t)).length / steps.length : 0);
  const percent = (v) => `${Math.round(100 * v)} %`, cm = (v) => (v === Infinity ? "outside of the outline" : `${(100 * v).toFixed(1)} cm`);

  // ---- the picture ---------------------------------------------------------------------------------------------
  let frame, which, treatment, tolerance, flat;
  function middle() { // of the cloth at this frame
    const places = Array.from({ length: each / 3 }, (_, i) => triple(cloth, (frame * each) / 3 + i));
    return [0, 1, 2].map((c) => places.reduce((sum, p) => sum + p[c], 0) / places.length);
  }
  const later = lazily(draw), { cam, see, back } = orbit(scene, data.view, later, { Escape: reset });
  function outline(places) { // the convex hull of places in the picture
    const sorted = [...places].sort((p, q) => p[0] - q[0] || p[1] - q[1]), half = (list) => list.reduce((chain, p) => {
      while (chain.length > 1) {
        const [a, b] = chain.slice(-2);
        if ((b[0] - a[0]) * (p[1] - a[1]) - (b[1] - a[1]) * (p[0] - a[0]) > 0) break;
        chain.pop();
      }
      return [...chain, p];
    }, []);
    return [...half(sorted).slice(0, -1), ...half(sorted.reverse()).slice(0, -1)];
  }
  function drawScene() {
    const [g, w, h] = start(scene), loop = loops[which][frame], look = see(middle()), { centre, radius } = extentOf(loop.curve);
    const scale = (0.46 * Math.min(w, h - 40) * cam.zoom) / data.radius, to = (p) => (([x, y]) => [w / 2 + scale * x, h / 2 + 8 - scale * y])(look(p));
    for (let i = frame * each; i < (frame + 1) * each; i += 3) dot(g, to(triple(cloth, i / 3)), 1.6, fade(css("--soft").trim(), 0.55));
    const most = offOf(treatment, 0, frame).most, area = (places, margin) => { // with its margin
      g.globalAlpha = 0.25;
      trace(g, outline(places), blue(), 2 * margin * scale + 1, { close: true, fill: blue() });
      g.globalAlpha = 1;
    };
    hullsOf(treatment, loop).forEach((points) => area(points.map(to), tolerance));
    if (treatment === "near its plane") area(loop.curve.map(to), 0);
    if (treatment === "in the opening") dot(g, to(centre), radius * scale, fade(blue(), 0.25));
    if (treatment === "any curve") trace(g, loop.tight.map(to), css("--soft"), 2, { close: true, dash: [5, 4] });
    trace(g, loop.curve.map(to), css("--ink"), 2.5, { close: true, dash: loop.present ? [] : [2, 5] });
    if (treatment === "wide hull" || treatment === "any curve") trace(g, loop.closing.map(to), css("--accent"), 5);
    names.forEach((_, m) => placesOf(m, frame).forEach((p) => dot(g, to(p), 6, ink(m), css("--panel"), 2)));
    [g.textBaseline, g.textAlign] = ["middle", "left"];
    names.forEach((name, m) => { // the legend
      dot(g, [16, 36 + 20 * m], 5, ink(m));
      g.fillStyle = css("--ink");
      word(g, name, 28, 36 + 20 * m);
    });
    g.fillStyle = css("--soft");
    if (!loop.present) word(g, "the loop lies flat", 10, h - 14);
    return most;
  }
  function drawShares() { // a row for each treatment; a click chooses it
    const [g, w, h] = start(shares), left = 108, wide = w - left - 52, pace = (h - 34) / TREATMENTS.length, thin = Math.min(13, (pace - 6) / names.length), steps = counted();
    g.textBaseline = "middle";
    g.fillStyle = css("--soft");
    g.fillText(`share of ${steps.length} frames in which the nearest mean is in`, 10, 14, w - 20);
    TREATMENTS.forEach((kind, r) => {
      const y = 28 + r * pace;
      [g.textAlign, g.font, g.fillStyle] = ["right", getComputedStyle(document.body).font, css(kind === treatment ? "--ink" : "--soft")];
      g.fillText(kind, left - 8, y + pace / 2);
      names.forEach((_, m) => {
        const top = y + pace / 2 + (m - names.length / 2) * thin, v = share(kind, m, steps);
        g.fillStyle = css("--line");
        g.fillRect(left, top + 1, wide, thin - 2);
        g.fillStyle = kind === treatment ? ink(m) : fade(ink(m), 0.5);
        g.fillRect(left, top + 1, Math.max(2, v * wide), thin - 2);
        [g.textAlign, g.fillStyle, g.font] = ["left", css("--ink"), "11px system-ui, sans-serif"];
        g.fillText(percent(v), left + wide + 6, top + thin / 2);
      });
    });
    shares.onclick = (e) => choose({ treatment: TREATMENTS[clamp(Math.floor((e.offsetY - 28) / pace), 0, TREATMENTS.length - 1)] });
    shares.style.cursor = "pointer";
    describe(shares, TREATMENTS.map((kind) => `${kind}: ${names.map((name, m) => `${name} ${percent(share(kind, m, steps))}`).join(", ")}`).join("; "));
  }
  function drawCourse() { // how far off, over the frames
    const values = names.map((_, m) => Array.from({ length: K }, (_, t) => 100 * offOf(treatment, m, t).off));
    const allowed = Array.from({ length: K }, (_, t) => 100 * offOf(treatment, 0, t).most), high = 1.1 * Math.max(2, ...values.flat().filter(isFinite), ...allowed);
    const [g, X, Y, box] = axes(course, Math.max(1, K - 1), high, `${treatment}: off by (cm); dashed: limit`, "frames ahead", ticks(high), []);
    g.textAlign = "center";
    data.frames.forEach((name, t) => {
      if (t % 3 === 0) g.fillText(name, X(t), box.y + box.h + 12);
      if (loops[which][t].present) return;
      g.fillStyle = fade(css("--soft").trim(), 0.2);
      g.fillRect(X(Math.max(0, t - 0.5)), box.y, X(Math.min(K - 1, t + 0.5)) - X(Math.max(0, t - 0.5)), box.h);
      g.fillStyle = css("--soft");
    });
    g.textAlign = "left";
    trace(g, allowed.map((v, t) => [X(t), Y(v)]), css("--ink"), 1.4, { dash: [5, 4] });
    values.forEach((line_of, m) => {
      line_of.forEach((v, t) => {
        if (t && isFinite(v) && isFinite(line_of[t - 1])) trace(g, [[X(t - 1), Y(line_of[t - 1])], [X(t), Y(v)]], ink(m), 2.2);
        if (isFinite(v)) dot(g, [X(t), Y(v)], t === frame ? 5 : 2.5, ink(m));
      });
    });
    pen(g, css("--ink"), 1.2);
    line(g, X(frame), box.y, X(frame), box.y + box.h, [3, 3]);
    describe(course, `${treatment}, over the frames; ${$("status").textContent}`);
  }
  function draw() {
    const loop = loops[which][frame];
    const said = names.map((name, m) => `${name} ${cm(offOf(treatment, m, frame).off)}${isIn(treatment, m, frame) ? ", in" : ", out"}`).join(" \u00b7 ");
    const text = `${data.frames[frame]} frames ahead, ${treatment}${hullsOf(treatment, loop).length ? ` within ${(100 * tolerance).toFixed(1)} cm` : ""}: ${said}`
      + `${loop.present ? "" : " \u00b7 the loop lies flat"} \u00b7 in, over the frames, flat loops ${flat ? "counted" : "left out"}: ${names.map((name, m) => `${name} ${percent(share(treatment, m))}`).join(", ")}`;
    drawScene();
    drawShares();
    tell(text, $("frame"), frame);
    drawCourse();
    [$("loop").value, $("treatment").value, $("tolerance").value, $("flat").checked] = [which, treatment, 100 * tolerance, flat];
    $("tolerance").setAttribute("aria-valuetext", `${(100 * tolerance).toFixed(1)} cm`);
    describe(scene, `${text}. ${TURN}; Escape puts all back.`);
  }
  function choose(change) {
    ({ frame, which, treatment, tolerance, flat } = { frame, which, treatment, tolerance, flat, ...change });
    later();
  }
  const [go, play] = stepped($("frame"), () => K - 1, (k) => choose({ frame: k }), 5);
  function reset() {
    play(false);
    choose({ which: data.first, treatment: TREATMENTS[0], tolerance: 0, flat: true });
    go(data.frame);
    back();
  }
  $("frame").max = K - 1;
  $("loop").append(...data.labels.map((name, k) => new Option(name, k)));
  $("loop").hidden = data.labels.length < 2;
  $("treatment").append(...TREATMENTS.map((name) => new Option(name)));
  $("loop").oninput = (e) => choose({ which: +e.target.value });
  $("treatment").oninput = (e) => choose({ treatment: e.target.value });
  $("tolerance").oninput = (e) => choose({ tolerance: e.target.value / 100 });
  $("flat").oninput = (e) => choose({ flat: e.target.checked });
  scrub(course, (s) => (play(false), go(Math.round(clamp(s, 0, 1) * (K - 1)))));
  onReset(reset);
  reset();
  watch(later);
})();
