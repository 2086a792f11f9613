// The Gaussian mixture of the longest-lived loop of a planar cloud: its ellipses, its density, and how it fits the opening.
function mixtureOf(points, loop, most, noise) { // of the first `most` triangles, as topokit.loop_mixture has it
  const side = (a, b) => Math.hypot(points[a][0] - points[b][0], points[a][1] - points[b][1]) / 2;
  const value = ([a, b, c]) => Math.max(side(a, b), side(b, c), side(c, a)), [i, j] = loop.killerEdge;
  const outer = loop.triangles.flatMap(([, , z]) => [[i, z, j], [j, z, i]]); // of each killer triangle two edges, and its other corner
  const next = outer.map(([a, b, c]) => points.map((_, z) => [a, b, z]).filter((t) => t[2] !== a && t[2] !== b && t[2] !== c)
    .reduce((best, t) => (value(t) < value(best) ? t : best))).filter((t) => value(t) <= loop.death);
  const triangles = [...loop.triangles, ...next].slice(0, most), whole = triangles.reduce((sum, t) => sum + value(t), 0);
  return triangles.map((ids) => {
    const at = ids.map((v) => points[v]), m = [0, 1].map((k) => (at[0][k] + at[1][k] + at[2][k]) / 3);
    const spread = (k, l) => at.reduce((sum, p) => sum + (p[k] - m[k]) * (p[l] - m[l]), 0) / 2;
    return { ids, weight: value(ids) / whole, mean: m, cov: [spread(0, 0) + noise, spread(0, 1), spread(1, 1) + noise] };
  });
}
function density(mixture, p) {
  return mixture.reduce((sum, { weight, mean, cov: [a, b, c] }) => {
    const x = p[0] - mean[0], y = p[1] - mean[1], det = a * c - b * b;
    return sum + (weight * Math.exp((2 * b * x * y - c * x * x - a * y * y) / (2 * det))) / (2 * Math.PI * Math.sqrt(det));
  }, 0);
}
function matched(mixture) { // one Gaussian of the same mean and covariance
  const total = (f) => mixture.reduce((sum, g) => sum + g.weight * f(g), 0), mean = [0, 1].map((k) => total((g) => g.mean[k]));
  const cov = [[0, 0], [0, 1], [1, 1]].map(([k, l], n) => total((g) => g.cov[n] + (g.mean[k] - mean[k]) * (g.mean[l] - mean[l])));
  return [{ weight: 1, mean, cov }];
}
function within(curve, side) { // the points of a grid inside a closed curve
  const [low, high] = [Math.min, Math.max].map((f) => [0, 1].map((k) => f(...curve.map((p) => p[k])))), found = [];
  for (let m = 0; m < side * side; m++) {
    const p = [m % side, Math.floor(m / side)].map((n, k) => low[k] + ((n + 0.5) / side) * (high[k] - low[k]));
    const cuts = curve.filter(([x, y], k) => {
      const [u, v] = curve[(k + 1) % curve.length];
      return y > p[1] !== v > p[1] && p[0] < x + ((p[1] - y) / (v - y)) * (u - x);
    });
    if (cuts.length % 2) found.push(p);
  }
  return found;
}
function credibilities(mixture, places) { // of each place the share of the mass that is denser, on a grid of 64 by 64 cells
  const [{ mean, cov }] = matched(mixture), reach = [cov[0], cov[2]].map((v) => 6 * Math.sqrt(v)), cells = [];
  for (let m = 0; m < 4096; m++) cells.push(density(mixture, [m % 64, m >> 6].map((n, k) => mean[k] + (n / 31.5 - 1) * reach[k])));
  cells.sort((a, b) => b - a);
  const mass = cells.map(((sum) => (d) => (sum += d))(0)), at = (d) => { // how many cells are denser
    let [low, high] = [0, cells.length];
    while (low < high) ((m) => (cells[m] > d ? (low = m + 1) : (high = m)))((low + high) >> 1);
    return low;
  };
  return places.map((p) => (mass[at(density(mixture, p)) - 1] || 0) / mass[mass.length - 1]);
}

