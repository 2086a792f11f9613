"""Compare seqPH with trackers that others wrote, on the same bars and places: book/results/linkers.json.

    pip install --group linkers
    python book/experiments/linkers.py --tuning DIR --episodes DIR --out book/results/linkers.json

Question: a reader who has the bars of each frame and a place for each could link them over time with a well-known library. Does
seqPH keep identities better? Every library gets the bars of topokit, so that only the identities differ: once the bars that
live alpha or longer, and once the bars that the evidence of their own frame supports. Its options are those with the largest
mean of HOTA and IDF1, over all conditions, on the films of `--tuning` (seeds 100 to 102). Then all films of `--episodes` are
scored once with these options. seqPH was tuned on the same tuning films.

Rows are appended to linkers.jsonl in the folder of the films; an interrupted run goes on where it was.

Source: Allan et al., *trackpy*; Fukai and Kawaguchi 2023, *LapTrack*; Thomas et al. 2017, *Stone Soup*; Saul, Tralie, *persim*;
Soler et al. 2018, *Lifted Wasserstein matcher for fast and robust topology tracking*. Taught in chapter 8.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import time
from collections.abc import Callable, Iterator
from datetime import datetime, timedelta
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist
from tables import write_results
from tqdm import tqdm
from tracking import pack, simulated, total, unpack, weights_of, with_intervals

import topokit as tk
from topokit.evaluate import TrackingScore, compare, score, true_loops
from topokit.io import load_episode

from _tracking_clouds import conditions

SEEDS = {"tuning": range(100, 103), "episodes": range(3)}
DROPPED = -1  # identity of a bar that a linker leaves out
OURS = {"seqPH": tk.SeqPH, "seqPH, the paper's": tk.SeqPH.paper}
RULES: dict[str, Callable[[], tk.SeqPH]] = {
    "alpha": lambda: tk.SeqPH.paper(match=lambda _: []),
    "evidence": lambda: tk.SeqPH(memory=0, match=lambda _: []),
}
"""Which bars of a frame are given to linkers: those of the paper, or those that the evidence of that frame alone supports."""


class Bars(NamedTuple):
    """The bars of one frame."""

    centre: NDArray[np.float64]  # (k, 3) metres
    start: NDArray[np.float64]  # (k, 3) middle of the edge that creates the bar, metres
    diagram: NDArray[np.float64]  # (k, 2) births and deaths, metres


Ids = list[NDArray[np.int64]]
Linker = Callable[[list[Bars]], Ids]

# ------------------------------------------------------------------------------------------------------ linkers of particles


def table_of_bars(frames: list[Bars]) -> Any:
    """Return a table with a row for each bar: x, y, z, frame, and its number among the bars of all frames."""
    import pandas as pd

    places = np.concatenate([bars.centre for bars in frames]).reshape(-1, 3)
    table = pd.DataFrame(places, columns=list("xyz"))
    table["frame"] = np.repeat(np.arange(len(frames)), [len(bars.centre) for bars in frames])
    table["bar"] = np.arange(len(table))
    return table


def by_frame(frames: list[Bars], ids: NDArray[np.int64]) -> Ids:
    """Return identities of all bars, divided by frames."""
    return np.split(ids, np.cumsum([len(bars.centre) for bars in frames])[:-1])


def trackpy_link(frames: list[Bars], reach: float, memory: int) -> Ids:
    """Link by trackpy: the least total squared distance from frame to frame, within `reach` metres."""
    import trackpy

    trackpy.quiet()
    table = table_of_bars(frames)
    ids = np.full(len(table), DROPPED)
    if len(table):
        found = trackpy.link(table, reach, pos_columns=list("xyz"), t_column="frame", memory=memory)
        ids[found["bar"].to_numpy()] = found["particle"].to_numpy()
    return by_frame(frames, ids)


def laptrack_link(frames: list[Bars], reach: float, memory: int) -> Ids:
    """Link by LapTrack: assignments from frame to frame, then of ends to starts over at most `memory` frames."""
    from laptrack import LapTrack

    table = table_of_bars(frames)
    ids = np.full(len(table), DROPPED)
    if len(table):
        linker = LapTrack(
            cutoff=reach**2,
            gap_closing_cutoff=reach**2 if memory else False,
            gap_closing_max_frame_count=max(memory, 1),
        )
        found, _, _ = linker.predict_dataframe(table, list("xyz"), frame_col="frame", only_coordinate_cols=False)
        ids[found["bar"].to_numpy()] = found["track_id"].to_numpy()
    return by_frame(frames, ids)


# ------------------------------------------------------------------------------------------------------- a filter framework


def stonesoup_link(
    frames: list[Bars], motion: float, noise: float, missed: float, memory: int, probabilistic: bool
) -> Ids:
    """Link by Stone Soup: Kalman filters of nearly constant velocity; global nearest neighbours or JPDA.

    Parameters
    ----------
    motion, noise : float
        Diffusion of the velocity, and standard deviation of a place in metres.
    missed : float
        Distance, in standard deviations, from which a bar is rather another loop; with JPDA the probability of the gate.
    memory : int
        Frames without a bar after which a track ends.
    probabilistic : bool
        Use joint probabilistic data association.
    """
    from stonesoup.dataassociator.neighbour import GNNWith2DAssignment
    from stonesoup.dataassociator.probability import JPDA
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
        associator = JPDA(hypothesiser)
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
            yield (
                when,
                {
                    Detection(place[:, None], when, model, metadata={"bar": (number, i)})
                    for i, place in enumerate(bars.centre)
                },
            )

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
    single = hypothesis
    if hasattr(hypothesis, "single_hypotheses"):
        single = max(hypothesis.single_hypotheses, key=lambda one: one.probability)
    metadata = getattr(single.measurement, "metadata", {})
    return metadata.get("bar")


# -------------------------------------------------------------------------------------------------------- matched diagrams


def chained(frames: list[Bars], pairs_of: Callable[[Bars, Bars], list[tuple[int, int]]]) -> Ids:
    """Return identities that pairs of bars, (earlier, later), hand on from frame to frame."""
    count = 0
    ids: Ids = []
    for number, bars in enumerate(frames):
        now = np.full(len(bars.centre), DROPPED)
        if number and len(now) and len(ids[-1]):
            for before, after in pairs_of(frames[number - 1], bars):
                now[after] = ids[-1][before]
        new = now == DROPPED
        now[new] = count + np.arange(new.sum())
        count += int(new.sum())
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
MEMORIES = [0, 5, 20]
FILTERS = choices(motion=[0.1, 1.0, 10.0], noise=[0.01, 0.03], missed=[3, 6], memory=[5, 20])
LINKERS: dict[str, tuple[Callable[..., Ids], list[dict[str, Any]]]] = {
    "trackpy": (trackpy_link, choices(reach=REACHES, memory=MEMORIES)),
    "LapTrack": (laptrack_link, choices(reach=REACHES, memory=MEMORIES)),
    "Stone Soup, nearest": (partial(stonesoup_link, probabilistic=False), FILTERS),
    "Stone Soup, JPDA": (
        partial(stonesoup_link, probabilistic=True),
        choices(motion=[0.1, 1.0, 10.0], noise=[0.01, 0.03], missed=[0.95], memory=[5, 20]),
    ),
    "bottleneck": (persim_link, choices(distance=["bottleneck"])),
    "Wasserstein": (persim_link, choices(distance=["wasserstein"])),
    "lifted Wasserstein": (lifted_link, choices(weight=[0.0, 0.01, 0.1, 1.0])),
}
"""The linkers, each with the options that are tried on the tuning films."""

# -------------------------------------------------------------------------------------------------------------- experiment


def named(states: list[tk.TopologicalState], ids: Ids) -> list[tk.TopologicalState]:
    """Return states with the identities of a linker, without the bars that it leaves out."""
    renamed = []
    for state, names in zip(states, ids, strict=True):
        loops = [
            dataclasses.replace(loop, id=name)
            for loop, name in zip(state.loops, names.tolist(), strict=True)
            if name != DROPPED
        ]
        renamed.append(dataclasses.replace(state, loops=tuple(loops)))
    return renamed


def bars_of(state: tk.TopologicalState, cloud: NDArray[np.float64]) -> Bars:
    """Return the bars of a frame."""
    loops = state.loops
    return Bars(
        np.array([loop.centre for loop in loops]).reshape(-1, 3),
        np.array([cloud[loop.birth_edge].mean(axis=0) for loop in loops]).reshape(-1, 3),
        np.array([(loop.birth, loop.death) for loop in loops]).reshape(-1, 2),
    )


def key_of(linker: str, rule: str, options: dict[str, Any]) -> str:
    """Return the name of a linker with its options, for a row."""
    return json.dumps([linker, rule, options], sort_keys=True)


def row_of(path: Path, asked: list[tuple[str, str, dict[str, Any]]]) -> dict[str, Any]:
    """Return the scores of all linkers that are asked, and of seqPH, on an episode; and the milliseconds of a frame."""
    episode = load_episode(path)
    truth = true_loops(episode.points, episode.loops)
    scores: dict[str, dict[str, Any]] = {}
    times: dict[str, float] = {}
    for condition, clouds, stride in conditions(episode):
        diagrams = tk.rips_persistence_many(clouds)

        def states_of(tracker: tk.SeqPH, clouds: Any = clouds, diagrams: Any = diagrams) -> list[tk.TopologicalState]:
            return [tracker.update(cloud, diagram=diagram) for cloud, diagram in zip(clouds, diagrams, strict=True)]

        def keep(
            key: str, start: float, states: list[tk.TopologicalState], condition: str = condition, stride: int = stride
        ) -> None:
            times[key] = times.get(key, 0.0) + 1000 * (time.process_time() - start) / len(states)
            scores.setdefault(key, {})[condition] = pack(score(compare(states, truth[::stride])))

        for name, tracker in OURS.items():
            start = time.process_time()
            keep(key_of(name, "", {}), start, states_of(tracker()))
        for rule, tracker in RULES.items():
            states = states_of(tracker())
            frames = [bars_of(state, cloud) for state, cloud in zip(states, clouds, strict=True)]
            for linker, its_rule, options in asked:
                if its_rule == rule:
                    start = time.process_time()
                    keep(key_of(linker, rule, options), start, named(states, LINKERS[linker][0](frames, **options)))
    count = len(next(iter(scores.values())))
    return {
        "episode": path.stem,
        "scores": scores,
        "ms": {key: round(value / count, 3) for key, value in times.items()},
    }


def rows_of(folder: Path, part: str, asked: list[tuple[str, str, dict[str, Any]]]) -> list[dict[str, Any]]:
    """Return a row for each film of a part, those of an earlier run included."""
    paths = simulated(folder, SEEDS[part])
    kept = folder / "linkers.jsonl"
    lines = kept.read_text(encoding="utf-8").splitlines() if kept.exists() else []
    known = {row["episode"]: row for row in map(json.loads, lines)}
    wanted = {key_of(*one) for one in asked}
    for path in tqdm(paths, part, unit="film"):
        if path.stem in known and wanted <= known[path.stem]["scores"].keys():
            continue
        known[path.stem] = row_of(path, asked)
        with kept.open("a", encoding="utf-8") as file:
            file.write(json.dumps(known[path.stem]) + "\n")
    return [known[path.stem] for path in paths]


def scores_in(rows: list[dict[str, Any]], key: str, condition: str) -> list[TrackingScore]:
    """Return a linker's score on each film."""
    return [unpack(row["scores"][key][condition]) for row in rows]


