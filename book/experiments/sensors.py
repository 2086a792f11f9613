"""Measure milliseconds of each step from a camera's frame to tracked loops.

    python book/experiments/sensors.py

Takes a minute on one core.

A depth camera of 640 x 480 pixels, drawn from the recorded apron in front of a wall and over a table, in 16-bit millimetres, with
lost pixels and noise: 307,200 raw points a frame. The film is stored as depth images, as organised clouds, or as a bag of
either, read back by `read_clouds`, cleaned by a pipeline, and tracked. The goal is 33 ms a frame, end to end, on two cores.
Times are of the processor, and the clock's beside them; medians after the first frames.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import numpy as np

import topokit as tk
from topokit.io import load_episode
from topokit.sensors import Cleaner, Pipeline, _pipeline, read_clouds

HEIGHT = 480
WIDTH = 640
FOCAL = 600.0
LENS = {"fx": FOCAL, "fy": FOCAL, "cx": WIDTH / 2, "cy": HEIGHT / 2}
PIPELINE = Pipeline(crop=((-0.8, -0.9, 1.4), (0.8, 0.9, 2.45)), planes=1, thickness=0.015, voxel=0.015, outliers=2.5)
EVERYTHING = Pipeline(planes=2, thickness=0.015, voxel=0.015, outliers=2.5)
STEPS = {
    "_sieve": "finite, zeros, crop",
    "_voxel_means": "voxel",
    "inliers": "outliers",
    "farthest_point_sample": "farthest points",
}


def film(frames: int) -> np.ndarray:
    """Return depth (T, h, w) in millimetres of the apron 2 m in front of the camera, the wall at 2.6 m, the table below."""
    episode = load_episode(Path(__file__).parents[2] / "data_small" / "apron_hook_0.npz")
    rng = np.random.default_rng(0)
    u, v = np.sort(rng.random((2, 400_000)), axis=0)
    weights = np.column_stack([u, v - u, 1 - v]).astype(np.float32)
    corners = episode.points[:, episode.faces]
    area = np.linalg.norm(np.cross(corners[0, :, 1] - corners[0, :, 0], corners[0, :, 2] - corners[0, :, 0]), axis=1)
    triangle = rng.choice(len(area), len(u), p=area / area.sum())
    down = (np.indices((HEIGHT, WIDTH))[0] - HEIGHT / 2) / FOCAL
    table = np.where(down > 0, 0.78 / np.maximum(down, 1e-9), np.inf)
    images = np.empty((frames, HEIGHT, WIDTH), np.uint16)
    for t in range(frames):
        x, y, z = np.einsum("ik,ikd->di", weights, corners[t % len(episode), triangle])
        away = y + 2.0
        row = np.rint(HEIGHT / 2 - FOCAL * (z - 0.9) / away).astype(int)
        column = np.rint(WIDTH / 2 + FOCAL * x / away).astype(int)
        depth = np.minimum(table, 2.6)
        seen = (row >= 0) & (row < HEIGHT) & (column >= 0) & (column < WIDTH)
        np.minimum.at(depth, (row[seen], column[seen]), away[seen])
        depth = depth + 0.0015 * rng.standard_normal(depth.shape)
        depth[rng.random(depth.shape) < 0.02] = 0
        images[t] = np.rint(1000 * depth)
    return images


def store(kind: str, images: np.ndarray, folder: Path) -> Path:
    """Write the film as a robot would."""
    (folder / "intrinsics.json").write_text(json.dumps(LENS))
    if kind == "depth .npy":
        np.save(folder / "film.npy", images)
        return folder / "film.npy"
    if kind == "depth .png":
        from PIL import Image

        (folder / "png").mkdir()
        (folder / "png" / "intrinsics.json").write_text(json.dumps(LENS))
        for t, image in enumerate(images):
            Image.fromarray(image).save(folder / "png" / f"{t}.png")
        return folder / "png"
    np.save(folder / "film.npy", images)
    organised = [cloud.reshape(HEIGHT, WIDTH, 3) for _, cloud in read_clouds(folder / "film.npy")]
    if kind == "clouds .npy":
        np.save(folder / "clouds.npy", organised)
        return folder / "clouds.npy"
    return store_bag(organised, folder / "bag")


def store_bag(clouds: list[np.ndarray], path: Path) -> Path:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS2_HUMBLE)
    field = types.types["sensor_msgs/msg/PointField"]
    kind = "sensor_msgs/msg/PointCloud2"
    fields = [field(axis, 4 * i, 7, 1) for i, axis in enumerate("xyz")]
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        connection = bag.add_connection("/camera/points", kind, typestore=types)
        for t, cloud in enumerate(clouds):
            stamp = types.types["builtin_interfaces/msg/Time"](t // 30 + 1, int(1e9 * (t % 30) / 30))
            header = types.types["std_msgs/msg/Header"](stamp, "camera")
            size = cloud[0].nbytes
            data = np.frombuffer(cloud.tobytes(), np.uint8)
            message = types.types[kind](header, *cloud.shape[:2], fields, False, 12, size, data, False)
            bag.write(connection, int(1e9 * t / 30), types.serialize_cdr(message, kind))
    return path


class Watch:
    """Milliseconds of the processor and of the clock, by what was done; since the start of the frame."""

    def __init__(self) -> None:
        self.took: dict[str, list[tuple[float, float]]] = defaultdict(list)

    @contextmanager
    def of(self, what: str) -> Iterator[None]:
        start = time.process_time(), time.perf_counter()
        yield
        self.took[what].append((1e3 * (time.process_time() - start[0]), 1e3 * (time.perf_counter() - start[1])))

    def wrapped(self, what: str, function: Any) -> Any:
        def timed(*arguments: Any, **named: Any) -> Any:
            with self.of(what):
                return function(*arguments, **named)

        return timed


def run(path: Path, pipeline: Pipeline, skip: int) -> tuple[Watch, Cleaner, float]:
    """Run a film from its file to its states."""
    watch = Watch()
    clean = Cleaner(pipeline)
    tracker = tk.SeqPH()
    clean._off_planes = watch.wrapped("  planes", clean._off_planes)
    kept = {name: getattr(_pipeline, name) for name in STEPS}
    for name, what in STEPS.items():
        setattr(_pipeline, name, watch.wrapped(f"  {what}", kept[name]))
    frames = read_clouds(path)
    loops = []
    try:
        while True:
            with watch.of("end to end"):
                with watch.of("read"):
                    time_, cloud = next(frames)
                with watch.of("clean"):
                    points = clean(cloud)
                with watch.of("track"):
                    loops.append(len(tracker.update(points, time=time_)))
    except StopIteration:
        watch.took["read"] = watch.took["read"][: len(loops)]
    finally:
        for name, function in kept.items():
            setattr(_pipeline, name, function)
    watch.took = {what: took[skip:] for what, took in watch.took.items()}
    return watch, clean, statistics.mean(loops)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=int, default=60)
    parser.add_argument(
        "--skip", type=int, default=5, help="first frames, which are compiled for and searched for planes"
    )
    options = parser.parse_args()
    images = film(options.frames)
    for kind in ("depth .npy", "depth .png", "clouds .npy", "bag of PointCloud2"):
        with tempfile.TemporaryDirectory() as folder:
            path = store(kind, images, Path(folder))
            for said, pipeline in (("cropped", PIPELINE), ("not cropped, two planes", EVERYTHING)):
                watch, clean, loops = run(path, pipeline, options.skip)
                print(f"{kind}, {said}; last frame: {clean.removed}; {loops:.1f} loops a frame")
                for what, took in watch.took.items():
                    cpu, clock = (statistics.median(one) for one in zip(*took, strict=True))
                    print(f"  {what:<22} {cpu:7.2f} ms of the processor {clock:7.2f} ms")
    return 0


if __name__ == "__main__":
    sys.exit(main())
