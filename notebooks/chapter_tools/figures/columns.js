// The boundary matrix of edges and triangles up to a radius, reduced over Z/2 as topokit.rips.reduction does it, a sum at a time.
// Idea: a column is a number with a bit for each edge, in order, so that its pivot is its highest bit; a chain has one for each triangle.
const bits = (column) => [...column.toString(2)].reverse().flatMap((one, k) => (one === "1" ? [k] : []));
const pivot = (column) => column.toString(2).length - 1; // of a column that is not empty

function eliminate(points, radius) {
  const rows = rips(points).edges.filter((e) => e.value <= radius), rank = new Map(rows.map((e, k) => [e.i + "," + e.j, k]));
  const columns = [], steps = [], owner = new Map();
  for (const { i, j } of rows) for (let z = j + 1; z < points.length; z++) { // each triangle once, by its two lowest vertices
    const sides = [[i, j], [i, z], [j, z]].map((ends) => rank.get(ends.join()));
    if (!sides.includes(undefined)) columns.push({ ids: [i, j, z], latest: Math.max(...sides), boundary: sides.reduce((sum, k) => sum | (1n << BigInt(k)), 0n) });
  }
  columns.sort((a, b) => a.latest - b.latest || a.ids.map((v, k) => v - b.ids[k]).find((d) => d));
  columns.forEach(({ boundary }, k) => {
    let step = { k, column: boundary, chain: 1n << BigInt(k), added: -1 };
    for (;;) {
      const other = step.column && owner.get(pivot(step.column)); // to be added next; the last step of a column has none
      steps.push(Object.assign(step, { next: other ? other.k : -1 }));
      if (!other) break;
      step = { k, column: step.column ^ other.column, chain: step.chain ^ other.chain, added: other.k };
    }
    if (step.column) owner.set(pivot(step.column), step);
  });
  return { rows, columns, steps };
}

// Whether a cycle bounds at a radius, and what it goes around. The cycle is a list of rows; the answer is the list of loops around
// which it goes, by their places in rips(points).loops, and triangles: their boundary is the cycle, plus those loops' cycles.
// Idea: reduced columns and the cycles of the living loops span all cycles, so the reduction of any cycle ends in nothing.
function bounding(points, radius, cycle) {
  const { rows, columns, steps } = eliminate(points, radius), owner = new Map(), one = (k) => 1n << BigInt(k);
  const reduced = (column, chain = 0n, loops = 0n) => {
    for (let other; column && (other = owner.get(pivot(column)));) [column, chain, loops] = [column ^ other.column, chain ^ other.chain, loops ^ other.loops];
    return { column, chain, loops };
  };
  for (const { column, chain, next } of steps) if (column && next < 0) owner.set(pivot(column), { column, chain, loops: 0n });
  rips(points).loops.forEach(({ birth, death, cycle: walk }, k) => {
    if (radius < birth || radius >= death) return;
    const ends = walk.map((v, at) => [v, walk[(at + 1) % walk.length]].sort((a, b) => a - b).join());
    const rest = reduced(rows.reduce((sum, e, row) => (ends.includes(e.i + "," + e.j) ? sum | one(row) : sum), 0n), 0n, one(k));
    owner.set(pivot(rest.column), rest);
  });
  const { chain, loops } = reduced(cycle.reduce((sum, row) => sum ^ one(row), 0n));
  return { loops: bits(loops), triangles: bits(chain).map((t) => columns[t].ids) };
}
