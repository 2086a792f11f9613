// A chain of edges that the reader makes, its boundary, and the answer to the question whether it bounds.
// Idea: the state is a radius and a set of edges. The answer is computed when it is asked for, and goes when the chain changes.
(() => {
  const scene = $("scene"), points = data.points, frame = framing(points, 0.08 * Math.max(...points.map((p) => apart(p, points[0]))));
  const { edges, loops } = rips(points), name = ([a, b]) => `${a}\u2013${b}`, sides = ([a, b, c]) => [[a, b], [a, c], [b, c]].map(name);
  const CHAIN = () => css("--accent");
  let radius, chain, answer, chosen;
  const rows = () => edges.filter((e) => e.value <= radius).map((e) => [e.i, e.j]);
  const triangles = () => { // those of the complex, by their three points
    const there = new Set(rows().map(name)), ids = points.keys();
    return [...ids].flatMap((a, _, all) => all.slice(a + 1).flatMap((b) => all.slice(b + 1).map((c) => [a, b, c]))).filter((t) => sides(t).every((side) => there.has(side)));
  };
  const inChain = () => rows().filter((e) => chain.has(name(e)));
  const boundary = () => [...points.keys()].filter((v) => inChain().filter((e) => e.includes(v)).length % 2);
  const alive = () => loops.map((loop, k) => ({ ...loop, k })).filter((l) => l.birth <= radius && radius < l.death);
  const walk = ({ cycle }) => cycle.map((v, k) => name([v, cycle[(k + 1) % cycle.length]].sort((a, b) => a - b)));
  const cells = () => [...rows(), ...triangles()]; // what can be added to the chain: an edge, or the boundary of a triangle
  const many = (count, what) => `${count} ${what}${count === 1 ? "" : "s"}`;

  // ---- drawing -------------------------------------------------------------------------------------------------
  function draw() {
    const [g, w, h] = start(scene), { to } = frame(w, h), S = points.map(to), at = (ids) => ids.map((v) => S[v]);
    for (const t of triangles()) trace(g, at(t), null, 0, { close: true, fill: dark ? "#2c343d" : "#e2e7ed" });
    for (const t of answer?.triangles ?? []) trace(g, at(t), fade(CHAIN(), 0.8), 1, { close: true, fill: fade(CHAIN(), 0.4) });
    for (const e of rows()) trace(g, at(e), css("--soft"), 1.2);
    for (const e of inChain()) trace(g, at(e), CHAIN(), 5);
    for (const k of answer?.loops ?? []) trace(g, at(loops[k].cycle), paint(k), 3, { close: true, dash: [3, 6] });
    if (cells()[chosen]) trace(g, at(cells()[chosen]), css("--ink"), 2, { close: true, dash: [2, 4] });
    for (const loop of alive()) {
      const [x, y] = mean(at(loop.cycle));
      [g.fillStyle, g.textAlign] = [css("--ink"), "center"];
      word(g, `loop ${loop.k}`, x, y);
    }
    g.textAlign = "left";
    const odd = boundary();
    S.forEach((p, v) => {
      dot(g, p, odd.includes(v) ? 9 : 4.5, odd.includes(v) ? css("--panel") : css("--ink"), odd.includes(v) ? CHAIN() : css("--panel"), odd.includes(v) ? 3.5 : 1);
      g.fillStyle = css("--ink");
      word(g, v, p[0] + 11, p[1] - 11);
    });
    const text = explanation();
    tell(text, $("radius"), Math.round((200 * radius) / data.end));
    $("take").disabled = !alive().length;
    $("take").textContent = `take loop ${alive()[0]?.k ?? 0}`;
    describe(scene, `${text}. Click an edge to add it to the chain or to take it out; click a triangle to add its three sides. Or go from one to the next with the keys n and p, and add it with Enter; space asks whether the chain bounds, Escape begins anew.`);
  }
  function explanation() {
    const odd = boundary(), size = inChain().length;
    const about = odd.length ? `its boundary is ${odd.length} points: ${odd.join(", ")}` : "its boundary is zero, so it is a cycle";
    return [`r = ${radius.toFixed(2)}`, many(rows().length, "edge"), many(triangles().length, "triangle"), size ? `chain of ${many(size, "edge")}: ${about}` : "empty chain", ...verdict(odd)].join(" \u00b7 ");
  }
  function verdict(odd) {
    if (!answer) return [];
    if (odd.length) return ["no: only a cycle can bound"];
    const filled = many(answer.triangles.length, "triangle");
    if (!answer.loops.length) return [`yes: it is the boundary of ${filled}`];
    const around = `loop ${answer.loops.join(" and loop ")}`, sum = answer.loops.length > 1 ? "the sum of the dashed cycles" : "the dashed cycle";
    return [`no: it goes around ${around}, and it ${answer.triangles.length ? `is homologous to ${sum}, by ${filled}` : `is ${sum}`}`];
  }
  const later = lazily(draw);

  // ---- the chain -----------------------------------------------------------------------------------------------
  function changed() {
    answer = null;
    later();
  }
  function add(cell) { // modulo 2
    for (const side of cell.length === 2 ? [name(cell)] : sides(cell)) if (!chain.delete(side)) chain.add(side);
    changed();
  }
  function ask() {
    const cycle = rows().flatMap((e, row) => (chain.has(name(e)) ? [row] : []));
    answer = boundary().length ? { loops: [], triangles: [] } : bounding(points, radius, cycle);
    later();
  }
  function reset() {
    [radius, chain, chosen] = [data.start, new Set(data.chain.map(name)), -1];
    changed();
  }
  function under({ offsetX: x, offsetY: y, pointerType }) { // the edge or the smallest triangle at a place, -1 for none
    const { to } = frame(scene.clientWidth, scene.clientHeight), S = points.map(to), all = cells();
    const turn = ([a, b], [c, d], [e, f]) => (c - a) * (f - b) - (d - b) * (e - a);
    const away = all.map((ids) => {
      const [a, b, c] = ids.map((v) => S[v]);
      if (c) { // inside, all three turns have one sign; an edge is nearer
        const turns = [turn(a, b, [x, y]), turn(b, c, [x, y]), turn(c, a, [x, y])].map(Math.sign);
        return Math.abs(turns[0] + turns[1] + turns[2]) === 3 ? 100 + Math.abs(turn(a, b, c)) : Infinity;
      }
      const t = clamp(((x - a[0]) * (b[0] - a[0]) + (y - a[1]) * (b[1] - a[1])) / apart(a, b) ** 2, 0, 1);
      const far = apart([x, y], [a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])]);
      return far < (pointerType === "touch" ? 20 : 12) ? far : Infinity;
    });
    const best = Math.min(...away);
    return best < Infinity ? away.indexOf(best) : -1;
  }
  scene.onclick = (e) => {
    const cell = cells()[under(e)];
    chosen = -1;
    if (cell) add(cell);
    else later();
  };
  scene.onpointermove = (e) => (scene.style.cursor = under(e) >= 0 ? "pointer" : "");
  const step = (by) => () => ((chosen = (Math.max(chosen, by > 0 ? -1 : 0) + by + cells().length) % cells().length), later());
  keys(scene, () => ({ n: step(1), p: step(-1), Enter: () => cells()[chosen] && add(cells()[chosen]), " ": ask, Escape: reset }));
  $("radius").oninput = (e) => {
    [radius, chosen] = [(e.target.value / 200) * data.end, -1];
    changed();
  };
  $("ask").onclick = ask;
  $("take").onclick = () => {
    chain = new Set(walk(alive()[0]));
    changed();
  };
  onReset(reset);
  reset();
  watch(later);
})();
