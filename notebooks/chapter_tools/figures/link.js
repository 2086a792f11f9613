// The linking number of two closed curves in space, by solid angles and by signed crossings, as topokit.linking counts it.
const minus = (p, q) => [p[0] - q[0], p[1] - q[1], p[2] - q[2]];
const inner = (p, q) => p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
const outer = (p, q) => [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]];
const along = (p, q, s) => p.map((v, k) => v + s * (q[k] - v));

function smooth(handles, pieces) { // a closed Catmull-Rom curve through the handles, as a polygon
  const n = handles.length, at = (i) => handles[(i + n) % n];
  return handles.flatMap((_, i) => Array.from({ length: pieces }, (_, m) => {
    const s = m / pieces, [p, q, r, t] = [at(i - 1), at(i), at(i + 1), at(i + 2)];
    return q.map((v, k) => v + (s / 2) * (r[k] - p[k] + s * (2 * p[k] - 5 * v + 4 * r[k] - t[k] + s * (3 * v - p[k] - 3 * r[k] + t[k]))));
  }));
}

function solid(u, v, w) { // signed solid angle of a triangle of unit vectors
  return 2 * Math.atan2(inner(u, outer(v, w)), 1 + inner(u, v) + inner(v, w) + inner(w, u));
}
function linkingSum(a, b) { // Gauss's integral: a whole number but for rounding
  const ways = a.map((p) => b.map((q) => {
    const r = minus(q, p), length = Math.hypot(...r);
    return r.map((v) => v / length);
  }));
  let sum = 0;
  for (let i = 0; i < a.length; i++) for (let j = 0; j < b.length; j++) {
    const [n, m] = [(i + 1) % a.length, (j + 1) % b.length], [u, v, w, x] = [ways[i][j], ways[n][j], ways[n][m], ways[i][m]];
    sum += solid(u, v, w) + solid(u, w, x);
  }
  return sum / (4 * Math.PI);
}

function crossingsOf(a, b) { // of curves as they are seen: right, up, towards the eye
  const found = [];
  for (let i = 0; i < a.length; i++) for (let j = 0; j < b.length; j++) {
    const [p, q, u, v] = [a[i], b[j], minus(a[(i + 1) % a.length], a[i]), minus(b[(j + 1) % b.length], b[j])];
    const turn = u[0] * v[1] - u[1] * v[0], w = minus(q, p);
    const s = (w[0] * v[1] - w[1] * v[0]) / turn, t = (w[0] * u[1] - w[1] * u[0]) / turn;
    if (!(s >= 0 && s < 1 && t >= 0 && t < 1)) continue; // nor where they are parallel
    const height = s * u[2] - w[2] - t * v[2];
    found.push({ place: [p[0] + s * u[0], p[1] + s * u[1]], sign: Math.sign(turn * height), over: height > 0 });
  }
  return found;
}

function gapOf(a, b) { // the least distance of two closed curves
  const share = (p, from, to) => { // of the way from one point to another, where it is nearest to p
    const d = minus(to, from);
    return Math.max(0, Math.min(1, inner(minus(p, from), d) / (inner(d, d) || 1)));
  };
  const far = (p, q) => Math.hypot(...minus(p, q)), near = (p, from, to) => far(p, along(from, to, share(p, from, to)));
  let least = Infinity;
  a.forEach((p, i) => b.forEach((q, j) => {
    const [r, t] = [a[(i + 1) % a.length], b[(j + 1) % b.length]], [u, v, w] = [minus(r, p), minus(t, q), minus(q, p)];
    const [uu, vv, uv, uw, vw] = [inner(u, u), inner(v, v), inner(u, v), inner(u, w), inner(v, w)], det = uu * vv - uv * uv;
    const [s, m] = [(uw * vv - vw * uv) / det, (uw * uv - vw * uu) / det];
    const between = s >= 0 && s <= 1 && m >= 0 && m <= 1 ? far(along(p, r, s), along(q, t, m)) : Infinity;
    least = Math.min(least, between, near(p, q, t), near(r, q, t), near(q, p, r), near(t, p, r));
  }));
  return least;
}
