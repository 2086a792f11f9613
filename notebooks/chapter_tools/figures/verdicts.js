// One frame of cloth, a part of its motion, and what each lemma promises: the verdicts of topokit.lemmas for each alpha and epsilon.
// Idea: the library has checked all statements for every step of both sliders; the page shows the step that is chosen.
(() => {
  const [scene, table, strip] = [$("scene"), $("verdicts"), $("bounds")], { statements, versions, epsilons, distortions, counts } = data;
  const [nA, nE, nS, nV] = data.outcomes.shape, [outcomes, numbers] = [unpack(data.outcomes), unpack(data.numbers)];
  const before = unpack(data.before), motion = unpack(data.motion), seen = unpack(data.seen), n = before.length / 3;
  const killers = { now: unpack(data.killers), then: unpack(data.killersThen) };
  const [NONE, SHORT, UNMET, TRUE, FALSE] = [0, 1, 2, 3, 4];
  const WORDS = ["", "no loop long enough", "assumptions not met", "true", "false"];
  let a, e, statement;
  const later = lazily(draw), eye = orbit(scene, data.view, later), cm = (v) => (100 * v).toFixed(1);
  const inks = () => [paint(0), paint(2), blue()]; // of the versions

  const index = (s, v, i = a, j = e) => ((i * nE + j) * nS + s) * nV + v;
  const outcome = (...at) => outcomes[index(...at)];
  const sides = (...at) => [numbers[2 * index(...at)], numbers[2 * index(...at) + 1]]; // the statistic and its bound, in metres
  const alphas = () => data.alphas.map((row) => row[e]); // of this motion
  const alongMotion = () => data.along[statement] === "epsilon";

  // ---- drawing -----------------------------------------------------------------------------------------------
  const place = (v, share) => [0, 1, 2].map((k) => before[3 * v + k] + share * motion[3 * v + k]);
  function drawScene() {
    const [g, w, h] = start(scene), see = eye.see(data.middle), zoom = (eye.cam.zoom * Math.min(w - 24, h - 44)) / data.spread, share = e / (nE - 1);
    const flat = (p) => {
      const [x, y] = see(p);
      return [w / 2 + zoom * x, h / 2 + 8 - zoom * y];
    };
    for (let v = 0; v < n; v++) {
      const p = flat(place(v, 0)), observed = seen[a * n + v];
      if (e) trace(g, [p, flat(place(v, share))], fade(css("--soft"), 0.45), 1);
      dot(g, p, observed ? 2.8 : 2.5, css(observed ? "--ink" : "--panel"), css(observed ? "--panel" : "--soft"), observed ? 0.5 : 1);
    }
    const edge = (ids, t, style, width, dash) => trace(g, [...ids].map((v) => flat(place(v, t))), style, width, { dash });
    edge(killers.now.subarray(2 * a, 2 * a + 2), 0, paint(0), 4.5, []);
    edge(killers.then.subarray(2 * (a * nE + e), 2 * (a * nE + e) + 2), share, blue(), 3, [8, 6]);
  }
  function drawTable() {
    const [g, w, h] = start(table), left = Math.min(154, 0.4 * w), wide = (w - left - 8) / nV, high = (h - 52) / nS;
    g.textBaseline = "middle";
    g.fillStyle = css("--soft");
    g.fillText("verdict on each lemma, in this step", 10, 14);
    versions.forEach((name, v) => g.fillText(name, left + v * wide + 4, 38, wide - 12));
    table.row = (y) => Math.floor((y - 50) / high);
    statements.forEach((name, s) => {
      const y = 50 + (s + 0.5) * high;
      if (s === statement) (g.fillStyle = fade(css("--accent"), 0.15)), g.fillRect(4, y - high / 2 + 1, w - 8, high - 2);
      g.fillStyle = css("--ink");
      g.fillText(name, 10, y, left - 14);
      versions.forEach((_, v) => {
        const is = outcome(s, v), x = left + v * wide + 10;
        if (is === NONE) return;
        const colour = is === TRUE ? paint(2) : is === FALSE ? paint(0) : null;
        dot(g, [x, y], 5, colour, colour || css("--soft"), 1.5);
        if (is === UNMET) line(g, x - 4, y + 4, x + 4, y - 4);
        g.fillStyle = css(colour ? "--ink" : "--soft");
        g.fillText(["", "no loop", "not met", "true", "false"][is], x + 10, y, wide - 22);
      });
    });
  }
  function drawStrip() { // statistic and bounds of one statement, along the slider on which it depends more
    const count = alongMotion() ? nE : nA, values = alongMotion() ? epsilons : alphas(), now = alongMotion() ? e : a;
    const at = (s, v, k) => (alongMotion() ? [s, v, a, k] : [s, v, k, e]);
    const drawn = versions.map((_, v) => Array.from({ length: count }, (_, k) => ({ k, is: outcome(...at(statement, v, k)), both: sides(...at(statement, v, k)) })));
    const useful = drawn.map((rows, v) => (data.counted[statement] && v === 0 ? [] : rows.filter(({ is, both }) => is > SHORT && both.every(Number.isFinite))));
    const all = useful.flat().flatMap(({ both }) => both), high = 1.12 * Math.max(0.01, ...all), wide = values.at(-1) || 1;
    const [g, X, Y, box] = axes(strip, 100 * wide, 100 * high, `${statements[statement]}: bounds (lines), measured (dots), cm`, alongMotion() ? "\u03b5, cm" : "\u03b1, cm");
    useful.forEach((rows, v) => {
      trace(g, rows.map(({ k, both }) => [X(100 * values[k]), Y(100 * both[1])]), inks()[v], 2, { dash: [[], [2, 5], [6, 4]][v] });
      rows.forEach(({ k, both }) => {
        dot(g, [X(100 * values[k]), Y(100 * both[1])], 2.5, inks()[v]);
        dot(g, [X(100 * values[k]), Y(100 * both[0])], 3.5, css("--ink"));
      });
      g.fillStyle = inks()[v];
      if (rows.length) word(g, versions[v], box.x + 8 + 76 * v, box.y + 8);
    });
    g.fillStyle = css("--soft");
    if (!all.length) g.fillText("it says nothing here: no loop is long enough", box.x + 8, box.y + 12);
    pen(g, css("--ink"), 1.2);
    line(g, X(100 * values[now]), box.y, X(100 * values[now]), box.y + box.h, [3, 3]);
  }
  function draw() {
    drawScene();
    drawTable();
    drawStrip();
    const said = (s, v) => {
      const is = outcome(s, v), [left, right] = sides(s, v);
      if (is <= SHORT) return `${versions[v]}: ${WORDS[is]}`;
      const both = data.counted[s] && v === 0 ? `${left} loop, at most ${right}` : `${cm(left)} \u2264 ${cm(right)} cm`;
      return `${versions[v]}: ${both}, ${WORDS[is]}`;
    };
    const present = (s) => [...versions.keys()].filter((v) => outcome(s, v) !== NONE);
    const text = `\u03b1 = ${cm(alphas()[a])} cm, ${counts[a]} of ${n} points observed \u00b7 \u03b5 = ${cm(epsilons[e])} cm, \u03b4 = ${cm(distortions[e])} cm \u00b7 lifetime ${cm(data.life)} cm \u00b7 `
      + `${statements[statement]}: ${present(statement).map((v) => said(statement, v)).join("; ")}`;
    $("status").textContent = text;
    for (const [name, value, is] of [["alpha", a, alphas()[a]], ["epsilon", e, epsilons[e]]]) {
      $(name).value = value;
      $(name).setAttribute("aria-valuetext", `${cm(is)} cm`);
      $(`${name}-is`).textContent = `${cm(is)} cm`;
    }
    $("statement").value = statement;
    describe(scene, `a frame of cloth, observed points filled; the killer edge of the observed points, and dashed that of the observed points after the motion; ${text}. ${TURN.replace("Drag", "Drag the scene")}`);
    describe(table, statements.map((name, s) => `${name}: ${present(s).map((v) => `${versions[v]} ${WORDS[outcome(s, v)]}`).join(", ")}`).join("; "));
    describe(strip, `what is measured and the bounds of one statement; ${text}`);
  }

  // ---- hands -------------------------------------------------------------------------------------------------
  function reset() {
    [a, e, statement] = [...data.start, statements.length - 2];
    eye.back();
    later();
  }
  $("statement").append(...statements.map((name, s) => new Option(name, s)));
  $("statement").onchange = (event) => ((statement = +event.target.value), later());
  [$("alpha").max, $("epsilon").max] = [nA - 1, nE - 1];
  $("alpha").oninput = (event) => ((a = Math.round(event.target.value)), later());
  $("epsilon").oninput = (event) => ((e = Math.round(event.target.value)), later());
  table.onpointerdown = (event) => {
    const s = table.row(event.offsetY);
    if (s >= 0 && s < nS) (statement = s), later();
  };
  scrub(strip, (share) => {
    const values = alongMotion() ? epsilons : alphas(), away = values.map((v) => Math.abs(v - share * values.at(-1))), k = away.indexOf(Math.min(...away));
    if (alongMotion()) e = k;
    else a = k;
    later();
  });
  onReset(reset);

  // ---- start -------------------------------------------------------------------------------------------------
  reset();
  watch(later);
})();
