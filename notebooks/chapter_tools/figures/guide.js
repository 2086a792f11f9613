// A planner in the page: a ring that goes with the hands, the guide of a hook, and a search for the path with the least guide.
// Idea: as in topokit.control.Planner a path is a smooth curve through five knots. Paths are drawn about the best ones, twice or
// more often, each time with half the spread; three frames of the best path are followed, and the search begins again.
const KNOTS = [0, 8, 18, 30, 44, 60], GUIDED = [4, 9, 14, 19, 24, 29, 39, 49, 59], FOLLOWED = 3, KEPT = 4, MOST_PLANS = 40;
const SPREAD = [0.06, 0.04], PACE = 0.026, CHANGE = 0.1, ABOVE = 0.06, MARGIN = 0.03, PRICE = 10, SEATED = 0.03; // metres; a share

function splineWeights(knots) { // of the natural cubic spline from 0 through values at the other knots: at each frame a weight for each
  const n = knots.length, h = knots.slice(1).map((v, k) => v - knots[k]);
  const columns = knots.slice(1).map((_, unit) => {
    const y = knots.map((_, k) => (k === unit + 1 ? 1 : 0)), slope = h.map((step, k) => (y[k + 1] - y[k]) / step);
    const diagonal = [1], right = [0]; // second derivatives, by elimination downwards and back
    for (let k = 1; k < n - 1; k++) {
      const share = k > 1 ? h[k - 1] / diagonal[k - 1] : 0;
      diagonal[k] = 2 * (h[k - 1] + h[k]) - (k > 1 ? share * h[k - 1] : 0);
      right[k] = 6 * (slope[k] - slope[k - 1]) - share * right[k - 1];
    }
    const bend = knots.map(() => 0);
    for (let k = n - 2; k > 0; k--) bend[k] = (right[k] - h[k] * bend[k + 1]) / diagonal[k];
    return Array.from({ length: knots[n - 1] }, (_, f) => {
      const t = f + 1, k = knots.findIndex((v) => v >= t) - 1, [a, b] = [knots[k + 1] - t, t - knots[k]];
      return (bend[k] * a ** 3 + bend[k + 1] * b ** 3) / (6 * h[k]) + (y[k] / h[k] - (bend[k] * h[k]) / 6) * a + (y[k + 1] / h[k] - (bend[k + 1] * h[k]) / 6) * b;
    });
  });
  return columns[0].map((_, f) => columns.map((column) => column[f]));
}
const WEIGHTS = splineWeights(KNOTS);

function random(seed) { // normal numbers, the same for the same seed
  let state = (seed + 1) * 2654435769;
  const uniform = () => {
    state = (state + 0x6d2b79f5) | 0;
    let v = Math.imul(state ^ (state >>> 15), state | 1);
    v = (v + Math.imul(v ^ (v >>> 7), v | 61)) ^ v;
    return (((v ^ (v >>> 14)) >>> 0) + 0.5) / 4294967296;
  };
  return { uniform, normal: () => Math.sqrt(-2 * Math.log(uniform())) * Math.cos(2 * Math.PI * uniform()) };
}

// ---- a ring whose rim is at (y, z), and a hook ----------------------------------------------------------------------
function fieldOf(ring, line, closed) { // what a place of the rim is worth, in metres; the hook's tip is the line's last corner
  const rim = ring.reduce((top, p) => (p[2] > top[2] ? p : top)), n = ring.length;
  const base = ring.map((p) => [p[0], p[1] - rim[1], p[2] - rim[2]]), x = rim[0];
  const [a, b, tip] = line.slice(-3), seat = along(a, b, 0.5), over = [tip[0], tip[1], tip[2] + ABOVE];
  const lengthTo = (y, z, p) => Math.hypot(x - p[0], y - p[1], z - p[2]), overToSeat = Math.hypot(...minus(over, seat));

  function gap(y, z) { // the least distance of the ring's corners from the line
    let least = Infinity;
    for (let k = 1; k < line.length; k++) {
      const [u, v, w] = line[k - 1], [d, e, f] = [line[k][0] - u, line[k][1] - v, line[k][2] - w], size = d * d + e * e + f * f;
      for (let i = 0; i < n; i++) {
        const p = base[i][0] - u, q = base[i][1] + y - v, r = base[i][2] + z - w, s = Math.max(0, Math.min(1, (p * d + q * e + r * f) / size));
        least = Math.min(least, (p - s * d) ** 2 + (q - s * e) ** 2 + (r - s * f) ** 2);
      }
    }
    return Math.sqrt(least);
  }

  // The linking number by the signs of the crossings at which the ring is in front, seen from a direction without ties.
  const axes = [[0.36, 0.48, 0.8], [-0.8, 0.6, 0], [-0.48, -0.64, 0.6]], seen = (p) => axes.map((axis) => inner(axis, p));
  const rope = closed.map(seen), flat = base.map(seen);
  function around(y, z) {
    const [r, u, e] = seen([0, y, z]);
    let number = 0;
    for (let i = 0; i < n; i++) for (let j = 0; j < rope.length; j++) {
      const [p, q, s, t] = [flat[i], flat[(i + 1) % n], rope[j], rope[(j + 1) % rope.length]];
      const px = p[0] + r - s[0], py = p[1] + u - s[1], dx = q[0] - p[0], dy = q[1] - p[1], ex = t[0] - s[0], ey = t[1] - s[1];
      const turn = dx * ey - dy * ex, m = (ex * py - ey * px) / turn, k = (dx * py - dy * px) / turn;
      if (m >= 0 && m < 1 && k >= 0 && k < 1 && p[2] + e + m * (q[2] - p[2]) > s[2] + k * (t[2] - s[2])) number += Math.sign(turn);
    }
    return number !== 0;
  }
  // The guide: over the tip and to the seat; or to the seat alone.
  const guide = (y, z, linked = around(y, z)) => (linked ? lengthTo(y, z, seat) : lengthTo(y, z, over) + overToSeat);
  const seated = (y, z) => around(y, z) && lengthTo(y, z, seat) < SEATED;
  return { base, seat, over, gap, around, guide, seated };
}

