"""Measure how well trackers keep the identities of loops: book/results/tracking.json.

    python book/experiments/tracking.py --episodes DIR --seeds 3 --out book/results/tracking.json

Takes an hour on one core. Episodes that are missing are simulated into a folder. Every episode is tracked and scored once,
and its row is appended to scores.jsonl beside it. The table pools the episodes; intervals are percentiles over bootstrap
samples of episodes. With --clips a few frames around some failures are saved for the book.
"""

import argparse
import dataclasses
import json
import platform
import subprocess
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from tables import draw_episodes, write_results
from tqdm import tqdm

import topokit as tk
from topokit.evaluate import Overlap, compare, distance_to_hull, events, score, true_loops
from topokit.evaluate._scores import TrackingScore
from topokit.io import Episode, load_episode, save_episode, save_states
from topokit.linking import curve_centroid
from topokit.sensors import CloudMemory
from topokit.seqph import PAPER as PAPERS
from topokit.sim import TASKS, Randomisation, SimulationError, simulate

from _tracking_clouds import CAMERA, SEEN, Clouds, conditions, true_parameters

sys.path.append(str(Path(__file__).parents[2] / "notebooks"))
from chapter_tools.trackers import by_diagram, by_killer, by_midpoint, track_vines

GARMENTS = ("apron", "apron2", "tote", "tote2", "backpack", "mask", "sheet", "sheet2", "shirt", "vest")
FILMED = tuple(task for task in TASKS if task.split("-")[0] in GARMENTS)
"""The tasks of the films. A garment that joined the library later is not among them, so the films stay the same."""
MEMORY = 8  # frames, of the paper's tracker where it has a memory
MEASURES = ("mota", "idf1", "hota", "deta", "assa")
COUNTS = ("objects", "detections", "misses", "false_positives", "switches", "fragments")
THRESHOLDS = (0.3, 0.5, 0.7)  # of similarity: 1.4, 1 and 0.6 radii away
FIELDS = tuple(field.name for field in dataclasses.fields(TrackingScore))
TOGETHER = "all together"
SOME = "compared, together"
Follow = Callable[[Clouds, list[tk.Diagram]], list[tk.TopologicalState]]


def paper(**options: Any) -> Follow:
    """Return the paper's tracker with some options of its own; it is given the persistence of the frames."""

    def follow(clouds: Clouds, diagrams: list[tk.Diagram]) -> list[tk.TopologicalState]:
        tracker = tk.SeqPH.paper(**options)
        return [tracker.update(cloud, diagram=diagram) for cloud, diagram in zip(clouds, diagrams, strict=True)]

    return follow


TRACKERS: dict[str, Follow] = {
    "paper, alpha guessed": paper(),
    "killer-triangles": paper(identity="killer-triangles"),
    "cycle": paper(identity="cycle"),
    "memory": paper(memory=MEMORY),
    "triangles and memory": paper(identity="killer-triangles", gates="proved", memory=MEMORY),
    "birth and death": paper(match=by_diagram),
    "nearest midpoint": paper(match=by_midpoint),
    "default": lambda clouds, _: tk.track(clouds, n_jobs=1),
}
"""The paper's tracker with our guess of alpha, and with one thing changed; what was recommended before the default; other
matchings; the default."""
PAPER = "paper, alpha guessed"
GIVEN = "paper, alpha given"  # its parameters are of the film and the condition, see `true_parameters`
RECOMMENDED = "default"
WITH_MEMORY = "default, with a memory"  # of the cloud: what a camera sees now and saw before, and what it looks through
MAIN = (PAPER, GIVEN, "triangles and memory", RECOMMENDED)  # the others are in some conditions alone
SEVERAL = (PAPER, GIVEN, *list(TRACKERS)[1:])
COMPARED = ("all vertices", "every 4th frame", "250 points", "noise of 5 mm", "one camera")
VINES = "vines"
VINES_IN = ("all vertices", "every 4th frame", "noise of 5 mm")
WHOLE = ("all vertices", "every 4th frame")


def remembered(clouds: Clouds) -> list[tk.TopologicalState]:
    """Track what a camera sees and what it remembers; only loops that it has looked through count."""
    memory = CloudMemory()
    tracker = tk.SeqPH()
    return [memory.open_loops(tracker.update(memory(cloud, eye=CAMERA.eye))) for cloud in clouds]


