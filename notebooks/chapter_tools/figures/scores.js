// MOTA, IDF1 and HOTA of a film, as topokit.evaluate.score has them.
// Idea: a frame has objects, names, and a table of similarities, a row for each object. All measures follow from counts.
const LEVELS = Array.from({ length: 19 }, (_, k) => 0.05 + 0.05 * k); // similarities over which HOTA is a mean
const reaches = (similarity, level) => similarity >= level - Number.EPSILON;

function greatest(gain) { // pairs of the assignment of greatest total gain, without pairs that gain nothing
  const rows = gain.length, columns = rows ? gain[0].length : 0;
  if (!columns) return [];
  const tall = rows > columns, short = Math.min(rows, columns), long = Math.max(rows, columns);
  const at = (a, b) => (tall ? gain[b][a] : gain[a][b]);
  const cost = Array.from({ length: short }, (_, a) => Array.from({ length: long }, (_, b) => -at(a, b)));
  const pairs = assign(cost).map((b, a) => (tall ? [b, a] : [a, b]));
  return pairs.filter(([row, column]) => gain[row][column] > 0);
}

function eventsOf(frames, threshold) { // for each frame its matches as [object, name, whether the name is another than last time]
  const last = new Map(); // the name of each object's last match
  let current = new Map(); // the matches of the last frame with anything in it
  return frames.map(({ objects, ids, similarity }) => {
    if (!objects.length || !ids.length) return [];
    const gainOf = (object, r) => (id, c) => (reaches(similarity[r][c], threshold) ? similarity[r][c] + (current.get(object) === id ? 1000 : 0) : 0);
    const pairs = greatest(objects.map((object, r) => ids.map(gainOf(object, r)))).map(([r, c]) => [objects[r], ids[c]]);
    const matches = pairs.map(([object, id]) => [object, id, last.has(object) && last.get(object) !== id]);
    current = new Map(pairs);
    pairs.forEach(([object, id]) => last.set(object, id));
    return matches;
  });
}

function scoreOf(frames, threshold = 0.5) {
  const objects = [...new Set(frames.flatMap((frame) => frame.objects))], ids = [...new Set(frames.flatMap((frame) => frame.ids))];
  const row = new Map(objects.map((object, k) => [object, k])), column = new Map(ids.map((id, k) => [id, k]));
  const table = () => objects.map(() => ids.map(() => 0)), total = (values) => values.reduce((sum, v) => sum + v, 0);
  const events = eventsOf(frames, threshold), matches = total(events.map((found) => found.length));
  const switches = total(events.map((found) => found.filter(([, , other]) => other).length));
  const [whole, detections] = ["objects", "ids"].map((kind) => total(frames.map((frame) => frame[kind].length)));

  // IDF1 gives each object one name for good. The potential is how well an object and a name fit over the whole film.
  const together = table(), potential = table(), framesOfObject = objects.map(() => 0), framesOfId = ids.map(() => 0);
  for (const frame of frames) {
    const down = frame.ids.map((_, c) => total(frame.similarity.map((line) => line[c])));
    frame.objects.forEach((object, r) => {
      const across = total(frame.similarity[r]);
      framesOfObject[row.get(object)]++;
      frame.ids.forEach((id, c) => {
        const s = frame.similarity[r][c], union = across + down[c] - s;
        together[row.get(object)][column.get(id)] += reaches(s, threshold) ? 1 : 0;
        potential[row.get(object)][column.get(id)] += union > 0 ? s / union : 0;
      });
    });
    frame.ids.forEach((id) => framesOfId[column.get(id)]++);
  }
  const pairs = greatest(together), kept = total(pairs.map(([r, c]) => together[r][c]));

  // HOTA matches each frame by the fit over the film. At each level it counts the matches that reach the level.
  const fits = table().map((line, r) => line.map((_, c) => potential[r][c] / (framesOfObject[r] + framesOfId[c] - potential[r][c])));
  const at = LEVELS.map(table);
  for (const { objects: here, ids: names, similarity } of frames) {
    const gain = here.map((object, r) => names.map((id, c) => fits[row.get(object)][column.get(id)] * similarity[r][c]));
    for (const [r, c] of greatest(gain)) {
      LEVELS.forEach((level, k) => {
        if (reaches(similarity[r][c], level)) at[k][row.get(here[r])][column.get(names[c])]++;
      });
    }
  }
  const levels = at.map((both) => {
    const count = total(both.flat());
    const shares = both.flatMap((line, r) => line.map((n, c) => (n * n) / Math.max(framesOfObject[r] + framesOfId[c] - n, 1)));
    return { detection: count / Math.max(whole + detections - count, 1), association: total(shares) / Math.max(count, 1) };
  });
  const mean = (value) => total(levels.map(value)) / levels.length;
  return {
    objects, ids, together, pairs, events, matches, switches, misses: whole - matches, extra: detections - matches,
    mota: 1 - (whole - matches + detections - matches + switches) / whole,
    idf1: (2 * kept) / (whole + detections),
    deta: mean((level) => level.detection),
    assa: mean((level) => level.association),
    hota: mean((level) => Math.sqrt(level.detection * level.association)),
  };
}
