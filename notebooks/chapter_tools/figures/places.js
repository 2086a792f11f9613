// Where a loop is, in three ways, for the longest-lived loop of a planar cloud; `rips` is in complex.js.
const mean = (cloud) => [0, 1].map((k) => cloud.reduce((sum, p) => sum + p[k], 0) / cloud.length);
const apart = (p, q) => Math.hypot(p[0] - q[0], p[1] - q[1]);

function places(points) { // null where there is no loop
  const [loop] = rips(points).loops, at = (ids) => ids.map((v) => points[v]);
  if (!loop) return null;
  const walk = at(loop.cycle), next = (k) => walk[(k + 1) % walk.length];
  const steps = walk.map((p, k) => apart(p, next(k))), length = steps.reduce((a, b) => a + b, 0);
  const centroid = [0, 1].map((c) => walk.reduce((sum, p, k) => sum + (steps[k] * (p[c] + next(k)[c])) / 2, 0) / length);
  return { birth: loop.birth, death: loop.death, ids: loop.killerEdge, edge: at(loop.killerEdge),
    triangles: loop.triangles.map(at), thick: mean(at(loop.triangles[0])), cycle: walk, centroid };
}

function moved(a, b) { // how far the killer edge (Hausdorff distance), the thick triangle and the cycle moved
  const far = (from, to) => Math.max(...from.map((p) => Math.min(...to.map((q) => apart(p, q)))));
  return [Math.max(far(a.edge, b.edge), far(b.edge, a.edge)), apart(a.thick, b.thick), apart(a.centroid, b.centroid)];
}

function nudged(points, vertex, along, by) { // one point moved along the circle around the middle, or outward
  const middle = mean(points), [x, y] = points[vertex].map((v, k) => v - middle[k]), size = Math.hypot(x, y) || 1;
  const way = along ? [-y / size, x / size] : [x / size, y / size];
  return points.map((p, v) => (v === vertex ? p.map((c, k) => c + by * way[k]) : p));
}
