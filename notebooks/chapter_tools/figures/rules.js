// Which bars of a planar cloud are loops, by two rules, as topokit.SeqPH has them; `rips` is in rips.js, `apart` in places.js.
// Idea: a rule says how long a bar would have to live, and how far it is above that: a loop has a `strength` of 1 or more.
const quantile = (values, q) => { // linear between neighbours, as NumPy has it
  const sorted = [...values].sort((a, b) => a - b), at = q * (sorted.length - 1), low = Math.floor(at);
  return sorted[low] + (at - low) * (sorted[Math.ceil(at)] - sorted[low]);
};
const distinct = (points) => points.filter((p, v) => points.findIndex((q) => q[0] === p[0] && q[1] === p[1]) === v);
const nearestOthers = (points, count) => // how far every point is from its nearest others, the nearest first
  points.map((p, v) => points.filter((_, w) => w !== v).map((q) => apart(p, q)).sort((a, b) => a - b).slice(0, count));

function judged({ loops }, judge) { // copies of the loops, each with what its bar must reach and how strong it is
  return loops.map((loop) => Object.assign(Object.create(loop), judge(loop)));
}

function byAlpha(points, complex = rips(points)) { // the paper's: a loop lives as long as half the largest distance of a point from its nearest other one
  const places = distinct(points), away = nearestOthers(places, 1).map(([d = 0]) => d), alpha = Math.max(...away) / 2;
  const loops = judged(complex, ({ birth, death }) => ({ needed: birth + alpha, strength: (death - birth) / alpha }));
  return { alpha, cloud: points, loops, kept: loops.filter((l) => l.strength >= 1), loneliest: places[away.indexOf(2 * alpha)] };
}

function inliers(points) { // without those whose fifth neighbour is farther than 2.5 times the median, twice
  let left = distinct(points);
  for (let round = 0; round < 2 && left.length > 5; round++) {
    const fifth = nearestOthers(left, 5).map((d) => d[4]), far = 2.5 * quantile(fifth, 0.5);
    left = left.filter((_, v) => fifth[v] <= far);
  }
  return left;
}

function byEvidence(points, complex = rips(points)) { // a loop's bar is long beside the gaps between points, and dies at many times the radius of its birth
  const left = inliers(points), n = left.length, near = nearestOthers(left, 5), first = near.map(([d = 0]) => d);
  const middle = quantile(first, 0.5), fifth = quantile(near.map((d) => d[d.length - 1]), 0.5);
  const unevenness = Math.min(fifth, 1.4 * quantile(first, 0.9)) / middle, strewn = Math.min(Math.max((unevenness - 2.1) / 0.3, 0), 1);
  const spacing = fifth * Math.max(unevenness / 2, 1), many = (1000 / Math.max(n, 128)) ** (0.75 - 0.45 * strewn);
  const significance = (birth, death) => ((1.1 * (death - birth)) / spacing) * Math.log(death / birth) ** 0.3 * many;
  const reach = (birth) => { // the least death of a loop that is born then
    let [low, high] = [birth, 2 * birth];
    while (significance(birth, high) < 1) high *= 2;
    for (let step = 0; step < 60; step++) {
      const death = (low + high) / 2;
      if (significance(birth, death) < 1) low = death;
      else high = death;
    }
    return high;
  };
  const loops = judged(n < points.length ? rips(left) : complex, ({ birth, death }) => ({ needed: reach(birth), strength: significance(birth, death) }));
  return { alpha: quantile(first, 0.95) / 2, cloud: left, loops, kept: loops.filter((l) => l.strength > 1) };
}
