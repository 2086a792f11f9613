// Garments to be turned, one at a time: their cloth, and their true loops around their openings.
(() => {
  const scene = $("scene"), menu = $("garment"), later = lazily(draw), eye = orbit(scene, data.view, later, { n: () => step(1), p: () => step(-1) });
  let garment, a, body;
  function choose(k) {
    garment = data.garments[k];
    a = { points: unpack(garment.points), faces: unpack(garment.faces), line: [] };
    body = cloth(garment, a, eye);
    menu.selectedIndex = k;
    later();
  }
  const step = (by) => choose((menu.selectedIndex + by + menu.length) % menu.length);
  function draw() {
    const [g, w, h] = start(scene), { items, S, place } = body.draw(g, w, h, 0), at = (v) => S.subarray(2 * v, 2 * v + 2);
    const loops = $("loops").checked ? garment.truth : [];
    loops.forEach((loop, c) => loop.forEach((v, n) => { // a part behind the cloth is hidden by it
      const [p, q] = [v, loop[(n + 1) % loop.length]], depth = (place(a.points, 3 * p)[2] + place(a.points, 3 * q)[2]) / 2;
      items.push([depth + 0.03 * garment.radius, () => trace(g, [at(p), at(q)], paint(c), 4)]);
    }));
    items.sort((p, q) => p[0] - q[0]).forEach((item) => item[1]());
    loops.forEach((loop, c) => trace(g, loop.map(at), fade(paint(c), 0.5), 1.5, { close: true, dash: [3, 4] })); // but its way shows
    const many = garment.truth.length, text = `${garment.name} \u00b7 ${a.points.length / 3} vertices \u00b7 ${many} opening${many === 1 ? "" : "s"}`;
    $("status").textContent = text;
    describe(scene, `${text}. ${TURN}; n and p change the garment.`);
  }
  menu.append(...data.garments.map(({ name }) => new Option(name)));
  menu.onchange = () => choose(menu.selectedIndex);
  $("loops").onchange = later;
  onReset(eye.back);
  choose(0);
  watch(later, () => body.refit());
})();
