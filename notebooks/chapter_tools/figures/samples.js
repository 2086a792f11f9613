// Clouds that the page computes, the same at each visit. Coordinates are rounded to a ten thousandth, so they are the same in every browser.
function chances(seed) { // numbers spread evenly over 0..1 (the generator mulberry32)
  return () => {
    let t = (seed = (seed + 0x6d2b79f5) | 0);
    t = Math.imul(t ^ (t >>> 15), t | 1);
    t ^= t + Math.imul(t ^ (t >>> 7), t | 61);
    return ((t ^ (t >>> 14)) >>> 0) / 2 ** 32;
  };
}
function strewn(count, place) { // `count` places, each made of chances and of its share of the count
  const chance = chances(7), numbers = Array.from({ length: count }, (_, k) => place(chance, k / count)).flat();
  return Float64Array.from(numbers, (v) => Math.round(1e4 * v) / 1e4);
}
const turned = (turn, radius) => [radius * Math.cos(turn), radius * Math.sin(turn)];
const COMPUTED = {
  "a mug's handle": () => strewn(1200, (chance, part) => { // the wall, the bottom and the handle of a mug 9 cm high
    const turn = 2 * Math.PI * chance();
    if (part < 0.6) return [...turned(turn, 0.04), 0.09 * chance()];
    if (part < 0.75) return [...turned(turn, 0.04 * Math.sqrt(chance())), 0];
    const [along, up] = turned(Math.PI * (chance() - 0.5), 0.036), [out, side] = turned(turn, 0.004), share = 1 + out / 0.036;
    return [0.039 + 1.2 * along * share, side, 0.046 + up * share];
  }),
  "a trefoil": () => strewn(400, (chance, part) => {
    const turn = 2 * Math.PI * part, [x, y] = turned(2 * turn, 2 + Math.cos(3 * turn)), jitter = () => 0.2 * (chance() - 0.5);
    return [x + jitter(), y + jitter(), Math.sin(3 * turn) + jitter()];
  }),
  "a torus": () => strewn(1500, (chance) => {
    let tube = 2 * Math.PI * chance();
    while (chance() > (1 + 0.4 * Math.cos(tube)) / 1.4) tube = 2 * Math.PI * chance(); // as many points inside as outside, by area
    const [out, up] = turned(tube, 0.4);
    return [...turned(2 * Math.PI * chance(), 1 + out), up];
  }),
  "noise without a loop": () => strewn(600, (chance) => {
    let place = [1, 1, 1];
    while (Math.hypot(...place) > 1) place = place.map(() => 2 * chance() - 1);
    return place;
  }),
};
