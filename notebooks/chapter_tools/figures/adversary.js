// An adversary of the longest-lived loop: it may move each point by at most epsilon, and pushes where birth and death are decided.
function leash(home, where, epsilon) { // as far towards a place as the disc around home allows
  const [dx, dy] = [where[0] - home[0], where[1] - home[1]], share = Math.min(1, epsilon / (Math.hypot(dx, dy) || 1));
  return [home[0] + share * dx, home[1] + share * dy];
}
function push(points, homes, loop, epsilon, rest) { // one round: the birth edge longer, the killer edge shorter; smaller steps when less rest is left
  const step = epsilon * (0.02 + 0.4 * rest), moved = points.map((p) => [...p]);
  for (const [[a, b], by] of [[loop.birthEdge, -step], [loop.killerEdge, step]]) {
    const way = [0, 1].map((k) => moved[b][k] - moved[a][k]), length = Math.hypot(...way) || 1;
    way.forEach((w, k) => {
      moved[a][k] += (by * w) / length;
      moved[b][k] -= (by * w) / length;
    });
  }
  return moved.map((p, v) => leash(homes[v], p, epsilon));
}
