// What the figures of a planar cloud that changes share: the picture's frame, its strokes, and points under the pointer.
function framing(points, margin) { // from the plane to the canvas and back; the frame stays when points move
  const low = [0, 1].map((k) => Math.min(...points.map((p) => p[k])) - margin);
  const size = [0, 1].map((k) => Math.max(...points.map((p) => p[k])) + margin - low[k]);
  return (w, h) => {
    const scale = Math.max(1e-6, Math.min((w - 32) / (size[0] || 1), (h - 56) / (size[1] || 1))); // a folded frame has no width
    const x = w / 2 - scale * (low[0] + size[0] / 2), y = h / 2 + 12 + scale * (low[1] + size[1] / 2);
    return { scale, to: (p) => [x + scale * p[0], y - scale * p[1]], back: (a, b) => [(a - x) / scale, (y - b) / scale] };
  };
}
function trace(g, places, style, width, { close = false, dash = [], fill = null } = {}) {
  g.setLineDash(dash);
  g.beginPath();
  places.forEach((p, k) => (k ? g.lineTo(...p) : g.moveTo(...p)));
  if (close) g.closePath();
  if (fill) (g.fillStyle = fill), g.fill();
  if (width) pen(g, style, width), g.stroke();
  g.setLineDash([]);
}
function dot(g, [x, y], radius, fill, stroke = null, width = 1) {
  g.beginPath();
  g.arc(x, y, radius, 0, 7);
  if (fill) (g.fillStyle = fill), g.fill();
  if (stroke) pen(g, stroke, width), g.stroke();
}
function disc(g, [x, y], radius) { // into a path of many
  g.moveTo(x + radius, y);
  g.arc(x, y, radius, 0, 7);
}
function nearest(points, to, x, y, reach) { // the point under the pointer, -1 for none
  const away = points.map((p) => Math.hypot(to(p)[0] - x, to(p)[1] - y)), best = away.indexOf(Math.min(...away));
  return away[best] < reach ? best : -1;
}
function balls(g, places, radius, tint, rim) { // one path, so that the union of the balls has one tint
  g.beginPath();
  for (const p of places) disc(g, p, radius);
  g.fillStyle = fade(blue(), tint);
  g.fill();
  for (const p of places) dot(g, p, radius, null, fade(blue(), rim));
}
function inside(canvas, x, y) { // where a point can be found again
  return [clamp(x, 8, canvas.clientWidth - 8), clamp(y, 8, canvas.clientHeight - 8)];
}
function walk(canvas, { count, chosen, choose, move, ...others }) { // n and p choose a point, the arrows move it
  keys(canvas, () => {
    const n = count(), v = chosen(), by = (dx, dy) => () => v >= 0 && move(v, dx, dy);
    return { n: () => choose((v + 1) % n), p: () => choose((Math.max(v, 0) + n - 1) % n),
      ArrowLeft: by(-1, 0), ArrowRight: by(1, 0), ArrowUp: by(0, -1), ArrowDown: by(0, 1), ...others };
  });
}
const KEYS = "choose one with the keys n and p and move it with the arrow keys; Escape puts the points back.";
function beside(canvas, frame, point, dx, dy) { // a place 4 pixels from a point
  const { to, back } = frame(canvas.clientWidth, canvas.clientHeight), [x, y] = to(point);
  return back(...inside(canvas, x + 4 * dx, y + 4 * dy));
}
function draggable(canvas, { points, frame, grab = () => false, press = () => {}, move, tap = () => {}, release = () => {}, miss = () => {}, all = false }) {
  // press(v), move(v, where, by), then release(v), or tap(v) when nothing moved; beside all points v is -1 if `all`, else miss()
  const here = () => frame(canvas.clientWidth, canvas.clientHeight);
  const find = (x, y, type) => { // what grab(where, scale) names, if it names something, goes before the points
    const { to, back, scale } = here();
    return grab(back(x, y), scale) || nearest(points(), to, x, y, type === "mouse" ? 14 : 24);
  };
  let held = null;
  canvas.addEventListener("touchstart", (e) => { // a finger on a point drags it, a finger beside one scrolls the page
    const { left, top } = canvas.getBoundingClientRect(), { clientX, clientY } = e.touches[0];
    if (find(clientX - left, clientY - top, "touch") >= 0) e.preventDefault();
  }, { passive: false });
  canvas.onpointerdown = (e) => {
    const v = find(e.offsetX, e.offsetY, e.pointerType);
    held = v >= 0 || (all && e.pointerType === "mouse") ? { v, x: e.offsetX, y: e.offsetY, moved: false } : null;
    if (!held) return miss();
    canvas.setPointerCapture(e.pointerId);
    press(v);
  };
  canvas.onpointermove = (e) => {
    if (!held) {
      canvas.style.cursor = find(e.offsetX, e.offsetY, "mouse") >= 0 ? "grab" : all ? "move" : "";
      return;
    }
    if (!held.moved && Math.hypot(e.offsetX - held.x, e.offsetY - held.y) < 4) return; // a trembling click
    held.moved = true;
    const { back } = here(), [a, b] = [back(held.x, held.y), back(...inside(canvas, e.offsetX, e.offsetY))];
    move(held.v, b, [b[0] - a[0], b[1] - a[1]]);
  };
  canvas.onpointerup = canvas.onpointercancel = () => {
    if (!held) return;
    const { v, moved } = held;
    held = null;
    if (moved) release(v);
    else tap(v);
  };
}
function hands(canvas, { points, frame, chosen, press, put, tap, release, miss, ...others }) { // a point is put where it is dragged or walked to
  draggable(canvas, { points, frame, press, move: put, tap, release, miss });
  walk(canvas, { count: () => points().length, chosen, choose: press, move: (v, dx, dy) => put(v, beside(canvas, frame, points()[v], dx, dy)), ...others });
}
function shapes(choose) { // one of the clouds that have names
  const select = $("shape"), names = Object.keys(data.shapes);
  select.append(...names.map((name) => new Option(name)));
  select.hidden = names.length < 2;
  select.onchange = () => choose(data.shapes[select.value]);
  select.onchange();
}
