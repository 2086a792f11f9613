"""Make the films of the tracking benchmark, and score anyone's tracks of them.

    python book/experiments/tracking_benchmark.py make --episodes DIR --films FILMS
    python book/experiments/tracking_benchmark.py seqph --films FILMS --tracks TRACKS
    python book/experiments/tracking_benchmark.py score --films FILMS --tracks TRACKS --out scores.csv
    python book/experiments/tracking_benchmark.py export --films FILMS --tracks TRACKS --out FOLDER --name mine

`make` simulates the 63 episodes of chapter 8 where they are missing (about ten seconds each), and writes each in 20 conditions
to FILMS/condition/film.npz: an episode whose observed points are what a tracker may see, with the true loops. Clouds of other
sizes are filled up by repeating points. Beside it lies film.gt.txt, the true loops in the format of MOTChallenge.

`score` reads TRACKS/condition/film.csv with the columns frame, id, x, y, z (frames from 0, metres), or film.txt as MOTChallenge
has it: frame (from 1), id, four numbers of a box, a confidence, x, y, z. A film.txt of nine columns is one that `export` wrote.
A film without a file has no tracks.
`seqph` writes the tracks of topokit's default in the first format. `export` writes truth and tracks into the folders that
TrackEval reads; `trackeval_dataset` is the class that makes it score loops. The page *A benchmark of trackers* has the rules.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
from tqdm import tqdm
from tracking import MEASURES, film_of, simulated

import topokit as tk
from topokit.evaluate import TrackingScore, TrueLoops, compare, score, true_loops
from topokit.io import Episode, load_episode, save_episode

from _tracking_clouds import Clouds, conditions

SEEDS = 3
COLUMNS = ["frame", "id", "x", "y", "z"]
MOT_COLUMNS = ["frame", "id", "left", "top", "width", "height", "confidence", "x", "y", "z"]
SUFFIXES = (".csv", ".txt")  # of files with tracks
EXPORTED_COLUMNS = [*COLUMNS, "radius", "confidence", "kind", "seen"]
TRUTHS: dict[bytes, list[TrueLoops]] = {}
"""The true loops of films by their points. An episode has the same ones in nineteen conditions."""


def slug(condition: str) -> str:
    """Return the name of a condition's folder."""
    return condition.replace(",", "").replace("%", "percent").replace("'", "").replace(" ", "-")


def make(episodes: Path, films: Path) -> None:
    """Write all films, and their true loops in the format of MOTChallenge."""
    for path in tqdm(simulated(episodes, range(SEEDS)), "films", unit="episode"):
        episode = load_episode(path)
        for condition, clouds, stride in conditions(episode):
            out = films / slug(condition) / path.name
            if out.exists():
                continue
            out.parent.mkdir(parents=True, exist_ok=True)
            note = {"condition": condition, "sizes": [len(cloud) for cloud in clouds], "stride": stride}
            film = film_of(episode, clouds, stride, note)
            truth_table(film).to_csv(out.with_suffix(".gt.txt"), header=False, index=False)
            save_episode(out, film)


def truth_of(film: Episode) -> list[TrueLoops]:
    """Return the true loops of a film; they are computed once for the same points."""
    key = film.points.tobytes()
    if key not in TRUTHS:
        TRUTHS[key] = true_loops(film.points, film.loops)
    return TRUTHS[key]


def truth_table(film: Episode) -> pd.DataFrame:
    """Return a row for each true loop and frame in which it is present, with the columns of MOTChallenge."""
    rows = [
        (frame + 1, loop + 1, -1, -1, -1, -1, 1, *true.centres[loop])
        for frame, true in enumerate(truth_of(film))
        for loop in np.flatnonzero(true.present).tolist()
    ]
    return pd.DataFrame(rows, columns=MOT_COLUMNS).round(5)


def clouds_of(film: Episode) -> Clouds:
    """Return the clouds of a film without the repeated points at their ends."""
    sizes = film.observation["sizes"]
    return [cloud[:size].astype(float) for cloud, size in zip(film.observed, sizes, strict=True)]


