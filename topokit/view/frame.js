// What the moving figures share: the page's theme, canvases, charts, the play button, and a height that fits.
"use strict";
const $ = (id) => document.getElementById(id);
const data = JSON.parse($("data").textContent);

// ---- theme ---------------------------------------------------------------------------------------------------
let dark = false;
function theme() {
  dark = matchMedia("(prefers-color-scheme: dark)").matches;
  try { // the page around the frame knows better; a page of another origin does not let us ask
    const root = parent.document.documentElement.dataset.theme, lab = parent.document.body.dataset.jpThemeLight;
    if (parent !== window && (root || lab)) dark = root ? root === "dark" : lab === "false";
  } catch { /* keep the system's */ }
  document.documentElement.classList.toggle("dark", dark);
}
const css = (name) => getComputedStyle(document.documentElement).getPropertyValue(name);
const blue = () => (dark ? "#56b4e9" : "#0072b2");
const paint = (k) => data.palette[k % data.palette.length];
const fade = (hex, alpha) => hex + Math.round(alpha * 255).toString(16).padStart(2, "0");

// ---- drawing -------------------------------------------------------------------------------------------------
function start(canvas) { // a cleared context in CSS pixels, whatever the screen's density
  const ratio = devicePixelRatio || 1, w = canvas.clientWidth, h = canvas.clientHeight, g = canvas.getContext("2d");
  canvas.width = Math.round(w * ratio);
  canvas.height = Math.round(h * ratio);
  g.scale(ratio, ratio);
  g.font = getComputedStyle(document.body).font;
  g.lineCap = g.lineJoin = "round";
  return [g, w, h];
}
function line(g, x, y, u, v, dash = []) {
  g.setLineDash(dash);
  g.beginPath();
  g.moveTo(x, y);
  g.lineTo(u, v);
  g.stroke();
  g.setLineDash([]);
}
function pen(g, style, width) {
  [g.strokeStyle, g.lineWidth] = [style, width];
}
function word(g, text, x, y) { // on a rim of the ground, so that no line strikes it through
  pen(g, css("--panel"), 4);
  g.strokeText(text, x, y);
  g.fillText(text, x, y);
}
function ticks(high) {
  const rough = high / 5, ten = 10 ** Math.floor(Math.log10(rough));
  const step = [1, 2, 5, 10].map((m) => m * ten).find((s) => s >= rough);
  return Array.from({ length: Math.floor(high / step + 1e-9) + 1 }, (_, k) => +(k * step).toPrecision(6));
}
function axes(canvas, highX, highY, title, unitX, marks = ticks(highY), marksX = ticks(highX)) {
  const [g, w, h] = start(canvas), box = (canvas.box = { x: 44, y: 28, w: w - 58, h: h - 64 });
  const X = (v) => box.x + (v / highX) * box.w, Y = (v) => box.y + box.h - (v / highY) * box.h;
  g.fillStyle = css("--soft");
  g.strokeStyle = css("--line");
  g.lineWidth = 1;
  g.textBaseline = "middle";
  g.fillText(title, 10, 14, w - 20);
  for (const v of marksX) {
    g.textAlign = "center";
    g.fillText(v, X(v), box.y + box.h + 12);
  }
  g.textAlign = "right";
  g.fillText(unitX, box.x + box.w, box.y + box.h + 27);
  for (const v of marks) {
    g.fillText(v, box.x - 6, Y(v));
    line(g, X(0), Y(v), X(highX), Y(v));
  }
  g.textAlign = "left";
  return [g, X, Y, box];
}

// ---- time ----------------------------------------------------------------------------------------------------
function lazily(draw) { // at most one drawing a frame of the screen
  let queued = false;
  return () => {
    if (!queued) requestAnimationFrame(() => ((queued = false), draw()));
    queued = true;
  };
}
const svg = (path) => `<svg viewBox="0 0 10 10" aria-hidden="true">${path}</svg>`;
function playback(at, go, end, seconds) { // the button plays at() from where it is, or from 0, to end() by calling go
  let playing = false, runs = 0;
  const play = (on = !playing) => {
    const began = performance.now(), from = on && at() < end() ? at() : 0, mine = ++runs;
    playing = on;
    $("icon").setAttribute("d", on ? "M1 0h3v10h-3zM6 0h3v10h-3z" : "M1.5 0 9.5 5 1.5 10z");
    describe($("play"), on ? "pause" : "play");
    $("status").setAttribute("aria-live", on ? "off" : "polite"); // it would speak at every step
    const step = (now) => {
      if (runs !== mine) return; // paused or started anew
      go(from + (Math.max(0, now - began) / seconds / 1000) * end());
      if (at() >= end()) {
        play(false);
        if (data.film) setTimeout((last) => runs === last && play(true), 1500, runs); // again, until a hand stops it
      } else requestAnimationFrame(step);
    };
    if (on) requestAnimationFrame(step);
  };
  $("play").innerHTML = svg('<path id="icon"/>');
  $("play").onclick = () => play();
  play(false);
  return play;
}
function stepped(slider, steps, set, seconds = 6) { // a slider of whole steps, 0 to steps(), and its play button: each calls set(step)
  let played = 0; // where the play button is: not rounded, or it would stand still
  const go = (k) => {
    played = clamp(k, 0, steps());
    set(Math.ceil(played)); // the first step at once
  };
  const play = playback(() => played, go, steps, seconds);
  slider.oninput = (e) => (play(false), go(+e.target.value));
  return [go, play];
}

