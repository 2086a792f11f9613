// seqPH's rule: which bars of a cloud are loops, and which loop of a frame is which of the frames before, as topokit.SeqPH has it.
//
//   const { track, tracker, evidence, measured, significance } = seqphKernel(ripsKernel(), assign);
//   track(clouds, d, { onProgress }) -> a state for each cloud, as topokit.track(clouds): { used, alpha, epsilon, diagram, evidence, loops }
//     used        ids of the points that are not alone; the diagram (`persistence` of rips.js) is of these
//     evidence    Float64Array, the log-odds that each bar of the diagram is a loop, by this frame alone
//     loops       [{ id, bar, belief }], longest lifetime first; belief is the log-odds with the frames before
//   tracker(d)(points)           the same state of the next cloud, for clouds that come one after another
//   evidence(points, n, d, births, deaths) -> Float64Array, the same log-odds for all bars of a cloud
//   measured(points, n, d)   a frame's points that are not alone, and the gaps between them
//
// Idea: a bar of the scene is long beside the gaps between neighbouring points, and it dies at many times the radius of its
// birth. In a cloud with little noise 2.6 times the significance of the fourth bar is enough. Along a track evidence adds up and is slowly forgotten. A loop is the same as one before when birth, death and place
// have moved no more than sampling, motion and the jitter of killers allow; the assignment of least total distance decides.
// Source: Antonova et al. 2021 (Algorithm 1); topokit/seqph/_evidence.py has the reasons for the constants.
function seqphKernel({ persistence }, assign) {
  const WEAKEST = -2.5; // a bar of less evidence is never looked at
  const MISSED = -1; // evidence of a frame in which a known loop is not found
  const MEMORY = 40; // frames for which a missed loop is remembered
  const NEIGHBOURS = 5;
  const WIDE = 3; // birth, in spacings, from which the cycle of a bar crosses gaps of another kind than those between points
  const OPEN = 2; // death / birth of a loop across gaps twice as wide as that
  const REACH = 8; // radius, in deaths, of the part of a large scene whose points count for a bar
  const BARS = 100; // bars; the noise of fewer is not known
  const GRID = 1.3; // unevenness of points of a grid, whose bars are so short that they are no measure of noise
  const QUIET = 0.72; // least significance of a loop in a cloud without noise

  function quantile(values, share) { // linear between neighbours
    const sorted = Float64Array.from(values).sort();
    const at = share * (sorted.length - 1);
    const low = Math.floor(at);
    return sorted[low] + (at - low) * (sorted[Math.ceil(at)] - sorted[low]);
  }

  // ---- a frame: points that are not alone, and their gaps ----------------------------------------------------

  function measured(points, n, d) {
    const copies = new Map(); // of each place all points there
    for (let i = 0; i < n; i++) {
      const place = points.subarray(i * d, (i + 1) * d).join();
      if (copies.has(place)) copies.get(place).push(i);
      else copies.set(place, [i]);
    }

    // A place is left out when its fifth nearest one is farther than 2.5 times the median; twice, as such places raise the median.
    let kept = [...copies.values()];
    let places, nearest, many;
    for (let round = 0; round < 3; round++) {
      places = subcloud(points, d, kept.map(([first]) => first));
      many = Math.max(1, Math.min(NEIGHBOURS, kept.length - 1));
      nearest = nearestOthers(places, kept.length, d, many);
      if (round === 2 || kept.length <= NEIGHBOURS) break;
      const last = kept.map((_, i) => nearest[i * many + many - 1]);
      const far = 2.5 * quantile(last, 0.5);
      if (last.every((gap) => gap <= far)) break;
      kept = kept.filter((_, i) => last[i] <= far);
    }
    const frame = { used: Int32Array.from(kept.flat()).sort(), places, size: kept.length, alpha: 0, spacing: 0, unevenness: 1 };
    if (kept.length < 2) return frame;

    // Points strewn at random have far fifth neighbours, and some far nearest ones; the smaller of the two measures counts.
    const firsts = kept.map((_, i) => nearest[i * many]);
    const first = quantile(firsts, 0.5);
    const fifth = quantile(kept.map((_, i) => nearest[i * many + many - 1]), 0.5);
    const axes = Array.from({ length: d }, (_, k) => places.filter((_, c) => c % d === k));
    return Object.assign(frame, {
      alpha: quantile(firsts, 0.95) / 2,
      spacing: fifth,
      unevenness: Math.min(fifth / first, (1.4 * quantile(firsts, 0.9)) / first),
    });
  }

  function significance({ spacing, unevenness, size }, birth, death) { // a loop has more than 1
    if (spacing === 0) return 0;
    const strewn = Math.min(Math.max((unevenness - 2.1) / 0.3, 0), 1);
    const gap = spacing * Math.max(unevenness / 2, 1);
    const ratio = Math.log(death / birth);
    const nearby = 5 * ((REACH * death) / spacing) ** 2; // the spacing is the radius of five points of a sheet
    const n = Math.max(128, Math.min(size, Math.max(nearby, 1000)));
    const strength = ((1.1 * (death - birth)) / gap) * ratio ** 0.3 * (1000 / n) ** (0.75 - 0.45 * strewn);
    const wide = Math.min(Math.max(birth / (WIDE * spacing) - 1, 0), 1); // the share of a cycle's own gaps in the measure
    return strength ** (1 - wide) * Math.min(strength, ratio / Math.log(OPEN)) ** wide;
  }

  // Each bar of a cloud is judged beside the others: the fourth is taken for noise.
  function evidenceIn(frame, births, deaths) {
    const strengths = births.map((birth, i) => significance(frame, birth, deaths[i]));
    const judged = births.length >= BARS && frame.unevenness >= GRID;
    const least = judged ? Math.min(Math.max(2.6 * Float64Array.from(strengths).sort().at(-4), QUIET), 1) : 1;
    return strengths.map((strength, i) => {
      const needed = births[i] > frame.spacing ? 1 : least;
      return Math.min(Math.max(5 * Math.log(strength / needed), -3), 2);
    });
  }

  function evidence(points, n, d, births, deaths) {
    return evidenceIn(measured(points, n, d), births, deaths);
  }

  const believe = (belief, more) => Math.max(0.9 * belief + more, -8);

  // ---- from frame to frame -----------------------------------------------------------------------------------

  // The centroid of a still scene moves when a part of it is hidden. So its shift counts only if the nearest quarter of the points fits
  // the frame before better with the shift than without it. Epsilon is how far the points move besides.
  function motionSince(frame, before, d) {
    const mean = ({ places, size }) => Array.from({ length: d }, (_, k) => places.reduce((sum, v, c) => (c % d === k ? sum + v : sum), 0) / size);
    const [now, then] = [mean(frame), mean(before)];
    const shift = now.map((v, k) => v - then[k]);
    const still = nearestAmong(frame.places, frame.size, before.places, before.size, d);
    const shifted = nearestAmong(frame.places.map((v, c) => v - shift[c % d]), frame.size, before.places, before.size, d);
    const moves = quantile(shifted, 0.25) < quantile(still, 0.25);
    return { shift: moves ? shift : shift.fill(0), epsilon: quantile(moves ? shifted : still, 0.9) };
  }

  const apart = (loop, old) => Math.hypot(...loop.place.map((v, k) => v - old.place[k]));

  function paired(found, known, alpha) { // the pairs within their gates, as many as possible, at the least total distance
    return matched(found, known, (loop, old) => {
      const births = Math.abs(loop.birth - old.birth);
      const deaths = Math.abs(loop.death - old.death);
      const distance = apart(loop, old);
      const longest = Math.max(loop.death, old.death);
      const gate = alpha + old.motion + longest / 4;
      return { fits: births < gate && deaths < gate && distance < 2 * longest + old.motion, cost: distance + deaths };
    });
  }

  // New loops and lost ones whose places are within 2 beta, twice the longer killer edge.
  const lostNearby = (found, lost) => matched(found, lost, (loop, old) => {
    const distance = apart(loop, old);
    return { fits: distance < 4 * Math.max(loop.death, old.death), cost: distance };
  });

  function matched(found, known, compare) { // as many pairs that fit as possible, at the least total cost
    if (found.length === 0 || known.length === 0) return [];
    const pairs = found.map((loop) => known.map((old) => compare(loop, old)));
    let total = 0;
    for (const { fits, cost } of pairs.flat()) if (fits) total += cost;
    const closed = 1 + 2 * total; // a pair that does not fit costs more than all others together
    const table = pairs.map((row) => row.map(({ fits, cost }) => (fits ? cost : closed)));
    let chosen;
    if (found.length <= known.length) chosen = assign(table).map((j, i) => [i, j]);
    else chosen = assign(known.map((_, j) => table.map((row) => row[j]))).map((i, j) => [i, j]);
    return chosen.filter(([i, j]) => pairs[i][j].fits);
  }

  function check(t, frame, before) {
    if (frame.size === 0) throw new Error(`frame ${t} has no points`);
  }

  function tracker(d) { // a function that is given one cloud after another
    let known = [];
    let before = null;
    let nextId = 0;
    let t = -1;
    return (points, report) => {
      t += 1;
      const n = points.length / d;
      const frame = measured(points, n, d);
      check(t, frame, before);
      const diagram = persistence(points, n, d, { ids: frame.used, onProgress: report });
      const strength = evidenceIn(frame, diagram.births, diagram.deaths);
      const { shift, epsilon } = before ? motionSince(frame, before, d) : { shift: new Array(d).fill(0), epsilon: 0 };

      // The bars that may be loops, each at the barycentre of its thick killer triangle; and the loops known from before, moved with the scene.
      const bars = [...strength.keys()].filter((bar) => strength[bar] > WEAKEST);
      const found = bars.map((bar) => {
        const corners = diagram.killerTriangles.subarray(6 * bar, 6 * bar + 3);
        const place = shift.map((_, k) => corners.reduce((sum, v) => sum + points[v * d + k], 0) / 3);
        return { bar, birth: diagram.births[bar], death: diagram.deaths[bar], place, belief: 0, id: null, motion: 0, missed: 0 };
      });
      known = known.map((loop) => ({ ...loop, place: loop.place.map((v, k) => v + shift[k]), motion: loop.motion + epsilon, missed: loop.missed + 1 }));

      // Known loops that are believed are matched first, then the others.
      const taken = new Set();
      for (const believed of [true, false]) {
        const open = found.filter((loop) => !loop.same);
        const old = known.filter((loop) => loop.belief > 0 === believed);
        for (const [i, j] of paired(open, old, frame.alpha)) {
          open[i].same = old[j];
          taken.add(old[j]);
        }
      }

      // A matched bar takes over belief and identity. A bar whose belief becomes positive gets the identity of a lost loop near
      // it, or else a new one.
      for (const loop of found) {
        if (loop.same) [loop.belief, loop.id] = [loop.same.belief, loop.same.id];
        delete loop.same;
        loop.belief = believe(loop.belief, strength[loop.bar]);
      }
      const nameless = found.filter((loop) => loop.belief > 0 && loop.id === null);
      const lost = known.filter((loop) => loop.id !== null && !taken.has(loop));
      for (const [i, j] of lostNearby(nameless, lost)) {
        nameless[i].id = lost[j].id;
        taken.add(lost[j]);
      }
      const loops = [];
      for (const loop of found) {
        if (loop.belief > 0) {
          loop.id ??= nextId++;
          loops.push({ id: loop.id, bar: loop.bar, belief: loop.belief });
        }
      }

      // Known loops that were not found are remembered for some frames, with less belief.
      const missed = known.filter((loop) => !taken.has(loop) && loop.missed <= MEMORY);
      known = [...found, ...missed.map((loop) => ({ ...loop, belief: believe(loop.belief, MISSED) }))];
      before = frame;
      return { used: frame.used, alpha: frame.alpha, epsilon, diagram, evidence: strength, loops };
    };
  }

  function track(clouds, d, { onProgress } = {}) {
    const update = tracker(d);
    return clouds.map((points, t) => update(points, onProgress && ((share) => onProgress((t + share) / clouds.length))));
  }

  return { track, tracker, evidence, measured, significance };
}
