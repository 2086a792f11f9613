// A cloth that moves: masses at the vertices of a mesh, edges that stretch, a fold at each inner edge, rods, a floor and two hands.
//
//   const body = clothBody({ rest, faces, rods }, { stiffness });      rest: flat (n * 3), metres; rods: [start, end, radius]
//   body.place(points)           puts the vertices there, at rest
//   body.hold(h, vertex, at)     hand h takes a vertex; vertex -1: it lets go
//   body.frame(goals)            one frame of FRAME seconds, in which each hand moves towards its goal [x, y, z]
//   body.points, body.hands      the vertices, flat; of each hand { vertex, at }
//   body.energy(), body.speed(), body.deepest()     joules; metres a second; depth of the deepest vertex in a rod, negative outside
//
// Idea: extended position-based dynamics. In each short substep the vertices move on by their velocities. Then every edge moves its two
// ends towards its rest length, by as much as a spring of its stiffness would in an implicit step; folds do the same between the two
// vertices across an edge. What is in a rod or below the floor is put outside, and friction takes back a part of its sliding. The
// velocities are the way made. Everything runs in a fixed order with fixed substeps and nothing is random: the same moves give the same film.
// Sources: Macklin, Mueller, Chentanez 2016, *XPBD: position-based simulation of compliant constrained dynamics*; Macklin et al. 2019,
// *Small steps in physics simulation* (one iteration in each of many substeps); Mueller et al. 2007, *Position based dynamics* (friction).
// Only vertices touch: the rods must be thicker than the gaps between vertices, and layers of cloth keep apart by a gap, without friction.
const FRAME = 0.018; // seconds; two are a frame of a recorded episode
const SUBSTEPS = 12;