// ---- words -----------------------------------------------------------------------------------------------------
function describe(element, text) { // to those who hear the page
  element.setAttribute("aria-label", text);
}
function tell(text, slider, value) { // what the figure shows, below it and on its slider
  $("status").textContent = text;
  slider.value = value;
  slider.setAttribute("aria-valuetext", text);
}

// ---- hands ---------------------------------------------------------------------------------------------------
function clamp(value, low, high) {
  return Math.max(low, Math.min(high, value));
}
function keys(canvas, actions) { // actions() is what every key does now
  canvas.onkeydown = (e) => {
    const act = actions()[e.key];
    if (act) (e.preventDefault(), act());
  };
}
function scrub(canvas, go) { // go to a share of a chart's width
  canvas.onpointerdown = canvas.onpointermove = (e) => {
    if (!e.buttons) return;
    canvas.setPointerCapture(e.pointerId);
    go((e.offsetX - canvas.box.x) / canvas.box.w);
  };
}
function fullScreen() { // where the browser and the page around allow it
  if (!document.fullscreenEnabled) return;
  const button = Object.assign(document.createElement("button"), { type: "button", title: "full screen", id: "full" });
  button.innerHTML = svg('<path d="M0 0h4v1.5H1.5V4H0zM6 0h4v4H8.5V1.5H6zM0 6h1.5v2.5H4V10H0zM8.5 6H10v4H6V8.5h2.5z"/>');
  describe(button, "full screen");
  button.onclick = () => (document.fullscreenElement ? document.exitFullscreen() : document.documentElement.requestFullscreen());
  document.onfullscreenchange = () => button.setAttribute("aria-pressed", !!document.fullscreenElement);
  button.setAttribute("aria-pressed", false);
  $("status").before(button);
}
function explain() { // a button that shows what to try, and what a screen reader reads: the keys, and what can be dragged
  const button = Object.assign(document.createElement("button"), { type: "button", textContent: "?", title: "what to try, and how", id: "help" });
  const show = (on) => {
    button.setAttribute("aria-expanded", on);
    $("keys").hidden = !on;
    const hands = $("scene").getAttribute("aria-label").replace(/^.*?\. (?=Drag|Click)/, "");
    $("keys").textContent = `Try this: ${document.querySelector("nav").dataset.try}\n${hands}`;
  };
  describe(button, "what to try, and how");
  button.setAttribute("aria-controls", "keys");
  button.onclick = () => show($("keys").hidden);
  button.onkeydown = (e) => { // not an arrow that returns false: it would swallow the Tab key
    if (e.key === "Escape") show(false);
  };
  show(false);
  $("status").before(button);
}
function onReset(reset) {
  $("reset").innerHTML = svg('<path d="M5 1.2a3.9 3.9 0 1 1-3.8 4.9l1.3-.3A2.6 2.6 0 1 0 5 2.5v1.6L1.7 1.9 5-.4z"/>');
  $("reset").onclick = reset;
}

// ---- the page around -----------------------------------------------------------------------------------------
function watch(draw, resized = () => {}) { // redraw when the theme or the size changes
  const repaint = () => (theme(), draw());
  const layout = () => {
    try { // stacked on a narrow page, the figure needs more height than it was given
      if (frameElement) frameElement.style.height = innerWidth < 640 ? document.querySelector("main").offsetHeight + "px" : data.height + "px";
    } catch { /* the page around us is of another origin */ }
    resized();
    draw();
  };
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", repaint);
  try {
    const observer = new MutationObserver(repaint), what = { attributes: true, attributeFilter: ["data-theme", "data-jp-theme-light"] };
    if (parent !== window) [parent.document.documentElement, parent.document.body].forEach((node) => observer.observe(node, what));
  } catch { /* another origin */ }
  new ResizeObserver(layout).observe(document.body);
  document.querySelector("figcaption").textContent = data.title;
  theme();
  layout();
  requestAnimationFrame(() => (fullScreen(), explain())); // once the first drawing has said what can be done
}
