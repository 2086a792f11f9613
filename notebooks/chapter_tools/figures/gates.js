// A film of killer edges and the tracker's three numbers: the table of costs of each step, its assignment, and the names.
// Idea: the state is a frame and the options. The whole film is followed anew whenever an option changes.
(() => {
  const [scene, table, strip] = [$("scene"), $("table"), $("names")], { frames, spread, scale, low } = data, SHOWN = 5;
  const dots = unpack(data.cloud), bars = unpack(data.bars), each = dots.length / 3 / frames, MOST = { alpha: data.most, beta: 0.3, epsilon: 0.15 };
  let at = 0;
  const film = data.counts.map((many) => Array.from({ length: many }, () => {
    const [birth, death, ...ends] = bars.subarray(8 * at, 8 * ++at);
    return { birth, death, ends: [ends.slice(0, 3), ends.slice(3)] };
  }));
  let time, options, told;
  const later = lazily(draw), eye = orbit(scene, data.view, later, { " ": () => play() });
  const colour = (name) => (dark && name % 6 === 1 ? blue() : paint(name)), cm = (v) => (100 * v).toFixed(1);

  // ---- what follows from the state ---------------------------------------------------------------------------
  function compute() {
    told = followed(film, options);
    later();
  }
  function reset() {
    play(false);
    time = Math.floor(frames / 2);
    options = { ...data.options };
    $("gates").value = options.gates;
    eye.back();
    compute();
  }
  const now = () => told[time], count = () => new Set(told.flatMap(({ names }) => names)).size;

  // ---- drawing -----------------------------------------------------------------------------------------------
  function drawScene() {
    const [g, w, h] = start(scene), see = eye.see(data.middle), zoom = (eye.cam.zoom * Math.min(w - 20, h - 30)) / spread;
    const flat = (p, i = 0) => {
      const [x, y] = see(p, i);
      return [w / 2 + zoom * x, h / 2 + 10 - zoom * y];
    };
    g.fillStyle = fade(css("--soft"), 0.55);
    for (let v = 0; v < each; v++) {
      const [x, y] = flat([0, 1, 2].map((k) => scale * dots[3 * (each * time + v) + k] + low[k]));
      g.fillRect(x - 1, y - 1, 2, 2);
    }
    const { loops, names, before, old, match } = now();
    before.slice(0, SHOWN).forEach((loop, k) => trace(g, loop.ends.map((p) => flat(p)), fade(colour(old[k]), 0.8), 2.5, { dash: [3, 5] }));
    const drawn = loops.slice(0, SHOWN).map((loop) => loop.ends.map((p) => flat(p)));
    drawn.forEach((ends, i) => trace(g, ends, colour(names[i]), 4.5));
    drawn.forEach(([a, b], i) => {
      g.fillStyle = css("--ink");
      word(g, names[i] + (match[i] < 0 && time ? " new" : ""), (a[0] + b[0]) / 2 + 6, (a[1] + b[1]) / 2 - 8);
    });
  }
  function drawTable() { // rows: the loops of this frame; columns: those of the frame before
    const [g, w, h] = start(table), { loops, before, names, old, cost, closed, match } = now();
    const [rows, columns] = [loops, before].map((list) => Math.min(SHOWN, list.length)), [x0, y0] = [58, 58];
    const [a, b] = [Math.min(110, (w - x0 - 10) / Math.max(1, columns)), Math.min(44, (h - y0 - 8) / Math.max(1, rows))];
    g.textBaseline = "middle";
    g.fillStyle = css("--soft");
    g.fillText("cost in cm: loops now \u00d7 one frame before", 10, 14, w - 20);
    const label = (name, x, y) => {
      dot(g, [x - 10, y], 5, colour(name));
      g.fillStyle = css("--ink");
      g.fillText(name, x, y);
    };
    for (let k = 0; k < columns; k++) label(old[k], x0 + (k + 0.5) * a, y0 - 16);
    for (let i = 0; i < rows; i++) {
      label(names[i], x0 - 26, y0 + (i + 0.5) * b);
      for (let k = 0; k < columns; k++) {
        const taken = match[i] === k, why = closed[i][k], [x, y] = [x0 + k * a, y0 + i * b];
        pen(g, taken ? colour(names[i]) : css("--line"), taken ? 3 : 1);
        if (taken) (g.fillStyle = fade(colour(names[i]), 0.2)), g.fillRect(x + 2, y + 2, a - 4, b - 4);
        g.strokeRect(x + 2, y + 2, a - 4, b - 4);
        g.textAlign = "center";
        g.fillStyle = css(why ? "--soft" : "--ink");
        g.fillText(cm(cost[i][k]), x + a / 2, y + b / 2 - (why ? 7 : 0));
        if (why) g.fillText(`${why} gate`, x + a / 2, y + b / 2 + 8);
        g.textAlign = "left";
      }
    }
    g.fillStyle = css("--soft");
    if (!rows || !columns) g.fillText(time ? "no pair of loops" : "the first frame has no frame before it", 10, y0);
  }
  function drawStrip() {
    const many = count(), [g, X, Y, box] = axes(strip, frames - 1, Math.max(1, many), `names along the film: ${many}`, "frame", []), wide = clamp((0.6 * box.h) / Math.max(1, many), 1.5, 8);
    g.lineCap = "butt";
    told.forEach(({ names }, t) => names.forEach((name) => trace(g, [[X(t - 0.45), Y(name + 0.5)], [X(t + 0.45), Y(name + 0.5)]], colour(name), wide)));
    pen(g, css("--ink"), 1.2);
    line(g, X(time), box.y, X(time), box.y + box.h, [3, 3]);
  }
  function draw() {
    drawScene();
    drawTable();
    drawStrip();
    const { loops, match, closed } = now(), kept = match.filter((k) => k >= 0).length, shut = closed.flat(), because = (gate) => shut.filter((why) => why === gate).length;
    const { size, place } = gatesOf(options, loops[0] ?? { death: 0 }, loops[0] ?? { death: 0 });
    const text = `frame ${time + 1} of ${frames} \u00b7 gates: size ${cm(size)} cm, place ${cm(place)} cm \u00b7 ${loops.length} loops, ${kept} keep their names; of ${shut.length} pairs `
      + `${because("size")} are closed by size, ${because("place")} by place \u00b7 ${count()} names in the film`;
    tell(text, $("time"), time);
    for (const name of ["alpha", "beta", "epsilon"]) {
      $(name).value = Math.round((200 * options[name]) / MOST[name]);
      $(name).setAttribute("aria-valuetext", `${cm(options[name])} cm`);
      $(`${name}-is`).textContent = `${cm(options[name])} cm`;
    }
    describe(scene, `the killer edges of this frame, and dashed those of the frame before; ${text}. ${TURN.replace("Drag", "Drag the scene")}; the space key plays.`);
    describe(table, `the table of costs with its assignment; ${text}`);
    describe(strip, `the names of the loops along the film; ${text}`);
  }

  // ---- hands -------------------------------------------------------------------------------------------------
  const [go, play] = stepped($("time"), () => frames - 1, (t) => ((time = t), later()), 10);
  for (const name of ["alpha", "beta", "epsilon"]) $(name).oninput = (e) => ((options[name] = (e.target.value / 200) * MOST[name]), compute());
  $("gates").onchange = (e) => ((options.gates = e.target.value), compute());
  $("time").max = frames - 1;
  $("alpha").min = Math.ceil((200 * data.least) / MOST.alpha);
  scrub(strip, (share) => (play(false), go(clamp(Math.round(share * (frames - 1)), 0, frames - 1))));
  onReset(reset);

  // ---- start -------------------------------------------------------------------------------------------------
  reset();
  watch(later);
})();
