"""seqPH: follow loops through a sequence of point clouds.

Idea: every frame's loops come from Rips persistence; a loop is the same as one of the frame before when its birth, its
death and the place of its killer edge have moved no more than the sampling (alpha), the motion (epsilon) and the jitter of
killers (beta) allow. The assignment that moves killers least in total hands the identities on.

Source: Antonova et al. 2021, Algorithm 1 and Corollary 1. In the paper's listing the matching stands inside the loop over
l; it needs the whole distance matrix, so it follows both loops here. Taught in chapter 0.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._validate import as_points, as_sequence, positive
from .rips import Diagram, rips_persistence
from .sampling import hausdorff
from .state import Loop, TopologicalState

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["SeqPH", "track"]

_GATES = ("paper", "proved")
_IDENTITIES = ("killer-edge",)


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
        Largest change of birth and death, and largest distance of killers, for the same loop: ``2 alpha + epsilon`` and
        ``2 alpha + beta + epsilon`` as in the paper, or ``alpha + epsilon`` and ``2 beta + epsilon``, which are what the
        proofs give.
    identity : {"killer-edge"}
        What a loop's place is: the end points of its killer edge, compared by Hausdorff distance.

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
    ) -> None:
        self.alpha = None if alpha is None else positive(alpha, "alpha")
        self.beta = None if beta is None else positive(beta, "beta")
        self.epsilon = None if epsilon is None else positive(epsilon, "epsilon")
        if gates not in _GATES:
            raise ValueError(f"gates must be one of {_GATES}, not {gates!r}")
        if identity not in _IDENTITIES:
            raise ValueError(f"identity must be one of {_IDENTITIES}, not {identity!r}")
        self.gates, self.identity = gates, identity
        self._frame, self._next_id = 0, 0
        self._cloud: NDArray[np.float64] | None = None
        self._loops: tuple[Loop, ...] = ()

    def update(self, points: ArrayLike, *, time: float | None = None) -> TopologicalState:
        """Take the next frame and return its state. When it raises, the tracker is as it was before the call.

        Parameters
        ----------
        points : (n, d) array_like
            At least one point; clouds may differ in n, not in d.
        time : float, optional
            Seconds; the frame's number when not given.

        Raises
        ------
        TypeError, ValueError
            When the cloud is empty, not finite, or of another dimension; the message names the frame.
        """
        cloud = as_points(points, f"frame {self._frame}")
        if len(cloud) == 0:
            raise ValueError(
                f"frame {self._frame} has no points: nothing seen is not the same as no loops; skip the frame"
            )
        if self._cloud is not None and cloud.shape[1] != self._cloud.shape[1]:
            raise ValueError(
                f"frame {self._frame} has {cloud.shape[1]} dimensions, the frames before it {self._cloud.shape[1]}"
            )
        diagram = rips_persistence(cloud)
        alpha = _spacing(cloud) if self.alpha is None else self.alpha
        found = [i for i in range(len(diagram)) if diagram.lifetime[i] >= alpha]
        epsilon, beta = self._motion(cloud, diagram, found)
        steps = self._match(cloud, diagram, found, (alpha, beta, epsilon))
        loops, next_id = [], self._next_id
        for k, i in enumerate(found):
            identity, step = steps.get(k, (next_id, float("nan")))
            next_id += k not in steps
            loops.append(_loop(diagram, i, cloud, identity, step))
        parameters = {"alpha": alpha, "beta": beta, "epsilon": epsilon}
        state = TopologicalState(self._frame, float(self._frame if time is None else time), tuple(loops), parameters)
        self._cloud, self._loops, self._next_id, self._frame = cloud, state.loops, next_id, self._frame + 1
        return state

    def _motion(self, cloud: NDArray[np.float64], diagram: Diagram, found: list[int]) -> tuple[float, float]:
        """Epsilon and beta of this step, given or estimated."""
        epsilon, beta = self.epsilon, self.beta
        if epsilon is None:
            epsilon = 0.0 if self._cloud is None else hausdorff(cloud, self._cloud)
        if beta is None:
            beta = 2 * max([*diagram.death[found], *(loop.death for loop in self._loops)], default=0.0)
        return epsilon, float(beta)

    def _match(
        self, cloud: NDArray[np.float64], diagram: Diagram, found: list[int], parameters: tuple[float, float, float]
    ) -> dict[int, tuple[int, float]]:
        """For each matched loop (its place in `found`): the identity it takes over, and how far its killer edge went."""
        if not found or not self._loops:
            return {}
        alpha, beta, epsilon = parameters
        gate, bound = (2 * alpha + epsilon, 2 * alpha + beta + epsilon)
        if self.gates == "proved":
            gate, bound = (alpha + epsilon, 2 * beta + epsilon)
        old = self._loops
        distance = np.array(
            [[hausdorff(cloud[diagram.killer_edge[i]], loop.killer_edge_points) for loop in old] for i in found]
        )
        births = np.abs(diagram.birth[found][:, None] - [loop.birth for loop in old])
        deaths = np.abs(diagram.death[found][:, None] - [loop.death for loop in old])
        pairs = assign(distance, (births < gate) & (deaths < gate) & (distance < bound))
        return {k: (old[j].id, float(distance[k, j])) for k, j in pairs}


def track(
    sequence: ArrayLike | Sequence[ArrayLike], *, times: Iterable[float] | None = None, **options: Any
) -> list[TopologicalState]:
    """Track the loops of a whole sequence of clouds; `SeqPH.update` frame by frame gives the same.

    Parameters
    ----------
    sequence : (T, n, d) array_like or list of (n_t, d) array_like
    times : T floats, optional
        Seconds of the frames.
    **options
        Those of `SeqPH`.

    Returns
    -------
    list of TopologicalState
        One a frame.

    Raises
    ------
    TypeError, ValueError
        As `SeqPH` does, naming the frame; before anything is computed when a frame is not a cloud.
    """
    clouds = as_sequence(sequence)
    stamps = list(range(len(clouds))) if times is None else list(times)
    if len(stamps) != len(clouds):
        raise ValueError(f"times has {len(stamps)} values for {len(clouds)} frames")
    tracker = SeqPH(**options)
    return [tracker.update(cloud, time=time) for cloud, time in zip(clouds, stamps, strict=True)]


def assign(cost: NDArray[np.float64], allowed: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Match as many rows and columns as `allowed` lets, at the least total cost among such matchings.

    A forbidden pair costs more than all allowed ones together, so the Hungarian algorithm takes one only where it has no
    choice, and those are dropped: unlike infinite entries this cannot make the problem infeasible.

    Examples
    --------
    >>> assign(np.array([[1.0, 2.0], [1.0, 9.0]]), np.array([[True, True], [True, False]]))
    [(0, 1), (1, 0)]
    """
    from scipy.optimize import linear_sum_assignment

    forbidden = 1.0 + 2.0 * float(np.where(allowed, cost, 0.0).sum())
    rows, columns = linear_sum_assignment(np.where(allowed, cost, forbidden))
    return [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if allowed[i, j]]


def _spacing(cloud: NDArray[np.float64]) -> float:
    """Half the largest distance from a point to its nearest other one."""
    from scipy.spatial import cKDTree

    if len(cloud) < 2:
        return 0.0
    return float(cKDTree(cloud).query(cloud, k=2)[0][:, 1].max()) / 2


def _loop(diagram: Diagram, i: int, cloud: NDArray[np.float64], identity: int, step: float) -> Loop:
    """Gather what the state keeps of loop `i` of a diagram."""
    killers, neighbours = diagram.killer_triangles[i], diagram.neighbours(i)
    return Loop(
        id=identity,
        birth=float(diagram.birth[i]),
        death=float(diagram.death[i]),
        birth_edge=diagram.birth_edge[i],
        killer_edge=diagram.killer_edge[i],
        killer_triangle_ids=killers,
        neighbour_ids=neighbours,
        killer_edge_points=cloud[diagram.killer_edge[i]],
        killer_triangles=cloud[killers],
        neighbours=cloud[neighbours],
        killer_values=np.array([diagram.value(triangle) for triangle in killers]),
        neighbour_values=np.array([diagram.value(triangle) for triangle in neighbours]),
        step=step,
    )
