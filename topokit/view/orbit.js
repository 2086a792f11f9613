// What the figures in space share: packed arrays, and an eye that the hand turns: one finger turns, two zoom.
function unpack({ type, values, scale, low }) {
  const bytes = Uint8Array.from(atob(values), (c) => c.charCodeAt(0));
  const array = new { u1: Uint8Array, u2: Uint16Array, i4: Int32Array, f4: Float32Array }[type](bytes.buffer);
  return scale === undefined ? array : Float32Array.from(array, (v, i) => v * scale + low[i % 3]);
}
const TURN = "Drag or use the arrow keys to turn it, plus and minus or two fingers to zoom";
function orbit(canvas, [az, el], later, others = {}) {
  const cam = { az: (az * Math.PI) / 180, el: (el * Math.PI) / 180, zoom: 1 }, home = { ...cam };
  const turn = (dx, dy) => {
    cam.az -= dx;
    cam.el = clamp(cam.el + dy, -1.5, 1.5);
    later();
  };
  const zoom = (by) => ((cam.zoom = clamp(cam.zoom * by, 0.4, 8)), later());
  const fingers = new Map();
  canvas.classList.add("orbit");
  canvas.onpointerdown = (e) => (canvas.setPointerCapture(e.pointerId), fingers.set(e.pointerId, [e.offsetX, e.offsetY]));
  canvas.onpointerup = canvas.onpointercancel = (e) => fingers.delete(e.pointerId);
  canvas.onpointermove = (e) => {
    const last = fingers.get(e.pointerId), here = [e.offsetX, e.offsetY];
    if (!last) return;
    const [other] = [...fingers].filter(([id]) => id !== e.pointerId).map(([, place]) => place);
    const apart = (p) => Math.hypot(p[0] - other[0], p[1] - other[1]) || 1;
    if (other) zoom(apart(here) / apart(last));
    else turn((here[0] - last[0]) / 120, (here[1] - last[1]) / 120);
    fingers.set(e.pointerId, here);
  };
  canvas.addEventListener("wheel", (e) => { // only once the picture was clicked: a reader who scrolls by is left in peace
    if (document.activeElement !== canvas) return;
    e.preventDefault();
    zoom(Math.exp(-e.deltaY / 500));
  }, { passive: false });
  keys(canvas, () => ({ ArrowLeft: () => turn(0.1, 0), ArrowRight: () => turn(-0.1, 0), ArrowUp: () => turn(0, 0.1),
    ArrowDown: () => turn(0, -0.1), "+": () => zoom(1.15), "=": () => zoom(1.15), "-": () => zoom(0.87), ...others }));
  const back = () => (Object.assign(cam, home), later());
  canvas.ondblclick = back;
  const see = (centre) => { // from space to (right, up, towards the eye)
    const [sa, ca, se, ce] = [Math.sin(cam.az), Math.cos(cam.az), Math.sin(cam.el), Math.cos(cam.el)];
    return (p, i = 0, out = []) => {
      const x = p[i] - centre[0], y = p[i + 1] - centre[1], z = p[i + 2] - centre[2];
      out[0] = -sa * x + ca * y;
      out[1] = -se * (ca * x + sa * y) + ce * z;
      out[2] = ce * (ca * x + sa * y) + se * z;
      return out;
    };
  };
  return { cam, see, back };
}
