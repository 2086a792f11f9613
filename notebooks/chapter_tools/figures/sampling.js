// Farthest points and distances to nearest points of a cloud, as topokit.sampling has them. Points lie in one flat array.
// Idea of `farthestPoints` (Gonzalez 1985): the next point is the one farthest from all that are chosen.
//
//   farthestPoints(points, n, d, k, start = 0) -> { ids: Int32Array(k), radii }   start -1: the point farthest from the mean;
//                                                    radii: the covering radius of the first 1, 2, ... k points
//   nearestOthers(points, n, d, k, others = points) -> Float64Array(n * k)           distances, ascending; Infinity where there are fewer
//   placeGaps(points, n, d) -> Float64Array(n)       from each point to the nearest other place; 0 where there is none
function squareBetween(points, i, others, j, d) { // the square of the distance between two points of flat arrays
  let sum = 0;
  for (let k = 0; k < d; k++) {
    const step = points[i * d + k] - others[j * d + k];
    sum += step * step;
  }
  return sum;
}

function farthestPoints(points, n, d, k, start = 0) {
  let next = start;
  if (start < 0) {
    const mean = new Float64Array(d);
    for (let i = 0; i < n * d; i++) mean[i % d] += points[i];
    for (let axis = 0; axis < d; axis++) mean[axis] /= n;
    let most = -1;
    for (let i = 0; i < n; i++) {
      const square = squareBetween(points, i, mean, 0, d);
      if (square > most) [most, next] = [square, i];
    }
  }
  const ids = new Int32Array(k);
  const squares = new Float64Array(n).fill(Infinity); // from every point to the nearest of those chosen so far
  const radii = new Float64Array(k);
  for (let c = 0; c < k; c++) {
    const newest = next;
    ids[c] = newest;
    let farthest = -1;
    for (let i = 0; i < n; i++) {
      const square = squareBetween(points, i, points, newest, d);
      if (square < squares[i]) squares[i] = square;
      if (squares[i] > farthest) {
        farthest = squares[i];
        next = i;
      }
    }
    radii[c] = Math.sqrt(farthest);
  }
  return { ids, radii };
}

function nearestOthers(points, n, d, k, others = points) {
  const many = others.length / d;
  const table = new Float64Array(n * k).fill(Infinity);
  for (let i = 0; i < n; i++) {
    const last = i * k + k - 1;
    for (let j = 0; j < many; j++) {
      if (others === points && i === j) continue;
      const square = squareBetween(points, i, others, j, d);
      if (square >= table[last]) continue;
      let place = last; // it is inserted, and the last one drops out
      for (; place > i * k && table[place - 1] > square; place--) table[place] = table[place - 1];
      table[place] = square;
    }
  }
  return table.map(Math.sqrt);
}

function placeGaps(points, n, d) {
  return Float64Array.from({ length: n }, (_, i) => {
    let least = Infinity;
    for (let j = 0; j < n; j++) {
      const square = squareBetween(points, i, points, j, d);
      if (square > 0 && square < least) least = square;
    }
    return least < Infinity ? Math.sqrt(least) : 0;
  });
}
