"""Clouds that trackers are shown of an episode: samples, noise, outliers, holes, and what depth cameras see."""

from collections.abc import Callable, Iterator
from functools import lru_cache

import numpy as np
from spoilt import spoil

import topokit as tk
from topokit.io import Episode
from topokit.sampling import covering_radius
from topokit.sim import Camera

CAMERA = Camera(eye=(-0.8, -2.3, 1.6), target=(0.0, 0.0, 1.2), fov=60.0, width=192, height=192)
SECOND = Camera(eye=(1.4, 2.0, 1.6), target=(0.0, 0.0, 1.2), fov=60.0, width=192, height=192)
SEEN = 500  # points that cameras give together
CAMERAS = ("one camera", "two cameras", "a depth camera's flaws")
SPOILT = ("noise", "outliers", "repeated")  # conditions, by how they begin, in which a spoilt cloud has all vertices
Clouds = list[np.ndarray]


def conditions(episode: Episode) -> Iterator[tuple[str, Clouds, int]]:
    """Yield name, clouds, and the number of frames of the film from one cloud to the next."""
    points = episode.points.astype(float)
    rng = np.random.default_rng(episode.seed)
    yield "all vertices", list(points), 1
    yield "every 4th frame", list(points[::4]), 4
    for n in (1000, 500):
        yield f"{n:,} points", [sampled(frame, episode.faces, n, rng) for frame in points], 1
    for n in (250, 128):
        yield f"{n} points", [frame[tk.farthest_point_sample(frame, n)[0]] for frame in points], 1
    yield "500 points at random", [strewn(frame, episode.faces, 500, rng) for frame in points], 1
    for millimetres in (2, 5, 10):
        yield f"noise of {millimetres} mm", list(points + rng.normal(0, millimetres / 1000, points.shape)), 1
    for percent in (1, 5, 10, 20):
        yield f"outliers, {percent} %", list(spoil(points, rng, outliers=percent / 100)), 1
    stray = np.vstack([np.zeros((50, 3)), [[3.0, 0.0, 1.0]]])  # pixels without depth, and one on a far wall
    yield "repeated points, stray pixels", [np.vstack([frame, frame, stray]) for frame in points], 1
    yield "holes", [torn(frame, 0.03, 3, rng) for frame in points], 1
    yield "a hand", hidden_by_a_hand(points, episode.loops[0]), 1
    yield "one camera", [np.unique(frame.astype(float), axis=0) for frame in episode.observed], 1
    yield "two cameras", [seen(frame, episode.faces, (CAMERA, SECOND)) for frame in points], 1
    yield (
        "a depth camera's flaws",
        [seen(f, episode.faces, (CAMERA,), lambda *see: flawed(*see, rng)) for f in points],
        1,
    )


def true_parameters(episode: Episode, name: str, clouds: Clouds, stride: int) -> dict[str, float]:
    """Return the alpha and the epsilon that the paper's Algorithm 1 is given, of a film in a condition.

    Each is the smallest number for which the paper's assumption holds in all frames that are used.

    Alpha (Assumption 1) is the covering radius of the scene by the clean observed points, those before noise, stray points and
    repetitions. The scene is all vertices and the midpoints of all edges of the mesh, so that the surface counts. A camera
    cannot cover what it does not see: there the scene is those of these places that a picture of the cloth alone shows, and
    the clean observed points are the farthest-point sample of the picture's pixels.

    Epsilon (Assumption 2) is the largest displacement of a vertex between two frames that follow each other.

    Beta is not among them. The tracker takes the longest killer edge of a step, as it does where alpha is guessed. Assumption 3
    asks for a beta that is at least the distance from a killer edge to the point of the scene that is farthest from it. With
    such a beta the gate for places would exclude no pair. So the two trackers of the paper differ in alpha and epsilon alone.
    """
    used = episode.points[::stride].astype(float)
    epsilon = float(np.linalg.norm(np.diff(used, axis=0), axis=2).max())
    if name in CAMERAS:
        return {"alpha": seen_radius(episode, cameras_of(episode, name)), "epsilon": epsilon}
    edges = edges_of(episode.faces)
    clean = used if name.startswith(SPOILT) else clouds
    alpha = max(covering_radius(places(frame, edges), cloud) for frame, cloud in zip(used, clean, strict=True))
    return {"alpha": alpha, "epsilon": epsilon}


def cameras_of(episode: Episode, name: str) -> tuple[Camera, ...]:
    """Return the cameras of a condition. The simulator moves the camera of an episode a little, and notes where it is."""
    if name == "one camera":
        return tuple(Camera(**camera) for camera in episode.observation["cameras"])
    return (CAMERA, SECOND) if name == "two cameras" else (CAMERA,)


def edges_of(faces: np.ndarray) -> np.ndarray:
    """Return (m, 2) the edges of a mesh."""
    return np.unique(np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)), axis=0)


