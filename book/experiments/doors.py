"""Time neighbours and topokit at the same work: book/results/doors.json.

    python book/experiments/doors.py

Takes some minutes on one core.

Writes book/results/doors.json and the table of book/coming_from.md; needs `pip install ripser` beside topokit[all]. One
core, one thread. Each work is done by both in turn, `--repeat` times after a turn that is not counted; the least counts, of the
processor's time, which other programs stretch less.
"""

from __future__ import annotations

import argparse
import datetime as dt
import importlib.metadata
import json
import os
import platform
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np
import torch
from sklearn.ensemble import RandomForestClassifier
from sklearn.model_selection import StratifiedGroupKFold, cross_val_score
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import FunctionTransformer

import topokit as tk
from topokit._archive import atomic_file
from topokit.data import Dataset

from _rips_clouds import cloud
from _rips_tables import processor

ROOT = Path(__file__).parents[2]
MARKS = ("<!-- python book/experiments/doors.py -->", "<!-- until here -->")
Work = tuple[str, Callable[[], Any], Callable[[], Any]]


def works() -> dict[str, Work]:
    """Return by the neighbour's name what is done, there and here; both give the same numbers."""
    import gudhi
    from ripser import ripser as theirs

    apron = cloud("apron", 500)
    small = cloud("apron", 150)

    def generators(points: np.ndarray) -> Any:
        tree = gudhi.RipsComplex(points=points).create_simplex_tree(max_dimension=2)
        tree.compute_persistence()
        return tree.flag_persistence_generators()

    def our_generators(points: np.ndarray) -> Any:
        diagram = tk.rips_persistence(points)
        return [np.hstack([diagram.birth_edge[:, ::-1], diagram.killer_edge[:, ::-1]])]

    def gradient(edges: Any) -> Any:
        points = torch.tensor(small, requires_grad=True)
        ends = torch.tensor(edges).reshape(-1, 2, 2)
        bars = (points[ends[..., 0]] - points[ends[..., 1]]).norm(dim=-1) / 2
        (bars[:, 1] - bars[:, 0]).sum().backward()
        return points.grad

    return {
        "ripser.py": (
            "degrees 0 and 1 of 500 points",
            lambda: theirs(apron)["dgms"][1],
            lambda: 2 * our_bars(apron),
        ),
        "GUDHI": (
            "generators of 150 points, which need all triangles",
            lambda: generators(small)[1][0],
            lambda: our_generators(small)[0],
        ),
        "PyTorch": (
            "a gradient, 150 points, generators by GUDHI",
            lambda: gradient(generators(small)[1][0]),
            lambda: gradient(our_generators(small)[0]),
        ),
    }


def alike(one: Any, other: Any) -> bool:
    """Return whether two arrays hold the same rows, whatever their order; Ripser's numbers are float32."""
    a, b = (np.asarray(part, float) for part in (one, other))
    return a.shape == b.shape and np.allclose(
        *(part[np.lexsort(part.T.round(4))] for part in (a, b)), rtol=1e-4, atol=1e-6
    )


def our_bars(points: np.ndarray) -> np.ndarray:
    """Return births and deaths by topokit."""
    diagram = tk.rips_persistence(points)
    return np.column_stack([diagram.birth, diagram.death])


def bars_of_ripser(points: np.ndarray) -> np.ndarray:
    """Return births and deaths by ripser.py, in half lengths."""
    from ripser import ripser

    return ripser(points)["dgms"][1] / 2


