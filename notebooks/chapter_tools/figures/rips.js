// Degree-1 Rips persistence of a small cloud, by lunes, as topokit.rips does it.
// Idea: edges arrive by (length, smaller index, larger index). The lune of an edge is the set of points already joined to
// both of its ends. An empty lune joins two components or creates a loop; each further component of a lune is a relation
// that may kill one. A cycle is written in creators, a bit each: an edge with a lune counts as the two other edges of a
// triangle on it, an edge of the spanning forest as nothing.
function edgesOf(points) { // in order
  const edges = [];
  for (let i = 0; i < points.length; i++) for (let j = i + 1; j < points.length; j++) {
    const square = points[i].reduce((sum, x, k) => sum + (x - points[j][k]) * (x - points[j][k]), 0);
    edges.push({ i, j, square, value: Math.sqrt(square) / 2 });
  }
  return edges.sort((a, b) => a.square - b.square); // stable, and i, j came in order
}
function forest(n) { // joins two components, unless they are one
  const ends = [...Array(n).keys()], find = (i) => (ends[i] === i ? i : (ends[i] = find(ends[i])));
  return (i, j) => find(i) !== find(j) && ((ends[find(i)] = find(j)), true);
}
function rips(points) {
  const n = points.length, edges = edgesOf(points), at = new Int32Array(n * n).fill(-1), joins = forest(n);
  edges.forEach((edge, rank) => {
    edge.cycle = 0n;
    at[edge.i * n + edge.j] = at[edge.j * n + edge.i] = rank;
  });
  const edge = (i, j) => edges[at[i * n + j]], joined = (i, j, rank) => at[i * n + j] >= 0 && at[i * n + j] < rank;
  const later = (edge, z) => Math.max(edges[at[edge.i * n + z]].square, edges[at[edge.j * n + z]].square);

  // From the moment when one point is joined to all others the complex is a cone: no loop is alive or will be born.
  let cone = Infinity;
  for (let i = 0; i < n; i++) cone = Math.min(cone, edges.reduce((m, e) => (e.i === i || e.j === i ? Math.max(m, e.value) : m), 0));

  function lune(e, rank) { // its components, each from the point that is joined to both ends first
    const left = [], found = [];
    for (let z = 0; z < n; z++) if (joined(e.i, z, rank) && joined(e.j, z, rank)) left.push(z);
    left.sort((a, b) => later(e, a) - later(e, b) || a - b);
    while (left.length) {
      const part = [left.shift()];
      for (const z of part) for (let k = left.length - 1; k >= 0; k--) if (joined(z, left[k], rank)) part.push(...left.splice(k, 1));
      found.push(part);
    }
    return found;
  }

  const creators = [], merges = [];
  const through = (e, z) => edge(e.i, z).cycle ^ edge(e.j, z).cycle;
  edges.every((e, rank) => {
    if (e.value > cone) return false;
    const [first, ...further] = (e.parts = lune(e, rank)).map(([apex]) => apex);
    if (first !== undefined) e.cycle = through(e, first);
    else if (joins(e.i, e.j)) {
      merges.push(e.value);
      e.joins = true;
    } else {
      e.cycle = 1n << BigInt(creators.length);
      creators.push({ e, rank, bit: e.cycle, killer: null });
    }
    for (const z of further) {
      let column = through(e, first) ^ through(e, z), youngest;
      while ((youngest = column && creators[column.toString(2).length - 1]) && youngest.killer) column ^= youngest.column;
      if (!youngest) continue; // a void begins
      e.kills = (e.kills || 0) + 1;
      Object.assign(youngest, { column, killer: e, death: rank, apexes: [z, first] }); // the thick triangle first
    }
    return true;
  });

  // A shortest closed walk at birth through the birth edge, in the very class that the killer ends. (The birth edge and
  // the shortest way back may run around an older loop as well, and outlive the bar.) Idea: Dijkstra over pairs (vertex,
  // class of the way so far), classes up to the relations that came before the birth edge.
  function cycle({ e: born, rank, bit, column }) {
    const known = creators.filter((c) => c.killer && c.death < rank).reverse();
    const reduce = (mask) => known.reduce((m, c) => (m & c.bit ? m ^ c.column : m), mask);
    const goal = reduce(column ^ bit), best = new Map(), open = [{ v: born.i, mask: 0n, length: 0, from: null }];
    while (open.length) {
      const here = open.splice(open.reduce((m, s, k) => (s.length < open[m].length ? k : m), 0), 1)[0], key = here.v + ":" + here.mask;
      if (best.has(key)) continue;
      best.set(key, here);
      if (here.v === born.j && here.mask === goal) {
        const walk = [];
        for (let s = here; s; s = s.from) walk.push(s.v);
        return walk;
      }
      for (let v = 0; v < n; v++) if (joined(here.v, v, rank)) {
        const e = edge(here.v, v), mask = reduce(here.mask ^ e.cycle);
        if (!best.has(v + ":" + mask)) open.push({ v, mask, length: here.length + 2 * e.value, from: here });
      }
    }
    return [];
  }

  const loops = creators.filter((c) => c.killer && c.killer.value > c.e.value).map((c) => ({
    birth: c.e.value, death: c.killer.value, birthEdge: [c.e.i, c.e.j], killerEdge: [c.killer.i, c.killer.j],
    triangles: c.apexes.map((z) => [c.killer.i, c.killer.j, z]),
    get cycle() { // found when it is first asked for
      return (this.walk ??= cycle(c));
    },
  })).sort((a, b) => b.death - b.birth - (a.death - a.birth));
  const does = (rank) => { // what an edge does when it arrives, after the cone as well
    const e = edges[rank], c = (e.parts ??= lune(e, rank)).length;
    return e.kills ? "kills" : e.joins ? "joins" : ["begins", "nothing"][c] || "void";
  };
  return { edges, merges, loops, cone, does, joined };
}
function loopsFromRows(points, rows) { // the same from rows that topokit wrote: birth edge, killer edge, two apexes, length of a cycle, cycle
  const edges = edgesOf(points), joins = forest(points.length), loops = [], value = (a, b) => edges.find((e) => e.i === a && e.j === b).value;
  for (let k = 0; k < rows.length; k += 7 + rows[k + 6]) {
    const [a, b, i, j, y, z, many] = rows.subarray(k, k + 7), cycle = [...rows.subarray(k + 7, k + 7 + many)];
    loops.push({ birth: value(a, b), death: value(i, j), birthEdge: [a, b], killerEdge: [i, j], triangles: [[i, j, y], [i, j, z]], cycle });
  }
  return { edges, loops, merges: edges.filter((e) => joins(e.i, e.j)).map((e) => e.value) };
}
function spacing(points) { // half the largest distance from a point to its nearest other one, as topokit.sampling.spacing
  const apart = points.map((p) => Math.min(...points.map((q) => Math.hypot(...p.map((x, k) => x - q[k]))).filter((d) => d > 0)));
  return Math.max(0, ...apart.filter(Number.isFinite)) / 2;
}
