// The kernel in a worker, made from the source that is in the page already: this works from a plain folder too.
//
//   const worker = kernelWorker();
//   worker.run(name, given, onProgress) -> Promise      name: persistence, cycle, track, evidence or farthestPoints; given: its arguments
//   worker.stop()                                       ends all runs; their promises reject with Error("stopped")
// Where there can be no worker, the page itself computes.
function kernelCalls(more = []) {
  const rips = ripsKernel();
  return Object.assign({ ...rips, ...seqphKernel(rips, assign), farthestPoints }, ...more.map((part) => part()));
}

function withReports(name, given, onProgress) { // the arguments, with `onProgress` among the options, which come last
  const options = { persistence: 3, track: 2, readFilm: 1 }[name];
  if (options === undefined) return given;
  return Object.assign([...given], { [options]: { ...given[options], onProgress } });
}

function kernelWorker(more = []) { // more: functions without arguments that return further calls by name
  const parts = [axesOf, subcloud, squaresTo, farthestPoints, nearestOthers, nearestAmong, ripsKernel, assign, seqphKernel, kernelCalls, withReports, ...more];
  const answering = `const calls = kernelCalls([${more.map((part) => part.name)}]);
    onmessage = async ({ data: { number, name, given } }) => {
      try {
        const onProgress = (share) => postMessage({ number, share });
        postMessage({ number, result: await calls[name](...withReports(name, given, onProgress)) });
      } catch (error) {
        postMessage({ number, error: error.message });
      }
    };`;
  const runs = new Map();
  let worker = null;
  let number = 0;

  function start() {
    const address = URL.createObjectURL(new Blob([parts.join("\n"), "\n", answering], { type: "text/javascript" }));
    worker = new Worker(address);
    worker.onerror = ({ message }) => fail(message);
    worker.onmessage = ({ data }) => {
      const run = runs.get(data.number);
      if (data.share !== undefined) return run.onProgress?.(data.share);
      runs.delete(data.number);
      if (data.error !== undefined) run.reject(new Error(data.error));
      else run.resolve(data.result);
    };
  }

  function run(name, given, onProgress) {
    try {
      if (!worker) start();
    } catch {
      return new Promise((resolve) => resolve(kernelCalls(more)[name](...withReports(name, given, onProgress))));
    }
    return new Promise((resolve, reject) => {
      runs.set(++number, { resolve, reject, onProgress });
      worker.postMessage({ number, name, given });
    });
  }

  function fail(message) {
    worker?.terminate();
    worker = null;
    for (const { reject } of runs.values()) reject(new Error(message));
    runs.clear();
  }

  return { run, stop: () => fail("stopped") };
}
