"""seqPH: follow loops through a sequence of point clouds.

Idea: every frame's loops come from Rips persistence; a loop is the same as one of the frame before when its birth, its
death and the place of its killer edge have moved no more than the sampling (alpha), the motion (epsilon) and the jitter of
killers (beta) allow. The assignment that moves killers least in total hands the identities on.

Source: Antonova et al. 2021, Algorithm 1 and Corollary 1. In the paper's listing the matching stands inside the loop over
l; it needs the whole distance matrix, so it follows both loops here. Taught in chapters 0 and 6.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._frames import check_diagram, check_follows
from ._matching import Candidates, Matching, hausdorff_table, within_gates
from ._validate import as_sequence, positive, whole
from .linking import curve_centroid
from .rips import Diagram, next_persistence, rips_persistence_many
from .sampling import as_tree, hausdorff, spacing
from .state import Loop, TopologicalState, loop_of

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

__all__ = ["RECOMMENDED", "Candidates", "SeqPH", "place", "track"]

Array = NDArray[np.float64]
RECOMMENDED: Mapping[str, Any] = {"identity": "killer-triangles", "gates": "proved", "memory": 8}
"""Options of the tracker that labels are made with and predictors use: the fewest switches of identity (chapter 6)."""
_GATES = ("paper", "proved")
_IDENTITIES = ("killer-edge", "killer-triangles", "cycle")


@dataclass(frozen=True, eq=False)
class _Known:
    """A loop that may come back: where it is for its identity (p, d), how far the scene has moved since, for how many frames."""

    loop: Loop
    place: Array
    motion: float = 0.0
    missed: int = 0


class SeqPH:
    """Tracker of loops, one frame at a time: sequential persistent homology.

    Parameters
    ----------
    alpha : float, optional
        How far the scene may be from the nearest observed point (Assumption 1). Loops of a lifetime below it are dropped.
        Estimated, when not given, as half the largest distance from a point of the frame to its nearest other point: no
        smaller alpha is possible when no piece of the scene is a single point.
    beta : float, optional
        How far two killers of one loop may lie apart (Assumption 3). Estimated, when not given, as the length of the longest
        killer edge of the two frames: on cloth the candidates for a loop's killer lie around that loop.
    epsilon : float, optional
        How far a point may move from one frame to the next (Assumption 2). Estimated, when not given, as the Hausdorff
        distance between the two clouds.
    gates : {"paper", "proved"}
        Largest change of birth and death, and largest distance of places, for the same loop: ``2 alpha + epsilon`` and
        ``2 alpha + beta + epsilon`` as in the paper, or ``alpha + epsilon`` and ``2 beta + epsilon``, which are what the
        proofs give.
    identity : {"killer-edge", "killer-triangles", "cycle"}
        What a loop's place is. In the paper, the two ends of its killer edge, compared by Hausdorff distance; on a nearly
        round loop that edge can jump across the loop between two frames. The barycentre of the thick killer triangle, or
        the centroid of the representative cycle, stays; the cycle costs a search of its own.
    memory : int
        For how many frames a loop that is not found is remembered: when it comes back within its gates, widened by the
        motion since, it keeps its identity. 0 is the paper's algorithm.
    match : callable, optional
        Takes `Candidates` and gives the pairs (i, j) of a found loop i that is the known loop j. By default the least total
        distance of places within the gates.

    Raises
    ------
    TypeError, ValueError
        When an option is not of its kind.

    Examples
    --------
    >>> square = np.array([[0, 0], [1, 0], [1, 1], [0, 1.01]])
    >>> tracker = SeqPH(alpha=0.1, beta=1.0, epsilon=0.1)
    >>> [tracker.update(square + [0.05 * t, 0]).loops[0].id for t in range(3)]
    [0, 0, 0]
    """

    def __init__(
        self,
        alpha: float | None = None,
        beta: float | None = None,
        epsilon: float | None = None,
        *,
        gates: str = "paper",
        identity: str = "killer-edge",
        memory: int = 0,
        match: Matching | None = None,
    ) -> None:
        self.alpha = None if alpha is None else positive(alpha, "alpha")
        self.beta = None if beta is None else positive(beta, "beta")
        self.epsilon = None if epsilon is None else positive(epsilon, "epsilon")
        if gates not in _GATES:
            raise ValueError(f"gates must be one of {_GATES}, not {gates!r}")
        if identity not in _IDENTITIES:
            raise ValueError(f"identity must be one of {_IDENTITIES}, not {identity!r}")
        self.gates, self.identity, self.memory = gates, identity, whole(memory, "memory")
        self._match = partial(within_gates, gates) if match is None else match
        self._frame, self._next_id = 0, 0
        self._time: float | None = None
        self._tree: cKDTree | None = None  # of the frame before
        self._known: list[_Known] = []
        self._film: list[Any] = []

    def update(
        self, points: ArrayLike, *, time: float | None = None, diagram: Diagram | None = None
    ) -> TopologicalState:
        """Take the next frame and return its state. One that cannot follow is refused, and the tracker stays as it was.

        Parameters
        ----------
        points : (n, d) array_like
            At least one point; clouds may differ in n, not in d. They are copied.
        time : float, optional
            Seconds, for all frames or for none; the frame's number when not given.
        diagram : Diagram, optional
            The persistence of these points, when it is known already; computed when not given. All its loops must die.
        """
        tree = as_tree(points, f"frame {self._frame}", copy=True)
        check_follows(self._frame, (self._tree, self._time), (tree, time))
        if diagram is None:
            diagram = next_persistence(tree.data, self._film)
        else:
            check_diagram(self._frame, diagram, tree.n)
        return self._advance(tree, diagram, time)

    def stream(self, frames: Iterable[ArrayLike]) -> Iterator[TopologicalState]:
        """Yield the state of every frame as it comes; nothing is kept but what the next frame needs.

        Examples
        --------
        >>> square = np.array([[0, 0], [1, 0], [1, 1], [0, 1.01]])
        >>> [len(state) for state in SeqPH(alpha=0.1).stream(square for _ in range(2))]
        [1, 1]
        """
        for points in frames:
            yield self.update(points)

    def _advance(self, tree: cKDTree, diagram: Diagram, time: float | None) -> TopologicalState:
        """Take a checked frame whose persistence is known."""
        cloud, alpha = tree.data, spacing(tree) if self.alpha is None else self.alpha
        found = np.flatnonzero(diagram.lifetime >= alpha).tolist()
        epsilon, beta = self._motion(tree, diagram, found)
        known = [replace(k, motion=k.motion + epsilon, missed=k.missed + 1) for k in self._known]
        places = [place(diagram, i, cloud, self.identity) for i in found]
        matched: dict[int, int] = {}
        if found and known:
            matched = dict(self._match(_candidates(diagram, found, places, known, (alpha, beta))))
        loops, next_id = [], self._next_id
        for k, i in enumerate(found):
            before = known[matched[k]].loop if k in matched else None
            loops.append(_loop(diagram, i, cloud, next_id if before is None else before.id, before))
            next_id += before is None
        parameters = {"alpha": alpha, "beta": beta, "epsilon": epsilon}
        state = TopologicalState(self._frame, float(self._frame if time is None else time), tuple(loops), parameters)
        taken = set(matched.values())
        kept = [k for j, k in enumerate(known) if j not in taken and k.missed <= self.memory]
        self._known = [_Known(loop, place) for loop, place in zip(loops, places, strict=True)] + kept
        self._tree, self._next_id, self._frame, self._time = tree, next_id, self._frame + 1, time
        return state

    def _motion(self, tree: cKDTree, diagram: Diagram, found: list[int]) -> tuple[float, float]:
        """Epsilon and beta of this step, given or estimated."""
        epsilon, beta = self.epsilon, self.beta
        if epsilon is None:
            epsilon = 0.0 if self._tree is None else hausdorff(tree, self._tree)
        if beta is None:
            beta = 2 * max([*diagram.death[found], *(known.loop.death for known in self._known)], default=0.0)
        return epsilon, float(beta)


def track(
    sequence: ArrayLike | Sequence[ArrayLike],
    *,
    times: Iterable[float] | None = None,
    n_jobs: int | None = None,
    progress: bool = False,
    **options: Any,
) -> list[TopologicalState]:
    """Track the loops of a whole sequence of clouds; `SeqPH.update` frame by frame gives the same.

    Parameters
    ----------
    sequence : (T, n, d) array_like or list of (n_t, d) array_like
    times : T floats, optional
        Seconds of the frames.
    n_jobs : int, optional
        Threads for the persistence of the frames; as many as there are cores when not given.
    progress : bool
        Count the frames done on stderr.
    **options
        Those of `SeqPH`.

    Raises
    ------
    TypeError, ValueError
        As `SeqPH` does, naming the frame; before anything is computed when a frame is not a cloud.
    """
    clouds = as_sequence(sequence, copy=True)
    stamps: list[float | None] = [None] * len(clouds) if times is None else list(times)
    if len(stamps) != len(clouds):
        raise ValueError(f"times has {len(stamps)} values for {len(clouds)} frames")
    tracker = SeqPH(**options)
    frames = [
        (as_tree(cloud, f"frame {t}"), stamp) for t, (cloud, stamp) in enumerate(zip(clouds, stamps, strict=True))
    ]
    for number, frame in enumerate(frames):
        check_follows(number, frames[number - 1] if number else (None, None), frame)
    diagrams = rips_persistence_many(clouds, n_jobs, progress=progress)
    return [tracker._advance(tree, diagram, time) for (tree, time), diagram in zip(frames, diagrams, strict=True)]


def _candidates(
    diagram: Diagram, found: list[int], places: list[Array], known: list[_Known], sizes: tuple[float, float]
) -> Candidates:
    return Candidates(
        diagram.birth[found],
        diagram.death[found],
        np.array(places),
        np.array([k.loop.birth for k in known]),
        np.array([k.loop.death for k in known]),
        np.array([k.place for k in known]),
        np.array([k.motion for k in known]),
        *sizes,
    )


def place(diagram: Diagram, i: int, cloud: Array, identity: str) -> Array:
    """Return (p, d) where loop `i` of a diagram is, for one of the identities of `SeqPH`.

    Parameters
    ----------
    diagram : Diagram
    i : int
    cloud : (n, d) float64
        The diagram's points.
    identity : str
    """
    if identity == "killer-edge":
        return cloud[diagram.killer_edge[i]]
    if identity == "killer-triangles":
        return cloud[diagram.killer_triangles[i, 0]].mean(axis=0, keepdims=True)
    return curve_centroid(cloud[diagram.cycle(i)])[None]


def _loop(diagram: Diagram, i: int, cloud: Array, identity: int, before: Loop | None) -> Loop:
    """Gather what the state keeps of loop `i` of a diagram."""
    edge, neighbours, step = diagram.killer_edge[i], diagram.neighbours(i), float("nan")
    if before is not None:
        step = float(hausdorff_table(cloud[edge][None], before.killer_edge_points[None])[0, 0])
    sides = np.linalg.norm(cloud[neighbours] - cloud[neighbours[:, [2, 0, 1]]], axis=2)
    return loop_of(
        cloud,
        partial(diagram.cycle, i),
        id=identity,
        birth=float(diagram.birth[i]),
        death=float(diagram.death[i]),
        step=step,
        birth_edge=diagram.birth_edge[i],
        killer_edge=edge,
        killer_triangle_ids=diagram.killer_triangles[i],
        neighbour_ids=neighbours,
        neighbour_values=sides.max(axis=1, initial=0.0) / 2,
    )
