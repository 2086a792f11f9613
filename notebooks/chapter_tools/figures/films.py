"""Interactive figures of films: names that are repainted, forecasts that are measured, and plans that are compared."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from topokit import farthest_point_sample
from topokit.evaluate import true_loops
from topokit.linking import close_far
from topokit.view import HtmlFigure

from .pages import _figure

NAMES = "abcdef"  # the figures have a colour for each
MOST_PAINTED = 40  # frames of a strip; narrower cells cannot be hit
MOST_FORECASTERS = 3
MOST_CUTS = 7  # six colours and grey
MOST_COMPONENTS = 20  # of features; with these the chapter's mean errors are right to a millimetre
MOST_TURNED = 5  # the figure has a colour for each
MOST_DOTS = 120  # of the cloth in a picture


def repaint(films: Mapping[str, Sequence[str]]) -> HtmlFigure:
    """Return an interactive figure of the names that a tracker gives, which the reader repaints, and of their scores.

    A strip has a row for each true loop, a cell for each frame, and one more row for detections that are no loop. Beside it are
    MOTA, IDF1 and HOTA, computed anew after each stroke, and the names that IDF1 gives the loops for good.

    Parameters
    ----------
    films : mapping of str to sequence of str
        Films by name, of which the reader chooses one. A film has a string for each true loop: a letter from a to f for each
        frame, or ``-`` where the loop is missed.

    Raises
    ------
    ValueError
        When a film is empty, its strings differ in length, a letter is unknown, or two loops have one name in a frame.
    """
    for title, rows in films.items():
        lengths = {len(row) for row in rows}
        if len(lengths) != 1 or not 1 <= max(lengths) <= MOST_PAINTED:
            raise ValueError(f"film {title!r} needs strings of one length, 1 to {MOST_PAINTED}, not {sorted(lengths)}")
        for t, found in enumerate(zip(*rows, strict=True)):
            names = [name for name in found if name != "-"]
            if not set(names) <= set(NAMES) or len(names) != len(set(names)):
                raise ValueError(
                    f"film {title!r} has the names {found} in frame {t}; give each of {NAMES} once at most"
                )
    data = {"films": {title: list(rows) for title, rows in films.items()}}
    scripts = ["assign.js", "scores.js", "planar.js"]
    return _figure("repaint", data, scripts, 500, "drag over the strip to paint", "Names and scores")


def treatments(
    points: ArrayLike,
    loops: Mapping[str, ArrayLike],
    means: Mapping[str, ArrayLike],
    frames: Sequence[int],
    *,
    start: int = 0,
    view: tuple[float, float] = (-60.0, 12.0),
) -> HtmlFigure:
    """Return an interactive figure of the hull measure on one garment, under several treatments.

    The picture shows a true loop, the hull that counts with its tolerance, and the means of forecasters. The reader turns it and
    chooses a treatment, a tolerance, a frame, and whether frames count in which the loop lies flat. Charts show how far the
    nearest mean is off, frame by frame, and in what share of the frames it counts as in.

    Parameters
    ----------
    points : (K, N, 3) array_like
        The garment's vertices at K frames, metres.
    loops : mapping of str to (L,) array_like of int
        The true loops by name, as vertex ids; the last is shown first.
    means : mapping of str to (K, S, 3) array_like
        At most three forecasters by name, with the means of at most S loops at each frame; nan where there is none.
    frames : (K,) sequence of int
        The number of frames ahead of each frame.
    start : int
        The frame that is shown first, of the K.
    view : (2,) float
        Azimuth and elevation of the eye in degrees.

    Raises
    ------
    ValueError
        When the numbers of frames differ, or there are more than three forecasters.
    """
    film = np.asarray(points, dtype=np.float64)
    ids = [np.asarray(loop) for loop in loops.values()]
    places = np.stack([np.asarray(one, dtype=np.float64) for one in means.values()])
    if not len(film) == len(frames) == places.shape[1] or len(places) > MOST_FORECASTERS:
        raise ValueError(
            f"points, frames and at most {MOST_FORECASTERS} forecasters must have one number of frames, not {len(film)}, "
            f"{len(frames)} and {places.shape[:2]}"
        )
    truth = true_loops(film, ids)
    chosen, _ = farthest_point_sample(film[0], min(MOST_DOTS, film.shape[1]))
    packed = []
    for k, loop in enumerate(ids):
        tight = [film[t, true.tight[k]] for t, true in enumerate(truth)]
        curves = {
            "curve": np.float32(film[:, loop]),
            "closing": np.float32(np.stack([film[t, true.killers[k]] for t, true in enumerate(truth)])),
            "tight": np.float32(np.concatenate(tight)),
            "first": np.cumsum([0, *map(len, tight)]).tolist(),
            "present": [bool(true.present[k]) for true in truth],
        }
        packed.append(curves)
    seen = np.asarray(np.isfinite(places).all(axis=-1))
    data = {
        "names": list(means),
        "labels": list(loops),
        "frames": list(map(int, frames)),
        "frame": int(start),
        "first": len(ids) - 1,
        "view": list(map(float, view)),
        "radius": float(np.linalg.norm(np.ptp(film, axis=1), axis=-1).max() / 2),
        "slots": places.shape[2],
        "cloth": np.float32(film[:, chosen]),
        "loops": packed,
        "means": np.float32(np.where(seen[..., None], places, film.mean())),
        "seen": seen,
    }
    scripts = ["orbit.js", "planar.js", "hulls.js"]
    title = f"The hull measure of {len(ids)} loops at {len(film)} frames"
    return _figure("treatments", data, scripts, 600, "drag to turn", title)


def planning(ring: ArrayLike, line: ArrayLike, start: Sequence[float], radius: float = 0.02) -> HtmlFigure:
    """Return an interactive figure of the paths that a planner compares, over the guide of a hook seen from the side.

    The guide is the metres from the ring's rim over the tip to the seat, or to the seat alone once the ring
    is around. The forecast is the rigid one: the ring goes with the hands. The reader chooses how many paths are compared, the
    rounds of the search, the seed and the first guess, drags the start of the ring, and runs through the plans.

    Parameters
    ----------
    ring : (n, 3) array_like
        The ring, metres; it keeps its shape and its place along x.
    line : (m, 3) array_like
        Corners of the hook's centre line in a plane of one x. The last edge is its tip, the edge before that its arm.
    start : (2,) sequence of float
        Where the rim begins, along y and z.
    radius : float
        Radius of the rod.
    """
    corners = np.asarray(line, dtype=np.float64)
    first = np.asarray(start, dtype=np.float64)
    around = np.array([corners[-3:, 1:].min(axis=0), corners[-3:, 1:].max(axis=0), first])
    data = {
        "ring": np.asarray(ring, dtype=np.float64).tolist(),
        "line": corners.tolist(),
        "closed": close_far(corners).tolist(),
        "radius": float(radius),
        "start": first.tolist(),
        "window": {"low": (around.min(axis=0) - 0.15).tolist(), "high": (around.max(axis=0) + 0.15).tolist()},
    }
    scripts = ["link.js", "planar.js", "guide.js"]
    return _figure(
        "planning", data, scripts, 560, "darker: less to go; dotted: around", "Paths over the guide of a hook"
    )


def turning(
    forecasts: Mapping[str, ArrayLike],
    truth: ArrayLike,
    hands: ArrayLike,
    angles: Sequence[float],
    ahead: Sequence[int],
) -> HtmlFigure:
    """Return an interactive figure of forecasts of one loop in a scene that the reader turns, seen from above.

    A forecast of the motion of cloth turns with the scene. Charts show the error by angle and by frame.

    Parameters
    ----------
    forecasts : mapping of str to (A, T, 3) array_like
        At most five forecasters by name, with the places of the loop in each turned scene, metres; the last is shown first.
    truth : (T, 3) array_like
        The true places in the scene that is not turned.
    hands : (H, 3) array_like
        The path of the middle of the grippers, likewise. The scene is turned about the vertical through its first place.
    angles : (A,) sequence of float
        Evenly spaced, from 0, degrees.
    ahead : (T,) sequence of int
        The number of frames ahead of each place.

    Raises
    ------
    ValueError
        When the numbers of angles or frames differ, or there are more than five forecasters.
    """
    places = np.stack([np.asarray(one, dtype=np.float64) for one in forecasts.values()])
    path = np.asarray(truth, dtype=np.float64)
    shape = (len(angles), len(ahead), 3)
    if places.shape[1:] != shape or path.shape != shape[1:] or len(places) > MOST_TURNED:
        raise ValueError(
            f"at most {MOST_TURNED} forecasts of shape {shape} are needed, and a truth of {shape[1:]}, not {places.shape} "
            f"and {path.shape}"
        )
    middle = np.asarray(hands, dtype=np.float64)
    data = {
        "names": list(forecasts),
        "angles": list(map(float, angles)),
        "ahead": list(map(int, ahead)),
        "centre": middle[0, :2].tolist(),
        "truth": path.round(5).tolist(),
        "hands": middle.round(5).tolist(),
        "forecasts": np.float32(places),
    }
    scripts = ["orbit.js", "planar.js", "turns.js"]
    return _figure("turning", data, scripts, 520, "drag sideways to turn the scene", "Forecasts in a turned scene")


def leak(
    features: ArrayLike,
    futures: ArrayLike,
    present: ArrayLike,
    films: ArrayLike,
    frames: ArrayLike,
    cuts: Sequence[str],
    stays: float,
) -> HtmlFigure:
    """Return an interactive figure of a forecaster that copies the nearest window, and of what it may copy.

    The reader sets how many frames must lie between a window and those of its own film that may be copied, up to the whole
    film, and may leave out the garment. The picture shows the windows by their first two principal components.

    Parameters
    ----------
    features : (N, F) array_like
        The windows, each film's in order; their Euclidean distances decide which is nearest. They are stored by their first
        principal components.
    futures : (N, 3) array_like
        What is to be forecast, metres.
    present : (N,) array_like of bool
        Whether it is there.
    films, frames : (N,) array_like of int
        The film of each window, and its frame.
    cuts : (N,) sequence of str
        The cut of each window's garment, of at most seven.
    stays : float
        The mean error of the forecast that nothing moves, metres.

    Raises
    ------
    ValueError
        When there are more than seven cuts, or the numbers of windows differ.
    """
    table = np.asarray(features, dtype=np.float64)
    film = np.asarray(films, dtype=np.int64)
    frame = np.asarray(frames, dtype=np.int64)
    places = np.asarray(futures, dtype=np.float64)
    names = sorted(set(cuts))
    counts = {len(table), len(film), len(frame), len(places), len(cuts)}
    if len(counts) != 1 or len(names) > MOST_CUTS:
        raise ValueError(
            f"{counts} windows of {len(names)} cuts; give one number of windows, of at most {MOST_CUTS} cuts"
        )
    centred = table - table.mean(axis=0)
    left, sizes, _ = np.linalg.svd(centred, full_matrices=False)
    components = max(2, min(MOST_COMPONENTS, len(sizes)))
    data = {
        "features": np.float32((left * sizes)[:, :components]),
        "futures": np.float32(places),
        "alive": [int(there) for there in np.asarray(present, dtype=bool)],
        "film": film.tolist(),
        "frame": frame.tolist(),
        "longest": int(max(np.ptp(frame[film == one]) for one in np.unique(film))),
        "cut": [names.index(cut) for cut in cuts],
        "cuts": names,
        "titles": dict(zip(film.tolist(), cuts, strict=True)),
        "stays": float(stays),
    }
    scripts = ["orbit.js", "planar.js", "copycat.js"]
    title = f"{len(table)} windows of {len(np.unique(film))} films, and which is copied"
    return _figure("leak", data, scripts, 520, "a window and its copy", title)
