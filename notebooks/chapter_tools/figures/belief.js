// Evidence along a film: the significance of a loop's bar in each frame, the belief that adds up, and when the loop is reported.
// Idea: the state is a number for each frame, which the reader can drag, and three thresholds. The belief is computed anew at every change.
(() => {
  const [scene, chart, strip] = [$("scene"), $("beliefs"), $("reported")], LEAST = 0.3, HIGHEST = 5;
  const USUAL = { threshold: 1, kept: 0.9, report: 0 };
  let home, strength, beliefs, options, chosen;
  const later = lazily(draw), frames = () => strength.length;

  // ---- what follows from the state ---------------------------------------------------------------------------
  function compute() {
    beliefs = beliefsOf(strength, options);
    later();
  }
  const single = (t) => strength[t] > options.threshold, summed = (t) => beliefs[t] > options.report;
  const times = () => [...strength.keys()];
  function put(t, value) {
    strength[t] = clamp(value, LEAST, HIGHEST);
    compute();
  }
  function reset() {
    [strength, chosen, options] = [[...home], Math.floor(home.length / 2), { ...USUAL }];
    compute();
  }

  // ---- drawing: both upper charts have the same axis of frames ---------------------------------------------------
  const frame = (w, h) => { // significance on a logarithmic axis
    const [x0, y0, wide, high] = [44, 34, w - 64, h - 74], tall = Math.log(HIGHEST / LEAST);
    return { scale: 1, to: ([t, z]) => [x0 + (wide * t) / (frames() - 1), y0 + high * (1 - Math.log(z / LEAST) / tall)],
      back: (x, y) => [((x - x0) / wide) * (frames() - 1), LEAST * Math.exp(tall * (1 - (y - y0) / high))] };
  };
  function drawScene() {
    const [g, w, h] = start(scene), { to } = frame(w, h), S = strength.map((z, t) => to([t, z]));
    g.textBaseline = "middle";
    for (const z of [0.5, 1, 2, 4]) {
      const [x, y] = to([0, z]);
      pen(g, css("--line"), 1);
      line(g, x, y, ...to([frames() - 1, z]));
      g.fillStyle = css("--soft");
      g.textAlign = "right";
      g.fillText(z, x - 8, y);
    }
    g.textAlign = "left";
    g.fillText("significance of the longest bar, by frame", 44, h - 16);
    pen(g, css("--ink"), 1.5);
    line(g, ...to([0, options.threshold]), ...to([frames() - 1, options.threshold]), [6, 4]);
    trace(g, S, fade(blue(), 0.6), 1.5);
    S.forEach((p, t) => {
      dot(g, p, 4.5, single(t) ? blue() : css("--panel"), blue(), 1.5);
      if (t === chosen) dot(g, p, 9, null, css("--accent"), 2.5);
    });
  }
  function drawChart() { // a belief may be negative: the axis begins at its lowest value
    const low = Math.min(-2, options.report - 0.5, ...beliefs), high = Math.max(2, options.report + 0.5, ...beliefs) - low, step = high > 12 ? 5 : 2;
    const [g, X, Y, box] = axes(chart, frames() - 1, high, "belief", "frame", []);
    for (let v = step * Math.ceil(low / step); v <= low + high; v += step) {
      pen(g, css("--line"), 1);
      line(g, box.x, Y(v - low), box.x + box.w, Y(v - low));
      g.fillStyle = css("--soft");
      g.textAlign = "right";
      g.fillText(v, box.x - 6, Y(v - low));
      g.textAlign = "left";
    }
    pen(g, css("--ink"), 1.5);
    line(g, box.x, Y(options.report - low), box.x + box.w, Y(options.report - low), [6, 4]);
    trace(g, beliefs.map((b, t) => [X(t), Y(b - low)]), paint(2), 2.2);
    times().forEach((t) => dot(g, [X(t), Y(beliefs[t] - low)], t === chosen ? 5.5 : 3, summed(t) ? paint(2) : css("--panel"), paint(2), 1.5));
  }
  function drawStrip() {
    const [g, X, , box] = axes(strip, frames() - 1, 1, "frames in which the loop is reported", "frame", []), rows = [["alone", single, blue()], ["belief", summed, paint(2)]];
    g.lineCap = "butt";
    rows.forEach(([name, is, colour], row) => {
      const y = box.y + ((row + 0.5) * box.h) / 2;
      times().forEach((t) => trace(g, [[X(t - 0.42), y], [X(t + 0.42), y]], is(t) ? colour : fade(css("--soft"), 0.25), Math.min(14, 0.3 * box.h)));
      g.fillStyle = css("--soft");
      g.fillText(name, 2, y);
    });
    pen(g, css("--ink"), 1.2);
    line(g, X(chosen), box.y, X(chosen), box.y + box.h, [3, 3]);
  }
  function draw() {
    drawScene();
    drawChart();
    drawStrip();
    const evidence = evidenceOf(strength[chosen], options.threshold), many = (is) => times().filter(is).length, shifts = (is) => times().filter((t) => t && is(t) !== is(t - 1)).length;
    const text = `frame ${chosen + 1} of ${frames()}: significance ${strength[chosen].toFixed(2)}, evidence ${evidence.toFixed(2)}, belief ${beliefs[chosen].toFixed(2)} \u00b7 `
      + `each frame alone: reported in ${many(single)}, ${shifts(single)} changes \u00b7 belief: reported in ${many(summed)}, ${shifts(summed)} changes`;
    $("status").textContent = text;
    for (const [name, digits] of [["threshold", 2], ["kept", 2], ["report", 1]]) {
      $(name).value = options[name];
      $(`${name}-is`).textContent = options[name].toFixed(digits);
    }
    describe(scene, `the significance in each frame; ${text}. Drag a dot up or down; or choose a frame with the keys n and p and change it with the up and down arrows; Escape begins anew.`);
    describe(chart, `the belief in each frame, with the threshold above which the loop is reported; ${text}`);
    describe(strip, `the frames in which the loop is reported, by each frame alone and by belief; ${text}`);
  }

  // ---- hands -------------------------------------------------------------------------------------------------
  const hold = (t) => ((chosen = t), later());
  draggable(scene, { points: () => strength.map((z, t) => [t, z]), frame, press: hold, move: (t, [, z]) => put(t, z) });
  walk(scene, { count: frames, chosen: () => chosen, choose: hold, move: (t, dx, dy) => (dx ? hold(clamp(t + dx, 0, frames() - 1)) : put(t, strength[t] * 1.05 ** -dy)), Escape: reset });
  for (const canvas of [chart, strip]) scrub(canvas, (share) => hold(clamp(Math.round(share * (frames() - 1)), 0, frames() - 1)));
  for (const name of Object.keys(USUAL)) $(name).oninput = (e) => ((options[name] = +e.target.value), compute());
  onReset(reset);

  // ---- start -------------------------------------------------------------------------------------------------
  shapes((values) => {
    home = values;
    reset();
  });
  watch(later);
})();
