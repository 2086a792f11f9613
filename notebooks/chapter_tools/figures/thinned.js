// A cloud thinned to some of its points, and a threshold alpha: which loops of the sample live alpha or longer.
// Idea: farthest points come in one order, so every sample is a prefix of it. The state is the length of the prefix and alpha, which may
// follow the covering radius. The loops of a sample are computed when it is first shown.
(() => {
  const [scene, diagram] = [$("scene"), $("diagram")], cloud = Float64Array.from(unpack(data.points)), n = cloud.length / 3;
  const { persistence } = ripsKernel(), { ids, radii } = farthestPoints(cloud, n, 3, n), sampled = subcloud(cloud, 3, ids);
  const later = lazily(draw), eye = orbit(scene, data.view, later, { Escape: reset }), known = [];
  let count, alpha; // alpha as the slider has it, in metres
  const mm = (v) => (1000 * v).toFixed(1), radius = () => radii[count - 1], follows = () => $("follow").checked, threshold = () => (follows() ? radius() : alpha);
  const loopsOf = (k) => (known[k] ??= persistence(sampled.subarray(0, 3 * k), k, 3));
  const life = ({ births, deaths }, i) => deaths[i] - births[i];
  const ink = (i) => (i ? blue() : paint(0)); // the longest loop has a colour of its own
  const long = (found) => [...found.births.keys()].filter((i) => life(found, i) >= threshold());
  let top = 1.1 * Math.max(...loopsOf(data.least).deaths, ...loopsOf(n).deaths); // of the diagram: it grows for a sample that needs it, and does not shrink
  function reset() {
    [count, alpha] = [data.start, radii[data.start - 1]];
    $("follow").checked = true;
    eye.back();
  }

  // ---- drawing -----------------------------------------------------------------------------------------------
  function drawScene() {
    const [g, w, h] = start(scene), see = eye.see(data.middle), zoom = (eye.cam.zoom * Math.min(w - 24, h - 44)) / data.spread;
    const S = Array.from({ length: n }, (_, v) => (([x, y]) => [w / 2 + zoom * x, h / 2 + 8 - zoom * y])(see(sampled, 3 * v)));
    const found = loopsOf(count), places = (list) => Array.from(list, (v) => S[v]);
    S.forEach((p, v) => dot(g, p, v < count ? 2.6 : 1.3, css(v < count ? "--ink" : "--soft")));
    for (const i of long(found).reverse()) {
      for (const k of [6 * i + 3, 6 * i]) trace(g, places(found.killerTriangles.subarray(k, k + 3)), fade(ink(i), 0.95), 1.3, { close: true, fill: fade(ink(i), 0.4) });
      for (const [style, width] of [[css("--panel"), i ? 4 : 6], [ink(i), i ? 2.2 : 3.4]]) trace(g, places(found.killerEdges.subarray(2 * i, 2 * i + 2)), style, width);
    }
    if (count === n) return;
    const among = (v) => [0, 1, 2].reduce((sum, c) => sum + (sampled[3 * v + c] - sampled[3 * count + c]) ** 2, 0); // the next point is the farthest from the sample
    const next = Array.from({ length: count }, (_, v) => v).reduce((best, v) => (among(v) < among(best) ? v : best), 0);
    trace(g, places([count, next]), css("--ink"), 2);
    dot(g, S[count], 3.5, css("--panel"), css("--ink"), 1.5);
    g.textBaseline = "middle";
    g.fillStyle = css("--ink");
    word(g, "covering radius", Math.min(S[count][0] + 8, w - 100), S[count][1]);
  }
  function drawDiagram() {
    const found = loopsOf(count), counted = long(found), high = 1000 * top;
    const [g, X, Y] = axes(diagram, high, high, "diagram: death against birth (mm)", "birth");
    pen(g, css("--soft"), 1.2);
    line(g, X(0), Y(0), X(high), Y(high));
    const lines = [[1000 * threshold(), follows() ? "\u03b1 = covering radius" : "\u03b1", css("--ink"), [7, 4]]];
    if (!follows()) lines.push([1000 * radius(), "covering radius", css("--soft"), [2, 4]]);
    for (const i of [...found.births.keys()].reverse()) {
      const counts = counted.includes(i);
      dot(g, [X(1000 * found.births[i]), Y(1000 * found.deaths[i])], counts ? 5.5 : 3, counts ? ink(i) : css("--soft"), css("--panel"), 1);
    }
    const [upper] = lines.map(([v]) => v).sort((p, q) => q - p);
    for (const [v, name, style, dash] of lines) {
      pen(g, style, 1.5);
      line(g, X(0), Y(v), X(high - v), Y(high), dash);
      const at = 0.86 * (high - v), left = v === upper && X(at) - g.measureText(name).width > X(0) + 12; // above the upper line, where there is room
      g.fillStyle = style;
      g.textAlign = left ? "right" : "left";
      word(g, name, X(at) + (left ? -8 : 10), Y(at + v) + (left ? 0 : 6));
      g.textAlign = "left";
    }
  }
  function draw() {
    top = Math.max(top, 1.05 * loopsOf(count).deaths.reduce((most, death) => Math.max(most, death), 0));
    drawScene();
    drawDiagram();
    const found = loopsOf(count), many = found.births.length, counted = long(found).length, text = [`${count} of ${n} points`, `covering radius ${mm(radius())} mm`, `\u03b1 = ${mm(threshold())} mm`];
    text.push(`${counted} of ${many} loops live${counted === 1 ? "s" : ""} \u03b1 or longer`);
    if (many) text.push(`the longest lives ${mm(life(found, 0))} mm`);
    if (counted) text.push(threshold() < radius() ? "\u03b1 is below the covering radius: such a loop may be a gap of the sample" : `every such loop is also a loop of all ${n} points`);
    tell(text.join(" \u00b7 "), $("count"), count);
    $("count-is").textContent = count;
    $("alpha").value = 1000 * threshold();
    $("alpha-is").textContent = `${mm(threshold())} mm`;
    $("alpha").setAttribute("aria-valuetext", $("alpha-is").textContent);
    describe(scene, `The cloud, its sample, and the killer triangles of the loops that live \u03b1 or longer; ${$("status").textContent}. ${TURN}; Escape begins anew.`);
    describe(diagram, `the persistence diagram of the sample, with the line of lifetime \u03b1; ${$("status").textContent}`);
  }

  // ---- hands -------------------------------------------------------------------------------------------------
  [$("count").min, $("count").max, $("alpha").max] = [data.least, n, 1000 * radii[data.least - 1]];
  $("count").oninput = (e) => ((count = +e.target.value), later());
  $("alpha").oninput = (e) => {
    alpha = e.target.value / 1000;
    $("follow").checked = false;
    later();
  };
  $("follow").onchange = () => ((alpha = radius()), later());
  onReset(reset);

  // ---- start -------------------------------------------------------------------------------------------------
  reset();
  watch(later);
})();