def exported_truth(film: Episode) -> pd.DataFrame:
    """Return a row for each true loop and frame, as TrackEval reads it: x, y, z and the radius stand for a box.

    A loop that is closed in a frame has the class of a distractor, 8: TrackEval then leaves out a track that fits it.
    """
    rows = [
        (frame + 1, loop + 1, *true.centres[loop], true.radii[loop], int(present), 1 if present else 8, 1)
        for frame, true in enumerate(truth_of(film))
        for loop, present in enumerate(true.present.tolist())
    ]
    return pd.DataFrame(rows).round(6)


def export(films: Path, tracks: Path, out: Path, name: str) -> None:
    """Write truth and tracks into the folders of TrackEval, a benchmark for each condition, as MOTChallenge has them."""
    for condition, path in tqdm(list(films_in(films)), "export", unit="film"):
        film = load_episode(path)
        benchmark = f"{condition}-all"
        truth = out / "gt" / benchmark / path.stem / "gt" / "gt.txt"
        mine = out / "trackers" / benchmark / name / "data" / f"{path.stem}.txt"
        sequences = out / "gt" / "seqmaps" / f"{benchmark}.txt"
        for file in (truth, mine, sequences):
            file.parent.mkdir(parents=True, exist_ok=True)
        exported_truth(film).to_csv(truth, header=False, index=False)
        (truth.parents[1] / "seqinfo.ini").write_text(f"[Sequence]\nname={path.stem}\nseqLength={len(film)}\n")
        names = sorted(each.stem for each in path.parent.glob("*.npz"))
        sequences.write_text("\n".join(["name", *names]) + "\n")

        # The fourth number of a track's box is not used: a tracker does not know the radius.
        table = tracks_of(tracks / condition, path.stem, len(film))
        table = table.assign(frame=table["frame"] + 1, radius=0, confidence=1, kind=1, seen=1)
        table[EXPORTED_COLUMNS].to_csv(mine, header=False, index=False)


def trackeval_dataset() -> type[Any]:
    """Return a class that makes TrackEval score exported loops: MOTChallenge's, with the similarity of this benchmark."""
    from trackeval.datasets import MotChallenge2DBox

    class Loops(MotChallenge2DBox):  # type: ignore[misc]
        """Loops of a film: a box is x, y, z and a radius."""

        def _calculate_similarities(self, truth: np.ndarray, tracks: np.ndarray) -> np.ndarray:
            distance = np.linalg.norm(truth[:, None, :3] - tracks[None, :, :3], axis=2)
            return np.maximum(1 - distance / (2 * truth[:, None, 3]), 0)

    return Loops


def films_in(folder: Path) -> Iterator[tuple[str, Path]]:
    """Yield condition and path of each film."""
    paths = sorted(folder.glob("*/*.npz"))
    if not paths:
        raise FileNotFoundError(f"{folder}: no film at */*.npz; the command make writes them")
    for path in paths:
        yield path.parent.name, path


def write_seqph(films: Path, tracks: Path) -> None:
    """Write the tracks of topokit's default tracker."""
    for condition, path in tqdm(list(films_in(films)), "seqPH", unit="film"):
        states = tk.track(clouds_of(load_episode(path)), n_jobs=1)
        rows = [(state.frame, loop.id, *loop.centre) for state in states for loop in state.loops]
        out = tracks / condition / f"{path.stem}.csv"
        out.parent.mkdir(parents=True, exist_ok=True)
        pd.DataFrame(rows, columns=COLUMNS).round(5).to_csv(out, index=False)


def read_tracks(path: Path, frames: int) -> pd.DataFrame:
    """Read tracks in any of the formats; frames are numbered from 0. An empty file has no tracks.

    Raises
    ------
    ValueError
        When a column is missing, a value is no number, a frame is not in the film, or a frame has an identity twice.
    """
    if not path.stat().st_size:
        return pd.DataFrame(columns=COLUMNS)
    if path.suffix == ".txt":
        table = pd.read_csv(path, header=None)
        columns = EXPORTED_COLUMNS if table.shape[1] == len(EXPORTED_COLUMNS) else MOT_COLUMNS
        table = table.rename(columns=dict(enumerate(columns)))
        table["frame"] -= 1
    else:
        table = pd.read_csv(path)
    missing = [column for column in COLUMNS if column not in table]
    if missing:
        raise ValueError(f"{path}: the column {missing[0]} is missing; wanted are {', '.join(COLUMNS)}")
    table = table[COLUMNS].apply(pd.to_numeric, errors="coerce")
    bad = ~np.isfinite(table).all(axis=1)
    bad |= (table["frame"] < 0) | (table["frame"] >= frames) | (table[["frame", "id"]] % 1 != 0).any(axis=1)
    bad |= table.duplicated(["frame", "id"])
    if bad.any():
        row = int(np.flatnonzero(bad)[0])
        raise ValueError(
            f"{path}: row {row + 1} has no place, a frame that is not among the {frames} of the film, "
            "an identity that is no whole number, or one that its frame has already"
        )
    return table


