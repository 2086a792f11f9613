// The paths that a planner compares, over the guide of a hook seen from the side; the reader chooses how many, and where the ring begins.
// Idea: a whole run is computed anew at each change, and the slider shows one of its plans.
(() => {
  const [scene, course, costs] = [$("scene"), $("course"), $("costs")], field = fieldOf(data.ring, data.line, data.closed), { low, high } = data.window;
  const frame = framing([low, high], 0), grid = 0.02, beyond = 0.4, cells = []; // the ground of the picture, by where the rim is
  for (let y = low[0] - beyond; y < high[0] + beyond; y += grid) for (let z = low[1] - beyond; z < high[1] + beyond; z += grid) {
    const place = [y + grid / 2, z + grid / 2], around = field.around(...place);
    cells.push({ y, z, around, guide: field.guide(...place, around), near: !around && field.gap(...place) < MARGIN });
  }
  const highest = field.guide(...low);
  let begin, step, run, asked, chosen;

  // ---- the picture ---------------------------------------------------------------------------------------------
  const flat = (p) => [p[1], p[2]], wayOf = ({ at }, path) => [at, ...path.map(([y, z]) => [at[0] + y, at[1] + z])];
  function drawScene() {
    const [g, w, h] = start(scene), { to } = frame(w, h), now = run.frames[step];
    for (const { y, z, around, guide, near } of cells) {
      const [[x, v], [u, t]] = [[y, z + grid], [y + grid, z]].map((p) => to(p).map(Math.round));
      g.fillStyle = near ? fade(paint(0), 0.3) : fade(blue(), 0.5 * Math.max(0, 1 - guide / highest) * (Math.floor(guide / 0.1) % 2 ? 1 : 0.72));
      g.fillRect(x, v, u - x, t - v);
      if (around) ((g.fillStyle = css("--ink")), g.fillRect((x + u) / 2 - 1, (v + t) / 2 - 1, 2, 2));
    }
    trace(g, data.line.map((p) => to(flat(p))), css("--soft"), Math.max(5, 2 * data.radius * (to([1, 0])[0] - to([0, 0])[0])));
    const round = now.rounds[now.rounds.length - 1] || [];
    round.slice(KEPT).forEach(({ path }) => trace(g, wayOf(now, path).map(to), fade(css("--soft").trim(), 0.6), 1));
    round.slice(1, KEPT).forEach(({ path }) => trace(g, wayOf(now, path).map(to), css("--ink"), 1.4));
    if (round.length) trace(g, wayOf(now, round[0].path).map(to), paint(0), 3);
    trace(g, run.frames.slice(0, step + 1).map((each) => to(each.at)), css("--ink"), 2.5, { dash: [2, 5] });
    trace(g, field.base.map((p) => to([now.at[0] + p[1] + 0.25 * p[0], now.at[1] + p[2]])), css("--ink"), 2.5, { close: true }); // seen a little from the side
    dot(g, to(flat(field.over)), 4, css("--ground"), css("--ink"), 1.5);
    dot(g, to(flat(field.seat)), 4, css("--ground"), css("--ink"), 1.5);
    g.textBaseline = "middle";
    g.fillStyle = css("--ink");
    word(g, "above the tip", to(flat(field.over))[0] - 84, to(flat(field.over))[1] - 12);
    word(g, "seat", to(flat(field.seat))[0] - 10, to(flat(field.seat))[1] + 18);
    dot(g, to(begin), chosen < 0 ? 6 : 8, css("--panel"), css(chosen < 0 ? "--ink" : "--accent"), 2.5);
  }
  function drawCourse() { // the guide along the way, and what the best path forecasts
    const now = run.frames[step], last = run.frames.length - 1, values = run.frames.map(({ guide }) => 100 * guide), top = 1.1 * Math.max(...values, 10);
    const wide = Math.max(last * FOLLOWED, step * FOLLOWED + 60), [g, X, Y, box] = axes(course, wide, top, "guide (cm); thin: as the best path forecasts it", "frames");
    const [best] = now.rounds[now.rounds.length - 1] || [];
    if (best) trace(g, [[X(step * FOLLOWED), Y(values[step])], ...best.path.map((p, f) => [X(step * FOLLOWED + f + 1), Y(100 * Math.min(top / 100, field.guide(now.at[0] + p[0], now.at[1] + p[1])))])], paint(0), 1.6);
    trace(g, values.map((v, k) => [X(k * FOLLOWED), Y(v)]), blue(), 2.5);
    pen(g, css("--ink"), 1.2);
    line(g, X(step * FOLLOWED), box.y, X(step * FOLLOWED), box.y + box.h, [3, 3]);
    course.wide = wide;
  }
  function drawCosts() { // the candidates of each round
    const now = run.frames[step], all = now.rounds.flat().map(({ cost }) => 100 * cost), rounds = Math.max(1, now.rounds.length);
    const [g, X, Y] = axes(costs, rounds, 1.1 * Math.max(10, ...all), "mean cost of each path (cm)", "round", undefined, []);
    now.rounds.forEach((round, r) => {
      g.textAlign = "center";
      g.fillStyle = css("--soft");
      g.fillText(r + 1, X(r + 0.5), Y(0) + 12);
      round.forEach(({ cost }, k) => dot(g, [X(r + 0.14 + (0.72 * (k + 0.5)) / round.length), Y(100 * cost)], k ? 3 : 5, k ? (k < KEPT ? css("--ink") : css("--soft")) : paint(0)));
    });
    g.textAlign = "left";
  }
  function draw() {
    const now = run.frames[step], last = run.frames.length - 1, best = now.rounds.length ? now.rounds[now.rounds.length - 1][0].cost : null;
    const end = run.done ? `around the hook and at the seat after ${last * FOLLOWED} frames` : `not at the seat after ${last * FOLLOWED} frames`;
    const text = `plan ${step} of ${last} \u00b7 ${asked.plans} paths, ${asked.rounds} round${asked.rounds === 1 ? "" : "s"}, seed ${asked.seed} \u00b7 guide ${(100 * now.guide).toFixed(0)} cm, `
      + `${field.around(...now.at) ? "around" : "not around"}${best === null ? "" : `; best path ${(100 * best).toFixed(1)} cm`} \u00b7 ${end}`;
    drawScene();
    drawCourse();
    drawCosts();
    tell(text, $("step"), step);
    for (const name of ["plans", "rounds", "seed"]) ($(name).value = asked[name]), $(name).setAttribute("aria-valuetext", text);
    $("guess").value = +asked.guess;
    describe(course, `the guide along the way; ${text}`);
    describe(costs, `costs of the candidates by round; ${text}`);
    describe(scene, `${text}. Drag the start of the ring, or choose it with the key n and move it with the arrow keys; Escape puts all back.`);
  }
  const later = lazily(draw), [go, play] = stepped($("step"), () => run.frames.length - 1, (k) => {
    step = k;
    later();
  }, 5);
  const compute = lazily(() => {
    run = runOf(begin, field, asked);
    $("step").max = run.frames.length - 1;
    step = Math.min(step, run.frames.length - 1);
    draw();
  });
  function ask(change) {
    play(false);
    Object.assign(asked, change);
    compute();
  }
  function put(v, where) {
    begin = where.map((c, k) => clamp(c, low[k] + 0.02, high[k] - 0.02));
    play(false);
    step = 0;
    compute();
  }
  function reset() {
    [begin, step, chosen, asked] = [[...data.start], 0, -1, { plans: 24, rounds: 2, seed: 0, guess: true }];
    run = run || { frames: [], done: false };
    play(false);
    compute();
  }
  hands(scene, { points: () => [begin], frame, chosen: () => chosen, press: (v) => ((chosen = v), later()), put, Escape: reset });
  for (const name of ["plans", "rounds", "seed"]) $(name).oninput = (e) => ask({ [name]: +e.target.value });
  $("guess").oninput = (e) => ask({ guess: e.target.value === "1" });
  scrub(course, (s) => (play(false), go(Math.round(clamp((s * course.wide) / FOLLOWED, 0, run.frames.length - 1)))));
  onReset(reset);
  reset();
  run = runOf(begin, field, asked);
  watch(() => run.frames.length && compute());
})();
