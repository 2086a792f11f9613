// How far apart two observers see the killer of one loop when nothing moves, as topokit.lemmas.corollary measures it; the scripts
// complex.js, match.js and lens.js compute loops, matchings and critical edges.
//
//   scenery(points) -> { points, table, loops }
//   observer(scene, hidden) -> { hidden, ids, alpha, complex, killer }; ids and killer are vertices of the scene; null where no loop is seen
//   compared(scene, a, b) -> { alpha, distance, life, paper, corrected }; a bound is null where its statement promises nothing
function scenery(points) {
  return { points, table: distancesOf(points), loops: rips(points).loops };
}

function observer({ points, table, loops }, hidden) {
  const ids = [...points.keys()].filter((v) => !hidden.includes(v));
  const alpha = Math.max(...points.map((_, v) => Math.min(...ids.map((o) => table[v][o]))));
  const complex = rips(ids.map((v) => points[v]));
  const [partner] = matchLoops(loops, complex.loops, true).partner;
  const killer = partner >= 0 ? complex.loops[partner].killerEdge.map((v) => ids[v]) : null;
  return { hidden, ids, alpha, complex, killer };
}

function compared({ table, loops }, a, b) { // the longest-lived loop of the scene
  const alpha = Math.max(a.alpha, b.alpha);
  const life = loops[0].death - loops[0].birth;
  const distance = a.killer && b.killer ? edgesApart(table, a.killer, b.killer) : Infinity;
  if (life <= alpha) return { alpha, distance, life, paper: null, corrected: null };

  // The paper's beta is one number for all loops that live longer than alpha; ours is of this loop.
  const long = loops.filter(({ birth, death }) => death - birth > alpha);
  const beta = Math.max(...long.map(({ killerEdge, death }) => betaAll(table, killerEdge, death, alpha)));
  const own = betaCritical(table, loops[0].killerEdge, loops[0].death, alpha, 0);
  return { alpha, distance, life, paper: 2 * alpha + beta, corrected: 2 * own };
}
