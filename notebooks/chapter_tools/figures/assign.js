// The column of every row in a cheapest assignment, rows at most as many as columns: shortest augmenting paths with potentials
// (the Hungarian method).
function assign(cost) {
  const n = cost.length, m = n && cost[0].length, u = new Float64Array(n + 1), v = new Float64Array(m + 1), row = new Int32Array(m + 1);
  for (let i = 1; i <= n; i++) {
    const least = new Float64Array(m + 1).fill(Infinity), way = new Int32Array(m + 1), used = new Uint8Array(m + 1);
    let j = 0;
    row[0] = i;
    do {
      let next = 0, step = Infinity;
      used[j] = 1;
      for (let k = 1; k <= m; k++) if (!used[k]) {
        const reduced = cost[row[j] - 1][k - 1] - u[row[j]] - v[k];
        if (reduced < least[k]) [least[k], way[k]] = [reduced, j];
        if (least[k] < step) [step, next] = [least[k], k];
      }
      for (let k = 0; k <= m; k++) {
        if (used[k]) (u[row[k]] += step), (v[k] -= step);
        else least[k] -= step;
      }
      j = next;
    } while (row[j]);
    for (; j; j = way[j]) row[j] = row[way[j]];
  }
  const column = new Array(n);
  for (let k = 1; k <= m; k++) if (row[k]) column[row[k] - 1] = k - 1;
  return column;
}