def simulated(folder: Path, seeds: Iterable[int]) -> list[Path]:
    """Return the files of all episodes; those that are missing are simulated. A refused one leaves a note of the reason."""
    wanted = [(task, seed) for seed in seeds for task in FILMED]
    folder.mkdir(parents=True, exist_ok=True)
    for task, seed in tqdm(wanted, "films", unit="film"):
        path = folder / f"{task}_{seed}.npz"
        if not path.exists() and not path.with_suffix(".rejected").exists():
            options = {"randomisation": Randomisation(), "cameras": [CAMERA], "n_observed": SEEN, "time_limit": 600}
            try:
                episode = simulate(task=task, seed=seed, **options)
            except SimulationError as error:
                path.with_suffix(".rejected").write_text(str(error))
            else:
                save_episode(path, episode)
    return [path for task, seed in wanted if (path := folder / f"{task}_{seed}.npz").exists()]


def row_of(path: Path) -> dict[str, Any]:
    """Return all that is measured on an episode."""
    episode = load_episode(path)
    truth = true_loops(episode.points, episode.loops)
    row: dict[str, Any] = {
        "episode": path.stem,
        "frames": len(episode),
        "given": {},
        "scores": {},
        "levels": {},
        "failures": [],
    }
    for name, clouds, stride in conditions(episode):
        true = truth[::stride]
        diagrams = tk.rips_persistence_many(clouds)
        wanted = SEVERAL if name in COMPARED else MAIN
        given = true_parameters(episode, name, clouds, stride)
        trackers = TRACKERS | {GIVEN: paper(**given)}
        films = {label: trackers[label](clouds, diagrams) for label in wanted}
        row["given"][name] = {key: round(value, 6) for key, value in given.items()}
        if name == "one camera":
            films[WITH_MEMORY] = remembered(clouds)
        if name in VINES_IN:
            films[VINES] = track_vines(clouds, steps=4, **PAPERS)
        overlaps = {label: compare(states, true) for label, states in films.items()}
        row["scores"][name] = {label: pack(score(seen)) for label, seen in overlaps.items()}
        row["levels"][name] = {
            label: [counts(score(seen, threshold)) for threshold in THRESHOLDS] for label, seen in overlaps.items()
        }
        for label, seen in overlaps.items():
            found = failures(path.stem, name, label, seen, stride)
            row["failures"] += [one for one in found if label == PAPER or one["kind"] == "switch"]
        row.setdefault("places", {})[name] = places(films[RECOMMENDED], overlaps[RECOMMENDED], true, episode, stride)
        if name in WHOLE:
            row.setdefault("jumps", {})[name] = jumps(clouds, diagrams, true)
            exact = score(compare(films[RECOMMENDED], true, by_killer))
            row.setdefault("exact", {})[name] = pack(exact)
    row["present"] = np.mean([true.present for true in truth], axis=0).round(4).tolist()
    return row


def pack(result: TrackingScore) -> dict[str, Any]:
    """Return a score as JSON."""
    values = {name: getattr(result, name) for name in FIELDS}
    return {
        name: value.round(6).tolist() if isinstance(value, np.ndarray) else int(value) for name, value in values.items()
    }


def unpack(values: dict[str, Any]) -> TrackingScore:
    """Return the score of its JSON."""
    return TrackingScore(**{k: np.array(v) if isinstance(v, list) else v for k, v in values.items()})


def counts(result: TrackingScore) -> list[float]:
    """Return what has to be added up for MOTA and IDF1 at other thresholds."""
    return [result.objects, result.detections, result.matches, result.switches, result.id_matches]


def failures(episode: str, condition: str, tracker: str, overlaps: list[Overlap], stride: int) -> list[dict[str, Any]]:
    """Return every switch, and every run of frames in which a loop is missed or a false one found; frames are the film's."""
    found: list[dict[str, Any]] = []
    running: dict[tuple[str, int], dict[str, Any]] = {}
    for event in events(overlaps):
        if event.kind in ("match", "fragment"):
            continue
        key = (event.kind, event.id if event.kind == "false positive" else event.loop)
        run = running.get(key)
        if event.kind != "switch" and run and run["last"] == (event.frame - 1) * stride:
            run["last"] = event.frame * stride
            continue
        running[key] = {"episode": episode, "condition": condition, "tracker": tracker, "kind": event.kind}
        running[key] |= {"first": event.frame * stride, "last": event.frame * stride}
        running[key] |= {"loop": event.loop, "id": event.id}
        found.append(running[key])
    return found