def loop_features(clouds: Any, find_bars: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Return birth and lifetime of the six longest-lived loops of each cloud."""
    rows = np.zeros((len(clouds), 6, 2))
    for row, points in zip(rows, clouds, strict=True):
        bars = find_bars(points)
        bars = bars[np.argsort(bars[:, 0] - bars[:, 1], kind="stable")][:6]
        row[: len(bars)] = np.column_stack([bars[:, 0], bars[:, 1] - bars[:, 0]])
    return rows.reshape(len(rows), -1)


def garments(find_bars: Callable[[np.ndarray], np.ndarray]) -> dict[str, Any]:
    """Classify garments by the loops of their clouds, cross-validated by episode; return seconds and accuracy."""
    folders = [Dataset(ROOT / "data_small" / name) for name in ("dataset", "motion")]
    films = [data[i] for data in folders for i in data.episodes]
    kinds = [film.garment for film in films]
    films = [film for film in films if kinds.count(film.garment) > 3]
    frames = [(film.observed[t], film.garment, i) for i, film in enumerate(films) for t in range(0, len(film), 12)]
    clouds, garment, episode = map(list, zip(*frames, strict=True))
    features = FunctionTransformer(loop_features, kw_args={"find_bars": find_bars})
    model = make_pipeline(features, RandomForestClassifier(random_state=0))
    began = time.process_time()
    scores = cross_val_score(model, clouds, garment, groups=episode, cv=StratifiedGroupKFold(4))
    most = max(map(garment.count, set(garment))) / len(garment)
    told = {"clouds": len(clouds), "episodes": len(films), "kinds": len(set(garment)), "most_frequent": most}
    return {"seconds": time.process_time() - began, "score": float(scores.mean()), **told}


def least(work: Callable[[], Any], times: int) -> float:
    """Return the milliseconds of the quickest of some turns."""
    found = []
    for _ in range(times):
        began = time.process_time()
        work()
        found.append(1e3 * (time.process_time() - began))
    return min(found)


def measured(repeat: int) -> dict[str, Any]:
    rows = []
    for name, (what, there, here) in works().items():
        assert alike(there(), here()), f"{name}: not the same numbers"
        turns = [(least(there, 1), least(here, 3)) for _ in range(repeat)]
        rows.append(
            {"neighbour": name, "what": what, "there_ms": min(t for t, _ in turns), "here_ms": min(h for _, h in turns)}
        )
        print(rows[-1])
    packages = ("topokit", "ripser", "gudhi", "scikit-learn", "torch")
    versions = {name: importlib.metadata.version(name) for name in packages if name != "topokit"} | {
        "topokit": tk.__version__
    }
    return {
        "command": "python book/experiments/doors.py",
        "date": str(dt.datetime.now(dt.timezone.utc).date()),
        "machine": {"processor": processor(), "python": platform.python_version(), "versions": versions},
        "rows": rows,
        "garments": {"topokit": garments(our_bars), "ripser.py": garments(bars_of_ripser)},
    }


def table(found: dict[str, Any]) -> str:
    """Return the part of the page that the results fill."""
    one = found["garments"]["topokit"]
    other = found["garments"]["ripser.py"]
    versions = ", ".join(f"{name} {version}" for name, version in found["machine"]["versions"].items())
    lines = [f"({found['machine']['processor']}, one core, {found['date']}; {versions}.)", ""]
    lines += ["| neighbour | work | there | here |", "|---|---|---|---|"]
    for row in found["rows"]:
        lines.append(f"| {row['neighbour']} | {row['what']} | {row['there_ms']:,.3g} ms | {row['here_ms']:,.3g} ms |")
    what = f"{one['clouds']} clouds of {one['episodes']} episodes, {one['kinds']} garments, cross-validated"
    lines.append(f"| scikit-learn, bars by ripser.py | {what} | {other['seconds']:.3g} s | {one['seconds']:.3g} s |")
    told = (
        f"{100 * one['score']:.0f} % of the clouds are told right, with bars by ripser.py {100 * other['score']:.0f} %"
    )
    lines += [
        "",
        f"In the last row {told}; always saying the most frequent garment, {100 * one['most_frequent']:.0f} %.",
    ]
    return "\n".join(lines)


def paged(page: str, found: dict[str, Any]) -> str:
    """Return a page with the part between its two marks made anew."""
    before, rest = page.split(MARKS[0])
    return f"{before}{MARKS[0]}\n{table(found)}\n{MARKS[1]}{rest.split(MARKS[1])[1]}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--out", type=Path, default=ROOT / "book" / "results" / "doors.json")
    options = parser.parse_args()
    found = measured(options.repeat)
    with atomic_file(options.out) as file:
        file.write((json.dumps(found, indent=1) + "\n").encode())
    page = ROOT / "book" / "coming_from.md"
    page.write_text(paged(page.read_text(), found))


if __name__ == "__main__":
    main()
