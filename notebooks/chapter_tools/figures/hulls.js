// When a forecast mean counts as in a true loop: the treatments of the hull measure, as topokit.evaluate has them.
const OFFSET = 0.25; // allowed distance from a loop's plane, as a share of its radius
const less = (p, q) => [p[0] - q[0], p[1] - q[1], p[2] - q[2]], times = (p, q) => p[0] * q[0] + p[1] * q[1] + p[2] * q[2];

function nearestOf(corners) { // the point of a simplex nearest to the origin: [its place, the corners that it depends on]
  let best = [null, []], least = Infinity;
  for (let mask = 1; mask < 1 << corners.length; mask++) {
    // The nearest point of the flat through these corners, and its weights, by elimination in the normal equations.
    const some = corners.filter((_, k) => (mask >> k) & 1), [first, ...rest] = some, sides = rest.map((p) => less(p, first)), n = sides.length;
    const rows = sides.map((side) => [...sides.map((other) => times(side, other)), -times(side, first)]);
    let singular = false;
    for (let i = 0; i < n; i++) {
      const pivot = rows.slice(i).reduce((top, row, k) => (Math.abs(row[i]) > Math.abs(rows[top][i]) ? i + k : top), i);
      [rows[i], rows[pivot]] = [rows[pivot], rows[i]];
      if (Math.abs(rows[i][i]) < 1e-14) singular = true;
      for (let k = 0; k < n && !singular; k++) {
        const share = k === i ? 0 : rows[k][i] / rows[i][i];
        rows[k] = rows[k].map((v, c) => v - share * rows[i][c]);
      }
    }
    const weights = rows.map((row, i) => row[n] / row[i]), free = 1 - weights.reduce((sum, v) => sum + v, 0);
    if (singular || [free, ...weights].some((v) => !(v >= -1e-12))) continue; // outside of the simplex
    const place = first.map((v, c) => v + sides.reduce((sum, side, k) => sum + weights[k] * side[c], 0)), size = times(place, place);
    if (size < least) [least, best] = [size, [place, some]];
  }
  return best;
}
function hullDistance(point, points) { // by the method of Gilbert, Johnson and Keerthi
  const offsets = points.map((p) => less(p, point)), scale = Math.max(...offsets.flat().map(Math.abs)) || 1;
  const scaled = offsets.map((p) => p.map((v) => v / scale));
  let [place, corners] = [scaled[0], [scaled[0]]];
  for (let step = 0; step < 200; step++) {
    const farthest = scaled.reduce((low, p) => (times(p, place) < times(low, place) ? p : low));
    if (corners.includes(farthest) || times(place, place) - times(farthest, place) < 1e-14) break;
    [place, corners] = nearestOf([...corners, farthest]);
    if (times(place, place) < 1e-24) return 0;
  }
  return scale * Math.sqrt(times(place, place));
}

function principal(offsets) { // axes of the largest, the middle and the least spread, by Jacobi's rotations
  const matrix = [0, 1, 2].map((i) => [0, 1, 2].map((j) => offsets.reduce((sum, p) => sum + p[i] * p[j], 0)));
  const axes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]; // columns
  for (let sweep = 0; sweep < 30; sweep++) for (const [i, j] of [[0, 1], [0, 2], [1, 2]]) {
    const angle = Math.atan2(2 * matrix[i][j], matrix[j][j] - matrix[i][i]) / 2, c = Math.cos(angle), s = Math.sin(angle);
    for (const table of [matrix, axes]) for (const row of table) [row[i], row[j]] = [c * row[i] - s * row[j], s * row[i] + c * row[j]];
    [matrix[i], matrix[j]] = [matrix[i].map((v, k) => c * v - s * matrix[j][k]), matrix[i].map((v, k) => s * v + c * matrix[j][k])];
  }
  const order = [0, 1, 2].sort((a, b) => matrix[b][b] - matrix[a][a]);
  return order.map((k) => axes.map((row) => row[k]));
}
function extentOf(curve) { // the centroid by length, and the distance of the farthest vertex
  const next = (k) => curve[(k + 1) % curve.length], legs = curve.map((p, k) => Math.hypot(...less(next(k), p)));
  const whole = legs.reduce((sum, v) => sum + v, 0);
  const centre = [0, 1, 2].map((c) => curve.reduce((sum, p, k) => sum + (legs[k] * (p[c] + next(k)[c])) / 2, 0) / whole);
  return { centre, radius: Math.max(...curve.map((p) => Math.hypot(...less(p, centre)))) };
}
function planeDistance(point, curve) { // Infinity outside of the outline that is seen along the normal
  const offsets = curve.map((p) => less(p, point)), mean = [0, 1, 2].map((c) => offsets.reduce((sum, p) => sum + p[c], 0) / offsets.length);
  const [u, v, normal] = principal(offsets.map((p) => less(p, mean)));
  const outline = offsets.map((p) => [times(p, u), times(p, v), 0]);
  return hullDistance([0, 0, 0], outline) < 1e-9 ? Math.abs(times(mean, normal)) : Infinity;
}

const TREATMENTS = ["marked curve", "wide hull", "any curve", "near its plane", "in the opening"];
function hullsOf(treatment, { curve, closing, tight }) { // the points whose hulls count
  if (treatment === "marked curve") return [curve];
  return treatment === "wide hull" ? [[...curve, ...closing]] : treatment === "any curve" ? [[...curve, ...closing], [...tight, ...closing]] : [];
}
function judged(treatment, loop, point, tolerance) { // how far off by this treatment, and the largest distance that counts as in, metres
  const { centre, radius } = extentOf(loop.curve);
  if (treatment === "near its plane") return { off: planeDistance(point, loop.curve), most: OFFSET * radius };
  if (treatment === "in the opening") return { off: Math.hypot(...less(point, centre)), most: radius };
  return { off: Math.min(...hullsOf(treatment, loop).map((points) => hullDistance(point, points))), most: tolerance };
}