def places(
    states: list[tk.TopologicalState],
    overlaps: list[Overlap],
    truth: list[Any],
    episode: Episode,
    stride: int,
) -> dict[str, list[float]]:
    """Return of every match the distance of centres in metres and in true radii, and the distance to the true hull."""
    away = []
    relative = []
    outside = []
    for event in events(overlaps):
        if event.kind in ("match", "switch"):
            true = truth[event.frame]
            centre = states[event.frame][event.id].centre
            away.append(float(np.linalg.norm(true.centres[event.loop] - centre)))
            relative.append(away[-1] / float(true.radii[event.loop]))
            outside.append(distance_to_hull(centre, episode.points[event.frame * stride][episode.loops[event.loop]]))
    return {
        "metres": np.round(away, 4).tolist(),
        "radii": np.round(relative, 3).tolist(),
        "outside": np.round(outside, 4).tolist(),
    }


def place_of(diagram: tk.Diagram, bar: int, cloud: np.ndarray, identity: str) -> np.ndarray:
    """Return the place (p, 3) of a loop, for one of the identities of `topokit.SeqPH`."""
    if identity == "killer-edge":
        return cloud[diagram.killer_edge[bar]]
    if identity == "killer-triangles":
        return cloud[diagram.killer_triangles[bar, 0]].mean(axis=0, keepdims=True)
    return curve_centroid(cloud[diagram.cycle(bar)])[None]


def jumps(clouds: Clouds, diagrams: list[tk.Diagram], truth: list[Any]) -> dict[str, list[int]]:
    """Return for each place of a loop the steps, and the steps in which it jumped by more than half the killer edge's length.

    The loop is known by the edge that ends the true one, so that no tracker is involved, and its true motion is taken away.
    """
    answer = {}
    for identity in ("killer-edge", "killer-triangles", "cycle"):
        before: dict[int, np.ndarray] = {}
        steps = far = 0
        for cloud, diagram, true in zip(clouds, diagrams, truth, strict=True):
            now: dict[int, np.ndarray] = {}
            for loop in np.flatnonzero(true.present).tolist():
                i = int(np.flatnonzero((diagram.killer_edge == true.killers[loop]).all(axis=1))[0])
                now[loop] = place_of(diagram, i, cloud, identity) - true.centres[loop]
                if loop in before:
                    steps += 1
                    far += tk.hausdorff(now[loop], before[loop]) > diagram.death[i]
            before = now
        answer[identity] = [steps, int(far)]
    return answer


def pooled(rows: list[dict[str, Any]], samples: int = 1000) -> dict[str, Any]:
    """Return scores of all episodes together, with 95 % intervals; and what each tracker gains over the paper's.

    All are given the same samples, so that a gain is that on the same episodes.
    """
    weights = weights_of(rows, samples)
    table: dict[str, Any] = {}
    for condition in (*rows[0]["scores"], SOME, TOGETHER):
        table[condition] = {}
        first = None
        for tracker in {TOGETHER: MAIN, SOME: SEVERAL}.get(condition) or rows[0]["scores"][condition]:
            scores = [score_of(row, condition, tracker) for row in rows]
            line, drawn_values = with_intervals(scores, weights)
            table[condition][tracker] = line
            first = first or drawn_values
            for name in MEASURES:
                line[name + "_gain"] = interval(drawn_values[name] - first[name])
    return table


def with_intervals(scores: list[TrackingScore], weights: np.ndarray) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Return a line with 95 % intervals of all episodes together, and each measure over the draws, which weigh the episodes."""
    stacked = [np.array([getattr(one, name) for one in scores]) for name in FIELDS]
    many = [TrackingScore(*parts) for parts in zip(*(weights @ values for values in stacked), strict=True)]
    drawn = {name: np.array([getattr(one, name) for one in many]) for name in MEASURES}
    line = table_of(total(scores))
    for name, values in drawn.items():
        line[name + "_interval"] = interval(values)
    return line, drawn


def weights_of(rows: list[dict[str, Any]], samples: int = 1000) -> np.ndarray:
    """Return how often each of some bootstrap samples takes each episode, (samples, episodes)."""
    return draw_episodes(pd.Series("any garment", index=range(len(rows))), samples).to_numpy()[1:]


def score_of(row: dict[str, Any], condition: str, tracker: str) -> TrackingScore:
    """Return the score of an episode, in one condition or in several together."""
    if condition in row["scores"]:
        return unpack(row["scores"][condition][tracker])
    some = COMPARED if condition == SOME else row["scores"]
    return total([unpack(row["scores"][each][tracker]) for each in some])


def interval(values: np.ndarray) -> list[float]:
    """Return the middle 95 % of some values."""
    return np.percentile(values, [2.5, 97.5]).round(4).tolist()


def total(scores: list[TrackingScore]) -> TrackingScore:
    """Add scores, field by field."""
    return TrackingScore(*(np.sum([getattr(one, name) for one in scores], axis=0) for name in FIELDS))


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return all tables of the book."""
    garments = {name: [row for row in rows if garment_of(row) == name] for name in sorted(set(map(garment_of, rows)))}
    return {
        "episodes": [row["episode"] for row in rows],
        "scores": pooled(rows),
        "exact": {name: table_of(total([unpack(row["exact"][name]) for row in rows])) for name in rows[0]["exact"]},
        "by_garment": {garment: lines_of(mine) for garment, mine in garments.items()},
        "thresholds": thresholds(rows),
        "jumps": {garment: added_jumps(mine) for garment, mine in garments.items()},
        "given": {
            name: {key: median_of(row["given"][name][key] for row in rows) for key in rows[0]["given"][name]}
            for name in rows[0]["given"]
        },
        "places": {condition: where(rows, condition) for condition in rows[0]["places"]},
        "failures": listed([failure for row in rows for failure in row["failures"]]),
    }