// ---- paths -----------------------------------------------------------------------------------------------------------
function pathOf(knots, speed) { // moves at 60 frames, with limits of speed and of acceleration
  let at = [0, 0], step = speed;
  return WEIGHTS.map((weights) => {
    const goal = [0, 1].map((c) => weights.reduce((sum, w, k) => sum + w * knots[k][c], 0));
    step = [0, 1].map((c) => {
      const wanted = Math.max(-PACE, Math.min(PACE, goal[c] - at[c]));
      return Math.max(step[c] - CHANGE * PACE, Math.min(step[c] + CHANGE * PACE, wanted));
    });
    return (at = [at[0] + step[0], at[1] + step[1]]);
  });
}
function costOf([y, z], path, { gap, around, guide }) { // the mean guide, and a price for coming too near to the rod before the ring is around
  let was = around(y, z), from = 0, sum = 0;
  for (const f of GUIDED) {
    const linked = around(y + path[f][0], z + path[f][1]);
    sum += guide(y + path[f][0], z + path[f][1], linked);
    let near = 0;
    for (let k = from; k <= f && !was; k++) near = Math.max(near, MARGIN - gap(y + path[k][0], z + path[k][1]));
    sum += PRICE * near;
    [was, from] = [linked, f + 1];
  }
  return sum / GUIDED.length;
}
function guessOf(now, { seat, over, around }) { // knots of a ring that goes past the stops at an even pace
  const stops = [now, ...(around(...now) ? [] : [over.slice(1), [seat[1], over[2]]]), seat.slice(1)];
  const legs = stops.slice(1).map((p, k) => Math.hypot(p[0] - stops[k][0], p[1] - stops[k][1]));
  return KNOTS.slice(1).map((frame) => {
    let left = frame * PACE, k = 0;
    while (k < legs.length - 1 && left > legs[k]) left -= legs[k++];
    const place = along(stops[k], stops[k + 1], Math.min(1, left / (legs[k] || 1)));
    return [place[0] - now[0], place[1] - now[1]];
  });
}
function searchFrom(now, field, speed, last, { plans, rounds, guess, draw }) { // the candidates of each round, the best first
  const first = guess ? guessOf(now, field) : KNOTS.slice(1).map(() => [0, 0]), found = [];
  let kept = last ? [first, last] : [first], spread = SPREAD;
  for (let round = 0; round < rounds; round++) {
    const about = Array.from({ length: Math.max(0, plans - kept.length) }, () => kept[Math.floor(draw.uniform() * kept.length)]);
    const drawn = about.map((knots) => knots.map((p) => p.map((v, c) => v + spread[c] * draw.normal())));
    const candidates = [...kept, ...drawn].map((knots) => {
      const path = pathOf(knots, speed);
      return { knots, path, cost: costOf(now, path, field) };
    });
    found.push(candidates.sort((a, b) => a.cost - b.cost));
    kept = candidates.slice(0, KEPT).map(({ knots }) => knots);
    spread = spread.map((v) => v / 2);
  }
  return found;
}
function runOf(start, field, { seed, ...asked }) { // replans until the ring is around and its rim near the seat
  const draw = random(seed), frames = [];
  let now = start, speed = [0, 0], last = null;
  while (!field.seated(...now) && frames.length < MOST_PLANS) {
    const rounds = searchFrom(now, field, speed, last, { ...asked, draw }), { path } = rounds[rounds.length - 1][0], end = path[FOLLOWED - 1];
    frames.push({ at: now, rounds, guide: field.guide(...now) });
    speed = [0, 1].map((c) => end[c] - path[FOLLOWED - 2][c]);
    last = KNOTS.slice(1).map((t) => path[Math.min(t + FOLLOWED, path.length) - 1].map((v, c) => v - end[c]));
    now = [now[0] + end[0], now[1] + end[1]];
  }
  return { frames: [...frames, { at: now, rounds: [], guide: field.guide(...now) }], done: field.seated(...now) };
}
