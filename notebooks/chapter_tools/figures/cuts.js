// What a reader takes away from a cloud in space: what is outside a box, and planes. Points are flat, three numbers a point.
//
//   middleOf(points) -> [low, high]                         corners of the box of all points but the outermost half per cent at each side
//   cutAway(points, { crop, planes }) -> { kept, off, outside, onPlane }   crop: [low, high], null where there is no limit
//   largestPlane(points, thickness) -> { normal, offset, thickness }       the plane with the most points within the thickness
function cloudCuts() {
  const dotted = (p, q) => p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
  const less = (p, q) => p.map((v, k) => v - q[k]);
  const crossed = (p, q) => [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]];
  function sampled(points, most) {
    const count = points.length / 3, step = Math.max(1, Math.floor(count / most));
    return Array.from({ length: Math.ceil(count / step) }, (_, i) => [...points.subarray(3 * i * step, 3 * i * step + 3)]);
  }

  function middleOf(points) {
    const sample = sampled(points, 2000), axes = [0, 1, 2].map((k) => Float64Array.from(sample, (p) => p[k]).sort());
    return [0.005, 0.995].map((share) => axes.map((axis) => axis[Math.round(share * (axis.length - 1))] ?? 0));
  }

  function cutAway(points, { crop, planes = [] } = {}) {
    const [low, high] = crop ?? [[null, null, null], [null, null, null]], [kept, off] = [new Float64Array(points.length), new Float64Array(points.length)];
    let [stay, gone, outside] = [0, 0, 0];
    for (let i = 0; i < points.length; i += 3) {
      const place = [points[i], points[i + 1], points[i + 2]];
      const isIn = place.every((v, k) => (low[k] === null || v >= low[k]) && (high[k] === null || v <= high[k]));
      if (isIn && planes.every(({ normal, offset, thickness }) => Math.abs(dotted(place, normal) - offset) > thickness)) {
        kept.set(place, stay);
        stay += 3;
      } else {
        off.set(place, gone);
        gone += 3;
        if (!isIn) outside++;
      }
    }
    return { kept: kept.slice(0, stay), off: off.slice(0, gone), outside, onPlane: gone / 3 - outside };
  }

  // Source: RANSAC, Fischler and Bolles 1981; then the plane of least squares of what is near the best one. The numbers are rounded to
  // what the thickness needs, so that a line of Python can show them whole.
  function largestPlane(points, thickness) {
    const sample = sampled(points, 2000);
    if (!(thickness > 0)) throw new Error("a plane needs a thickness above 0");
    if (sample.length < 4) throw new Error("too few points are left for a plane");
    let [best, normal, seed] = [[], [0, 0, 1], 1];
    const one = () => sample[(seed = (Math.imul(seed, 1664525) + 1013904223) >>> 0) % sample.length];
    for (let trial = 0; trial < 600; trial++) {
      const [a, b, c] = [one(), one(), one()], across = crossed(less(b, a), less(c, a)), long = Math.hypot(...across);
      if (!long) continue;
      const unit = across.map((v) => v / long), level = dotted(a, unit), near = sample.filter((p) => Math.abs(dotted(p, unit) - level) <= thickness);
      if (near.length > best.length) [best, normal] = [near, unit];
    }
    if (!best.length) throw new Error("all points are on a line: there is no plane");
    const middle = [0, 1, 2].map((k) => best.reduce((total, p) => total + p[k], 0) / best.length), moved = best.map((p) => less(p, middle));
    const rows = [0, 1, 2].map((k) => [0, 1, 2].map((l) => moved.reduce((total, p) => total + p[k] * p[l], 0)));
    const normals = [[1, 2], [2, 0], [0, 1]].map(([k, l]) => crossed(rows[k], rows[l])).sort((p, q) => Math.hypot(...q) - Math.hypot(...p));
    if (Math.hypot(...normals[0]) > 0) normal = normals[0].map((v) => v / Math.hypot(...normals[0]));
    const digits = (size) => Math.min(15, Math.max(2, 3 + Math.ceil(Math.log10(size / thickness))));
    normal = normal.map((v) => +v.toFixed(digits(Math.hypot(...middle))) + 0);
    return { normal, offset: +dotted(middle, normal).toFixed(digits(1)), thickness };
  }
  return { middleOf, cutAway, largestPlane };
}
