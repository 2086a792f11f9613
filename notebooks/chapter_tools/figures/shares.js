// The shares of an evaluation, as the reader asks for them: by predictor, horizon, garment, condition and measure.
// Idea: all cells are in one table of ten thousandths; NONE where nothing was asked. Charts are rows of a mean and an interval.
const NONE = 65535;
const cellAt = (table, shape, index) => { // the last axis of a packed table
  const from = index.reduce((sum, i, k) => sum * shape[k] + i, 0) * shape[index.length];
  return table.slice(from, from + shape[index.length]);
};

if (typeof data !== "undefined") (() => {
  const [scene, steps, where] = [$("scene"), $("steps"), $("where")], cells = unpack(data.cells), counts = unpack(data.counts);
  const kinds = ["condition", "garment", "measure", "model", "horizon"], ask = {}, horizon = (h) => (data.horizon[h] === "mean" ? "mean" : "t+" + data.horizon[h]);
  const cell = (other = {}) => {
    const [mean, low, high] = cellAt(cells, data.cells.shape, kinds.map((kind) => ({ ...ask, ...other })[kind]));
    return mean === NONE ? null : [mean, low === NONE ? mean : low, high === NONE ? mean : high].map((v) => v / 100);
  };
  const count = (other = {}) => cellAt(counts, data.counts.shape, kinds.filter((k) => k !== "model").map((kind) => ({ ...ask, ...other })[kind]))[0];
  const said = (c) => (c ? `${c[0].toFixed(0)} % (${c[1].toFixed(0)} to ${c[2].toFixed(0)})` : "not asked");
  const choose = (kind, to) => ((ask[kind] = clamp(to, 0, data[kind].length - 1)), later());

  function rows(canvas, kind, title) { // a row for each of a kind; a click chooses it
    const [g, w, h] = start(canvas), left = 82, wide = w - left - 130, X = (v) => left + (v / 100) * wide;
    g.textBaseline = "middle";
    g.fillStyle = css("--soft");
    g.fillText(title, 10, kind === "model" ? 42 : 14);
    const top = kind === "model" ? 52 : 26, pace = (h - top - 24) / data[kind].length;
    for (const v of [0, 50, 100]) {
      [g.strokeStyle, g.lineWidth, g.textAlign] = [css("--line"), 1, "center"];
      line(g, X(v), top, X(v), h - 22);
      g.fillText(v, X(v), h - 11);
    }
    data[kind].forEach((name, k) => {
      const y = top + (k + 0.5) * pace, c = cell({ [kind]: k }), chosen = k === ask[kind], ink = chosen ? blue() : css("--soft").trim();
      [g.textAlign, g.fillStyle] = ["right", chosen ? css("--ink") : css("--soft")];
      g.fillText(name, left - 10, y);
      if (c) {
        pen(g, fade(ink, 0.45), Math.min(9, 0.5 * pace));
        line(g, X(c[1]), y, X(c[2]), y);
        dot(g, [X(c[0]), y], Math.min(5.5, 0.36 * pace), ink);
      }
      g.textAlign = "left";
      g.fillText(said(c), X(100) + 12, y);
    });
    canvas.onclick = (e) => choose(kind, Math.floor((e.offsetY - top) / pace));
    canvas.style.cursor = "pointer";
    describe(canvas, `${title}: ${data[kind].map((name, k) => `${name} ${said(cell({ [kind]: k }))}`).join("; ")}`);
  }
  function drawSteps() { // what is asked over the horizons; dashed the two that need no training
    const ahead = data.horizon.flatMap((step, h) => (step === "mean" ? [] : [[+step, h]])), last = ahead[ahead.length - 1][0];
    const [g, X, Y, box] = axes(steps, last, 104, `${data.model[ask.model]} by horizon; dashed ${data.marks.slice(1).map((k) => data.model[k]).join(" and ")} (%)`, "frames ahead", [0, 50, 100], ahead.map(([t]) => t));
    const line_of = (model, k) => ahead.flatMap(([t, h]) => ((c) => (c ? [[X(t), Y(c[k])]] : []))(cell({ model, horizon: h })));
    for (const k of data.marks.slice(1)) trace(g, line_of(k, 0), css("--soft"), 1.6, { dash: [5, 4] });
    trace(g, [...line_of(ask.model, 1), ...line_of(ask.model, 2).reverse()], null, 0, { fill: fade(blue(), 0.25) });
    trace(g, line_of(ask.model, 0), blue(), 2.5);
    line_of(ask.model, 0).forEach((p) => dot(g, p, 4, blue()));
    if (data.horizon[ask.horizon] !== "mean") {
      pen(g, css("--ink"), 1.2);
      line(g, X(+data.horizon[ask.horizon]), box.y, X(+data.horizon[ask.horizon]), box.y + box.h, [3, 3]);
    }
    describe(steps, `${data.model[ask.model]} by horizon: ${ahead.map(([t, h]) => `t+${t} ${said(cell({ horizon: h }))}`).join("; ")}`);
  }
  function draw() {
    const n = count(), text = `${data.model[ask.model]}, ${data.garment[ask.garment]}, ${horizon(ask.horizon)}, ${data.measure[ask.measure]}: ${said(cell())}` + (n === NONE ? "" : ` \u00b7 ${n} windows`);
    rows(scene, "model", `${data.measure[ask.measure]}: shares (%)`);
    rows(where, "garment", `${data.model[ask.model]} by garment, ${horizon(ask.horizon)} (%)`);
    drawSteps();
    $("status").textContent = text;
    for (const kind of kinds) $(kind).value = ask[kind];
    $("horizon").setAttribute("aria-valuetext", horizon(ask.horizon));
    describe(scene, `${text}. Click a row, or use the arrow keys: up and down for the predictor, left and right for the horizon.`);
  }
  const later = lazily(draw), by = (kind, step) => () => choose(kind, ask[kind] + step);
  function reset() {
    Object.assign(ask, { condition: 0, garment: 0, measure: 0, model: data.marks[0], horizon: data.horizon.length - 1 });
    later();
  }
  for (const kind of kinds) {
    if (kind !== "horizon") $(kind).append(...data[kind].map((name, k) => new Option(name, k)));
    $(kind).oninput = (e) => choose(kind, +e.target.value);
  }
  $("horizon").max = data.horizon.length - 1;
  keys(scene, () => ({ ArrowUp: by("model", -1), ArrowDown: by("model", 1), ArrowLeft: by("horizon", -1), ArrowRight: by("horizon", 1), Escape: reset }));
  onReset(reset);
  reset();
  watch(later);
})();
