// Farthest points and distances to nearest points, as topokit.sampling has them; and what all scripts do with clouds.
// A cloud of n points in d dimensions, at most 3, is one flat Float64Array, point after point.
//
//   farthestPoints(points, n, d, k, start = 0) -> { ids: Int32Array(k), radii }   start -1: the point farthest from the mean;
//                                                    radii: the covering radius of the first 1, 2, ... k points
//   nearestOthers(points, n, d, k) -> Float64Array(n * k)          distances from each point to its nearest others, ascending
//   nearestAmong(points, n, others, m, d) -> Float64Array(n)       distances from each point to the nearest of m other points
//   placeGaps(points, n, d) -> Float64Array(n)                     from each point to the nearest other place; 0 where there is none
//   axesOf(points, n, d) -> [X, Y, Z]                              the coordinates, an array for each axis; 0 for those beyond d
//   subcloud(points, d, ids)                                       the points of these ids, as a cloud of their own
function axesOf(points, n, d) {
  return [0, 1, 2].map((k) => {
    const axis = new Float64Array(n);
    if (k < d) for (let i = 0; i < n; i++) axis[i] = points[i * d + k];
    return axis;
  });
}

function subcloud(points, d, ids) {
  const cloud = new Float64Array(ids.length * d);
  for (let i = 0; i < ids.length; i++) for (let k = 0; k < d; k++) cloud[i * d + k] = points[ids[i] * d + k];
  return cloud;
}

// Idea: the next point is the one farthest from all that are chosen. Source: Gonzalez 1985.
function farthestPoints(points, n, d, k, start = 0) {
  const [X, Y, Z] = axesOf(points, n, d);
  const squares = new Float64Array(n).fill(Infinity); // from every point to the nearest of those chosen so far
  let [x, y, z] = [X, Y, Z].map((axis) => (start < 0 ? axis.reduce((sum, v) => sum + v, 0) / n : axis[start]));
  let farthest = 0;
  let next = 0;

  function choose() { // the place (x, y, z)
    farthest = -1;
    for (let i = 0; i < n; i++) {
      const a = X[i] - x;
      const b = Y[i] - y;
      const c = Z[i] - z;
      const square = a * a + b * b + c * c;
      if (square < squares[i]) squares[i] = square;
      if (squares[i] > farthest) {
        farthest = squares[i];
        next = i;
      }
    }
  }

  if (start < 0) {
    choose();
    squares.fill(Infinity);
  } else {
    next = start;
  }
  const ids = new Int32Array(k);
  const radii = new Float64Array(k);
  for (let c = 0; c < k; c++) {
    ids[c] = next;
    x = X[next];
    y = Y[next];
    z = Z[next];
    choose();
    radii[c] = Math.sqrt(farthest);
  }
  return { ids, radii };
}

function squaresTo([X, Y, Z], n, x, y, z, squares) { // writes the squared distances from a place to n points
  for (let j = 0; j < n; j++) {
    const a = x - X[j];
    const b = y - Y[j];
    const c = z - Z[j];
    squares[j] = a * a + b * b + c * c;
  }
}

function nearestOthers(points, n, d, k) {
  const axes = axesOf(points, n, d);
  const [X, Y, Z] = axes;
  const squares = new Float64Array(n);
  const table = new Float64Array(n * k).fill(Infinity);
  for (let i = 0; i < n; i++) {
    squaresTo(axes, n, X[i], Y[i], Z[i], squares);
    squares[i] = Infinity;
    const first = i * k;
    const last = first + k - 1;
    for (let j = 0; j < n; j++) {
      const square = squares[j];
      if (square >= table[last]) continue;
      let place = last; // it is inserted, and the last one drops out
      for (; place > first && table[place - 1] > square; place--) table[place] = table[place - 1];
      table[place] = square;
    }
  }
  return table.map(Math.sqrt);
}

function nearestAmong(points, n, others, m, d) {
  const [X, Y, Z] = axesOf(points, n, d);
  const axes = axesOf(others, m, d);
  const squares = new Float64Array(m);
  const nearest = new Float64Array(n);
  for (let i = 0; i < n; i++) {
    squaresTo(axes, m, X[i], Y[i], Z[i], squares);
    let least = Infinity;
    for (let j = 0; j < m; j++) if (squares[j] < least) least = squares[j];
    nearest[i] = Math.sqrt(least);
  }
  return nearest;
}

function placeGaps(points, n, d) {
  const axes = axesOf(points, n, d);
  const [X, Y, Z] = axes;
  const squares = new Float64Array(n);
  return X.map((_, i) => {
    squaresTo(axes, n, X[i], Y[i], Z[i], squares);
    const least = squares.reduce((least, square) => (square > 0 && square < least ? square : least), Infinity);
    return least < Infinity ? Math.sqrt(least) : 0;
  });
}