if (typeof data !== "undefined") (() => {
  const [scene, along, fit] = [$("scene"), $("along"), $("fit")], frame = framing(data.points, 0.03), LOW = -6, HIGH = -2;
  let points, vertex, most, power, loop;
  const noise = () => 10 ** power, curve = () => points.slice(0, data.border);
  function compute() {
    loop = rips(points).loops[0];
    later();
  }
  function ellipse(g, { scale, to }, { mean, cov: [a, b, c] }, style, width, dash) { // one standard deviation
    const half = (a + c) / 2, root = Math.hypot((a - c) / 2, b), [x, y] = to(mean);
    g.setLineDash(dash);
    g.beginPath();
    g.ellipse(x, y, scale * Math.sqrt(half + root), scale * Math.sqrt(Math.max(half - root, 0)), -Math.atan2(2 * b, a - c) / 2, 0, 7);
    pen(g, style, width);
    g.stroke();
    g.setLineDash([]);
  }
  function drawScene(mixture) {
    const [g, w, h] = start(scene), view = frame(w, h), { to, back } = view, cell = 8, shades = [];
    for (let x = 0; mixture && x < w; x += cell) for (let y = 0; y < h; y += cell) shades.push([x, y, density(mixture, back(x + cell / 2, y + cell / 2))]);
    const peak = shades.reduce((top, s) => Math.max(top, s[2]), 0);
    for (const [x, y, d] of shades) if (d > 0.02 * peak) ((g.fillStyle = fade(blue(), (0.5 * d) / peak)), g.fillRect(x, y, cell, cell));
    trace(g, curve().map(to), css("--ink"), 2.5, { close: true });
    (mixture || []).forEach((part, k) => {
      trace(g, part.ids.map((v) => to(points[v])), fade(k < 2 ? paint(0) : blue(), 0.8), 1, { close: true });
      ellipse(g, view, part, k < 2 ? paint(0) : blue(), 2.2, []);
    });
    if (mixture) ellipse(g, view, matched(mixture)[0], css("--ink"), 1.6, [5, 4]);
    points.forEach((p, v) => dot(g, to(p), v === vertex ? 7 : 4, css("--soft"), css(v === vertex ? "--accent" : "--panel"), v === vertex ? 3 : 1));
  }
  function drawAlong(mixture) { // the density at even steps of the opening's border
    const border = curve(), legs = border.map((p, k) => Math.hypot(...p.map((v, c) => border[(k + 1) % border.length][c] - v))), whole = legs.reduce((a, b) => a + b, 0);
    const values = Array.from({ length: 121 }, (_, n) => {
      let left = (n / 120) * whole, k = 0;
      while (k < legs.length - 1 && left > legs[k]) left -= legs[k++];
      return density(mixture, border[k].map((v, c) => v + (left / (legs[k] || 1)) * (border[(k + 1) % border.length][c] - v)));
    });
    const [g, X, Y] = axes(along, whole, 1.1 * Math.max(...values), "density along the border of the opening", "m");
    trace(g, values.map((d, n) => [X((n / 120) * whole), Y(d)]), blue(), 2.5);
  }
  const covered = (reached, q) => reached.filter((c) => c <= q).length / reached.length;
  function drawFit(both) { // the reliability diagram of the opening's points
    const [g, X, Y] = axes(fit, 1, 1.05, "share of the opening in the credible region", "mass of the region", [0, 0.5, 1], [0, 0.5, 1]);
    trace(g, [[X(0), Y(0)], [X(1), Y(1)]], css("--soft"), 1, { dash: [2, 4] });
    both.forEach((reached, k) => trace(g, Array.from({ length: 61 }, (_, n) => [X(n / 60), Y(covered(reached, n / 60))]), k ? css("--ink") : blue(), k ? 1.6 : 2.5, { dash: k ? [5, 4] : [] }));
  }
  function draw() {
    const mixture = loop && mixtureOf(points, loop, most, noise()), places = mixture ? within(curve(), 18) : [];
    const both = places.length ? [mixture, matched(mixture)].map((m) => credibilities(m, places)) : [];
    drawScene(mixture);
    [along, fit].forEach((canvas) => start(canvas));
    if (both.length) (drawAlong(mixture), drawFit(both));
    const said = both.map((reached) => [0.5, 0.9].map((q) => Math.round(100 * covered(reached, q)) + " %").join(" and "));
    const text = both.length ? `${mixture.length} components \u00b7 noise (${(1000 * Math.sqrt(noise())).toFixed(0)} mm)\u00b2 \u00b7 regions of 50 and 90 % cover ${said[0]} of the opening; of one Gaussian ${said[1]}` : "no loop, and no mixture";
    $("status").textContent = text;
    [$("most").value, $("noise").value] = [most, Math.round(25 * (power - LOW))];
    $("most").setAttribute("aria-valuetext", text);
    $("noise").setAttribute("aria-valuetext", text);
    describe(along, `density of the mixture along the border of the opening; ${text}`);
    describe(fit, `share of the opening that credible regions cover; ${text}`);
    describe(scene, `${text}. Drag a point, or ${KEYS}`);
  }
  const later = lazily(draw), place = (v, where) => ((points[v] = where), compute());
  function reset() {
    [points, vertex, most, power] = [data.points.map((p) => [...p]), -1, 6, -4];
    compute();
  }
  hands(scene, { points: () => points, frame, chosen: () => vertex, press: (v) => ((vertex = v), later()), put: place, Escape: reset });
  $("most").oninput = (e) => ((most = +e.target.value), later());
  $("noise").oninput = (e) => ((power = LOW + e.target.value / 25), later());
  onReset(reset);
  reset();
  watch(later);
})();
