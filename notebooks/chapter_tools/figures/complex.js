// The Rips complex of a small cloud as the figures draw it: the kernel's edges and loops as lists. Points are lists of coordinates.
const kernel = ripsKernel();
const flatOf = (points) => Float64Array.from(points.flat());

function rips(points) {
  const n = points.length, d = n ? points[0].length : 2, flat = flatOf(points);
  const order = kernel.filtration(flat, n, d), found = kernel.persistence(flat, n, d), { rank } = order;
  const joined = (i, j, e) => rank[i * n + j] < e; // before an edge, by its number
  const later = (edge, z) => order.keys[Math.max(rank[edge.i * n + z], rank[edge.j * n + z])];

  function lune(edge, e) { // its components, each from the point that is joined to both ends first
    const left = [], parts = [];
    for (let z = 0; z < n; z++) if (joined(edge.i, z, e) && joined(edge.j, z, e)) left.push(z);
    left.sort((a, b) => later(edge, a) - later(edge, b) || a - b);
    while (left.length) {
      const part = [left.shift()];
      for (const z of part) for (let k = left.length - 1; k >= 0; k--) if (joined(z, left[k], e)) part.push(...left.splice(k, 1));
      parts.push(part);
    }
    return parts;
  }
  const edges = Array.from({ length: order.count }, (_, e) => ({
    i: order.low[e], j: order.high[e], value: Math.sqrt(order.keys[e]) / 2 / order.scale,
    get parts() { // found when they are first asked for
      return (this.components ??= lune(this, e));
    },
  }));

  const row = (array, many, k) => [...array.subarray(many * k, many * (k + 1))];
  const loops = [...found.births.keys()].map((k) => ({
    birth: found.births[k], death: found.deaths[k], birthEdge: row(found.birthEdges, 2, k), killerEdge: row(found.killerEdges, 2, k),
    triangles: [row(found.killerTriangles, 3, 2 * k), row(found.killerTriangles, 3, 2 * k + 1)],
    get cycle() {
      return (this.walk ??= [...kernel.cycle(flat, n, d, found, k)]);
    },
  }));

  const { created, killed } = found.pairing, killers = new Set(killed.map((killer) => killer && rank[killer[0] * n + killer[1]]));
  const does = (e) => { // what an edge does when it arrives
    if (killers.has(e)) return "kills";
    if (created.includes(e)) return "begins";
    return ["joins", "nothing"][edges[e].parts.length] ?? "void";
  };
  return { edges, loops, merges: [...found.merges], cone: Math.sqrt(order.cone) / 2 / order.scale, does, joined };
}
