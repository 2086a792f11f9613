"""Hang strangers' garments, from a file to a film: book/results/garments.json.

    python book/experiments/garments.py --folder runs/bag --meshes FOLDER
    python book/experiments/garments.py --folder runs/strangers --bag strangers --out book/results/strangers.json
    python book/experiments/garments.py --folder runs/hung --bag strangers --command hang --out book/results/strangers_hang.json

Takes a film's simulation for each of 40 meshes; `--bag strangers` has the 30 of strangers.py instead, all of which can hang.

Writes a bag of 40 meshes as other tools would write them (OBJ, PLY, STL; metres, centimetres, millimetres, no unit; any axis up;
turned, remeshed, decimated, in pieces with doubled vertices, with half an annotation or none), some of which no cloth can be made
of, and gives each to one command, `topokit simulate --mesh FILE --task TARGET`. What each came to is appended to the results one
by one, and not done again. `--meshes FOLDER` adds meshes of others to the bag.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv
import strangers
import trimesh

from topokit.io import load_episode
from topokit.sim import WARDROBE, Garment

UNITS = {"m": 1.0, "cm": 100.0, "mm": 1000.0, "none": 3.7}  # what a metre is in the file


@dataclass(frozen=True)
class Case:
    """A mesh of the bag."""

    name: str
    write: Callable[[Path], Path]  #: writes it into a folder, and says which file is it
    target: str  #: what it is to hang on: hook, hanger or mannequin
    expected: str = "hangs"  #: or "refused"
    options: tuple[str, ...] = ()


def bag(meshes: Path | None) -> Iterator[Case]:
    """Return every case, in an order that never changes."""
    makes: list[tuple[str, Garment, str]] = [
        ("apron", WARDROBE["apron"](), "hook"),
        ("apron long", WARDROBE["apron"](body_height=0.6, strap_length=0.75, spacing=0.035), "hook"),
        ("apron small", WARDROBE["apron"](body_width=0.4, body_height=0.3, bib_width=0.22, bib_height=0.2), "hanger"),
        ("apron of two loops", WARDROBE["apron"](loops=2), "hook"),
        ("tote", WARDROBE["tote"](), "hook"),
        ("tote wide", WARDROBE["tote"](width=0.5, height=0.35), "hanger"),
        ("tote of two handles", WARDROBE["tote"](handles=2), "hook"),
        ("backpack", WARDROBE["backpack"](), "hook"),
        ("mask", WARDROBE["mask"](), "hook"),
        ("sheet with a hole", WARDROBE["sheet"](), "hook"),
        ("shirt", WARDROBE["shirt"](), "mannequin"),
        ("vest", WARDROBE["vest"](), "mannequin"),
    ]
    kinds = [".obj", ".ply", ".stl"]
    units = list(UNITS)
    ups = ["z", "y"]
    ways = ["plain", "turned", "coarser", "finer", "seams", "shuffled"]
    number = 0
    for turn in range(3):
        for name, garment, target in makes:
            if number == 33:
                break
            kind = kinds[(number + turn) % 3]
            unit = units[(number // 2 + turn) % 4]
            way = ways[(number + turn) % 6]
            up = ups[(number // 3 + turn) % 2]
            words = f"{name}, {way}, {unit}, {up} up"
            write = _writer(f"{number:02d}{kind}", garment, way, UNITS[unit], up, number)
            yield Case(words, write, target)
            number += 1
    sphere = pv.Sphere(radius=0.3)
    closed = trimesh.Trimesh(sphere.points, sphere.regular_faces, process=False)
    yield Case("a closed ball", lambda folder: _export(closed, folder / "ball.obj"), "hook", "refused")
    yield Case("a web page", lambda folder: _text(folder / "page.obj", "<!DOCTYPE html><p>sign in"), "hook", "refused")
    pointer = "version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 9\n"
    yield Case("a pointer file", lambda folder: _text(folder / "pointer.obj", pointer), "hook", "refused")
    scarf = pv.Plane(i_size=1.2, j_size=0.2, i_resolution=30, j_resolution=6).triangulate()
    flat = trimesh.Trimesh(scarf.points[:, [0, 2, 1]], scarf.regular_faces, process=False)
    yield Case("an open scarf", lambda folder: _export(flat, folder / "scarf.ply"), "hook", "refused")
    found = sorted(meshes.glob("*.obj")) if meshes else []
    for path in found[:3]:
        where = "mannequin" if "shirt" in path.name else "hook"
        yield Case(f"not ours: {path.stem}", lambda _, path=path: path, where)


def _writer(file: str, garment: Garment, way: str, unit: float, up: str, number: int) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        rng = np.random.default_rng(number)
        vertices = garment.vertices.copy()
        faces = garment.faces.astype(np.int64)
        if way == "turned":
            angle = rng.uniform(-0.4, 0.4)
            c = np.cos(angle)
            s = np.sin(angle)
            vertices = vertices @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + rng.normal(0, 2, 3)
        if way == "coarser":
            cut = pv.make_tri_mesh(vertices, faces).decimate_pro(0.3, preserve_topology=True)
            vertices = np.asarray(cut.points, float)
            faces = cut.regular_faces
        if way == "finer":
            long = np.linalg.norm(np.diff(vertices[faces[:, :2]], axis=1), axis=2).max()
            vertices, faces = trimesh.remesh.subdivide_to_size(vertices, faces, 1.2 * long)
        if way == "seams":  # pieces, each with vertices of its own
            piece = (vertices[faces].mean(axis=1)[:, 0] > 0).astype(int)
            pairs, ids = np.unique(np.column_stack([faces.ravel(), np.repeat(piece, 3)]), axis=0, return_inverse=True)
            vertices = vertices[pairs[:, 0]]
            faces = ids.reshape(-1, 3)
        if way == "shuffled":
            order = rng.permutation(len(vertices))
            vertices = vertices[order]
            faces = np.argsort(order)[faces]
            faces = rng.permutation(faces)
        vertices = unit * (vertices[:, [0, 2, 1]] * [1, 1, -1] if up == "y" else vertices)
        return _export(trimesh.Trimesh(vertices, faces, process=False), folder / file)

    return write


def _export(mesh: trimesh.Trimesh, path: Path) -> Path:
    mesh.export(path)
    return path


def _text(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


def bag_of_strangers() -> Iterator[Case]:
    """Return the garments of strangers.py."""
    for stranger in strangers.strangers():
        yield Case(stranger.name, stranger.write, stranger.target)


def outcome(case: Case, folder: Path, seed: int, command: str) -> dict[str, Any]:
    """Run the command on a mesh and return the outcome."""
    mesh = case.write(folder)
    film = folder / "episodes" / f"{case.name.replace(' ', '_').replace(',', '')}.npz"
    film.parent.mkdir(exist_ok=True)
    asked = [
        command,
        "--mesh",
        str(mesh),
        "--task",
        case.target,
        "--seed",
        str(seed),
        "--out",
        str(film),
        *case.options,
    ]
    began = time.perf_counter()
    run = subprocess.run([sys.executable, "-m", "topokit", *asked, "--json"], capture_output=True, text=True)
    row: dict[str, Any] = {"mesh": case.name, "file": mesh.name, "target": case.target, "expected": case.expected}
    row["seconds"] = round(time.perf_counter() - began, 1)
    if not run.stdout:  # 2: it was refused; 1: the simulation failed
        said = [line for line in run.stderr.splitlines() if line.strip()]
        what = "refused" if run.returncode == 2 else "does not hang"
        return row | {"outcome": what, "said": said[-1].replace(str(mesh), mesh.name) if said else ""}
    answer = json.loads(run.stdout)
    episode = load_episode(film)
    row |= {"outcome": "hangs" if answer["success"] else "does not hang", "loops": [*episode.named_loops]}
    if not answer["success"]:
        row["said"] = answer["reason"]
    return row | {
        "vertices": episode.points.shape[1],
        "frames": len(episode),
        "lowest": float(episode.points[-1, :, 2].min()),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, required=True, help="where meshes and episodes are written")
    parser.add_argument("--meshes", type=Path, help="folder with OBJ files of others")
    parser.add_argument("--bag", choices=["ours", "strangers"], default="ours")
    parser.add_argument("--command", choices=["simulate", "hang"], default="simulate")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("book/results/garments.json"))
    parser.add_argument("--only", help="cases whose name has this in it")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    rows = json.loads(options.out.read_text())["meshes"] if options.out.exists() else []
    done = {row["mesh"] for row in rows}
    cases = bag_of_strangers() if options.bag == "strangers" else bag(options.meshes)
    for case in cases:
        if case.name in done or (options.only or "") not in case.name:
            continue
        rows.append(outcome(case, options.folder, options.seed, options.command))
        print(json.dumps(rows[-1]), flush=True)
        counts = {what: sum(row["outcome"] == what for row in rows) for what in ("hangs", "does not hang", "refused")}
        options.out.write_text(json.dumps({"seed": options.seed, **counts, "meshes": rows}, indent=1) + "\n")


if __name__ == "__main__":
    main()