def places(frame: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Return the vertices and the midpoints of the edges."""
    return np.vstack([frame, frame[edges].mean(axis=1)])


@lru_cache(maxsize=2)
def seen_radius(episode: Episode, cameras: tuple[Camera, ...]) -> float:
    """Return the largest distance, over all frames, from a place that cameras see to the sample of their pixels.

    A place is seen where it is at most 3 cm behind the picture, as in `flawed`. The pixels themselves would not do for the scene:
    where there are fewer than `SEEN` of them the sample has them all, and the gaps between pixels would count as observed.
    """
    edges = edges_of(episode.faces)
    radii = []
    for frame in episode.points.astype(float):
        scene = places(frame, edges)
        is_seen = np.zeros(len(scene), dtype=bool)
        for camera in cameras:
            image = depth_image(filled(frame, episode.faces), camera)
            rows, columns, forward = projected(scene, camera, np.array(camera.eye))
            is_seen |= np.isfinite(image[rows, columns]) & (forward <= image[rows, columns] + 0.03)
        radii.append(covering_radius(scene[is_seen], seen(frame, episode.faces, cameras)))
    return max(radii)


def strewn(frame: np.ndarray, faces: np.ndarray, n: int, rng: np.random.Generator) -> np.ndarray:
    """Draw (n, 3) points of the cloth at random, by area."""
    a, b, c = frame[faces].transpose(1, 0, 2)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    of = rng.choice(len(faces), n, p=area / area.sum())
    u, v = np.sort(rng.random((2, n)), axis=0)[..., None]
    return a[of] + u * (b - a)[of] + (1 - v) * (c - a)[of]


def sampled(frame: np.ndarray, faces: np.ndarray, n: int, rng: np.random.Generator) -> np.ndarray:
    """Return (n, 3) points of the cloth that keep their distance from each other."""
    many = strewn(frame, faces, 4 * n, rng)
    return many[tk.farthest_point_sample(many, n)[0]]


def torn(frame: np.ndarray, radius: float, holes: int, rng: np.random.Generator) -> np.ndarray:
    """Return the frame without what is near some of its points, others in every frame: what a sensor drops."""
    away = np.linalg.norm(frame[:, None] - frame[rng.integers(len(frame), size=holes)], axis=2)
    return frame[away.min(axis=1) > radius]


def hidden_by_a_hand(points: np.ndarray, loop: np.ndarray, radius: float = 0.06) -> Clouds:
    """Remove what is near a line of sight that crosses the cloth once, from one side to the other, at a loop's height."""
    places = points[:, loop].mean(axis=1)
    half = np.abs(points[..., 0] - places[:, None, 0]).max(axis=1)
    places[:, 0] += np.linspace(-1.5, 1.5, len(points)) * half
    away = np.linalg.norm((points - places[:, None])[..., [0, 2]], axis=2)
    return [frame[far > radius] for frame, far in zip(points, away, strict=True)]


Depth = np.ndarray
Flaw = Callable[[Camera, Depth, np.ndarray], Depth]


def seen(frame: np.ndarray, faces: np.ndarray, cameras: tuple[Camera, ...], flaw: Flaw | None = None) -> np.ndarray:
    """Return (n, 3) a farthest-point sample of the pixels that cameras have of the cloth."""
    surface = filled(frame, faces)
    parts = []
    for camera in cameras:
        depth = depth_image(surface, camera)
        if flaw is not None:
            depth = flaw(camera, depth, surface)
        parts.append(camera.unproject(depth, np.isfinite(depth)))
    pixels = np.vstack(parts)
    return pixels[tk.farthest_point_sample(pixels, min(SEEN, len(pixels)))[0]]


def filled(frame: np.ndarray, faces: np.ndarray, steps: int = 6) -> np.ndarray:
    """Return points so dense on every triangle that no pixel between them sees through."""
    i, j = np.meshgrid(np.arange(steps + 1), np.arange(steps + 1))
    inside = i + j <= steps
    weights = np.stack([i, j, steps - i - j], axis=-1)[inside] / steps
    return np.einsum("kc,fcd->fkd", weights, frame[faces]).reshape(-1, 3)


def projected(points: np.ndarray, camera: Camera, eye: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return (n,) rows and columns in the picture of a camera at another place, and depths."""
    right, up, forward = ((points - eye) @ camera.axes.T).T
    half = np.tan(np.radians(camera.fov) / 2)
    columns = np.rint((right / forward / half * camera.height / camera.width + 1) * camera.width / 2).astype(int)
    rows = np.rint((1 - up / forward / half) * camera.height / 2 - 1).astype(int)
    return rows.clip(0, camera.height - 1), columns.clip(0, camera.width - 1), forward


def depth_image(surface: np.ndarray, camera: Camera, eye: np.ndarray | None = None) -> Depth:
    """Return (h, w) metres along the view to the nearest point of a dense surface, inf where there is none."""
    rows, columns, forward = projected(surface, camera, np.array(camera.eye) if eye is None else eye)
    image = np.full((camera.height, camera.width), np.inf)
    np.minimum.at(image, (rows, columns), forward)
    image[[0, -1]] = image[:, [0, -1]] = np.inf  # what is outside of the picture was put there
    return image


def flawed(camera: Camera, depth: Depth, surface: np.ndarray, rng: np.random.Generator) -> Depth:
    """Add the flaws of a structured-light camera: a shadow beside what is near, flying pixels at edges, steps of depth.

    The step is that of the first Kinect, 2.73 z^2 + 0.74 z - 0.58 mm (Smisek, Jancosek and Pajdla 2011).
    """
    projector = np.array(camera.eye) + 0.075 * camera.axes[0]
    lit = depth_image(surface, camera, projector)
    rows, columns, forward = projected(camera.unproject(depth, np.isfinite(depth)), camera, projector)
    answer = depth.copy()
    answer[np.isfinite(depth)] = np.where(forward > lit[rows, columns] + 0.03, np.inf, depth[np.isfinite(depth)])
    background = np.where(np.isfinite(depth), depth, depth[np.isfinite(depth)].max() + 0.5)  # a wall behind
    behind = np.max([np.roll(background, shift, axis) for shift in (-1, 1) for axis in (0, 1)], axis=0)
    edge = np.isfinite(answer) & (behind > depth + 0.03) & (rng.random(depth.shape) < 0.1)
    answer[edge] += (behind - depth)[edge] * rng.random(int(edge.sum()))
    step = (2.73 * answer**2 + 0.74 * answer - 0.58) / 1000
    with np.errstate(invalid="ignore"):
        return np.where(np.isfinite(answer), np.rint(answer / step) * step, np.inf)
