// Calls of the worker for clouds that come one after another: their loops, with names and cycles; `kernelWorker` is in worker.js.
function liveCalls() { // a tracker that remembers the clouds before
  const rips = ripsKernel();
  let update = null;
  const follow = (points, count, anew) => { // the loops of a farthest-point sample, as rows of `points`
    if (anew) update = seqphKernel(rips, assign).tracker(3);
    const n = points.length / 3;
    const { ids } = farthestPoints(points, n, 3, Math.min(count, n));
    const cloud = subcloud(points, 3, ids);
    const { diagram, loops } = update(cloud);
    const rows = (list) => Array.from(list, (v) => ids[v]);
    const found = loops.map(({ id, bar }) => ({
      id,
      life: diagram.deaths[bar] - diagram.births[bar],
      edge: rows(diagram.killerEdges.subarray(2 * bar, 2 * bar + 2)),
      triangles: [0, 3].map((k) => rows(diagram.killerTriangles.subarray(6 * bar + k, 6 * bar + k + 3))),
      cycle: rows(rips.cycle(cloud, ids.length, 3, diagram, bar)),
    }));
    return { ids: rows(ids.keys()), cloud, loops: found };
  };
  return { follow };
}