def merit(rows: list[dict[str, Any]], key: str) -> float:
    """Return the mean of HOTA and IDF1 over the conditions, each over all films together."""
    values = []
    for condition in rows[0]["scores"][key]:
        together = total(scores_in(rows, key, condition))
        values.append((together.hota + together.idf1) / 2)
    return float(np.mean(values))


def best_options(rows: list[dict[str, Any]]) -> list[tuple[str, str, dict[str, Any]]]:
    """Return each linker with each rule, and the options that are best on the tuning films."""
    found = []
    for linker, (_, options) in LINKERS.items():
        for rule in RULES:
            best = max(options, key=lambda one: merit(rows, key_of(linker, rule, one)))
            found.append((linker, rule, best))
    return found


def table(rows: list[dict[str, Any]], keys: list[str]) -> dict[str, Any]:
    """Return for each condition and linker its measures with 95 % intervals, over draws of films."""
    weights = weights_of(rows)
    found: dict[str, Any] = {}
    for condition in rows[0]["scores"][keys[0]]:
        found[condition] = {key: with_intervals(scores_in(rows, key, condition), weights)[0] for key in keys}
    return found


def main() -> None:
    """Tune on some films, score others, write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tuning", type=Path, required=True, help="folder for the films to tune on")
    parser.add_argument("--episodes", type=Path, required=True, help="folder for the films to score")
    parser.add_argument("--out", type=Path, default=Path("book/results/linkers.json"))
    options = parser.parse_args()

    everything = [(name, rule, one) for name, (_, many) in LINKERS.items() for rule in RULES for one in many]
    tuned = rows_of(options.tuning, "tuning", everything)
    best = best_options(tuned)
    rows = rows_of(options.episodes, "episodes", best)
    keys = [key_of(name, "", {}) for name in OURS] + [key_of(*one) for one in best]
    answer = {
        "command": "python book/experiments/linkers.py --tuning DIR --episodes DIR",
        "films": [row["episode"] for row in rows],
        "tuned_on": [row["episode"] for row in tuned],
        "merit_on_tuning_films": {key: round(merit(tuned, key), 4) for key in keys},
        "ms_a_frame": {key: round(float(np.mean([row["ms"][key] for row in rows])), 2) for key in keys},
        "table": table(rows, keys),
    }
    write_results(options.out, answer)


if __name__ == "__main__":
    main()
