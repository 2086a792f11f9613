"""Compare seqPH with trackers that others wrote, on the same bars and places: book/results/linkers.json.

    pip install --group linkers
    python book/experiments/linkers.py --tuning DIR --episodes DIR --out book/results/linkers.json
    python book/experiments/linkers.py --page      # puts that file into book/benchmark.md

Question: a reader who has the bars of each frame and a place for each could link them over time with a well-known library. Does
seqPH keep identities better? The libraries get bars of topokit: those that live alpha or longer, and those that the evidence of
their own frame supports. Two libraries also get the loops that seqPH reports, without their identities, so that nothing but the
identities differs.
The options are those with the largest mean of HOTA and IDF1 on the films of `--tuning` (seeds 100 to 102), in one condition of
each kind. Then all films of `--episodes` are scored once with these options. seqPH was tuned on the same tuning films.

Films that are missing are simulated first; with `--made` the films that are there are enough. An interrupted run goes on.

Source: Allan et al., *trackpy*; Fukai and Kawaguchi 2023, *LapTrack*; Thomas et al. 2017, *Stone Soup*; Saul, Tralie, *persim*;
Soler et al. 2018, *Lifted Wasserstein matcher for fast and robust topology tracking*. Taught in chapter 8.
"""

import argparse
import json
import platform
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import datetime, timedelta
from functools import partial
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist
from tables import in_page, write_results
from tracking import pack, resumed, simulated, total, unpack, version, weights_of, with_intervals

import topokit as tk
from topokit.evaluate import compare, score, true_loops
from topokit.evaluate._scores import TrackingScore
from topokit.io import load_episode
from topokit.sampling import inliers

from _tracking_clouds import Clouds, conditions

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "book" / "results" / "linkers.json"
PAGE = ROOT / "book" / "benchmark.md"
TOGETHER = "all together"
SEEDS = {"tuning": range(100, 103), "episodes": range(3)}
PLACE = ["x", "y", "z"]
DROPPED = -1  # identity of a bar that a linker leaves out
DEFAULT = "seqPH"
PAPER = "seqPH, the paper's, alpha guessed"
OURS: dict[str, Callable[[], tk.SeqPH]] = {
    DEFAULT: tk.SeqPH,
    "seqPH, memory of 20 frames": partial(tk.SeqPH, memory=20),
    PAPER: tk.SeqPH.paper,
}
TUNED_IN = ("250 points", "noise of 10 mm", "a hand", "one camera")
REPORTED_BY = {"alpha": PAPER, "seqPH": DEFAULT}
"""The trackers whose loops are the bars by a rule. The paper's calls each bar that lives alpha or longer a loop."""
WITH = {
    "alpha": ("trackpy", "bottleneck", "Wasserstein", "lifted Wasserstein"),
    "evidence": (
        "trackpy",
        "LapTrack",
        "Stone Soup, nearest",
        "Stone Soup, JPDA",
        "bottleneck",
        "Wasserstein",
        "lifted Wasserstein",
    ),
    "seqPH": ("trackpy", "LapTrack"),
}
"""Which linkers get these bars. The slow ones get the better bars alone."""
TIMED = "500 points"  # the condition in which the time of a frame is measured


class Bars(NamedTuple):
    """The bars of one frame."""

    centre: NDArray[np.float64]  # (k, 3) metres
    start: NDArray[np.float64]  # (k, 3) middle of the edge that creates the bar, metres
    diagram: NDArray[np.float64]  # (k, 2) births and deaths, metres


Ids = list[NDArray[np.int64]]
Linker = Callable[[list[Bars]], Ids]


def linked(frames: list[Bars], link: Callable[[pd.DataFrame], pd.Series]) -> Ids:
    """Return identities by frames; `link` gets a row for each bar, and returns identities by rows."""
    counts = [len(bars.centre) for bars in frames]
    table = pd.DataFrame(np.concatenate([bars.centre for bars in frames]), columns=PLACE)
    table["frame"] = np.repeat(np.arange(len(frames)), counts)
    table["bar"] = table.index
    ids = np.full(len(table), DROPPED)
    if len(table):
        found = link(table)
        ids[found.index] = found
    return np.split(ids, np.cumsum(counts)[:-1])


