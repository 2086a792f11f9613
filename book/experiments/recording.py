"""Film the recorded apron as a depth camera would: 48 depth images, to walk the path "a recording to tracks".

    python book/experiments/recording.py --out runs/recording

A camera of 640 by 480 pixels looks at the apron from the side. Two hands hold it, a hook is in front of a wall, and a table is
below. Depths are whole millimetres, with the noise and the lost pixels of a sensor. `--picture FILE` draws the film as the
tracker gets it with no cleaning, with a box, and with all steps (book/_static/recording.png).
"""

import argparse
import json
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

import topokit as tk
from topokit import view
from topokit.io import load_episode
from topokit.sensors import Cleaner, read_clouds
from topokit.sim import Camera, Hook

ROOT = Path(__file__).parents[2]
EVERY = 2  # frames of the recorded episode from one image to the next
CAMERA = Camera((-0.7, -1.9, 1.35), (0.05, 0.1, 0.95), fov=45, width=640, height=480)
FOCAL = CAMERA.height / 2 / np.tan(np.radians(CAMERA.fov) / 2)  # pixels
LENS = {"fx": FOCAL, "fy": FOCAL, "cx": CAMERA.width / 2, "cy": CAMERA.height / 2}
WALL, TABLE = 0.8, 0.1  # metres: the plane y = 0.8 and the plane z = 0.1
HAND, SLEEVE = 0.03, 0.4  # radius and length of a forearm, metres
#: The steps of the page: the box leaves out wall, table and most of the hands.
STEPS = {"crop": ((-0.5, -0.45, 1.3), (0.6, 0.75, 2.45)), "voxel": 0.012, "outliers": 2.5}
SHOWN = 18  # image that is drawn

Array = NDArray[np.float64]


def capsule(start: Array, end: Array, radius: float, rng: np.random.Generator, n: int = 20_000) -> Array:
    """Return points (n, 3) on a rod."""
    across = np.linalg.svd((end - start)[None])[2][1:]
    turn = rng.uniform(0, 2 * np.pi, n)[:, None]
    return start + rng.random((n, 1)) * (end - start) + radius * (np.cos(turn) * across[0] + np.sin(turn) * across[1])


def film() -> NDArray[np.uint16]:
    """Return depth (T, h, w) in millimetres."""
    episode = load_episode(ROOT / "data_small" / "apron_hook_0.npz")
    rng = np.random.default_rng(0)
    # Random places on all triangles, the same in every frame.
    n = 300_000
    corners = episode.points[:, episode.faces].astype(np.float64)
    sides = corners[0, :, 1:] - corners[0, :, :1]
    area = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
    triangle = rng.choice(len(area), n, p=area / area.sum())
    weights = rng.dirichlet(np.ones(3), n)
    hook = np.concatenate([capsule(*map(np.asarray, rod[:2]), rod[2], rng) for rod in Hook().rods])

    # The depth of wall and table in each pixel.
    v, u = np.indices((CAMERA.height, CAMERA.width))
    rays = np.stack([(u - LENS["cx"]) / FOCAL, (LENS["cy"] - v) / FOCAL, np.ones(u.shape)], axis=-1) @ CAMERA.axes
    with np.errstate(divide="ignore"):
        planes = np.stack([(WALL - CAMERA.eye[1]) / rays[..., 1], (TABLE - CAMERA.eye[2]) / rays[..., 2]])
    room = np.where(planes > 0, planes, np.inf).min(axis=0)

    images = []
    for frame in range(0, len(episode), EVERY):
        cloth = np.einsum("ik,ikd->id", weights, corners[frame, triangle])
        hands = [capsule(hand, hand + [0, -SLEEVE / 2, SLEEVE], HAND, rng) for hand in episode.grippers[frame]]
        x, y, z = CAMERA.axes @ (np.concatenate([cloth, hook, *hands]) - CAMERA.eye).T
        row, column = np.rint(LENS["cy"] - FOCAL * y / z).astype(int), np.rint(LENS["cx"] + FOCAL * x / z).astype(int)
        inside = (row >= 0) & (row < CAMERA.height) & (column >= 0) & (column < CAMERA.width)
        depth = room.copy()
        np.minimum.at(depth, (row[inside], column[inside]), z[inside])
        # Noise, pixels without depth, and stray pixels.
        depth += 0.002 * rng.standard_normal(depth.shape)
        depth[rng.random(depth.shape) < 0.03] = 0
        stray = rng.random(depth.shape) < 0.001
        depth[stray] = rng.uniform(0.5, 3, stray.sum())
        images.append(np.rint(1000 * depth).astype(np.uint16))
    return np.array(images)


def picture(folder: Path) -> Figure:
    """Return a picture of the film in a folder: an image, and for each choice of steps a cloud with its loops and all tracks."""
    steps = {"nothing removed": {}, "a box": {"crop": STEPS["crop"]}, "box, voxels, outliers": STEPS}
    figure = Figure(figsize=(11, 5.4), dpi=90, layout="constrained")
    grid = figure.subplots(2, 4, height_ratios=(2, 1), width_ratios=(1.2, 1.2, 1, 1))
    image = np.asarray(Image.open(folder / f"depth_{SHOWN:03d}.png")) / 1000
    grid[0, 0].imshow(np.where(image > 0, image, np.nan), vmin=1, vmax=3.2, cmap="viridis_r")
    grid[0, 0].set_title("a depth image", fontsize="medium")
    for axes in grid[0]:
        axes.set_anchor("N")
    for axes in (*grid[0], grid[1, 0]):
        axes.set_axis_off()
    raw = [cloud for _, cloud in read_clouds(folder)]
    for (name, options), (above, below) in zip(steps.items(), grid.T[1:], strict=True):
        clean = Cleaner(**options)
        clouds = [clean(cloud) for cloud in raw]
        states = tk.track(clouds, times=EVERY * 0.036 * np.arange(len(clouds)))
        x, y, _ = clouds[SHOWN].T
        above.plot(x, -y, ".", color="0.45", markersize=2)
        for loop in states[SHOWN].loops:
            for triangle in loop.killer_triangles:
                above.fill(triangle[:, 0], -triangle[:, 1], color=view.loop_colour(loop.id), alpha=0.4)
        above.set_title(name, fontsize="medium")
        above.set_aspect("equal")
        view.plot_tracks(states, below)
    return figure


def main() -> None:
    """Write the film, and draw it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder for the depth images")
    parser.add_argument("--picture", type=Path, help="picture of the film, raw and cleaned (.png)")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for number, image in enumerate(film()):
        Image.fromarray(image).save(options.out / f"depth_{number:03d}.png")
    (options.out / "intrinsics.json").write_text(json.dumps(LENS))
    print(f"{options.out}: {number + 1} depth images")
    if options.picture is not None:
        picture(options.out).savefig(options.picture)


if __name__ == "__main__":
    main()
