// A strip of names that the reader repaints, a row for each true loop, and the scores of these names.
// Idea: each name is in a frame at most once. To paint a name that another row has in that frame exchanges the two.
function framesOf(rows, similarity) { // rows of names, the last one for detections that are no loop; "" where there is none
  const loops = rows.length - 1, objects = Array.from({ length: loops }, (_, k) => k);
  return rows[0].map((_, t) => {
    const found = rows.map((names, row) => ({ id: names[t], row })).filter(({ id }) => id);
    return { objects, ids: found.map(({ id }) => id), similarity: objects.map((k) => found.map(({ row }) => (row === k ? similarity : 0))) };
  });
}
function painted(rows, row, t, name) { // the rows with a name there
  const copy = rows.map((names) => [...names]), other = name ? rows.findIndex((names) => names[t] === name) : -1;
  if (other >= 0) copy[other][t] = copy[row][t];
  copy[row][t] = name;
  return copy;
}

if (typeof data !== "undefined") (() => {
  const [scene, table, bars] = [$("scene"), $("table"), $("bars")], NAMES = ["a", "b", "c", "d", "e", "f"], BRUSHES = [...NAMES, ""];
  const titles = Object.keys(data.films), ink = (name) => paint(NAMES.indexOf(name)), said = (name) => name || "none";
  let rows, first, brush, similarity, cell, painting = null;

  // ---- places: a line of brushes, then the rows of the strip ---------------------------------------------------
  function layout() {
    const w = scene.clientWidth, h = scene.clientHeight, frames = rows[0].length, left = w < 520 ? 60 : 70;
    const pace = (w - left - 12) / frames, top = 72, high = Math.min(46, (h - top - 24) / rows.length);
    return { left, top, pace, high, frames };
  }
  function cellAt(x, y) {
    const { left, top, pace, high, frames } = layout(), t = Math.floor((x - left) / pace), row = Math.floor((y - top) / high);
    return t >= 0 && t < frames && row >= 0 && row < rows.length ? [row, t] : null;
  }
  const brushPlace = (k) => [layout().left + 14 + 32 * k, 40];
  const brushAt = (x, y) => BRUSHES.findIndex((_, k) => Math.hypot(x - brushPlace(k)[0], y - brushPlace(k)[1]) < 15);

  // ---- pictures ------------------------------------------------------------------------------------------------
  function tile(g, x, y, wide, high, name) {
    g.fillStyle = name ? ink(name) : css("--ground");
    g.fillRect(x + 1, y + 2, Math.max(1, wide - 2), high - 4);
    if (wide < 9) return;
    [g.fillStyle, g.font, g.textAlign] = [name ? "#ffffff" : css("--soft"), "600 " + getComputedStyle(document.body).font, "center"];
    if (name) {
      pen(g, "#00000099", 2.5);
      g.strokeText(name, x + wide / 2, y + high / 2);
    }
    g.fillText(name || "\u00b7", x + wide / 2, y + high / 2);
  }
  function drawScene(score) {
    const [g] = start(scene), { left, top, pace, high, frames } = layout();
    g.textBaseline = "middle";
    g.fillStyle = css("--soft");
    g.fillText("paint", 10, 40);
    BRUSHES.forEach((name, k) => {
      const [x, y] = brushPlace(k), chosen = name === brush;
      tile(g, x - 12, y - 13, 24, 26, name);
      pen(g, css(chosen ? "--ink" : "--line"), chosen ? 2.5 : 1);
      g.strokeRect(x - 12, y - 12, 24, 24);
    });
    rows.forEach((names, row) => {
      [g.textAlign, g.fillStyle, g.font] = ["left", css("--soft"), getComputedStyle(document.body).font];
      g.fillText(row < rows.length - 1 ? `loop ${row + 1}` : "no loop", 10, top + (row + 0.5) * high);
      names.forEach((name, t) => tile(g, left + t * pace, top + row * high, pace, high, name));
    });
    score.events.forEach((found, t) => found.filter(([, , other]) => other).forEach(([row]) => { // a mark at each switch
      pen(g, css("--ink"), 2.5);
      line(g, left + t * pace, top + row * high, left + t * pace, top + (row + 1) * high);
      dot(g, [left + t * pace, top + row * high], 3.5, css("--ink"));
    }));
    if (cell) {
      pen(g, css("--accent"), 3);
      g.strokeRect(left + cell[1] * pace, top + cell[0] * high, pace, high);
    }
    [g.textAlign, g.fillStyle, g.font] = ["center", css("--soft"), getComputedStyle(document.body).font];
    for (let t = 0; t < frames; t += frames > 16 ? 5 : 2) g.fillText(t + 1, left + (t + 0.5) * pace, top + rows.length * high + 12);
  }
  function drawTable(score) { // in how many frames a loop had a name, and the pairs that IDF1 takes
    const [g, w, h] = start(table), loops = rows.length - 1, names = NAMES.filter((name) => score.ids.includes(name));
    const left = 66, top = 54, wide = Math.min(64, (w - left - 12) / Math.max(1, names.length)), high = Math.min(44, (h - top - 12) / loops);
    g.textBaseline = "middle";
    g.fillStyle = css("--soft");
    g.fillText("frames of a loop under a name; framed: kept by IDF1", 10, 14, w - 20);
    names.forEach((name, c) => tile(g, left + c * wide + wide / 2 - 12, 28, 24, 22, name));
    g.font = getComputedStyle(document.body).font;
    for (let r = 0; r < loops; r++) {
      [g.textAlign, g.fillStyle] = ["left", css("--soft")];
      g.fillText(`loop ${r + 1}`, 10, top + (r + 0.5) * high);
      names.forEach((name, c) => {
        const column = score.ids.indexOf(name), kept = score.pairs.some(([a, b]) => a === r && b === column);
        [g.textAlign, g.fillStyle] = ["center", css(kept ? "--ink" : "--soft")];
        g.fillText(score.together[r][column], left + (c + 0.5) * wide, top + (r + 0.5) * high);
        pen(g, kept ? blue() : css("--line"), kept ? 2.5 : 1);
        g.strokeRect(left + c * wide + 2, top + r * high + 2, wide - 4, high - 4);
      });
    }
    const text = score.pairs.map(([r, c]) => `loop ${r + 1} as ${score.ids[c]} in ${score.together[r][c]} frames`).join(", ");
    describe(table, `IDF1 keeps ${text || "nothing"}`);
  }
  const MEASURES = [["MOTA", "mota"], ["IDF1", "idf1"], ["HOTA", "hota"], ["DetA", "deta"], ["AssA", "assa"]];
  function drawBars(score) {
    const [g, w, h] = start(bars), left = 58, wide = w - left - 54, high = (h - 44) / MEASURES.length, X = (v) => left + clamp(v, 0, 1) * wide;
    g.textBaseline = "middle";
    g.fillStyle = css("--soft");
    g.fillText("scores; the line is the value at the start", 10, 14, w - 20);
    MEASURES.forEach(([name, key], k) => {
      const y = 32 + (k + 0.5) * high;
      [g.textAlign, g.fillStyle] = ["right", css("--ink")];
      g.fillText(name, left - 8, y);
      g.fillStyle = css("--line");
      g.fillRect(left, y - 0.32 * high, wide, 0.64 * high);
      g.fillStyle = k < 3 ? blue() : fade(blue(), 0.55);
      g.fillRect(left, y - 0.32 * high, X(score[key]) - left, 0.64 * high);
      pen(g, css("--ink"), 2);
      line(g, X(first[key]), y - 0.4 * high, X(first[key]), y + 0.4 * high);
      [g.textAlign, g.fillStyle] = ["left", css("--ink")];
      g.fillText(score[key].toFixed(2).replace("-", "\u2212"), left + wide + 8, y);
    });
    describe(bars, MEASURES.map(([name, key]) => `${name} ${score[key].toFixed(2)}, at the start ${first[key].toFixed(2)}`).join("; "));
  }
  function draw() {
    const score = scoreOf(framesOf(rows, similarity)), of = (n, word) => `${n} ${word}${n === 1 ? "" : /(s|ch)$/.test(word) ? "es" : "s"}`;
    drawScene(score);
    drawTable(score);
    drawBars(score);
    const text = `MOTA ${score.mota.toFixed(2)} \u00b7 IDF1 ${score.idf1.toFixed(2)} \u00b7 HOTA ${score.hota.toFixed(2)} \u00b7 ${of(score.switches, "switch")}, `
      + `${of(score.misses, "miss")}, ${of(score.extra, "false positive")} \u00b7 similarity ${similarity.toFixed(2)}`;
    const where = cell ? `${cell[0] < rows.length - 1 ? `loop ${cell[0] + 1}` : "no loop"}, frame ${cell[1] + 1}: ${said(rows[cell[0]][cell[1]])} \u00b7 ` : "";
    $("status").textContent = where + text.replace(/-(?=\d)/g, "\u2212");
    $("similarity").value = similarity;
    $("similarity").setAttribute("aria-valuetext", text);
    $("brush").value = brush;
    describe(scene, `${where}${text}. Drag over the strip to paint; or move with the arrow keys and paint with the space bar or a letter from a to f, `
      + "or Delete for none; n and p choose the name to paint; Escape puts the names back.");
  }
  const later = lazily(draw);

  // ---- hands ---------------------------------------------------------------------------------------------------
  function put([row, t], name = brush) {
    cell = [row, t];
    if (rows[row][t] !== name) rows = painted(rows, row, t, name);
    later();
  }
  function choose(name) {
    brush = name;
    later();
  }
  const other = (by) => () => choose(BRUSHES[(BRUSHES.indexOf(brush) + by + BRUSHES.length) % BRUSHES.length]);
  const step = (down, right) => () => {
    const [row, t] = cell || [0, 0];
    cell = cell ? [clamp(row + down, 0, rows.length - 1), clamp(t + right, 0, rows[0].length - 1)] : [0, 0];
    later();
  };
  scene.onpointerdown = (e) => {
    const k = brushAt(e.offsetX, e.offsetY), at = cellAt(e.offsetX, e.offsetY);
    if (k >= 0) choose(BRUSHES[k]);
    if (k >= 0 || !at) return;
    painting = at[0];
    scene.setPointerCapture(e.pointerId);
    put(at);
  };
  scene.onpointermove = (e) => { // along the row in which the drag began
    const { top, high } = layout(), at = painting === null ? null : cellAt(e.offsetX, top + (painting + 0.5) * high);
    if (at) put(at);
  };
  scene.onpointerup = scene.onpointercancel = () => (painting = null);
  const letters = Object.fromEntries(NAMES.map((name) => [name, () => put(cell || [0, 0], name)]));
  keys(scene, () => ({ ...letters, ArrowLeft: step(0, -1), ArrowRight: step(0, 1), ArrowUp: step(-1, 0), ArrowDown: step(1, 0),
    " ": () => put(cell || [0, 0]), Delete: () => put(cell || [0, 0], ""), Backspace: () => put(cell || [0, 0], ""), n: other(1), p: other(-1), Escape: reset }));
  function reset() {
    const names = data.films[$("film").value].map((row) => [...row].map((name) => (name === "-" ? "" : name)));
    rows = [...names, names[0].map(() => "")];
    [brush, similarity, cell] = ["b", 1, null];
    first = scoreOf(framesOf(rows, similarity));
    later();
  }
  $("film").append(...titles.map((title) => new Option(title)));
  $("film").hidden = titles.length < 2;
  $("film").onchange = reset;
  $("brush").append(...BRUSHES.map((name) => new Option(said(name), name)));
  $("brush").onchange = (e) => choose(e.target.value);
  $("similarity").oninput = (e) => ((similarity = +e.target.value), later());
  onReset(reset);
  reset();
  watch(later);
})();
