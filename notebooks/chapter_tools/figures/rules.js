// Which bars of a planar cloud are loops, by two rules, as topokit.SeqPH has them; the evidence is in seqph.js, `rips` in complex.js.
// Idea: a rule says how long a bar would have to live, and how far it is above that: a loop has a `strength` of 1 or more.
function judged({ loops }, judge) { // copies of the loops, each with what its bar must reach and how strong it is
  return loops.map((loop) => Object.assign(Object.create(loop), judge(loop)));
}

function byAlpha(points, complex = rips(points)) { // the paper's, alpha guessed: a loop lives as long as half the largest distance of a point from its nearest other one
  const gaps = placeGaps(flatOf(points), points.length, 2), alpha = Math.max(...gaps) / 2;
  const loops = judged(complex, ({ birth, death }) => ({ needed: birth + alpha, strength: (death - birth) / alpha }));
  return { alpha, cloud: points, loops, kept: loops.filter((l) => l.strength >= 1), loneliest: points[gaps.indexOf(2 * alpha)] };
}

function byEvidence(points, complex = rips(points)) { // without points that are alone; a loop's bar is long beside the gaps between points, and dies at many times the radius of its birth
  const { measured, significance } = seqphKernel(kernel, assign), frame = measured(flatOf(points), points.length, 2);
  const reach = (birth) => { // the least death of a loop that is born then
    let [low, high] = [birth, 2 * birth];
    while (significance(frame, birth, high) < 1) high *= 2;
    for (let step = 0; step < 60; step++) {
      const death = (low + high) / 2;
      if (significance(frame, birth, death) < 1) low = death;
      else high = death;
    }
    return high;
  };
  const cloud = [...frame.used].map((v) => points[v]), whole = cloud.length === points.length;
  const loops = judged(whole ? complex : rips(cloud), ({ birth, death }) => ({ needed: reach(birth), strength: significance(frame, birth, death) }));
  return { alpha: frame.alpha, cloud, loops, kept: loops.filter((l) => l.strength > 1) };
}