def trackpy_link(frames: list[Bars], reach: float, memory: int) -> Ids:
    """Link by trackpy: the least total squared distance from frame to frame, within `reach` metres.

    Where too many bars compete, trackpy tries smaller reaches, down to 1 cm, and then refuses: the film is left without tracks.
    """
    import trackpy
    from trackpy.linking.utils import SubnetOversizeException

    trackpy.quiet()
    options = {"pos_columns": PLACE, "t_column": "frame", "adaptive_stop": 0.01, "adaptive_step": 0.7}

    def link(table: pd.DataFrame) -> pd.Series:
        try:
            found = trackpy.link(table, reach, memory=memory, **options)
        except SubnetOversizeException:
            found = pd.DataFrame({"bar": [], "particle": []}, dtype=int)
        return found.set_index("bar")["particle"]

    return linked(frames, link)


def laptrack_link(frames: list[Bars], reach: float, memory: int) -> Ids:
    """Link by LapTrack: assignments from frame to frame, then of ends to starts over at most `memory` frames."""
    from laptrack import LapTrack

    linker = LapTrack(
        cutoff=reach**2,
        gap_closing_cutoff=reach**2 if memory else False,
        gap_closing_max_frame_count=max(memory, 1),
    )

    def link(table: pd.DataFrame) -> pd.Series:
        found, _, _ = linker.predict_dataframe(table, PLACE, frame_col="frame", only_coordinate_cols=False)
        return found.set_index("bar")["track_id"]

    return linked(frames, link)


def stonesoup_link(
    frames: list[Bars], motion: float, noise: float, missed: float, memory: int, probabilistic: bool
) -> Ids:
    """Link by Stone Soup: Kalman filters of nearly constant velocity; global nearest neighbours or JPDA.

    `motion` is the diffusion of the velocity, `noise` the standard deviation of a place in metres. From `missed` standard
    deviations on a bar is rather another loop (with JPDA: the probability of the gate). A track ends after `memory` frames.
    """
    from stonesoup.dataassociator.neighbour import GNNWith2DAssignment
    from stonesoup.dataassociator.probability import JPDAwithEHM2
    from stonesoup.deleter.time import UpdateTimeStepsDeleter
    from stonesoup.hypothesiser.distance import DistanceHypothesiser
    from stonesoup.hypothesiser.probability import PDAHypothesiser
    from stonesoup.initiator.simple import SimpleMeasurementInitiator
    from stonesoup.measures import Mahalanobis
    from stonesoup.models.measurement.linear import LinearGaussian
    from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
    from stonesoup.predictor.kalman import KalmanPredictor
    from stonesoup.tracker.simple import MultiTargetMixtureTracker, MultiTargetTracker
    from stonesoup.types.detection import Detection
    from stonesoup.types.state import GaussianState
    from stonesoup.updater.kalman import KalmanUpdater

    model = LinearGaussian(6, (0, 2, 4), np.eye(3) * noise**2)
    predictor = KalmanPredictor(CombinedLinearGaussianTransitionModel([ConstantVelocity(motion)] * 3))
    updater = KalmanUpdater(model)
    if probabilistic:
        hypothesiser = PDAHypothesiser(predictor, updater, clutter_spatial_density=0.1, prob_gate=missed)
        associator = JPDAwithEHM2(hypothesiser)  # probabilities as JPDA has, without listing all joint hypotheses
        tracker_class = MultiTargetMixtureTracker
    else:
        hypothesiser = DistanceHypothesiser(predictor, updater, Mahalanobis(), missed_distance=missed)
        associator = GNNWith2DAssignment(hypothesiser)
        tracker_class = MultiTargetTracker
    prior = GaussianState(np.zeros(6), np.diag([0, 0.25] * 3))
    start = datetime(2000, 1, 1)
    ids = [np.full(len(bars.centre), DROPPED) for bars in frames]

    def detections() -> Iterator[tuple[datetime, set[Any]]]:
        for number, bars in enumerate(frames):
            when = start + timedelta(seconds=number / 10)
            found = {
                Detection(place[:, None], when, model, metadata={"bar": (number, i)})
                for i, place in enumerate(bars.centre)
            }
            yield when, found

    tracker = tracker_class(
        initiator=SimpleMeasurementInitiator(prior, model),
        deleter=UpdateTimeStepsDeleter(memory),
        detector=detections(),
        data_associator=associator,
        updater=updater,
    )
    numbers: dict[str, int] = {}
    for when, tracks in tracker:
        for track in tracks:
            bar = _bar_of(track.states[-1], when)
            if bar is not None:
                ids[bar[0]][bar[1]] = numbers.setdefault(track.id, len(numbers))
    return ids


