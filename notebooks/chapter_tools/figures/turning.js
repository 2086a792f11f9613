// Forecasts of one window in a scene that the reader turns, seen from above: which of them turn with it?
// Idea: the forecasts in each turned scene are stored; the true path and the hands are turned in the page.
(() => {
  const [scene, byAngle, byFrame] = [$("scene"), $("byAngle"), $("byFrame")], { angles, ahead, centre, truth, hands } = data, names = data.names;
  const T = ahead.length, flat = unpack(data.forecasts), place = (m, a, t) => [0, 1, 2].map((k) => flat[3 * ((m * angles.length + a) * T + t) + k]);
  const forecasts = names.map((_, m) => angles.map((_, a) => ahead.map((_, t) => place(m, a, t))));
  const errors = forecasts.map((each) => each.map((forecast, a) => errorsOf(forecast, truth, angles[a], centre).map((v) => 100 * v)));
  const means = errors.map((each) => each.map(meanOf)), ink = (m) => paint([5, 3, 2, 4, 0][m] ?? m);
  const now = (path, a) => path.map((p) => turned(p, angles[a], centre));
  const all = angles.flatMap((_, a) => [...now(truth, a), ...now(hands, a)]), frame = framing(all, 0.12); // a forecast may leave the picture
  let angle, step, chosen;

  function drawScene() { // from above
    const [g, w, h] = start(scene), { to } = frame(w, h);
    trace(g, now(hands, angle).map(to), css("--soft"), 1.6, { dash: [4, 5] });
    names.forEach((_, m) => trace(g, forecasts[m][angle].map(to), fade(ink(m), m === chosen ? 1 : 0.45), m === chosen ? 3 : 1.6));
    trace(g, now(truth, angle).map(to), css("--ink"), 3.5);
    names.forEach((_, m) => dot(g, to(forecasts[m][angle][step]), m === chosen ? 7 : 4.5, ink(m), css("--panel"), 1.5));
    dot(g, to(now(truth, angle)[step]), 6.5, css("--ink"), css("--panel"), 2);
    [g.textBaseline, g.textAlign] = ["middle", "left"];
    ["seqPH, of the frame itself", ...names].forEach((name, k) => {
      dot(g, [16, 36 + 19 * k], 5, k ? ink(k - 1) : css("--ink"));
      g.fillStyle = css("--ink");
      word(g, name, 28, 36 + 19 * k);
    });
    g.fillStyle = css("--soft");
    word(g, "dashed: the middle of the hands", 10, h - 14);
  }
  function lines(canvas, title, unit, xs, values, at, marks) {
    const high = 1.1 * Math.max(...values.flat(), 1), [g, X, Y, box] = axes(canvas, xs[xs.length - 1], high, title, unit, ticks(high), marks);
    values.forEach((line_of, m) => trace(g, line_of.map((v, k) => [X(xs[k]), Y(v)]), fade(ink(m), m === chosen ? 1 : 0.5), m === chosen ? 3 : 1.6));
    pen(g, css("--ink"), 1.2);
    line(g, X(at), box.y, X(at), box.y + box.h, [3, 3]);
  }
  function draw() {
    drawScene();
    lines(byAngle, "mean error by angle (cm)", "degrees", angles, means, angles[angle], [0, 90, 180].filter((v) => v <= angles[angles.length - 1]));
    lines(byFrame, `error at ${angles[angle]} degrees (cm)`, "frames ahead", ahead, errors.map((each) => each[angle]), ahead[step], ahead.filter((_, k) => k % 5 === 4 || k === T - 1));
    const list = names.map((name, m) => `${name} ${means[m][angle].toFixed(1)}`).join(", ");
    const text = `turned by ${angles[angle]} degrees, ${ahead[step]} frames ahead: ${names[chosen]} ${errors[chosen][angle][step].toFixed(1)} cm off \u00b7 mean over the frames (cm): ${list}`;
    tell(text, $("ahead"), step);
    [$("angle").value, $("model").value] = [angle, chosen];
    $("angle").setAttribute("aria-valuetext", `${angles[angle]} degrees`);
    describe(byAngle, `mean error by angle, cm: ${names.map((name, m) => `${name} ${means[m].map((v) => v.toFixed(0)).join(" ")}`).join("; ")}`);
    describe(byFrame, `error by frame, cm; ${text}`);
    describe(scene, `${text}. Drag sideways, or use the arrow keys left and right, to turn the scene; up and down choose the forecaster; Escape puts all back.`);
  }
  const later = lazily(draw);
  const [go, play] = stepped($("ahead"), () => T - 1, (k) => {
    step = k;
    later();
  }, 4);
  function choose(change) {
    ({ angle, chosen } = { angle, chosen, ...change });
    [angle, chosen] = [clamp(angle, 0, angles.length - 1), clamp(chosen, 0, names.length - 1)];
    later();
  }
  function reset() {
    play(false);
    choose({ angle: 0, chosen: names.length - 1 });
    go(T - 1);
  }
  let from = null; // where a drag began, and the angle then
  scene.style.touchAction = "pan-y";
  scene.onpointerdown = (e) => {
    scene.setPointerCapture(e.pointerId);
    from = [e.offsetX, angle];
  };
  scene.onpointermove = (e) => from && choose({ angle: Math.round(from[1] + (e.offsetX - from[0]) / 24) });
  scene.onpointerup = scene.onpointercancel = () => (from = null);
  keys(scene, () => ({ ArrowLeft: () => choose({ angle: angle - 1 }), ArrowRight: () => choose({ angle: angle + 1 }),
    ArrowUp: () => choose({ chosen: chosen - 1 }), ArrowDown: () => choose({ chosen: chosen + 1 }), Escape: reset }));
  scrub(byAngle, (s) => choose({ angle: Math.round(s * (angles.length - 1)) }));
  scrub(byFrame, (s) => (play(false), go(Math.round(clamp(s, 0, 1) * (T - 1)))));
  $("angle").max = angles.length - 1;
  $("ahead").max = T - 1;
  $("model").append(...names.map((name, m) => new Option(name, m)));
  $("angle").oninput = (e) => choose({ angle: +e.target.value });
  $("model").oninput = (e) => choose({ chosen: +e.target.value });
  onReset(reset);
  reset();
  watch(later);
})();
