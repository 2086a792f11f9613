"""Count the loops that removing a table adds to cloth that lies on it: book/results/on_a_table.json.

    python book/experiments/on_a_table.py

Takes 10 minutes on one core. Rectangles of cloth without a hole are let down, pushed together or folded on a floor, and a depth
camera with noise sees each from a side. Some show a gap under a fold, which is a loop of what the camera sees. So four clouds of
each frame are tracked: the pixels of the cloth itself, which a real camera does not tell apart; all pixels without the plane
(`Pipeline(planes=1)`); all pixels a centimetre or more above the floor; all pixels. Loops of the second that the first does not
have come from removing the plane.
"""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from tables import write_results

import topokit as tk
from topokit.sensors import Cleaner, Pipeline
from topokit.sim import WARDROBE, Camera, Cloth, World

OUT = Path(__file__).parents[1] / "results" / "on_a_table.json"
WAYS = ("let down", "pushed", "folded")
FLOOR = 0.03  # metres above the floor at which cloth is released
FRAME = 0.02  # seconds between the places of the grippers
CLOUDS = ("its own pixels", "without the plane", "above a centimetre", "all pixels")

Points = NDArray[np.float64]


def path_of(way: str, start: Points, size: NDArray[np.float64], rng: np.random.Generator) -> Points:
    """Return the places (n, 2, 3) of the grippers, from those at the start."""
    share = np.linspace(0, 1, 100)[:, None, None]
    up = np.array([0.0, 0.0, 1.0])
    if way == "let down":
        wait = np.repeat(start[None], 50, axis=0)
        return np.concatenate([wait, start - share[::2] * (start[0, 2] - FLOOR) * up])
    if way == "pushed":
        by = rng.uniform(0.2, 0.5)
        goal = start * [1 - by, 1, 1] - [0, by * size[1] * rng.uniform(0, 0.6), 0]
        return start + (goal - start) * share + FLOOR * np.sin(np.pi * share) * up
    over = rng.uniform(0.5, 0.95) * size[1]
    askew = rng.uniform(-0.15, 0.15) * size[1]
    goal = start + [[0, askew - over, 0], [0, -askew - over, 0]]
    return start + (goal - start) * (1 - np.cos(np.pi * share)) / 2 + over / 2 * np.sin(np.pi * share) * up


def frame(seed: int, way: str) -> tuple[Points, NDArray[np.bool_], Camera]:
    """Return what a camera sees (n, 3) of cloth on the floor, which points are cloth, and the camera."""
    rng = np.random.default_rng(seed)
    size = rng.uniform(0.3, 0.55, 2)
    sheet = WARDROBE["sheet"](holes=0, width=size[0], height=size[1], spacing=0.03)
    flat = sheet.vertices[:, [0, 2, 1]] + [0, size[1] / 2, 0]
    corners = size / 2 * [[-1, 1], [1, 1]]
    if way == "let down":  # from a hand that holds it at one place
        grips = np.linalg.norm(flat - rng.choice(flat), axis=1).argsort()[:2]
        lift = 0.6
    else:
        grips = np.linalg.norm(flat[:, None, :2] - corners, axis=2).argmin(axis=0)
        lift = FLOOR
    sheet = dataclasses.replace(sheet, vertices=flat, faces=sheet.faces[:, ::-1], grips=grips)
    kinds = list(Cloth.KINDS.values())
    config = kinds[seed % len(kinds)].config(sheet)

    # Move the cloth, let it go and come to rest.
    start = flat[grips] + [0, 0, lift]
    with World(sheet, np.array([0, 0, lift]), config) as world:
        for places in path_of(way, start, size, rng):
            for _ in range(round(FRAME / config.dt)):
                world.step(places)
        world.release()
        for _ in range(round(1.2 / config.dt)):
            world.step(None)
        middle = world.vertices().mean(axis=0)
        angle = rng.uniform(0, 2 * np.pi)
        eye = middle + [0.5 * np.cos(angle), 0.5 * np.sin(angle), 0.75]
        camera = Camera(eye=tuple(eye), target=tuple(middle), width=640, height=480, noise=1.0)
        depth, cloth = world.image(camera)

    # The same noise for the picture and for the mask of the cloth.
    noisy, seen = camera.add_noise(depth, np.isfinite(depth), np.random.default_rng(seed))
    _, of_cloth = camera.add_noise(depth, cloth, np.random.default_rng(seed))
    return camera.unproject(noisy, seen), of_cloth[seen], camera


def loops_in(points: Points) -> int:
    """Return how many loops the farthest points of a single cloud have."""
    return len(tk.track([Cleaner()(points)])[0])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=42)
    parser.add_argument("--out", type=Path, default=OUT)
    options = parser.parse_args()
    frames = []
    for seed in range(options.frames):
        way = WAYS[seed % len(WAYS)]
        points, of_cloth, camera = frame(seed, way)
        without = Cleaner(Pipeline(planes=1, eye=camera.eye, points=None))(points)
        clouds = (points[of_cloth], without, points[points[:, 2] > 0.01], points)
        found = dict(zip(CLOUDS, map(loops_in, clouds), strict=True))
        frames.append({"seed": seed, "way": way, "loops": found, "kept": round(len(without) / int(of_cloth.sum()), 3)})
        print(frames[-1], flush=True)
    counts = np.array([[row["loops"][name] for name in CLOUDS] for row in frames])
    totals = {
        "frames": len(frames),
        "frames with loops": dict(zip(CLOUDS, (counts > 0).sum(axis=0).tolist(), strict=True)),
        "frames with more loops than its own pixels": dict(
            zip(CLOUDS, (counts > counts[:, :1]).sum(axis=0).tolist(), strict=True)
        ),
        "points kept beside those of the cloth": round(float(np.mean([row["kept"] for row in frames])), 3),
    }
    write_results(options.out, {"made_with": {"topokit": tk.__version__}, "totals": totals, "by_frame": frames})
    print(totals)


if __name__ == "__main__":
    main()