def _bar_of(state: Any, when: datetime) -> tuple[int, int] | None:
    """Return the bar that most likely updated a track at a time, or nothing where no bar did."""
    hypothesis = getattr(state, "hypothesis", None)
    if hypothesis is None or state.timestamp != when:
        return None
    if hasattr(hypothesis, "single_hypotheses"):
        hypothesis = max(hypothesis.single_hypotheses, key=lambda one: one.probability)
    return getattr(hypothesis.measurement, "metadata", {}).get("bar")


def chained(frames: list[Bars], pairs_of: Callable[[Bars, Bars], list[tuple[int, int]]]) -> Ids:
    """Return identities that pairs of bars, (earlier, later), hand on from frame to frame."""
    count = 0
    ids: Ids = []
    for number, bars in enumerate(frames):
        now = np.full(len(bars.centre), DROPPED)
        if number and len(now) and len(ids[-1]):
            for before, after in pairs_of(frames[number - 1], bars):
                now[after] = ids[-1][before]
        # Bars without an earlier one get new identities.
        new = np.flatnonzero(now == DROPPED)
        now[new] = count + np.arange(len(new))
        count += len(new)
        ids.append(now)
    return ids


def persim_link(frames: list[Bars], distance: str) -> Ids:
    """Link by the optimal matching of two diagrams, as persim computes it, for "bottleneck" or "wasserstein"."""
    import persim

    measure = getattr(persim, distance)

    def pairs_of(before: Bars, after: Bars) -> list[tuple[int, int]]:
        _, matching = measure(before.diagram, after.diagram, matching=True)
        pairs = np.asarray(matching)[:, :2].astype(int)
        return [(i, j) for i, j in pairs.tolist() if i >= 0 and j >= 0]

    return chained(frames, pairs_of)


def lifted_link(frames: list[Bars], weight: float) -> Ids:
    """Link by the lifted Wasserstein distance: births, deaths and, with a weight, places; on the diagonal a bar's own extent."""

    def pairs_of(before: Bars, after: Bars) -> list[tuple[int, int]]:
        cost = cdist(before.diagram, after.diagram, "sqeuclidean")
        cost += weight * cdist(before.centre, after.centre, "sqeuclidean")
        alone = [
            np.diff(bars.diagram, axis=1)[:, 0] ** 2 / 2 + weight * np.square(bars.centre - bars.start).sum(axis=1)
            for bars in (before, after)
        ]
        # A pair is taken where it costs less than leaving both bars alone.
        gain = np.maximum(alone[0][:, None] + alone[1] - cost, 0)
        rows, columns = linear_sum_assignment(-gain)
        return [(i, j) for i, j in zip(rows.tolist(), columns.tolist(), strict=True) if gain[i, j] > 0]

    return chained(frames, pairs_of)


def choices(**options: list[Any]) -> list[dict[str, Any]]:
    """Return all combinations of options."""
    return [dict(zip(options, values, strict=True)) for values in product(*options.values())]


