"""Make the films of the tracking benchmark, and score anyone's tracks of them.

    python book/experiments/tracking_benchmark.py make --episodes DIR --films FILMS
    python book/experiments/tracking_benchmark.py seqph --films FILMS --tracks TRACKS
    python book/experiments/tracking_benchmark.py score --films FILMS --tracks TRACKS --out scores.csv

`make` simulates the 63 episodes of chapter 8 where they are missing (about ten seconds each). It writes each of them in 20
conditions to FILMS/condition/film.npz: an episode whose observed points are what a tracker may see, with the true loops.
`seqph` writes the tracks of topokit's default. `score` reads TRACKS/condition/film.csv with the columns frame, id, x, y, z
(frames from 0, metres); a film without a file has no tracks. The page *A benchmark of trackers* has the rules.
"""

import argparse
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
from tqdm import tqdm
from tracking import MEASURES, film_of, simulated

import topokit as tk
from topokit.evaluate import compare, score, true_loops
from topokit.evaluate._scores import TrackingScore
from topokit.io import Episode, load_episode, save_episode

from _tracking_clouds import Clouds, conditions

SEEDS = 3
COLUMNS = ["frame", "id", "x", "y", "z"]


def slug(condition: str) -> str:
    """Return the name of a condition's folder."""
    return condition.replace(",", "").replace("%", "percent").replace("'", "").replace(" ", "-")


def make(episodes: Path, films: Path) -> None:
    """Write all films that are missing."""
    for path in tqdm(simulated(episodes, range(SEEDS)), "films", unit="episode"):
        episode = load_episode(path)
        for condition, clouds, stride in conditions(episode):
            out = films / slug(condition) / path.name
            if not out.exists():
                out.parent.mkdir(parents=True, exist_ok=True)
                note = {"condition": condition, "sizes": [len(cloud) for cloud in clouds], "stride": stride}
                save_episode(out, film_of(episode, clouds, stride, note))


def clouds_of(film: Episode) -> Clouds:
    """Return the clouds of a film without the repeated points at their ends."""
    sizes = film.observation["sizes"]
    return [cloud[:size].astype(float) for cloud, size in zip(film.observed, sizes, strict=True)]


def films_in(folder: Path) -> Iterator[tuple[str, Path]]:
    """Yield condition and path of each film."""
    for path in sorted(folder.glob("*/*.npz")):
        yield path.parent.name, path


def write_seqph(films: Path, tracks: Path) -> None:
    """Write the tracks of topokit's default tracker."""
    for condition, path in tqdm(list(films_in(films)), "seqPH", unit="film"):
        states = tk.track(clouds_of(load_episode(path)))
        rows = [(state.frame, loop.id, *loop.centre) for state in states for loop in state.loops]
        out = tracks / condition / f"{path.stem}.csv"
        out.parent.mkdir(parents=True, exist_ok=True)
        pd.DataFrame(rows, columns=COLUMNS).round(5).to_csv(out, index=False)


def read_tracks(path: Path) -> pd.DataFrame:
    """Read the tracks of a film; there are none where there is no file.

    Raises
    ------
    ValueError
        When a frame has an identity twice.
    """
    if not path.exists():
        return pd.DataFrame(columns=COLUMNS)
    table = pd.read_csv(path)[COLUMNS]
    twice = np.flatnonzero(table.duplicated(["frame", "id"]))
    if len(twice):
        raise ValueError(f"{path}: row {twice[0] + 1} has an identity that its frame has already")
    return table


def score_film(film: Episode, table: pd.DataFrame) -> TrackingScore:
    """Return the score of tracks of a film."""
    states: list[Any] = []
    for frame in range(len(film)):
        rows = table[table["frame"] == frame]
        loops = [SimpleNamespace(id=int(row.id), centre=np.array([row.x, row.y, row.z])) for row in rows.itertuples()]
        states.append(SimpleNamespace(loops=loops))
    return score(compare(states, true_loops(film.points, film.loops)))


def score_all(films: Path, tracks: Path) -> pd.DataFrame:
    """Return a row for each condition: films, films with tracks, measures and switches of all films together."""
    totals: dict[str, TrackingScore] = {}
    counts: dict[str, list[int]] = {}
    for condition, path in tqdm(list(films_in(films)), "scores", unit="film"):
        table = read_tracks(tracks / condition / f"{path.stem}.csv")
        reached = score_film(load_episode(path), table)
        totals[condition] = totals[condition] + reached if condition in totals else reached
        count = counts.setdefault(condition, [0, 0])
        count[0] += 1
        count[1] += not table.empty

    rows = []
    for condition, reached in totals.items():
        row = {"condition": condition, "films": counts[condition][0], "with tracks": counts[condition][1]}
        row |= {name: round(float(getattr(reached, name)), 4) for name in MEASURES}
        rows.append(row | {"switches": int(reached.switches)})
    return pd.DataFrame(rows)


def main(arguments: Sequence[str] | None = None) -> None:
    """Make films, write tracks, or score tracks."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=("make", "seqph", "score"))
    parser.add_argument("--episodes", type=Path, help="folder for the simulated episodes (make)")
    parser.add_argument("--films", type=Path, required=True, help="folder of the films")
    parser.add_argument("--tracks", type=Path, help="folder of the tracks (seqph, score)")
    parser.add_argument("--out", type=Path, help="file for the scores as CSV (score)")
    options = parser.parse_args(arguments)
    if options.command == "make":
        make(options.episodes, options.films)
    elif options.command == "seqph":
        write_seqph(options.films, options.tracks)
    else:
        table = score_all(options.films, options.tracks)
        print(table.to_string(index=False))
        if options.out:
            table.to_csv(options.out, index=False)


if __name__ == "__main__":
    main()
