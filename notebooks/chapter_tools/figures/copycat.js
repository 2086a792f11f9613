// A forecaster that copies the future of the nearest window, and what it may not copy: its own film near by, or its own garment.
function rankedOf(features, alive) { // of each window all others whose future is known, the nearest first
  const n = features.length;
  return features.map((p, i) => {
    const away = features.map((q) => p.reduce((sum, v, k) => sum + (v - q[k]) ** 2, 0));
    return Array.from({ length: n }, (_, j) => j).filter((j) => j !== i && alive[j]).sort((a, b) => away[a] - away[b] || a - b);
  });
}
function copyOf(i, ranked, { film, cut, frame }, gap, byCut) { // the window that is copied, -1 where there is none
  const far = (j) => film[j] !== film[i] || Math.abs(frame[j] - frame[i]) >= gap;
  return ranked[i].find((j) => far(j) && !(byCut && cut[j] === cut[i])) ?? -1;
}
function scoreOfCopies(ranked, windows, futures, alive, gap, byCut) { // the mean error, and the share of copies of the same film
  const asked = ranked.map((_, i) => i).filter((i) => alive[i]), pairs = asked.map((i) => [i, copyOf(i, ranked, windows, gap, byCut)]).filter(([, j]) => j >= 0);
  const off = pairs.map(([i, j]) => Math.hypot(...futures[i].map((v, k) => v - futures[j][k]))), mean = (values) => values.reduce((sum, v) => sum + v, 0) / values.length;
  return { error: mean(off), same: mean(pairs.map(([i, j]) => (windows.film[i] === windows.film[j] ? 1 : 0))) };
}