REACHES = [0.05, 0.1, 0.2, 0.4]
MEMORIES = [0, 5, 20, 40]
FILTERS = choices(motion=[0.1, 1.0, 10.0], noise=[0.01, 0.03], missed=[3], memory=[20, 40])
LINKERS: dict[str, tuple[Callable[..., Ids], list[dict[str, Any]]]] = {
    "trackpy": (trackpy_link, choices(reach=REACHES, memory=MEMORIES)),
    "LapTrack": (laptrack_link, choices(reach=REACHES, memory=[0, 20, 40])),
    "Stone Soup, nearest": (partial(stonesoup_link, probabilistic=False), FILTERS),
    "Stone Soup, JPDA": (
        partial(stonesoup_link, probabilistic=True),
        choices(motion=[0.1, 1.0, 10.0], noise=[0.03], missed=[0.95], memory=[20, 40]),
    ),
    "bottleneck": (persim_link, choices(distance=["bottleneck"])),
    "Wasserstein": (persim_link, choices(distance=["wasserstein"])),
    "lifted Wasserstein": (lifted_link, choices(weight=[0.01, 0.1, 1.0])),
}
"""The linkers, each with the options that are tried on the tuning films."""


def bars_of(state: tk.TopologicalState, cloud: NDArray[np.float64]) -> Bars:
    """Return the bars of a frame that a tracker calls loops."""
    loops = state.loops
    return Bars(
        np.array([loop.centre for loop in loops]).reshape(-1, 3),
        np.array([cloud[loop.birth_edge].mean(axis=0) for loop in loops]).reshape(-1, 3),
        np.array([(loop.birth, loop.death) for loop in loops]).reshape(-1, 2),
    )


Asked = tuple[str, str, dict[str, Any]]  # linker, rule, options


def named(frames: list[Bars], ids: Ids) -> list[Any]:
    """Return states with the identities of a linker, without the bars that it leaves out; `compare` reads them."""
    states = []
    for bars, names in zip(frames, ids, strict=True):
        pairs = zip(names.tolist(), bars.centre, strict=True)
        loops = [SimpleNamespace(id=name, centre=place) for name, place in pairs if name != DROPPED]
        states.append(SimpleNamespace(loops=loops))
    return states


def key_of(linker: str, rule: str = "", options: Mapping[str, Any] | None = None) -> str:
    """Return the name of a linker with its options, for a row; a tracker of our own has none."""
    return json.dumps([linker, rule, dict(options or {})], sort_keys=True)


def followed(
    tracker: tk.SeqPH, clouds: Clouds, diagrams: list[tk.Diagram], given: list[bool]
) -> list[tk.TopologicalState]:
    """Track clouds; the persistence of a frame is given, or else computed."""
    return [
        tracker.update(cloud, diagram=diagram if known else None)
        for cloud, diagram, known in zip(clouds, diagrams, given, strict=True)
    ]


def row_of(path: Path, part: str, asked: list[Asked], known: dict[str, Any]) -> dict[str, Any]:
    """Return the scores of all linkers that are asked, and of seqPH, on an episode; and the milliseconds of a frame.

    What a known row of the episode has is not computed again.
    """
    episode = load_episode(path)
    truth = true_loops(episode.points, episode.loops)
    scores: dict[str, dict[str, Any]] = known.get("scores", {})
    times: dict[str, float] = known.get("ms", {})
    asked = [one for one in asked if key_of(*one) not in scores]
    unknown = [name for name in OURS if key_of(name) not in scores]
    rules = {rule for _, rule, _ in asked}
    for condition, clouds, stride in conditions(episode):
        if part == "tuning" and condition not in TUNED_IN:
            continue
        for key, (states, seconds) in tracked(clouds, asked, unknown, rules).items():
            if condition == TIMED:
                times[key] = round(1000 * seconds / len(states), 3)
            scores.setdefault(key, {})[condition] = pack(score(compare(states, truth[::stride])))
    return {"episode": path.stem, "scores": scores, "ms": times}