function clothBody({ rest, faces, rods }, { stiffness = 1000, bending = 1, mass = 0.3, friction = 1, thickness = 0.006 } = {}) {
  const GRAVITY = 9.8;
  const DRAG = 1; // share of the velocity that air takes in a second
  const DAMPING = 0.05; // newtons for each metre a second by which a spring grows or shrinks
  const GRIP = 600; // newtons a metre between a hand and the vertex that it holds
  const STRONGEST = 6; // newtons: a hand that pulls more stays behind its goal
  const FASTEST = 1.2; // metres a second of a hand
  const FARTHEST = 0.01; // metres of a vertex in a substep: less than half a rod, so that none jumps through it
  const APART = 0.022; // metres between vertices of two layers: more than from a vertex of a triangle to its middle
  const NEAR = 0.05; // metres within which two vertices are looked at in a frame
  const dt = FRAME / SUBSTEPS;
  const n = rest.length / 3;
  const light = n / mass; // inverse mass of a vertex
  const x = Float64Array.from(rest);
  const before = new Float64Array(3 * n);
  const velocity = new Float64Array(3 * n);
  const hands = [0, 1].map(() => ({ vertex: -1, at: [0, 0, 0] }));
  const { edges, folds } = springs(rest, faces);
  const capsules = rods.map(([start, end, radius]) => {
    const axis = end.map((v, k) => v - start[k]);
    return { start, axis, square: axis.reduce((sum, v) => sum + v * v, 0), radius };
  });
  const out = [0, 0, 0]; // the way out of the rod that `depthIn` looked at
  let near = []; // pairs of vertices, as places in `x`
  let firm = stiffness;

  // ---- springs: an edge keeps its length, a fold the distance of the two vertices across it --------------------------

  function springs(points, triangles) {
    const across = new Map(); // of each edge the vertices that complete a triangle
    for (let f = 0; f < triangles.length; f += 3) for (let k = 0; k < 3; k++) {
      const [a, b, c] = [0, 1, 2].map((m) => triangles[f + ((k + m) % 3)]);
      const key = Math.min(a, b) * n + Math.max(a, b);
      if (across.has(key)) across.get(key).push(c);
      else across.set(key, [c]);
    }
    const withLengths = (pairs) => {
      const lengths = pairs.map(([a, b]) => Math.hypot(...[0, 1, 2].map((k) => points[3 * a + k] - points[3 * b + k])));
      return { ends: Int32Array.from(pairs.flat()), lengths: Float64Array.from(lengths) };
    };
    return {
      edges: withLengths([...across.keys()].map((key) => [Math.floor(key / n), key % n])),
      folds: withLengths([...across.values()].filter((apexes) => apexes.length === 2)),
    };
  }

  function approach(a, b, by, u, v, w) { // two vertices move towards each other, along the way (u, v, w) from a to b
    x[a] += by * u;
    x[a + 1] += by * v;
    x[a + 2] += by * w;
    x[b] -= by * u;
    x[b + 1] -= by * v;
    x[b + 2] -= by * w;
  }
  function pull({ ends, lengths }, force) { // of a spring of this many newtons a metre
    const damped = DAMPING / (force * dt);
    const share = light / ((1 + damped) * 2 * light + 1 / (force * dt * dt));
    for (let s = 0; s < lengths.length; s++) {
      const a = 3 * ends[2 * s];
      const b = 3 * ends[2 * s + 1];
      const u = x[b] - x[a];
      const v = x[b + 1] - x[a + 1];
      const w = x[b + 2] - x[a + 2];
      const square = u * u + v * v + w * w;
      if (square < 1e-18) continue;
      const length = Math.sqrt(square);
      const grown = (u * (u - before[b] + before[a]) + v * (v - before[b + 1] + before[a + 1]) + w * (w - before[b + 2] + before[a + 2])) / length;
      const by = (share * (length - lengths[s] + damped * grown)) / length;
      approach(a, b, by, u, v, w);
    }
  }

  // ---- hands: a spring of limited force between the vertex and the hand -----------------------------------------------

  function move(hand, goal, left) { // a part of the way to the goal, which it reaches at the end of the frame if it is fast enough
    const way = goal.map((v, k) => v - hand.at[k]);
    const length = Math.hypot(...way);
    if (length < 1e-12) return;
    const share = Math.min(1 / left, (FASTEST * dt) / length);
    for (let k = 0; k < 3; k++) hand.at[k] += share * way[k];
  }

  function grip({ vertex, at }) {
    if (vertex < 0) return;
    const i = 3 * vertex;
    const way = at.map((v, k) => v - x[i + k]);
    const length = Math.hypot(...way);
    if (length < 1e-12) return;
    const multiplier = Math.min(length / (light + 1 / (GRIP * dt * dt)), STRONGEST * dt * dt);
    for (let k = 0; k < 3; k++) x[i + k] += (light * multiplier * way[k]) / length;
  }

  // ---- contact: out of the rods and above the floor, with friction ------------------------------------------------------

  function rub(i, depth, nx, ny, nz) { // takes back sliding, at most the share `friction` of how far the contact pushed
    const u = x[i] - before[i];
    const v = x[i + 1] - before[i + 1];
    const w = x[i + 2] - before[i + 2];
    const along = u * nx + v * ny + w * nz;
    const length = Math.sqrt(Math.max(0, u * u + v * v + w * w - along * along));
    const share = length > 1e-12 ? Math.min(1, (friction * depth) / length) : 0;
    x[i] -= share * (u - along * nx);
    x[i + 1] -= share * (v - along * ny);
    x[i + 2] -= share * (w - along * nz);
  }

  function depthIn({ start, axis, square, radius }, i) { // of a vertex in a capsule; writes the way out
    const u = x[i] - start[0];
    const v = x[i + 1] - start[1];
    const w = x[i + 2] - start[2];
    const share = Math.min(1, Math.max(0, (u * axis[0] + v * axis[1] + w * axis[2]) / square));
    out[0] = u - share * axis[0];
    out[1] = v - share * axis[1];
    out[2] = w - share * axis[2];
    const length = Math.sqrt(out[0] * out[0] + out[1] * out[1] + out[2] * out[2]);
    if (length < 1e-12) {
      out[0] = 1; // on the axis any way out is as good
      return radius;
    }
    out[0] /= length;
    out[1] /= length;
    out[2] /= length;
    return radius - length;
  }

  function push(i, depth) {
    for (let k = 0; k < 3; k++) x[i + k] += depth * out[k];
  }

  function collide() {
    for (let i = 0; i < 3 * n; i += 3) {
      let touched = true;
      for (let round = 0; round < 3 && touched; round++) { // out of one rod can be into the next
        touched = false;
        for (let c = 0; c < capsules.length; c++) {
          const depth = depthIn(capsules[c], i) + thickness;
          if (depth <= 0) continue;
          touched = true;
          push(i, depth);
          rub(i, depth, out[0], out[1], out[2]);
          push(i, Math.max(0, depthIn(capsules[c], i) + thickness)); // to slide back along a round rod can lead into it
        }
      }
      const below = thickness - x[i + 2];
      if (below > 0) {
        x[i + 2] = thickness;
        rub(i, below, 0, 0, 1);
      }
    }
  }

  // ---- the cloth touches itself: vertices that are not neighbours keep apart, so that none fits through a triangle ------------

  function findNear() { // pairs that can touch within a frame
    near = [];
    for (let a = 0; a < 3 * n; a += 3) for (let b = a + 3; b < 3 * n; b += 3) {
      const u = x[b] - x[a];
      const v = x[b + 1] - x[a + 1];
      const w = x[b + 2] - x[a + 2];
      if (u * u + v * v + w * w > NEAR * NEAR) continue;
      const flat = (rest[b] - rest[a]) ** 2 + (rest[b + 1] - rest[a + 1]) ** 2 + (rest[b + 2] - rest[a + 2]) ** 2;
      if (flat > 4 * APART * APART) near.push(a, b);
    }
  }

  function keepApart() {
    for (let p = 0; p < near.length; p += 2) {
      const a = near[p];
      const b = near[p + 1];
      const u = x[b] - x[a];
      const v = x[b + 1] - x[a + 1];
      const w = x[b + 2] - x[a + 2];
      const square = u * u + v * v + w * w;
      if (square >= APART * APART || square < 1e-18) continue;
      const by = (Math.sqrt(square) - APART) / (2 * Math.sqrt(square));
      approach(a, b, by, u, v, w);
    }
  }

  // ---- time --------------------------------------------------------------------------------------------------------

  function substep() {
    for (let i = 0; i < 3 * n; i++) {
      before[i] = x[i];
      x[i] += dt * velocity[i];
      if (i % 3 === 2) x[i] -= GRAVITY * dt * dt;
    }
    pull(edges, firm);
    pull(folds, bending * firm);
    keepApart();
    hands.forEach(grip);
    for (let i = 0; i < 3 * n; i += 3) {
      const square = (x[i] - before[i]) ** 2 + (x[i + 1] - before[i + 1]) ** 2 + (x[i + 2] - before[i + 2]) ** 2;
      const share = square > FARTHEST * FARTHEST ? FARTHEST / Math.sqrt(square) : 1;
      if (share < 1) for (let k = i; k < i + 3; k++) x[k] = before[k] + share * (x[k] - before[k]);
    }
    collide();
    const kept = (1 - DRAG * dt) / dt;
    for (let i = 0; i < 3 * n; i++) velocity[i] = kept * (x[i] - before[i]);
  }

  function frame(goals) {
    findNear();
    for (let left = SUBSTEPS; left > 0; left--) {
      hands.forEach((hand, h) => move(hand, goals[h], left));
      substep();
    }
  }

  function place(points) {
    x.set(points);
    velocity.fill(0);
    hands.forEach((hand) => (hand.vertex = -1));
  }

  function hold(h, vertex, at) {
    hands[h].vertex = vertex;
    hands[h].at = [...at];
  }

  // ---- what can be measured -------------------------------------------------------------------------------------------

  function energy() { // of motion, height and springs
    let sum = 0;
    for (let i = 0; i < 3 * n; i++) sum += (velocity[i] * velocity[i]) / (2 * light);
    for (let i = 2; i < 3 * n; i += 3) sum += (GRAVITY * x[i]) / light;
    for (const [{ ends, lengths }, force] of [[edges, firm], [folds, bending * firm]]) lengths.forEach((length, s) => {
      const [a, b] = [3 * ends[2 * s], 3 * ends[2 * s + 1]];
      sum += (force / 2) * (Math.hypot(x[a] - x[b], x[a + 1] - x[b + 1], x[a + 2] - x[b + 2]) - length) ** 2;
    });
    return sum;
  }

  function speed() { // of the fastest vertex
    let most = 0;
    for (let i = 0; i < 3 * n; i += 3) most = Math.max(most, Math.hypot(velocity[i], velocity[i + 1], velocity[i + 2]));
    return most;
  }

  function deepest() {
    let most = -Infinity;
    for (let i = 0; i < 3 * n; i += 3) for (const capsule of capsules) most = Math.max(most, depthIn(capsule, i));
    return most;
  }

  return { points: x, hands, place, hold, frame, energy, speed, deepest, stiffen: (force) => (firm = force) };
}
