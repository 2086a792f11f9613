// The evidence of a frame and the belief along a film, as topokit.SeqPH has them, with other thresholds too.
//
//   evidenceOf(significance, threshold = 1) -> log-odds that the bar is a loop, by its frame alone
//   beliefsOf(significances, { threshold, kept }) -> log-odds with the frames before, for one bar that is found in each frame
const WEAKEST = -2.5; // with less evidence a frame counts as one without the bar
const MISSED = -1; // evidence of a frame without the bar
const MEMORY = 40; // frames for which a missed bar is remembered
const evidenceOf = (significance, threshold = 1) => Math.min(Math.max(5 * Math.log(significance / threshold), -3), 2);

function beliefsOf(significances, { threshold = 1, kept = 0.9 } = {}) {
  let belief = 0;
  let missed = Infinity; // frames since the bar was found
  return significances.map((significance) => {
    const evidence = evidenceOf(significance, threshold);
    const found = evidence > WEAKEST;
    missed = found ? 0 : missed + 1;
    if (missed > MEMORY + 1) belief = 0;
    else belief = Math.max(kept * belief + (found ? evidence : MISSED), -8);
    return belief;
  });
}