def tracked(
    clouds: Clouds, asked: list[Asked], unknown: list[str], rules: set[str]
) -> dict[str, tuple[list[Any], float]]:
    """Return by key the states of our own trackers and of linkers in some clouds, and the seconds that they took."""
    diagrams = tk.rips_persistence_many(clouds, 1)
    # Where isolated points have to be left out, seqPH computes the persistence of the others anew.
    clean = [len(inliers(cloud)) == len(cloud) for cloud in clouds]
    answer: dict[str, tuple[list[Any], float]] = {}
    states: dict[str, list[tk.TopologicalState]] = {}
    for name in dict.fromkeys([*unknown, *(REPORTED_BY[rule] for rule in rules if rule in REPORTED_BY)]):
        given = [True] * len(clouds) if name == PAPER else clean
        start = time.process_time()
        states[name] = followed(OURS[name](), clouds, diagrams, given)
        answer[key_of(name)] = states[name], time.process_time() - start

    # The bars that linkers get.
    if "evidence" in rules:
        states["evidence"] = followed(tk.SeqPH(memory=0, match=lambda _: []), clouds, diagrams, clean)
    bars: dict[str, list[Bars]] = {}
    for rule in rules:
        reported = states[REPORTED_BY.get(rule, rule)]
        bars[rule] = [bars_of(state, cloud) for state, cloud in zip(reported, clouds, strict=True)]
    for linker, rule, options in asked:
        start = time.process_time()
        ids = LINKERS[linker][0](bars[rule], **options)
        answer[key_of(linker, rule, options)] = named(bars[rule], ids), time.process_time() - start
    return answer


def rows_of(folder: Path, part: str, asked: list[Asked], made: bool) -> list[dict[str, Any]]:
    """Return a row for each film of a part, those of an earlier run included. With `made` no film is simulated."""
    paths = sorted(folder.glob("*_[0-9]*.npz")) if made else simulated(folder, SEEDS[part])
    wanted = {*(key_of(*one) for one in asked), *(key_of(name) for name in OURS)}
    return resumed(
        paths,
        folder / "linkers.jsonl",
        lambda path, known: row_of(path, part, asked, known),
        lambda row: wanted <= row["scores"].keys(),
    )


def scores_in(rows: list[dict[str, Any]], key: str, condition: str) -> list[TrackingScore]:
    """Return a linker's score on each film."""
    return [unpack(row["scores"][key][condition]) for row in rows]


def merit(rows: list[dict[str, Any]], key: str) -> float:
    """Return the mean of HOTA and IDF1 over the conditions to tune in, each over all films together."""
    values = []
    for condition in TUNED_IN:
        together = total(scores_in(rows, key, condition))
        values.append((together.hota + together.idf1) / 2)
    return float(np.mean(values))


def everything() -> list[Asked]:
    """Return each linker with each rule that it is given bars by, and with all its options."""
    asked: list[Asked] = []
    for rule, linkers in WITH.items():
        for linker in linkers:
            asked += [(linker, rule, one) for one in LINKERS[linker][1]]
    return asked


def best_options(rows: list[dict[str, Any]]) -> dict[str, Asked]:
    """Return for each linker and each rule the options that are best on the tuning films, by a label."""
    groups: dict[str, list[Asked]] = {}
    for one in everything():
        groups.setdefault(f"{one[0]}, bars by {one[1]}", []).append(one)
    return {label: max(some, key=lambda one: merit(rows, key_of(*one))) for label, some in groups.items()}


def table(rows: list[dict[str, Any]], keys: dict[str, str]) -> dict[str, Any]:
    """Return for each condition, and for all together, the measures of each label with 95 % intervals over draws of films."""
    weights = weights_of(rows)
    found: dict[str, Any] = {}
    every = list(rows[0]["scores"][keys["seqPH"]])
    for condition in every:
        found[condition] = {}
        for label, key in keys.items():
            if condition in rows[0]["scores"][key]:
                found[condition][label] = with_intervals(scores_in(rows, key, condition), weights)[0]
    found[TOGETHER] = {}
    for label, key in keys.items():
        if len(rows[0]["scores"][key]) == len(every):
            films = [total([unpack(row["scores"][key][condition]) for condition in every]) for row in rows]
            found[TOGETHER][label] = with_intervals(films, weights)[0]
    return found


def against_strangers(lines: dict[str, Any]) -> dict[str, Any]:
    """Return for each condition and measure the best stranger and its value, beside the value of seqPH.

    Apart from it is the best of those that get the loops of seqPH.
    """
    helped = f", bars by {DEFAULT}"
    found: dict[str, Any] = {}
    for condition, of in lines.items():
        found[condition] = {}
        for measure in ("hota", "idf1"):
            strangers = {label: line[measure] for label, line in of.items() if label not in OURS}
            given = [strangers.pop(label) for label in list(strangers) if label.endswith(helped)]
            best = max(strangers, key=lambda label: strangers[label])
            entry = {"seqPH": of[DEFAULT][measure], "best": strangers[best], "stranger": best}
            if given:
                entry["given_its_loops"] = max(given)
            found[condition][measure] = entry
    return found


