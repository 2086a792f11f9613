// An apron in the reader's hands: it is simulated in the page (cloth.js), and its loops are found, named and linked with the hook.
// Idea: the page moves the cloth and draws it. A worker gets a cloud of it whenever it is free, and returns the loops with their names
// and cycles. A cycle is a list of vertices, so it moves on with the cloth until the next answer comes.
(() => {
  const [scene, strip] = [$("scene"), $("strip")];
  const [rest, faces, began, actions, pybullet] = ["rest", "faces", "began", "actions", "neckThen"].map((name) => unpack(data.arrays[name]));
  const later = lazily(draw);
  const eye = orbit(scene, data.view, later);
  const body = clothBody({ rest, faces, rods: data.rods });
  const picture = cloth({ ...data.cloth, frames: 1 }, { points: body.points, faces, line: data.box.flat() }, eye);
  const worker = kernelWorker([liveCalls]);
  const WINDOW = 12; // seconds that the strip shows
  const SLIP = 0.12; // metres between hand and vertex at which the hand slips off
  const TAKE = 0.08; // metres within which a hand takes the nearest vertex
  const BOTH = 2;
  const MOST = 3000; // clouds that are kept
  let goals, chosen, frames, freed, looks, clouds, script, note, run;
  let [awake, calm, busy, last, debt] = [false, 0, false, 0, 0];

  // ---- what the cloth does ---------------------------------------------------------------------------------------
  const at = (points, v) => [points[3 * v], points[3 * v + 1], points[3 * v + 2]];
  const places = (points, ids) => Array.from(ids, (v) => at(points, v));
  const middle = (list) => [0, 1, 2].map((k) => list.reduce((sum, p) => sum + p[k], 0) / list.length);
  const linkOf = (curve) => Math.abs(Math.round(linkingSum(curve, data.line)));
  const holds = () => body.hands.some(({ vertex }) => vertex >= 0);
  const neck = () => places(body.points, data.neck);
  const time = () => frames * FRAME;

  function begin(shift) { // hang between the hands again, moved sideways
    body.place(began.map((v, i) => v + (i % 3 ? 0 : shift)));
    data.grips.forEach((vertex, h) => body.hold(h, vertex, at(body.points, vertex)));
    goals = body.hands.map((hand) => [...hand.at]);
    for (let k = 0; k < 60; k++) body.frame(goals); // it comes to rest
    [chosen, frames, freed, looks, clouds, script, note, run] = [BOTH, 0, 0, [], [], false, "", (run ?? 0) + 1];
    wake();
  }

  function scripted() { // the grippers of the recorded film; two frames of ours are one of its
    const t = frames / 2, T = data.held.length, k = Math.min(Math.floor(t), T - 1), next = Math.min(k + 1, T - 1), share = t - Math.floor(t);
    goals = [0, 1].map((h) => along(at(actions, 2 * k + h), at(actions, 2 * next + h), share));
    if (!data.held[k] && holds()) [0, 1].forEach(drop);
    if (t >= T) script = false;
  }

  function advance() {
    if (script) scripted();
    body.frame(goals);
    frames += 1;
    body.hands.forEach(({ vertex, at: hand }, h) => {
      if (vertex < 0 || Math.hypot(...minus(hand, at(body.points, vertex))) < SLIP) return;
      drop(h);
      note = `The ${["right", "left"][h]} hand slipped off: it pulled with more than the 6 newtons that it has. `;
    });
    calm = body.speed() < 0.03 && !script && body.hands.every((hand, h) => Math.hypot(...minus(hand.at, goals[h])) < 1e-4) ? calm + 1 : 0;
    if (holds()) freed = frames;
    if (calm > 40 || frames - freed > 1200) awake = false;
  }

  function tick(now) {
    if (!awake) return draw();
    debt = Math.min(debt + (now - last) / 1000, 3 * FRAME); // a slow machine shows it slower
    last = now;
    while (debt >= FRAME) {
      debt -= FRAME;
      advance();
    }
    if (!busy) look();
    draw();
    requestAnimationFrame(tick);
  }

  function wake() {
    [calm, freed] = [0, Math.max(freed, frames - 300)];
    if (awake) return;
    awake = true;
    [last, debt] = [performance.now(), 0];
    requestAnimationFrame(tick);
  }

  // ---- what the tracker sees ---------------------------------------------------------------------------------------
  function visible() { // vertices that no triangle hides from the eye
    const S = picture.draw(scene.getContext("2d"), scene.clientWidth, scene.clientHeight, 0), n = body.points.length / 3;
    const seen = Array.from({ length: n }, (_, v) => S.place(body.points, 3 * v));
    const kept = new Uint8Array(n).fill(1);
    for (let f = 0; f < faces.length; f += 3) {
      const [p, q, r] = [0, 1, 2].map((k) => seen[faces[f + k]]);
      const [left, right] = [Math.min(p[0], q[0], r[0]), Math.max(p[0], q[0], r[0])];
      const twice = (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]);
      for (let v = 0; v < n; v++) {
        const s = seen[v];
        if (s[0] <= left || s[0] >= right || !kept[v]) continue;
        const a = ((q[0] - s[0]) * (r[1] - s[1]) - (q[1] - s[1]) * (r[0] - s[0])) / twice;
        const b = ((r[0] - s[0]) * (p[1] - s[1]) - (r[1] - s[1]) * (p[0] - s[0])) / twice;
        if (a > 0 && b > 0 && a + b < 1 && a * p[2] + b * q[2] + (1 - a - b) * r[2] > s[2] + 0.015) kept[v] = 0;
      }
    }
    return [...kept.keys()].filter((v) => kept[v]);
  }

  async function look() {
    const all = $("look").value !== "camera", mine = run, when = time();
    const ids = all ? [...Array(body.points.length / 3).keys()] : visible();
    const points = subcloud(body.points, 3, ids), truth = linkOf(neck());
    busy = true;
    const { ids: sample, cloud, loops } = await worker.run("follow", [points, +$("count").value, !looks.length]);
    busy = false;
    if (mine !== run) return wake();
    const named = (list) => list.map((row) => ids[row]);
    for (const loop of loops) {
      loop.link = linkOf(places(points, loop.cycle));
      [loop.edge, loop.cycle, loop.triangles] = [named(loop.edge), named(loop.cycle), loop.triangles.map(named)];
    }
    looks.push({ when, sample: named(sample), loops, truth, held: holds() });
    clouds.push(cloud);
    if (looks.length > MOST) [looks, clouds].forEach((list) => list.shift());
    if (!awake) later();
  }

  // ---- words ---------------------------------------------------------------------------------------------------------
  function seen() { // what the tracker says now
    const { loops, sample } = looks.at(-1), main = loops.find(({ id }) => id === 0);
    if (!main) return `Loop 0 is not found: its opening is closed, hidden, or too narrow for ${sample.length} points. `;
    return `Loop 0 ${main.link ? "goes around the hook" : "does not go around the hook"} (linking number ${main.link}), lifetime ${(1000 * main.life).toFixed(0)} mm. `;
  }

  function hung() { // what became of the apron
    const truth = linkOf(neck()), height = middle(neck())[2];
    if (holds()) return ["", "Bring the neck loop over the tip of the hook, lower it, and let go."];
    if (awake && calm < 20 && frames - freed < 300) return ["", "It falls into place."];
    if (truth && height > 0.6) return ["yes", "It hangs: the neck goes around the hook (linking number 1), so only a way over the tip takes it off."];
    if (truth) return ["no", "The neck is around the pole, but it slid down to the floor."];
    if (height > 0.6 && body.deepest() > -0.007) return ["no", "It lies on the hook, but the neck does not go around it: one pull takes it off."];
    return ["no", "It fell to the floor: the neck was not around the hook when you let go, so nothing held it."];
  }

  function verdict() {
    const [done, sentence] = hung(), lost = looks.filter(({ loops }) => !loops.some(({ id }) => id === 0)).length;
    if ($("goal").value === "hang") return sentence;
    if ($("goal").value === "few") {
      const why = lost ? "In those the opening was narrower than the gaps between points." : "The opening stayed wider than the gaps between points all the way.";
      return `${sentence} Loop 0 was lost in ${lost} of ${looks.length} frames. ${done === "yes" ? why : ""}`;
    }
    const wrong = looks.find(({ loops, truth }) => loops.some(({ id, link }) => id === 0 && link !== truth));
    const renamed = looks.find(({ loops }) => loops.length && !loops.some(({ id }) => id === 0));
    const gone = looks.findIndex((_, k) => k + 10 <= looks.length && looks.slice(k, k + 10).every(({ loops }) => !loops.length));
    const second = (look) => `at ${look.when.toFixed(1)} s`;
    if (renamed) return `You fooled it ${second(renamed)}: loop 0 is not found, and loop ${renamed.loops[0].id} is. The opening closed or moved too far, and a new name was given.`;
    if (wrong) return `You fooled it ${second(wrong)}: the cycle of loop 0 and the true neck differ in their linking numbers. The cycle does not run where the strap runs.`;
    if (gone >= 0) return `You fooled it ${second(looks[gone])}: it found no loop for ten frames. Close the opening, or hide it from the camera, and there is nothing to find.`;
    return "Not fooled yet: loop 0 is where the neck is. Fold the strap, shake it, take fewer points, or let it see one side only.";
  }

  function tellAll() {
    const off = script && frames / 2 < data.held.length;
    const apart = off ? Math.hypot(...minus(middle(neck()), at(pybullet, Math.floor(frames / 2)))) : 0;
    const text = `${looks.length ? seen() : ""}${note}\n${verdict()}${off ? `\nThe same moves in PyBullet: the middle of the neck is ${(1000 * apart).toFixed(0)} mm away.` : ""}`;
    $("status").setAttribute("aria-live", awake ? "off" : "polite");
    if ($("status").textContent !== text) $("status").textContent = text;
    $("release").textContent = holds() ? "let go" : "take hold";
    $("turn").value = ((((eye.cam.az * 180) / Math.PI + 180) % 360) + 360) % 360 - 180;
    describe(scene, `An apron and a hook. Drag a hand, or the dot above the hands, which moves both; drag beside them to turn the view. By keys: Tab chooses a hand or both, `
      + "the arrow keys move it, page up and page down move it away from you and towards you, space lets go or takes hold, plus and minus zoom.");
    describe(strip, `lifetimes of the loops over the last ${WINDOW} seconds, thick where the loop goes around the hook; now ${$("status").textContent}`);
  }

  // ---- drawing ---------------------------------------------------------------------------------------------------------
  let shown = null; // how the last drawing placed points

  function draw() {
    const [g, w, h] = start(scene);
    const { place, items, S } = picture.draw(g, w, h, 0), spots = (ids) => Array.from(ids, (v) => S.subarray(2 * v, 2 * v + 2));
    shown = place;
    if ($("look").value !== "cloth") items.length = 0;
    const thick = data.rods[0][2];
    for (const [a, b] of data.pieces) {
      const [p, q] = [place(a, 0), place(b, 0)].map((s) => [...s]);
      items.push([(p[2] + q[2]) / 2, () => trace(g, [p, q], dark ? "#7f8fa1" : "#4a5868", Math.max(2, 2 * thick * p[3]))]);
    }
    items.sort((p, q) => p[0] - q[0]).forEach((item) => item[1]());
    const now = looks.at(-1);
    if (now && $("look").value !== "cloth") for (const p of spots(now.sample)) dot(g, p, 2.4, css("--ink"));
    for (const loop of [...(now?.loops ?? [])].reverse()) {
      const ink = paint(loop.id);
      for (const ids of loop.triangles) trace(g, spots(ids), fade(ink, 0.9), 1.2, { close: true, fill: fade(ink, 0.35) });
      trace(g, spots(loop.cycle), css("--panel"), 6, { close: true });
      trace(g, spots(loop.cycle), ink, 3.2, { close: true, dash: loop.id ? [6, 5] : [] });
      const [x, y] = spots(loop.edge)[1];
      g.fillStyle = css("--ink");
      word(g, `loop ${loop.id}`, clamp(x + 26, 8, w - 50), y);
    }
    drawHands(g);
    drawStrip();
    tellAll();
  }

  function spotsOfHands() { // in the picture; the handle of both is above them, where a finger does not take one of them
    const spots = [...body.hands.map((hand) => hand.at), middle(body.hands.map((hand) => hand.at))].map((p) => [...shown(p, 0)]);
    spots[BOTH][1] -= 34;
    return spots;
  }

  function drawHands(g) {
    const spots = spotsOfHands();
    trace(g, [spots[0], spots[BOTH], spots[1]], css("--soft"), 1.5);
    spots.forEach((p, h) => {
      const full = h === BOTH || body.hands[h].vertex >= 0;
      const lit = chosen === h || chosen === BOTH;
      dot(g, p, h === BOTH ? 11 : 8, full ? css("--ink") : css("--panel"), lit ? css("--accent") : css("--ink"), lit ? 4 : 2);
    });
    g.textAlign = "center";
    g.textBaseline = "middle";
    g.fillStyle = css("--ink");
    word(g, ["right hand", "left hand", "both hands"][chosen], spots[chosen][0] + 56, spots[chosen][1]);
    g.textAlign = "left";
  }

  function drawStrip() {
    const end = Math.max(WINDOW, time()), from = end - WINDOW, recent = looks.filter(({ when }) => when >= from);
    const high = Math.max(60, ...recent.flatMap(({ loops }) => loops.map(({ life }) => 1100 * life)));
    const [g, X, Y] = axes(strip, WINDOW, high, "lifetime (mm); thick: around the hook", `${WINDOW} s`, [0, Math.round(high / 20) * 10], []);
    recent.forEach(({ when, loops }, k) => {
      const before = recent[k - 1];
      for (const { id, life, link } of loops) {
        const same = before?.loops.find((other) => other.id === id), here = [X(when - from), Y(1000 * life)];
        if (same) trace(g, [[X(before.when - from), Y(1000 * same.life)], here], paint(id), link ? 5 : 1.6);
        else dot(g, here, 2, paint(id));
      }
    });
  }

  // ---- hands -------------------------------------------------------------------------------------------------------------
  function drop(h) {
    body.hold(h, -1, body.hands[h].at);
  }

  function take(h) { // the nearest vertex, if there is one in reach
    const hand = body.hands[h].at, n = body.points.length / 3;
    let best = 0;
    const far = (v) => Math.hypot(...minus(at(body.points, v), hand));
    for (let v = 1; v < n; v++) if (far(v) < far(best)) best = v;
    if (far(best) < TAKE) body.hold(h, best, (goals[h] = at(body.points, best)));
  }

  const those = () => (chosen === BOTH ? [0, 1] : [chosen]);

  function release(hands) {
    script = false;
    note = "";
    const held = hands.some((h) => body.hands[h].vertex >= 0);
    hands.forEach(held ? drop : take);
    wake();
  }

  function carry(across, up, away = 0) { // metres along the axis of the room that runs most across the picture, upwards, and along the other
    script = false;
    const [sa, ca] = [Math.sin(eye.cam.az), Math.cos(eye.cam.az)];
    const by = Math.abs(ca) >= Math.abs(sa) ? [-Math.sign(ca) * away, Math.sign(ca) * across, up] : [-Math.sign(sa) * across, -Math.sign(sa) * away, up];
    for (const h of those()) goals[h] = goals[h].map((v, k) => clamp(v + by[k], ...data.reach[k]));
    wake();
  }

  function dragBy(right, up) { // so that the hand stays under the pointer
    const [sa, ca, se, ce] = [Math.sin(eye.cam.az), Math.cos(eye.cam.az), Math.sin(eye.cam.el), Math.max(0.3, Math.cos(eye.cam.el))];
    const [major, minor] = Math.abs(ca) >= Math.abs(sa) ? [Math.abs(ca), Math.sign(ca) * sa] : [Math.abs(sa), -Math.sign(sa) * ca];
    const across = right / major;
    carry(across, (up + across * se * minor) / ce);
  }

  const turning = { down: scene.onpointerdown, move: scene.onpointermove, up: scene.onpointerup, key: scene.onkeydown };
  let dragged = null;
  const under = (x, y, reach) => {
    const away = spotsOfHands().map((p) => Math.hypot(p[0] - x, p[1] - y)), best = away.indexOf(Math.min(...away));
    return away[best] < reach ? best : -1;
  };
  scene.addEventListener("touchstart", (e) => { // a finger on a hand drags it, a finger beside one scrolls the page
    const { left, top } = scene.getBoundingClientRect(), { clientX, clientY } = e.touches[0];
    if (under(clientX - left, clientY - top, 34) >= 0) e.preventDefault();
  }, { passive: false });
  scene.onpointerdown = (e) => {
    const h = under(e.offsetX, e.offsetY, e.pointerType === "mouse" ? 18 : 34);
    if (h < 0) return turning.down(e);
    scene.setPointerCapture(e.pointerId);
    chosen = h;
    dragged = { id: e.pointerId, x: e.offsetX, y: e.offsetY };
    later();
  };
  scene.onpointermove = (e) => {
    if (!dragged) {
      if (e.buttons && $("look").value === "camera") wake(); // it sees another side
      scene.style.cursor = under(e.offsetX, e.offsetY, 18) >= 0 ? "pointer" : "";
      return turning.move(e);
    }
    if (dragged.id !== e.pointerId) return;
    const metre = spotsOfHands()[chosen][3]; // pixels
    dragBy((e.offsetX - dragged.x) / metre, (dragged.y - e.offsetY) / metre);
    [dragged.x, dragged.y] = [e.offsetX, e.offsetY];
  };
  scene.onpointerup = scene.onpointercancel = (e) => (dragged ? (dragged = null) : turning.up(e));
  const STEP = 0.02;
  const ORDER = [BOTH, 0, 1];
  const moves = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1], PageUp: [0, 0, 1], PageDown: [0, 0, -1] };
  scene.onkeydown = (e) => {
    if (e.key === "Tab") { // through the hands, then on to the buttons
      const next = ORDER[ORDER.indexOf(chosen) + (e.shiftKey ? -1 : 1)];
      if (next === undefined) return;
      chosen = next;
      later();
    } else if (moves[e.key]) carry(...moves[e.key].map((v) => STEP * v));
    else if (e.key === " ") release(those());
    else return turning.key(e);
    e.preventDefault();
  };
  scene.onfocus = () => {
    if (!dragged) chosen = BOTH;
    later();
  };

  // ---- controls -------------------------------------------------------------------------------------------------------------
  const again = () => begin(-middle([0, 1].map((h) => at(actions, h)))[0]); // before the hook, not beside it
  $("again").onclick = again;
  $("script").onclick = () => {
    begin(0);
    script = true;
  };
  $("release").onclick = () => release([0, 1]);
  $("goal").onchange = later;
  $("look").onchange = wake;
  $("count").oninput = wake;
  $("turn").oninput = (e) => {
    eye.cam.az = (+e.target.value * Math.PI) / 180;
    wake();
  };
  $("stiffness").oninput = (e) => {
    const force = 100 * 20 ** (+e.target.value / 100);
    body.stiffen(force);
    e.target.setAttribute("aria-valuetext", `${force.toFixed(0)} newtons a metre`);
    wake();
  };
  $("save").onclick = () => {
    const most = Math.min(...clouds.map((cloud) => cloud.length / 3)); // farthest points come in one order
    save("hold.npy", pointsAsNpy({ sample: true, names: ["hold"], columns: 3 }, clouds.map((cloud) => cloud.subarray(0, 3 * most)), 0));
    note = `Saved ${clouds.length} clouds. In Python: import numpy as np, topokit as tk; states = tk.track(np.load("hold.npy")). In a shell: topokit track hold.npy`;
    later();
  };
  again();
  watch(later, picture.refit);
})();
