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
