// Cloth, drawn from far to near on a 2D canvas: smooth light, two sides, a check that folds with it, a shadow.
function cloth({ frames, centre, radius, marks: lines }, a, eye) { // a: unpacked points of all frames, faces, corners of a line beside it
  const N = a.points.length / 3 / frames, F = a.faces.length / 3;
  let fit = null;
  function measure(w, h) { // one scale for the whole run, so that playing does not make the picture breathe
    const see = eye.see(centre), q = [0, 0, 0], low = [1e9, 1e9], high = [-1e9, -1e9];
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
  for (const { face, ends, bright } of lines) {
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
  const heights = a.points.filter((_, i) => i % 3 === 2), floor = heights.reduce((m, z) => Math.min(m, z), 1e9) > -0.02 * radius;
  function drawShadow(g, place, frame) { // a soft ellipse on z = 0 that follows the cloth, fainter and wider the higher it hangs
    let [n, mx, my, xx, xy, yy, low] = [0, 0, 0, 0, 0, 0, 1e9];
    for (let i = 3 * N * frame; i < 3 * N * (frame + 1); i += 3) {
      const [x, y] = [a.points[i], a.points[i + 1]];
      [n, mx, my, xx, xy, yy] = [n + 1, mx + x, my + y, xx + x * x, xy + x * y, yy + y * y];
      low = Math.min(low, a.points[i + 2]);
    }
    [mx, my] = [mx / n, my / n];
    const turn = 0.5 * Math.atan2(2 * (xy / n - mx * my), xx / n - mx * mx - yy / n + my * my), [c, s] = [Math.cos(turn), Math.sin(turn)];
    const wide = (u, v) => 2 * Math.sqrt(Math.max(0, (u * u * xx + 2 * u * v * xy + v * v * yy) / n - (u * mx + v * my) ** 2)) + 0.05 * radius + 0.3 * low;
    const [A, B] = [wide(c, s), wide(-s, c)], at = (u, v) => place([mx + u, my + v, 0], 0);
    const o = at(0, 0), p = at(A * c, A * s), q = at(-B * s, B * c), soft = g.createRadialGradient(0, 0, 0, 0, 0, 1);
    const strength = (dark ? 0.8 : 0.4) * Math.exp(-Math.max(0, low) / radius);
    soft.addColorStop(0, `rgba(0,0,0,${strength})`);
    soft.addColorStop(1, "rgba(0,0,0,0)");
    g.save();
    g.transform(p[0] - o[0], p[1] - o[1], q[0] - o[0], q[1] - o[1], o[0], o[1]);
    g.fillStyle = soft;
    g.fillRect(-1, -1, 2, 2);
    g.restore();
  }
  function draw(g, w, h, frame, surface = true) { // all but what stands in front: items to be sorted by depth, and where a point is seen
    fit = fit || measure(w, h);
    const see = eye.see(centre), q = [0, 0, 0], size = fit.scale * eye.cam.zoom, far = 5 * radius;
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
    const items = [];
    const shown = surface ? F : 0;
    if (shown) dye();
    if (floor && N && eye.cam.el > 0) drawShadow(g, place, frame);
    const thin = clamp(0.005 * radius * size, 0.7, 3);
    normal.fill(0);
    for (let f = 0; f < shown; f++) {
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
    if (!shown) for (let i = 0; i < N; i++) items.push([V[3 * i + 2], () => {
      g.fillStyle = fade(dark ? "#babac4" : "#5d6b7a", 0.8);
      g.fillRect(S[2 * i] - 1.5, S[2 * i + 1] - 1.5, 3, 3);
    }]);
    return { place, items, S };
  }
  return { draw, refit: () => (fit = null) };
}