def tables(results: dict[str, Any]) -> str:
    """Return the tables of the page: all trackers over all conditions, and seqPH against the best stranger in each."""
    films = len(results["films"])
    tuned = len(results["tuned_on"])
    text = [
        f"The first table has all twenty conditions together, on {films} films. The options of the libraries were chosen on",
        f"{tuned} other films. Brackets hold 95 % intervals over films. The last column is the time for a frame of 500 points,",
        "without persistence.",
        "",
        "| tracker | IDF1 | HOTA | MOTA | switches | ms |",
        "|---|---|---|---|---|---|",
    ]
    for label, line in sorted(results["table"][TOGETHER].items(), key=lambda pair: -pair[1]["idf1"]):
        measures = [(line[name], *line[f"{name}_interval"]) for name in ("idf1", "hota", "mota")]
        cells = ["{:.3f} [{:.3f}, {:.3f}]".format(*measure) for measure in measures]
        cells += [f"{line['switches']:,}", f"{results['ms_a_frame'][label]:.2g}"]
        text.append(f"| {label} | {' | '.join(cells)} |")
    text += [
        "",
        "The second table has a row for each condition. It compares seqPH with the best library on other bars, and with the",
        "best library on the loops of seqPH, by two measures.",
        "",
        "| condition | IDF1: seqPH | best library | on its loops | HOTA: seqPH | best library | on its loops |",
        "|---|---|---|---|---|---|---|",
    ]
    for condition, of in results["against_strangers"].items():
        cells = [condition]
        for measure in ("idf1", "hota"):
            one = of[measure]
            cells += [f"{one['seqPH']:.3f}", f"{one['best']:.3f}, {one['stranger']}"]
            if "given_its_loops" in one:
                cells.append(f"{one['given_its_loops']:.3f}")
            else:
                cells.append("")
        text.append(f"| {' | '.join(cells)} |")
    return "\n".join(text)


def main(arguments: Sequence[str] | None = None) -> None:
    """Tune on some films, score others, write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tuning", type=Path, help="folder for the films to tune on")
    parser.add_argument("--episodes", type=Path, help="folder for the films to score")
    parser.add_argument("--made", action="store_true", help="use the films that are there, and simulate none")
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument("--page", action="store_true", help=f"put the recorded run into {PAGE.name}, and run nothing")
    options = parser.parse_args(arguments)
    if options.page:
        PAGE.write_text(in_page(PAGE.read_text(), "linkers.py", tables(json.loads(RESULTS.read_text()))))
        return
    if options.tuning is None or options.episodes is None:
        parser.error("--tuning and --episodes are needed")

    tuned = rows_of(options.tuning, "tuning", everything(), options.made)
    best = best_options(tuned)
    rows = rows_of(options.episodes, "episodes", list(best.values()), options.made)
    keys = {name: key_of(name) for name in OURS} | {label: key_of(*one) for label, one in best.items()}
    lines = table(rows, keys)
    answer = {
        "command": "python book/experiments/linkers.py --tuning DIR --episodes DIR" + " --made" * options.made,
        "made_with": {"topokit": version(), "machine": platform.machine()},
        "films": [row["episode"] for row in rows],
        "tuned_on": [row["episode"] for row in tuned],
        "tuned_in": list(TUNED_IN),
        "options": {label: one[2] for label, one in best.items()},
        "merit_on_tuning_films": {label: round(merit(tuned, key), 4) for label, key in keys.items()},
        "ms_a_frame": {
            label: round(float(np.mean([row["ms"][key] for row in rows])), 2)
            for label, key in keys.items()
            if key in rows[0]["ms"]
        },
        "against_strangers": against_strangers(lines),
        "table": lines,
    }
    write_results(options.out, answer)


if __name__ == "__main__":
    main()