def median_of(values: Iterable[float]) -> float:
    """Return the median of some numbers of films."""
    return round(float(np.median(list(values))), 4)


def lines_of(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return a line without intervals for each condition and tracker."""
    answer = {}
    for condition, trackers in rows[0]["scores"].items():
        scores = {name: [unpack(row["scores"][condition][name]) for row in rows] for name in trackers}
        answer[condition] = {name: table_of(total(some)) for name, some in scores.items()}
    return answer


def added_jumps(rows: list[dict[str, Any]]) -> dict[str, dict[str, list[int]]]:
    """Return the steps and the far jumps of some episodes together, by condition and place."""
    answer = {}
    for condition, places in rows[0]["jumps"].items():
        counts = {name: [row["jumps"][condition][name] for row in rows] for name in places}
        answer[condition] = {name: np.sum(some, axis=0).tolist() for name, some in counts.items()}
    return answer


def listed(failures: list[dict[str, Any]]) -> dict[str, Any]:
    """Return the failures as a table: switches of the paper's and of the recommended tracker, and runs of ten frames or more."""
    kept = [
        failure
        for failure in failures
        if (failure["kind"] == "switch" and failure["tracker"] in (PAPER, RECOMMENDED))
        or failure["last"] - failure["first"] >= 9
    ]
    return {"columns": list(failures[0]), "rows": [list(failure.values()) for failure in kept]}


def table_of(result: TrackingScore) -> dict[str, Any]:
    """Return a line without intervals."""
    # Shares of what is detected, and of what is there.
    precision = result.matches / max(result.detections, 1)
    shares = {"precision": precision, "recall": result.matches / max(result.objects, 1)}
    shares |= {name: getattr(result, name) for name in MEASURES}
    counted = {name: int(getattr(result, name)) for name in COUNTS}
    return counted | {name: round(float(value), 4) for name, value in shares.items()}


def thresholds(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return MOTA and IDF1 at other thresholds, to see whether the order of the trackers depends on it."""
    answer: dict[str, Any] = {"similarity": list(THRESHOLDS)}
    for condition, trackers in rows[0]["levels"].items():
        answer[condition] = {}
        for tracker in trackers:
            added = np.sum([row["levels"][condition][tracker] for row in rows], axis=0)
            objects, detections, matches, switches, right = added.T
            mota = 1 - (objects + detections - 2 * matches + switches) / objects
            idf1 = 2 * right / (objects + detections)
            answer[condition][tracker] = {"mota": mota.round(4).tolist(), "idf1": idf1.round(4).tolist()}
    return answer


def where(rows: list[dict[str, Any]], condition: str) -> dict[str, float]:
    """Return where the matches of a condition are."""
    names = ("metres", "radii", "outside")
    metres, radii, outside = (np.concatenate([row["places"][condition][name] for row in rows]) for name in names)
    return {
        "matches": len(metres),
        "median_mm": round(1000 * float(np.median(metres)), 1),
        "median_radii": round(float(np.median(radii)), 3),
        "in_hull": round(float((outside <= 1e-9).mean()), 4),
        "within_10_mm_of_hull": round(float((outside <= 0.01).mean()), 4),
    }


def garment_of(row: dict[str, Any]) -> str:
    """Return the garment of an episode or a failure."""
    return row["episode"].split("-")[0]


def resumed(
    paths: list[Path],
    results: Path,
    row_of: Callable[[Path, dict[str, Any]], dict[str, Any]],
    is_whole: Callable[[dict[str, Any]], bool] = bool,
) -> list[dict[str, Any]]:
    """Return a row for each episode, from a file where it is there and whole, and else computed and appended to the file.

    `row_of` gets the episode and what is known of its row. Delete the file after a change of the code.
    """
    lines = []
    if results.exists():
        lines = results.read_text(encoding="utf-8").splitlines()
    known = {row["episode"]: row for row in map(json.loads, lines)}
    for path in tqdm(paths, results.stem, unit="film"):
        row = known.get(path.stem, {})
        if not row or not is_whole(row):
            known[path.stem] = row_of(path, row)
            with results.open("a", encoding="utf-8") as file:
                file.write(json.dumps(known[path.stem]) + "\n")
    return [known[path.stem] for path in paths]


SHOWN = (
    ("miss", "all vertices", PAPER),
    ("false positive", "all vertices", PAPER),
    ("miss", "one camera", PAPER),
    ("false positive", "one camera", PAPER),
    ("switch", "noise of 10 mm", PAPER),
    ("switch", "one camera", RECOMMENDED),
)


def telling(failures: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return failures to show: of each kind in `SHOWN` the longest, rather of a garment that is not shown yet."""
    chosen: list[dict[str, Any]] = []
    for what in SHOWN:
        found = [one for one in failures if (one["kind"], one["condition"], one["tracker"]) == what]
        shown = {garment_of(one) for one in chosen}

        def rank(one: dict[str, Any], shown: set[str] = shown) -> tuple[Any, ...]:
            return garment_of(one) in shown, one["first"] - one["last"], one["episode"], one["first"]

        found.sort(key=rank)
        chosen += found[:1]
    return chosen


def film_of(episode: Episode, clouds: Clouds, stride: int, note: dict[str, Any], first: int = 0) -> Episode:
    """Return an episode of every `stride`-th frame whose observed points are some clouds; small ones are filled up by repeats."""
    rows = slice(first * stride, (first + len(clouds)) * stride, stride)
    arrays = {name: getattr(episode, name)[rows] for name in ("points", "actions", "grippers", "held")}
    most = max(len(cloud) for cloud in clouds)
    arrays["observed"] = np.array([cloud[np.resize(np.arange(len(cloud)), most)] for cloud in clouds])
    return dataclasses.replace(episode, **arrays, dt=episode.dt * stride, observation=note)


def clip(folder: Path, failure: dict[str, Any], path: Path, around: int = 3) -> None:
    """Save the frames around a failure as an episode, its observation what the tracker saw, and what the tracker said."""
    episode = load_episode(folder / f"{failure['episode']}.npz")
    clouds, stride = next((clouds, k) for name, clouds, k in conditions(episode) if name == failure["condition"])
    middle = (failure["first"] + failure["last"]) // 2 // stride  # of a switch, the first frame under the new name
    first = max(middle - around, 0)
    last = min(middle + around, len(clouds))
    follow = TRACKERS[failure["tracker"]]
    states = follow(clouds[:last], tk.rips_persistence_many(clouds[:last]))[first:]
    note = {**failure, "shown": middle - first}
    save_episode(path, film_of(episode, clouds[first:last], stride, note, first))
    save_states(path.with_suffix(".tracks.npz"), states)


def version() -> str:
    """Return the commit that made the rows, when there is one."""
    command = ["git", "describe", "--always", "--dirty"]
    done = subprocess.run(command, cwd=Path(__file__).parent, capture_output=True, text=True)
    return done.stdout.strip() or "unknown"


def main() -> None:
    """Simulate, track, score, write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=Path, required=True, help="folder of the episodes; outside the repository")
    parser.add_argument("--seeds", type=int, default=3, help="episodes a task (default 3: 63 in all)")
    parser.add_argument("--out", type=Path, help="file for all tables as JSON")
    parser.add_argument("--clips", type=Path, help="folder for a few frames around some failures")
    options = parser.parse_args()
    paths = simulated(options.episodes, range(options.seeds))
    rows = resumed(paths, options.episodes / "scores.jsonl", lambda path, _: row_of(path))
    command = f"python book/experiments/tracking.py --episodes DIR --seeds {options.seeds}"
    answer = {
        "command": f"{command} --out book/results/tracking.json",
        "made_with": {"topokit": version(), "machine": platform.machine()},
        "memory": MEMORY,
        "recommended": RECOMMENDED,
        **summary(rows),
    }
    if options.out:
        write_results(options.out, answer)
    if options.clips:
        options.clips.mkdir(parents=True, exist_ok=True)
        for number, failure in enumerate(telling([failure for row in rows for failure in row["failures"]])):
            clip(options.episodes, failure, options.clips / f"failure_{number}.npz")


if __name__ == "__main__":
    main()
