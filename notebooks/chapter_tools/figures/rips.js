// Degree-1 Rips persistence of a cloud with its killers and cycles, as topokit.rips has them: the one kernel of all pages.
//
//   const { persistence, cycle, filtration } = ripsKernel();
//   persistence(points, n, d, { maxRadius, ids, onProgress }) -> loops; `points` is flat (n * d), d at most 3; ids: of these points alone
//     births, deaths            Float64Array(c), longest lifetime first; radii are half lengths; death Infinity when alive at maxRadius
//     birthEdges, killerEdges   Int32Array(2 c), smaller vertex first; -1 without a killer
//     killerTriangles           Int32Array(6 c), edge and apex twice, the thick triangle first
//     merges                    Float64Array of the radii at which components merge
//     ids, pairing              what `cycle` needs
//   cycle(points, n, d, loops, i) -> Int32Array, the closed walk around loop i, as Diagram.cycle
//   filtration(points, n, d)     all edges in the total order: count, low, high, keys (squared lengths), rank (n * n), scale
//   onProgress(share) is called now and then; what it throws ends the run.
//
// Idea: edges arrive by (length, smaller index, larger index). Every vertex keeps a row of bits, the vertices that it is joined
// to. So the *lune* of an arriving edge, all that is joined to both its ends, is the AND of two rows. An empty lune joins two
// components or creates a loop. A connected lune changes nothing. Each further component brings a *relation*, a cycle
// of both ends and two apexes that bounds from now on. Written in creators and reduced, youngest first, it may kill a loop.
//
// All is one function, so that a worker can be made from its source; `axesOf`, `squaresTo` and `subcloud` are in sampling.js.
// Source: Koyama, Memoli, Robins, Turner 2023 (the reduced Vietoris-Rips filtration).
function ripsKernel() {
  const OPEN = -2; // an edge whose lune is not empty
  const TREE = -1; // an edge that joined two components
  const AT_ONCE = 4096; // edges between two reports
  const SEARCH_LIMIT = 20000; // pairs (vertex, class) looked at before a search gives up

  const highest = (w, word) => 32 * w + 31 - Math.clz32(word); // the number of a bit of the word w of a row
  const lowest = (w, word) => highest(w, word & -word);

  // ---- the total order ---------------------------------------------------------------------------------------

  function powerOfTwoBelow(points) { // scales coordinates to at most 1, so that squares neither overflow nor vanish
    let largest = 0;
    for (const value of points) largest = Math.max(largest, Math.abs(value));
    const exponent = largest > 0 ? Math.floor(Math.log2(largest)) + 1 : 0;
    return 2 ** -Math.max(exponent, -1022);
  }

  function sortedBy(keys) { // a stable order of numbers that are not negative: their bits, 11 at a time, lowest first
    const count = keys.length;
    const words = new Uint32Array(keys.buffer);
    let order = new Uint32Array(count);
    let next = new Uint32Array(count);
    for (let e = 0; e < count; e++) order[e] = e;
    for (let pass = 0; pass < 6; pass++) {
      const half = pass < 3 ? 0 : 1;
      const shift = 11 * (pass % 3);
      const starts = new Uint32Array(2049);
      for (let e = 0; e < count; e++) starts[((words[2 * e + half] >>> shift) & 2047) + 1]++;
      for (let digit = 0; digit < 2048; digit++) starts[digit + 1] += starts[digit];
      for (let i = 0; i < count; i++) {
        const e = order[i];
        next[starts[(words[2 * e + half] >>> shift) & 2047]++] = e;
      }
      const sorted = next;
      next = order;
      order = sorted;
    }
    return order;
  }

  function filtration(points, n, d, { maxRadius = Infinity, toCone = false } = {}) {
    const scale = powerOfTwoBelow(points);
    const axes = axesOf(points.map((value) => scale * value), n, d);
    const [X, Y, Z] = axes;
    const squares = new Float64Array(n);

    // Once a vertex is joined to all others, the complex is a cone: no loop is alive and none will be born.
    const farthest = new Float64Array(n);
    for (let i = 0; i < n; i++) {
      squaresTo(axes, n, X[i], Y[i], Z[i], squares);
      for (let j = i + 1; j < n; j++) {
        if (squares[j] > farthest[i]) farthest[i] = squares[j];
        if (squares[j] > farthest[j]) farthest[j] = squares[j];
      }
    }
    const cone = n > 1 ? farthest.reduce((least, square) => Math.min(least, square)) : 0;
    const diameter = 2 * maxRadius * scale * (1 + 1e-15);
    const last = Math.min(diameter * diameter, toCone ? cone : Infinity);

    const foundLow = new Uint16Array((n * (n - 1)) / 2);
    const foundHigh = new Uint16Array((n * (n - 1)) / 2);
    const foundKeys = new Float64Array((n * (n - 1)) / 2);
    let count = 0;
    for (let i = 0; i < n; i++) {
      squaresTo(axes, n, X[i], Y[i], Z[i], squares);
      for (let j = i + 1; j < n; j++) {
        if (squares[j] > last) continue;
        foundLow[count] = i;
        foundHigh[count] = j;
        foundKeys[count++] = squares[j];
      }
    }

    const order = sortedBy(foundKeys.subarray(0, count));
    const low = new Uint16Array(count);
    const high = new Uint16Array(count);
    const keys = new Float64Array(count);
    const rank = new Int32Array(n * n).fill(count); // when the edge between two vertices arrives; `count` for never
    for (let e = 0; e < count; e++) {
      const x = foundLow[order[e]];
      const y = foundHigh[order[e]];
      low[e] = x;
      high[e] = y;
      keys[e] = foundKeys[order[e]];
      rank[x * n + y] = e;
      rank[y * n + x] = e;
    }
    return { n, count, low, high, keys, rank, scale, cone };
  }

  // ---- the pairing -------------------------------------------------------------------------------------------

  function pairEdges(edges, onProgress) {
    const { n, count, low, high, keys, rank } = edges;
    const words = (n + 31) >> 5;
    const rows = new Int32Array(n * words); // a vertex is joined to itself
    for (let v = 0; v < n; v++) rows[v * words + (v >> 5)] = 1 << v;
    const lune = new Int32Array(words);
    const left = new Int32Array(words);
    const waiting = new Int32Array(n);
    const component = Int32Array.from({ length: n }, (_, v) => v);
    const creator = new Int32Array(count).fill(OPEN); // of each edge: the loop that it created
    const apexOf = new Int32Array(count).fill(-1); // of each edge a vertex of its lune, once it is asked for
    const created = []; // edges that create loops
    const killed = []; // of each loop: killer edge and two apexes, once it is dead
    const relations = []; // of each dead loop: the creators that its relation is reduced to
    const merges = []; // edges that join components
    let column = new Int32Array(1); // a set of loops, as bits
    let alive = 0;

    function root(v) {
      while (component[v] !== v) v = component[v] = component[component[v]];
      return v;
    }

    // What z is joined to is absorbed. Then a vertex that is joined to an absorbed one is absorbed with all that it is joined to, and so
    // on. False may also mean that the order was unlucky.
    function isSurelyConnected(z) {
      let first = 0;
      for (let w = 0; w < words; w++) left[w] = lune[w] & ~rows[z * words + w];
      for (;;) {
        while (first < words && left[first] === 0) first++;
        if (first === words) return true;
        const v = lowest(first, left[first]);
        let shared = 0;
        for (let w = 0; w < words; w++) {
          const near = lune[w] & rows[v * words + w];
          shared |= near & ~left[w];
          left[w] &= ~near;
        }
        if (shared === 0) return false;
      }
    }

    function apexes(x, y) { // of each component the vertex whose longer edge to {x, y} is shortest, the nearest first; the lune is emptied
      const found = [];
      for (let w = 0; w < words; w++) while (lune[w] !== 0) {
        let apex = -1;
        let value = Infinity;
        let top = 0;
        waiting[0] = lowest(w, lune[w]);
        lune[w] &= lune[w] - 1;
        while (top >= 0) {
          const z = waiting[top--];
          const later = keys[Math.max(rank[x * n + z], rank[y * n + z])];
          if (later < value || (later === value && z < apex)) {
            apex = z;
            value = later;
          }
          for (let u = 0; u < words; u++) {
            let reached = lune[u] & rows[z * words + u];
            lune[u] ^= reached;
            for (; reached !== 0; reached &= reached - 1) waiting[++top] = lowest(u, reached);
          }
        }
        found.push({ apex, value });
      }
      return found.sort((a, b) => a.value - b.value || a.apex - b.apex).map((part) => part.apex);
    }

    function vertexOfLune(e) { // that the edge had when it arrived: one near the middle, else the first to complete a triangle
      const near = 0.4 * keys[e]; // of squares, so a little more than half the length
      const rowX = low[e] * words;
      const rowY = high[e] * words;
      let apex = -1;
      let least = e;
      for (let w = 0; w < words; w++) {
        for (let both = rows[rowX + w] & rows[rowY + w]; both !== 0; both &= both - 1) {
          const z = lowest(w, both);
          const later = Math.max(rank[low[e] * n + z], rank[high[e] * n + z]); // e or later: that edge came after e
          if (later >= least) continue;
          apex = z;
          least = later;
          if (keys[later] <= near) return apex;
        }
      }
      return apex;
    }

    // An edge with an empty lune stands for the loop that it created. Every other edge is replaced by the two other edges of a
    // triangle that was complete with it.
    function addEdge(a, b) {
      const stack = [rank[a * n + b]];
      while (stack.length > 0) {
        const e = stack.pop();
        const loop = creator[e];
        if (loop >= 0) column[loop >> 5] ^= 1 << loop;
        if (loop !== OPEN) continue;
        if (apexOf[e] < 0) apexOf[e] = vertexOfLune(e);
        stack.push(rank[low[e] * n + apexOf[e]], rank[high[e] * n + apexOf[e]]);
      }
    }

    function addRelation(x, y, first, further) { // it kills the youngest loop that is left of it
      column.fill(0);
      addEdge(x, first);
      addEdge(first, y);
      addEdge(y, further);
      addEdge(further, x);
      for (let w = column.length - 1; w >= 0; w--) while (column[w] !== 0) {
        const youngest = highest(w, column[w]);
        if (killed[youngest] === null) {
          killed[youngest] = [x, y, first, further];
          relations[youngest] = loopsOf(column);
          alive--;
          return;
        }
        for (const loop of relations[youngest]) column[loop >> 5] ^= 1 << loop;
      }
    }

    function loopsOf(bits) {
      const loops = [];
      bits.forEach((word, w) => {
        for (; word !== 0; word &= word - 1) loops.push(lowest(w, word));
      });
      return Int32Array.from(loops);
    }

    for (let e = 0; e < count; e++) {
      if (onProgress && e % AT_ONCE === 0) onProgress(e / count);
      const x = low[e];
      const y = high[e];
      const rowX = x * words;
      const rowY = y * words;
      let some = 0; // the last word of the lune that is not 0
      let seed = -1; // the number of that word
      if (alive === 0) { // no loop can be killed: only whether the lune is empty matters
        for (let w = 0; w < words && some === 0; w++) some = rows[rowX + w] & rows[rowY + w];
      } else {
        for (let w = 0; w < words; w++) {
          lune[w] = rows[rowX + w] & rows[rowY + w];
          if (lune[w] === 0) continue;
          some = lune[w];
          seed = w;
        }
      }
      rows[rowX + (y >> 5)] |= 1 << y;
      rows[rowY + (x >> 5)] |= 1 << x;
      if (some === 0) {
        const a = root(x);
        const b = root(y);
        creator[e] = a === b ? created.length : TREE;
        if (a === b) {
          created.push(e);
          killed.push(null);
          relations.push(null);
          alive++;
          if (created.length > 32 * column.length) column = new Int32Array(2 * column.length);
        } else {
          component[a] = b;
          merges.push(e);
        }
      } else if (alive > 0 && !isSurelyConnected(highest(seed, some))) {
        const [first, ...others] = apexes(x, y);
        for (const further of others) addRelation(x, y, first, further);
      }
    }
    return { created, killed, relations, merges };
  }

  function persistence(points, n, d, { maxRadius = Infinity, ids = null, onProgress } = {}) {
    const cloud = ids ? subcloud(points, d, ids) : points;
    const size = ids ? ids.length : n;
    const edges = filtration(cloud, size, d, { maxRadius, toCone: true });
    const { created, killed, relations, merges } = pairEdges(edges, onProgress);
    const radius = (e) => Math.sqrt(edges.keys[e]) / 2;

    // Bars that are born by the last radius, longest first; in scaled units, which decide ties.
    const bound = maxRadius * edges.scale;
    const rows = [];
    created.forEach((e, loop) => {
      const birth = radius(e);
      const killer = killed[loop];
      let death = killer ? radius(edges.rank[killer[0] * size + killer[1]]) : Infinity;
      if (death > bound) death = Infinity;
      if (birth <= bound && death > birth) rows.push({ loop, e, birth, death, killer: death < Infinity ? killer : [-1, -1, -1, -1] });
    });
    rows.sort((a, b) => b.death - b.birth - (a.death - a.birth) || a.loop - b.loop); // Infinity - Infinity is not a number
    const name = (v) => (ids && v >= 0 ? ids[v] : v);
    const named = (lists) => Int32Array.from(lists.flat(), name);
    return {
      births: Float64Array.from(rows, (row) => row.birth / edges.scale),
      deaths: Float64Array.from(rows, (row) => row.death / edges.scale),
      birthEdges: named(rows.map(({ e }) => [edges.low[e], edges.high[e]])),
      killerEdges: named(rows.map(({ killer: [x, y] }) => [x, y])),
      killerTriangles: named(rows.map(({ killer: [x, y, first, further] }) => [x, y, further, x, y, first])),
      merges: Float64Array.from(merges, radius).map((value) => value / edges.scale),
      ids,
      pairing: { created, killed, relations, loops: rows.map((row) => row.loop) },
    };
  }

  // ---- cycles ------------------------------------------------------------------------------------------------
  //
  // Idea: the birth edge and the shortest way around it may run around an older loop as well, and then outlive the bar. So the search
  // runs in pairs (vertex, class of the path so far), as in a covering space where unwanted loops are unrolled. A class is a
  // set of creators, as the bits of one BigInt, reduced by the relations before a time.
  // Source: Erickson and Nayyeri 2011 (the search in pairs).

  let lastLoops = null;
  let lastHomology = null;

  function cycle(points, n, d, loops, i) {
    if (loops !== lastLoops) {
      const cloud = loops.ids ? subcloud(points, d, loops.ids) : points;
      lastHomology = homology(filtration(cloud, loops.ids ? loops.ids.length : n, d, { toCone: true }), loops.pairing);
      lastLoops = loops;
    }
    const dies = loops.deaths[i] < Infinity;
    const walk = lastHomology(loops.pairing.loops[i], dies);
    return Int32Array.from(walk, (v) => (loops.ids ? loops.ids[v] : v));
  }

  function homology({ n, low, high, keys, rank }, { created, killed, relations }) {
    const lengths = keys.map(Math.sqrt);
    const bit = (loop) => 1n << BigInt(loop);
    const columns = relations.map((loops) => loops && loops.reduce((sum, loop) => sum | bit(loop), 0n));
    const killedAt = killed.map((killer) => (killer ? rank[killer[0] * n + killer[1]] : Infinity));
    const inCreators = new Map(created.map((e, loop) => [e, bit(loop)])); // edges written in creators
    let classes = new Map(); // classes of edges at the time that was asked for last
    let classesAt = -1;

    function firstTriangle(e) { // the vertex that completes the earliest triangle on an edge
      const rowX = low[e] * n;
      const rowY = high[e] * n;
      let apex = -1;
      let least = Infinity;
      for (let z = 0; z < n; z++) {
        const later = Math.max(rank[rowX + z], rank[rowY + z]);
        if (later < least) {
          apex = z;
          least = later;
        }
      }
      return apex;
    }

    function writtenInCreators(edge) {
      const stack = [edge];
      while (stack.length > 0) {
        const e = stack.at(-1);
        if (inCreators.has(e)) {
          stack.pop();
          continue;
        }
        const apex = firstTriangle(e);
        const sides = [rank[low[e] * n + apex], rank[high[e] * n + apex]];
        if (Math.max(...sides) > e) {
          inCreators.set(e, 0n); // an edge of the tree
        } else if (sides.every((side) => inCreators.has(side))) {
          inCreators.set(e, inCreators.get(sides[0]) ^ inCreators.get(sides[1]));
        } else {
          stack.push(...sides);
        }
      }
      return inCreators.get(edge);
    }

    function youngestOf(column) {
      return column.toString(2).length - 1;
    }

    function classOf(pairs, time) { // of a chain, just before a time; 0 for a boundary
      if (time !== classesAt) [classes, classesAt] = [new Map(), time];
      let total = 0n;
      for (const [a, b] of pairs) {
        const e = rank[a * n + b];
        if (!classes.has(e)) {
          let column = writtenInCreators(e);
          let left = 0n;
          while (column) {
            const youngest = youngestOf(column);
            if (killedAt[youngest] < time) {
              column ^= columns[youngest];
            } else {
              left |= bit(youngest);
              column ^= bit(youngest);
            }
          }
          classes.set(e, left);
        }
        total ^= classes.get(e);
      }
      return total;
    }

    function neighbours(v, time) {
      const joined = [];
      for (let w = 0; w < n; w++) if (rank[v * n + w] < time) joined.push(w);
      return joined;
    }

    function shortestPaths(targets, time) { // from each vertex to the nearest target, by Dijkstra's method
      const distance = new Float64Array(n).fill(Infinity);
      const done = new Uint8Array(n);
      for (const target of targets) distance[target] = 0;
      for (;;) {
        let v = -1;
        for (let w = 0; w < n; w++) if (!done[w] && distance[w] < (v < 0 ? Infinity : distance[v])) v = w;
        if (v < 0) return distance;
        done[v] = 1;
        for (let w = 0; w < n; w++) {
          const e = rank[v * n + w];
          if (e < time && distance[v] + lengths[e] < distance[w]) distance[w] = distance[v] + lengths[e];
        }
      }
    }

    function path(sources, targets, time) { // a shortest one before a time, with the fewest steps; [] when there is none
      const distance = shortestPaths(targets, time);
      const start = sources.reduce((best, v) => (distance[v] < distance[best] ? v : best));
      if (distance[start] === Infinity) return [];
      const following = (v) => neighbours(v, time).filter((w) => distance[w] + lengths[rank[v * n + w]] === distance[v]);

      // Vertices on shortest paths, by the number of steps.
      const levels = [new Map([[start, following(start)]])];
      const reached = new Set([start]);
      while (!targets.some((target) => reached.has(target))) {
        const next = new Map();
        for (const choices of levels.at(-1).values()) for (const w of choices) if (!reached.has(w)) next.set(w, null);
        for (const w of next.keys()) {
          reached.add(w);
          next.set(w, following(w));
        }
        levels.push(next);
      }

      // Back from the targets: the path that goes to the nearest vertex first.
      let rest = new Map(targets.filter((target) => levels.at(-1).has(target)).map((target) => [target, [target]]));
      for (const level of levels.slice(0, -1).reverse()) {
        const before = new Map();
        for (const [v, choices] of level) {
          const open = choices.filter((w) => rest.has(w));
          if (open.length === 0) continue;
          const isNearer = (w, other) => distance[w] < distance[other] || (distance[w] === distance[other] && w < other);
          const nearest = open.reduce((best, w) => (isNearer(w, best) ? w : best));
          before.set(v, [v, ...rest.get(nearest)]);
        }
        rest = before;
      }
      return rest.get(start);
    }

    // The shortest path before a time whose class before `death` is the one wanted, by A*: shortest paths of any class bound what remains.
    function pathInClass(source, target, time, death, wanted) {
      const remaining = shortestPaths([target], time);
      const numbers = new Map(); // of classes, in the order in which they are met
      const named = [];
      const stateOf = (v, its) => {
        if (!numbers.has(its)) {
          numbers.set(its, named.length);
          named.push(its);
        }
        return numbers.get(its) * n + v;
      };
      const classAt = (state) => named[Math.floor(state / n)];
      const start = stateOf(source, 0n);
      const goal = stateOf(target, wanted);
      const best = new Map([[start, { length: 0, steps: 0, before: -1 }]]);
      const done = new Set();
      const comesFirst = (a, b) => {
        if (a.bound !== b.bound) return a.bound < b.bound;
        if (a.steps !== b.steps) return a.steps < b.steps;
        const [v, w] = [a.state % n, b.state % n];
        return v !== w ? v < w : classAt(a.state) < classAt(b.state);
      };
      const queue = heap(comesFirst);
      queue.push({ bound: remaining[source], steps: 0, state: start });
      for (let next; done.size < SEARCH_LIMIT && (next = queue.pop()); ) {
        const { state } = next;
        if (state === goal) {
          const walk = [];
          for (let s = goal; s >= 0; s = best.get(s).before) walk.unshift(s % n);
          return walk;
        }
        if (done.has(state)) continue;
        done.add(state);
        const v = state % n;
        const { length, steps } = best.get(state);
        for (const w of neighbours(v, time)) {
          const further = length + lengths[rank[v * n + w]];
          const bound = further + remaining[w];
          if (bound === Infinity) continue;
          const other = stateOf(w, classAt(state) ^ classOf([[v, w]], death));
          const known = best.get(other);
          if (done.has(other) || (known && (known.length < further || (known.length === further && known.steps <= steps + 1)))) continue;
          best.set(other, { length: further, steps: steps + 1, before: state });
          queue.push({ bound, steps: steps + 1, state: other });
        }
      }
      return [];
    }

    function corrected(walk, born, death) { // walks around the older loops that a walk contains are added, over a bridge there and back
      let whole = walk;
      for (;;) {
        const left = classOf(sides(whole), death);
        if (!left) return whole;
        const e = created[youngestOf(left)];
        const other = path([low[e]], [high[e]], e);
        let bridge = path(whole, other, born);
        if (bridge.length === 0) bridge = path(whole, other, death);
        const i = whole.indexOf(bridge[0]);
        const j = other.indexOf(bridge.at(-1));
        const back = bridge.slice(0, -1).reverse();
        whole = [...whole.slice(0, i), ...bridge.slice(0, -1), ...other.slice(j), ...other.slice(0, j + 1), ...back, ...whole.slice(i + 1)];
      }
    }

    return (loop, dies) => {
      const born = created[loop];
      const [x, y] = [low[born], high[born]];
      const walk = path([x], [y], born);
      if (!dies) return walk;
      const death = killedAt[loop] + 1; // just after the killer edge
      if (classOf(sides(walk), death) === 0n) return walk;
      const around = pathInClass(x, y, born, death, classOf([[x, y]], death));
      return around.length > 0 ? around : corrected(walk, born, death);
    };
  }

  function sides(walk) {
    return walk.map((v, k) => [v, walk[(k + 1) % walk.length]]);
  }

  function heap(comesFirst) { // the first of its items comes out first
    const items = [];
    return {
      push(item) {
        let place = items.length;
        for (; place > 0 && comesFirst(item, items[(place - 1) >> 1]); place = (place - 1) >> 1) items[place] = items[(place - 1) >> 1];
        items[place] = item;
      },
      pop() {
        const first = items[0];
        const last = items.pop();
        if (items.length === 0) return first;
        let place = 0;
        for (;;) {
          let child = 2 * place + 1;
          if (child + 1 < items.length && comesFirst(items[child + 1], items[child])) child++;
          if (child >= items.length || !comesFirst(items[child], last)) break;
          items[place] = items[child];
          place = child;
        }
        items[place] = last;
        return first;
      },
    };
  }

  return { persistence, cycle, filtration };
}
