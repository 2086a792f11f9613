// Names of loops along a film by three numbers, as topokit.SeqPH gives them with loops="alpha", identity="killer-edge" and memory=0;
// `assign` is in assign.js.
//
//   followed(film, { alpha, beta, epsilon, gates }) -> for each frame { loops, before, cost, closed, match, names }
//     film     of each frame its bars, longest lifetime first: { birth, death, ends }, `ends` two places in space
//     cost     a row for each loop, a column for each loop of the frame before: what the pair costs
//     closed   of each pair "", or the gate that closes it: "size" (birth or death) or "place"
//     match    of each loop the loop of the frame before that it is, -1 for none
// Source: Antonova et al. 2021 (Algorithm 1, with the matching after both loops); topokit/seqph/_matching.py has the gates.
function gatesOf({ alpha, beta, epsilon, gates }, loop, other) { // the changes of size and of place that are too large
  if (gates === "paper") return { size: 2 * alpha + epsilon, place: 2 * alpha + beta + epsilon };
  if (gates === "proved") return { size: alpha + epsilon, place: 2 * beta + epsilon };
  return { size: alpha + epsilon + Math.max(loop.death, other.death) / 4, place: beta + epsilon };
}

function killersApart([a, b], [c, d]) { // Hausdorff distance of two pairs of ends
  const far = (p, q) => Math.hypot(...p.map((v, k) => v - q[k]));
  const nearer = (p, [q, r]) => Math.min(far(p, q), far(p, r));
  return Math.max(nearer(a, [c, d]), nearer(b, [c, d]), nearer(c, [a, b]), nearer(d, [a, b]));
}

function compareLoops(loop, other, options) {
  const births = Math.abs(loop.birth - other.birth);
  const deaths = Math.abs(loop.death - other.death);
  const distance = killersApart(loop.ends, other.ends);
  const gate = gatesOf(options, loop, other);
  const sameSize = births < gate.size && deaths < gate.size;
  const closed = !sameSize ? "size" : distance < gate.place ? "" : "place";
  return { cost: options.gates === "near" ? distance + deaths : distance, closed };
}

function cheapest(pairs, columns) { // as many open pairs as possible, at the least total cost
  if (!pairs.length || !columns) return pairs.map(() => -1);
  const open = pairs.flat().filter(({ closed }) => !closed);
  const price = 1 + 2 * open.reduce((sum, { cost }) => sum + cost, 0); // of a closed pair: more than all open ones together
  const table = pairs.map((row) => row.map(({ cost, closed }) => (closed ? price : cost)));
  const match = pairs.map(() => -1);
  if (pairs.length <= columns) {
    assign(table).forEach((k, i) => (match[i] = k));
  } else {
    const turned = Array.from({ length: columns }, (_, k) => table.map((row) => row[k]));
    assign(turned).forEach((i, k) => (match[i] = k));
  }
  return match.map((k, i) => (k >= 0 && !pairs[i][k].closed ? k : -1));
}

function followed(film, options) {
  let before = [];
  let names = [];
  let fresh = 0;
  return film.map((bars) => {
    const loops = bars.filter(({ birth, death }) => death - birth >= options.alpha);
    const pairs = loops.map((loop) => before.map((other) => compareLoops(loop, other, options)));
    const match = cheapest(pairs, before.length);
    const old = names;
    names = match.map((k) => (k >= 0 ? old[k] : fresh++));
    const frame = { loops, before, match, names, old, cost: pairs.map((row) => row.map(({ cost }) => cost)), closed: pairs.map((row) => row.map(({ closed }) => closed)) };
    before = loops;
    return frame;
  });
}