def tracks_of(folder: Path, film: str, frames: int) -> pd.DataFrame:
    """Return the tracks of a film in a folder, from a file in any of the formats; none when there is no file."""
    for suffix in SUFFIXES:
        path = folder / f"{film}{suffix}"
        if path.exists():
            return read_tracks(path, frames)
    return pd.DataFrame(columns=COLUMNS)


def score_film(film: Episode, table: pd.DataFrame) -> TrackingScore:
    """Return the score of tracks of a film."""
    states: list[Any] = []
    for frame in range(len(film)):
        rows = table[table["frame"] == frame]
        loops = [SimpleNamespace(id=int(row.id), centre=np.array([row.x, row.y, row.z])) for row in rows.itertuples()]
        states.append(SimpleNamespace(loops=loops))
    return score(compare(states, truth_of(film)))


def score_all(films: Path, tracks: Path) -> pd.DataFrame:
    """Return a row for each condition: films, films with tracks, measures and switches of all films together."""
    films_found = list(films_in(films))
    if not any(
        (tracks / condition / (path.stem + end)).exists() for condition, path in films_found for end in SUFFIXES
    ):
        raise FileNotFoundError(
            f"{tracks}: no tracks of any film; wanted is CONDITION/FILM.csv, with the names of {films}"
        )
    totals: dict[str, TrackingScore] = {}
    counts: dict[str, list[int]] = {}
    for condition, path in tqdm(films_found, "scores", unit="film"):
        film = load_episode(path)
        table = tracks_of(tracks / condition, path.stem, len(film))
        reached = score_film(film, table)
        totals[condition] = totals[condition] + reached if condition in totals else reached
        count = counts.setdefault(condition, [0, 0])
        count[0] += 1
        count[1] += not table.empty
    rows = [
        {
            "condition": condition,
            "films": counts[condition][0],
            "with tracks": counts[condition][1],
            **{name: round(float(getattr(reached, name)), 4) for name in MEASURES},
            "switches": int(reached.switches),
        }
        for condition, reached in totals.items()
    ]
    return pd.DataFrame(rows)


def main(arguments: Sequence[str] | None = None) -> int:
    """Make films, write tracks, score tracks, or export them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("command", choices=("make", "seqph", "score", "export"))
    parser.add_argument("--episodes", type=Path, help="folder for the simulated episodes (make)")
    parser.add_argument("--films", type=Path, required=True, help="folder of the films")
    parser.add_argument("--tracks", type=Path, help="folder of the tracks (seqph, score, export)")
    parser.add_argument("--out", type=Path, help="file for the scores as CSV (score), or folder for TrackEval (export)")
    parser.add_argument("--name", default="mine", help="name of the tracker (export)")
    options = parser.parse_args(arguments)
    needed = {"make": ["episodes"], "export": ["tracks", "out"]}.get(options.command, ["tracks"])
    for name in needed:
        if getattr(options, name) is None:
            parser.error(f"{options.command} needs --{name}")
    if options.command == "make":
        make(options.episodes, options.films)
        return 0
    if options.command == "seqph":
        write_seqph(options.films, options.tracks)
        return 0
    try:
        if options.command == "export":
            export(options.films, options.tracks, options.out, options.name)
            return 0
        table = score_all(options.films, options.tracks)
    except (ValueError, FileNotFoundError) as error:
        print(error, file=sys.stderr)
        return 1
    print(table.to_string(index=False))
    if options.out:
        table.to_csv(options.out, index=False)
    return 0


if __name__ == "__main__":
    sys.exit(main())
