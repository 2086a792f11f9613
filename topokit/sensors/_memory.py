"""A cloud with a memory: the points that one camera observes now, and earlier points that are hidden now.

Idea: remembered points are carried along with the cloth. One that is seen again is replaced; one that the camera looks through
is forgotten at once, for that place is empty; one that should be in sight and is not is forgotten after a while; one that
something hides stays. A hole that is looked through is a hole; what closes another may be hidden, as a bag's bottom is.

Source: Newcombe, Fox and Seitz 2015, *DynamicFusion* (one model of a moving scene out of depth images); Curless and Levoy 1996
(what is looked through is empty). The constants were chosen on simulated films that no table of the book scores.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from topokit._validate import Array, as_points, whole
from topokit.sampling import as_tree
from topokit.seqph import TopologicalState

# The unit of distances in space is the distance of cloth points from their nearest other one.
_APART = 0.7  # least distance of a remembered point from all observed points
_THICK = 1.3  # thickness of the cloth: places within it, in front or behind, belong to the cloth
# Distance in the picture beyond which a place is beside the cloth, in distances to the fifth nearest point.
_BESIDE = 1.2
_AROUND = 4  # number of near points in the picture that must all be farther away for a place to be empty
_WITHIN = np.array([[1 / 3] * 3, *(np.eye(3) + 1) / 4, *(3 * np.eye(3) + 1) / 6])  # places in a triangle


class CloudMemory:
    """The cloud of a depth camera together with remembered points, one call a frame. Use a new memory for each film.

    Remembered points move with the mean of the points in sight. So the cloth should stay in the picture, and objects in front of
    it should be given as `around`. Clouds should be evenly sampled (`Cleaner` with a voxel, or farthest points).

    Parameters
    ----------
    frames : int
        Number of frames for which a point is remembered while it should be in sight; frames in which it is hidden do not count.

    Examples
    --------
    >>> memory, strip = CloudMemory(), np.array([[x, 0.0, 9.0] for x in range(8)])
    >>> len(memory(strip)), len(memory(strip[:5], around=strip[5:] / 2))
    (8, 8)
    """

    def __init__(self, frames: int = 30) -> None:
        self.frames = whole(frames, "frames")
        self._view: _View | None = None  # view of the last frame
        self._remembered = np.zeros((0, 3))
        self._frames_in_sight = np.zeros(0, np.int64)  # one number for each remembered point
        self._open: set[int] = set()  # identities of loops that have been looked through

    def __call__(self, points: ArrayLike, *, eye: ArrayLike = (0, 0, 0), around: ArrayLike | None = None) -> Array:
        """Return the observed points, each place once, and the remembered ones (k, 3). A refused frame changes nothing.

        Parameters
        ----------
        points : (n, 3) array_like
            Points of the cloth, in a frame of reference that does not move.
        eye : (3,) array_like
            Place of the camera.
        around : (m, 3) array_like, optional
            Other points in the picture, such as a wall or a hand. They hide points behind them, and show that places in front
            of them are empty. Without them, remembered points beside the cloth in the picture stay.

        Raises
        ------
        ValueError
            When the cloth has too few places, an array is not (n, 3), or a coordinate is not finite. For a frame in which the
            cloth is hidden, give None to the tracker.
        """
        cloth = _in_space(points, "points")
        others = _in_space(np.zeros((0, 3)) if around is None else around, "around")
        view = _View(cloth, others, _in_space(np.reshape(eye, (1, -1)), "eye"))
        if self._view is not None:
            self._carry_along(self._view, view)
        self._view = view
        return np.vstack([view.cloth, self._remembered])

    def open_loops(self, state: TopologicalState) -> TopologicalState:
        """Return a tracked state with only the loops that the camera looks through past all cloth, now or in an earlier frame."""
        for loop in state.loops:
            _in_space(loop.killer_triangles[0], f"loop {loop.id}")
            if self._view is None:
                continue
            inside = (_WITHIN @ loop.killer_triangles).reshape(-1, 3)
            if self._view.look_at(inside).past_all_cloth.any():
                self._open.add(loop.id)
        return replace(state, loops=tuple(loop for loop in state.loops if loop.id in self._open))

    def _carry_along(self, before: _View, now: _View) -> None:
        """Move remembered and observed points, and keep those that are neither seen again nor contradicted."""
        # The motion is the motion of the mean of the cloth which nothing else hides in either frame.
        stays = ~now.look_at(before.cloth).covered
        was_there = ~before.look_at(now.cloth).covered
        if not (stays.any() and was_there.any()):
            stays[:] = True
            was_there[:] = True
        motion = now.cloth[was_there].mean(axis=0) - before.cloth[stays].mean(axis=0)
        carried = np.vstack([self._remembered, before.cloth]) + motion

        place = now.look_at(carried)
        frames_in_sight = np.pad(self._frames_in_sight, (0, len(before.cloth))) + ~place.hidden
        not_seen_again = now.tree.query(carried)[0] >= _APART * now.spacing
        kept = not_seen_again & ~place.empty & (frames_in_sight <= self.frames)
        self._remembered = carried[kept]
        self._frames_in_sight = frames_in_sight[kept]


class _Places(NamedTuple):
    """The visibility of n places in a view."""

    empty: NDArray[np.bool_]  #: (n,) True for places that the camera looks through
    hidden: NDArray[np.bool_]  #: (n,) True for places that are hidden, or beside all observed points
    covered: NDArray[np.bool_]  #: (n,) True for places hidden by other things than cloth
    past_all_cloth: NDArray[np.bool_]  #: (n,) True for places in a direction without cloth


class _View:
    """The view of a camera in a frame: the cloth, the distances of its points, and all directions from the eye."""

    def __init__(self, points: Array, others: Array, eye: Array) -> None:
        self.cloth = np.unique(points + 0.0, axis=0)  # -0.0 and 0.0 are one place
        self._eye = eye
        if len(self.cloth) <= _AROUND:
            raise ValueError(f"points has {len(self.cloth)} places, too few to decide what they hide: skip the frame")
        directions, self._depths = self._from_eye(np.vstack([self.cloth, others]))
        if not self._depths.all():
            raise ValueError(f"a point is where the eye is, at {eye[0].tolist()}: drop pixels without depth")
        self._picture = as_tree(directions)
        self._picture_of_cloth = as_tree(directions[: len(self.cloth)])
        self.tree = as_tree(self.cloth)
        self.spacing = float(np.median(self.tree.query(self.cloth, k=2)[0][:, 1]))
        to_fifth = self._picture_of_cloth.query(self._picture_of_cloth.data, k=[min(6, len(self.cloth))])[0]
        self._beside = _BESIDE * float(np.median(to_fifth))

    def look_at(self, places: Array) -> _Places:
        """Compare places with the observed points in their directions."""
        directions, depths = self._from_eye(places)
        away, near = self._picture.query(directions, k=_AROUND)
        farther = self._depths[near] - depths[:, None]
        thickness = _THICK * self.spacing
        beside = away[:, 1] >= self._beside
        behind = farther[:, 0] < -thickness
        covered = behind & ~beside & (near[:, 0] >= len(self.cloth))
        beside_cloth = self._picture_of_cloth.query(directions, k=2)[0][:, 1] >= self._beside
        return _Places(
            empty=(farther > thickness).all(axis=1) & ~beside,
            hidden=behind | beside,
            covered=covered,
            past_all_cloth=~covered & beside_cloth,
        )

    def _from_eye(self, points: Array) -> tuple[Array, Array]:
        """Return (n, 3) unit directions and (n,) distances from the eye."""
        rays = points - self._eye
        depths = np.linalg.norm(rays, axis=1)
        return rays / np.where(depths > 0, depths, 1)[:, None], depths


def _in_space(points: ArrayLike, name: str) -> Array:
    array = as_points(points, name)
    if array.shape[1] != 3:
        raise ValueError(f"{name} must be in space, (n, 3), not of shape {array.shape}: pick x, y and z")
    return array
