// The copycat's error by how far a window of its own film must be away to be copied; the picture shows one window and its copy.
(() => {
  const [scene, error, same] = [$("scene"), $("error"), $("same")], { film, cut, frame, alive, titles, stays } = data, N = film.length;
  const table = unpack(data.features), D = table.length / N, features = Array.from({ length: N }, (_, i) => [...table.slice(i * D, (i + 1) * D)]);
  const ends = unpack(data.futures), futures = Array.from({ length: N }, (_, i) => [...ends.slice(3 * i, 3 * i + 3)]), windows = { film, cut, frame };
  const ranked = rankedOf(features, alive), last = data.longest + 1, gaps = Array.from({ length: last }, (_, k) => k + 1); // the last gap is the whole film
  const curves = [false, true].map((byCut) => gaps.map((gap) => scoreOfCopies(ranked, windows, futures, alive, gap, byCut)));
  const places = features.map((p) => p.slice(0, 2)), view = framing(places, 0.05), asked = Array.from({ length: N }, (_, i) => i).filter((i) => alive[i]);
  let gap, byCut, chosen;
  const percent = (v) => `${Math.round(100 * v)} %`, tint = (k) => (k < data.palette.length ? paint(k) : css("--soft").trim()), ink = (i) => tint(cut[i]);

  function drawScene() { // windows by their first two principal components; a film is a chain
    const [g, w, h] = start(scene), { to } = view(w, h), i = asked[chosen], j = copyOf(i, ranked, windows, gap, byCut);
    for (let k = 1; k < N; k++) if (film[k] === film[k - 1]) {
      const barred = byCut ? cut[k] === cut[i] : film[k] === film[i] && Math.min(Math.abs(frame[k] - frame[i]), Math.abs(frame[k - 1] - frame[i])) < gap;
      trace(g, [to(places[k - 1]), to(places[k])], barred ? css("--line") : fade(ink(k), 0.7), 1.5);
    }
    places.forEach((p, k) => {
      const barred = byCut ? cut[k] === cut[i] : film[k] === film[i] && Math.abs(frame[k] - frame[i]) < gap;
      dot(g, to(p), 2.6, barred ? css("--line") : ink(k));
    });
    if (j >= 0) {
      pen(g, css("--ink"), 2);
      line(g, ...to(places[i]), ...to(places[j]), [4, 4]);
      dot(g, to(places[j]), 7, ink(j), css("--ink"), 2);
    }
    dot(g, to(places[i]), 7, css("--panel"), css("--ink"), 3);
    g.textBaseline = "middle";
    data.cuts.forEach((name, k) => {
      dot(g, [16, 36 + 19 * k], 5, tint(k));
      g.fillStyle = css("--ink");
      word(g, name, 28, 36 + 19 * k);
    });
  }
  function chart(canvas, title, high, value, level) {
    const [g, X, Y, box] = axes(canvas, last, high, title, "gap (frames); at the right end: by episode");
    if (level !== undefined) trace(g, [[X(0), Y(level)], [X(last), Y(level)]], css("--soft"), 1.6, { dash: [5, 4] });
    curves.forEach((curve, k) => trace(g, curve.map((score, n) => [X(gaps[n]), Y(value(score))]), k ? paint(0) : blue(), +byCut === k ? 3 : 1.4));
    pen(g, css("--ink"), 1.2);
    line(g, X(gap), box.y, X(gap), box.y + box.h, [3, 3]);
  }
  function draw() {
    const i = asked[chosen], j = copyOf(i, ranked, windows, gap, byCut), score = curves[+byCut][gap - 1];
    const off = j < 0 ? "nothing to copy" : `copies frame ${frame[j]} of film ${film[j]}, ${titles[film[j]]}: ${(100 * Math.hypot(...futures[i].map((v, k) => v - futures[j][k]))).toFixed(1)} cm off`;
    const text = `gap ${gap === last ? "by episode" : `${gap} frames`}${byCut ? ", without its garment" : ""}: mean error ${(100 * score.error).toFixed(1)} cm, ${percent(score.same)} of the copies from the same film`
      + ` \u00b7 window at frame ${frame[i]} of film ${film[i]}, ${titles[film[i]]}, ${off}`;
    drawScene();
    chart(error, "mean error at t+60 (cm); dashed: it stays", 110 * Math.max(stays, ...curves.flat().map((one) => one.error)), (one) => 100 * one.error, 100 * stays);
    chart(same, "copies from the same film (%)", 105, (one) => 100 * one.same);
    tell(text, $("gap"), gap);
    [$("cut").checked, $("window").value] = [byCut, chosen];
    $("window").setAttribute("aria-valuetext", text);
    describe(error, `mean error by gap, cm: ${curves[+byCut].map((one) => (100 * one.error).toFixed(1)).join(" ")}; it stays ${(100 * stays).toFixed(1)}`);
    describe(same, `copies from the same film by gap: ${curves[+byCut].map((one) => percent(one.same)).join(" ")}`);
    describe(scene, `${text}. Click a window, or choose one with the keys n and p; left and right change the gap; Escape puts all back.`);
  }
  const later = lazily(draw);
  function choose(change) {
    ({ gap, byCut, chosen } = { gap, byCut, chosen, ...change });
    [gap, chosen] = [clamp(gap, 1, last), (chosen + asked.length) % asked.length];
    later();
  }
  const reset = () => choose({ gap: 1, byCut: false, chosen: Math.floor(asked.length / 3) });
  scene.onclick = (e) => {
    const { to } = view(scene.clientWidth, scene.clientHeight), k = nearest(asked.map((i) => places[i]), to, e.offsetX, e.offsetY, 24);
    if (k >= 0) choose({ chosen: k });
  };
  keys(scene, () => ({ n: () => choose({ chosen: chosen + 1 }), p: () => choose({ chosen: chosen - 1 }), ArrowLeft: () => choose({ gap: gap - 1 }),
    ArrowRight: () => choose({ gap: gap + 1 }), Escape: reset }));
  [$("gap").max, $("window").max] = [last, asked.length - 1];
  $("gap").oninput = (e) => choose({ gap: +e.target.value });
  $("cut").oninput = (e) => choose({ byCut: e.target.checked });
  $("window").oninput = (e) => choose({ chosen: +e.target.value });
  scrub(error, (s) => choose({ gap: Math.round(s * last) }));
  scrub(same, (s) => choose({ gap: Math.round(s * last) }));
  onReset(reset);
  reset();
  watch(later);
})();
