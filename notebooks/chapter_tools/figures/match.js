// Optimal bottleneck matching of two small diagrams, two-sided or one-sided, as topokit.lemmas does it; `assign` is in assign.js.
// Idea: a bar may also be matched with its own place on the diagonal, and two such places with each other at no cost. The
// least threshold at which everything finds a partner is the bottleneck; among the matchings below it the cheapest is taken.
function matchLoops(first, second, oneSided = false) {
  const n = first.length, m = second.length, size = n + m, slack = 1e-9;
  const alone = (l) => (l.death - l.birth) / (oneSided ? 1 : 2);
  const pair = (a, b) => {
    const birth = b.birth - a.birth, death = b.death - a.death;
    if (oneSided && Math.min(birth, death) < -slack) return Infinity;
    return Math.max(oneSided ? 0 : Math.abs(birth), oneSided ? birth : Math.abs(death), oneSided ? death : 0);
  };
  const cost = Array.from({ length: size }, (_, i) => Array.from({ length: size }, (_, j) => {
    if (i < n) return j < m ? pair(first[i], second[j]) : alone(first[i]);
    return j < m ? alone(second[j]) : 0;
  }));
  const feasible = (limit) => {
    const fits = assign(cost.map((row) => row.map((c) => (c <= limit ? 0 : 1))));
    return fits.every((j, i) => cost[i][j] <= limit);
  };
  const limits = [...new Set(cost.flat())].filter(Number.isFinite).sort((a, b) => a - b);
  let low = 0, high = limits.length - 1;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (feasible(limits[middle])) high = middle;
    else low = middle + 1;
  }
  const bottleneck = limits[low] || 0, forbidden = 1 + 2 * size * bottleneck;
  const partner = assign(cost.map((row) => row.map((c) => (c <= bottleneck ? c : forbidden))));
  return { partner: partner.slice(0, n).map((j) => (j < m ? j : -1)), bottleneck };
}
