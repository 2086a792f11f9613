// Which edges are critical, and the path that decides it, as topokit.lemmas has it; `assign` and `matchLoops` are in files of their own.
//
//   distancesOf(points) -> rows of distances; the points are lists of coordinates
//   limitsOf(table, x, y, alpha, epsilon) -> { length, outer, apart, end, step, farther, lens, carriers }
//   isCritical(table, x, y, alpha, epsilon) -> whether no path joins some pair of points of the lens
//   hardest(table, x, y, alpha, epsilon) -> { path, excess }, null where the lens has no such pair
//   rivals(table, killer, death, below, above) -> [{ i, j, half, away }], the edges of half length in [death - below, death + above]
//
// Idea: a path may use points nearer than `end` to x and y, and steps shorter than `step`, at its two ends shorter than `end`. The
// *excess* of a path is the most by which it is above one of these limits, so a path counts when its excess is negative. Of each
// pair the path of least excess is found as Prim's algorithm finds a tree; the pair whose path has the largest excess is the
// hardest, and the edge is critical when this excess is not negative.
const ROUNDING = 1e-12; // relative; rounding may only add rivals and make more edges critical

function distancesOf(points) {
  return points.map((p) => points.map((q) => Math.hypot(...p.map((v, k) => v - q[k]))));
}

function edgesApart(table, [a, b], [c, d]) { // Hausdorff distance of two pairs of ends
  const nearer = (v, [p, q]) => Math.min(table[v][p], table[v][q]);
  return Math.max(nearer(a, [c, d]), nearer(b, [c, d]), nearer(c, [a, b]), nearer(d, [a, b]));
}

function limitsOf(table, x, y, alpha, epsilon) {
  const length = table[x][y];
  const end = (length - alpha - 4 * epsilon) * (1 - ROUNDING);
  const step = (length - 2 * alpha - 4 * epsilon) * (1 - ROUNDING);
  const outer = (length + 4 * epsilon) * (1 + ROUNDING);
  const apart = (length - 4 * epsilon) * (1 - ROUNDING);
  const farther = table.map((_, z) => Math.max(table[x][z], table[y][z]));
  const others = [...table.keys()].filter((z) => z !== x && z !== y);
  const lens = others.filter((z) => farther[z] <= outer);
  const carriers = others.filter((z) => farther[z] < end);
  return { length, outer, apart, end, step, farther, others, lens, carriers };
}

function pairsAsked(table, { lens, apart }) { // the pairs that the definition asks a path of
  const pairs = [];
  lens.forEach((a, k) => {
    for (const b of lens.slice(k + 1)) if (table[a][b] >= apart) pairs.push([a, b]);
  });
  return pairs;
}

function isCritical(table, x, y, alpha, epsilon) {
  const limits = limitsOf(table, x, y, alpha, epsilon);
  let blocked = pairsAsked(table, limits);
  const left = new Set(limits.carriers);
  while (blocked.length && left.size) { // a pair is joined when both touch one component of the carriers
    const component = [left.values().next().value];
    left.delete(component[0]);
    for (const p of component) {
      for (const q of left) {
        if (table[p][q] >= limits.step) continue;
        left.delete(q);
        component.push(q);
      }
    }
    const touches = (a) => component.some((p) => table[a][p] < limits.end);
    const touched = new Set(limits.lens.filter(touches));
    blocked = blocked.filter(([a, b]) => !touched.has(a) || !touched.has(b));
  }
  return blocked.length > 0;
}

function hardest(table, x, y, alpha, epsilon) {
  const limits = limitsOf(table, x, y, alpha, epsilon);
  let worst = null;
  let from = -1;
  let reached = null;
  for (const [a, b] of pairsAsked(table, limits)) {
    if (a !== from) reached = leastExcess(table, limits, a);
    from = a;
    const last = (p) => Math.max(reached[p], table[p][b] - limits.end);
    const excess = Math.min(...limits.others.map(last));
    if (!worst || excess > worst.excess) worst = { a, b, excess };
  }
  return worst && { excess: worst.excess, path: shortestPath(table, limits, worst) };
}

function leastExcess(table, { others, farther, end, step }, a) { // of a path from a to each point
  const reached = table.map((row, p) => Math.max(table[a][p], farther[p]) - end);
  const left = new Set(others);
  while (left.size) {
    let p = -1;
    for (const q of left) if (p < 0 || reached[q] < reached[p]) p = q;
    left.delete(p);
    for (const q of left) reached[q] = Math.min(reached[q], Math.max(reached[p], table[p][q] - step, farther[q] - end));
  }
  return reached;
}

function shortestPath(table, { others, farther, end, step }, { a, b, excess }) { // of those that count, else of those with the least excess
  const fits = excess < 0 ? (over) => over < 0 : (over) => over <= excess;
  const points = others.filter((p) => fits(farther[p] - end));
  const before = new Map();
  const length = new Map();
  for (const p of points) if (fits(table[a][p] - end)) length.set(p, table[a][p]);
  const left = new Set(points);
  let last = -1;
  let shortest = Infinity;
  for (;;) {
    let p = -1;
    for (const q of left) if (length.has(q) && (p < 0 || length.get(q) < length.get(p))) p = q;
    if (p < 0 || length.get(p) >= shortest) break;
    left.delete(p);
    if (fits(table[p][b] - end) && length.get(p) + table[p][b] < shortest) [last, shortest] = [p, length.get(p) + table[p][b]];
    for (const q of left) {
      const longer = length.get(p) + table[p][q];
      if (!fits(table[p][q] - step) || longer >= (length.get(q) ?? Infinity)) continue;
      length.set(q, longer);
      before.set(q, p);
    }
  }
  const path = [b];
  for (let p = last; p !== undefined; p = before.get(p)) path.unshift(p);
  return [a, ...path];
}

function rivals(table, killer, death, below, above) {
  const rounding = ROUNDING * Math.max(...table.map((row) => Math.max(...row)));
  const found = [];
  table.forEach((row, i) => row.forEach((distance, j) => {
    const half = distance / 2;
    if (j <= i || half < death - below - rounding || half > death + above + rounding) return;
    found.push({ i, j, half, away: edgesApart(table, killer, [i, j]) });
  }));
  return found;
}

function betaCritical(table, killer, death, alpha, epsilon) {
  const critical = rivals(table, killer, death, 2 * epsilon, alpha + 2 * epsilon).sort((e, f) => f.away - e.away);
  return critical.find(({ i, j }) => isCritical(table, i, j, alpha, epsilon))?.away ?? 0;
}

function betaAll(table, killer, death, alpha) {
  return Math.max(...rivals(table, killer, death, alpha, alpha).map(({ away }) => away));
}
