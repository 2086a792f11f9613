"""seqPH: follow loops through a sequence of point clouds.

Idea: every frame's loops come from Rips persistence; a loop is the same as one of the frame before when its birth, its
death and the place of its killer edge have moved no more than the sampling (alpha), the motion (epsilon) and the jitter of
killers (beta) allow. The assignment that moves killers least in total hands the identities on. Which bars are loops is told by
the diagram and by the film before it (`topokit.seqph._evidence`), or, as in the paper, by alpha alone.

Source: Antonova et al. 2021, Algorithm 1 and Corollary 1. In the paper's listing the matching stands inside the loop over
l; it needs the whole distance matrix, so it follows both loops here. Taught in chapters 0 and 7.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from topokit._validate import Array, as_sequence, positive, whole
from topokit.linking import curve_centroid
from topokit.rips import Diagram, Film, rips_persistence_many
from topokit.sampling import as_tree, hausdorff, hausdorff_table

from ._evidence import MISSED, WEAKEST, believe
from ._frames import Frame, check_diagram, check_follows
from ._matching import Candidates, Known, MatchRule, candidates_of, check_pairs, within_gates
from ._state import Loop, TopologicalState, loop_of

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

_PAPER = {"loops": "alpha", "gates": "paper", "identity": "killer-edge", "memory": 0}
PAPER: Mapping[str, Any] = MappingProxyType(_PAPER)
"""The options of `SeqPH` that make it the paper's tracker, rule for rule: ``SeqPH.paper()``, ``track(clouds, **PAPER)``."""
_LOOPS = ("evidence", "alpha")
_GATES = ("paper", "proved", "near")
_IDENTITIES = ("killer-edge", "killer-triangles", "cycle")


class SeqPH:
    """Tracker of loops, one frame at a time: sequential persistent homology.

    Parameters
    ----------
    alpha : float, optional
        How far the scene may be from the nearest observed point (Assumption 1). Estimated, when not given, as half the distance
        that 95 % of the points have from their nearest other one; with ``loops="alpha"`` that all of them have.
    beta : float, optional
        How far two killers of one loop may lie apart (Assumption 3). Estimated, when not given, as the length of the longer of
        the two killer edges: on cloth the candidates for a loop's killer lie around that loop.
    epsilon : float, optional
        How far a point may move from one frame to the next (Assumption 2). Estimated, when not given, as what 90 % of the
        points do not exceed beside the motion of the scene as a whole, which known places are carried along with; with
        ``loops="alpha"`` as the Hausdorff distance of the clouds. Nothing is carried along where it is given.
    loops : {"evidence", "alpha"}, optional
        Which bars are loops: those that the diagram and the film before it speak for, points that are alone
        (`topokit.sampling.inliers`) left out; or those that live alpha or longer, all points counting, as in the paper. The
        second when alpha is given, the first when it is not.
    gates : {"near", "proved", "paper"}
        Largest change of birth and death, and largest distance of places, for the same loop: ``alpha + epsilon`` and a
        quarter of the larger death, and ``beta + epsilon`` with the beta of these two; ``alpha + epsilon`` and
        ``2 beta + epsilon``, which are what the proofs give; or the paper's ``2 alpha + epsilon`` and
        ``2 alpha + beta + epsilon``.
    identity : {"killer-edge", "killer-triangles", "cycle"}
        What a loop's place is. In the paper, the two ends of its killer edge, compared by Hausdorff distance; on a nearly
        round loop that edge can jump across the loop between two frames. The barycentre of the thick killer triangle, or
        the centroid of the representative cycle, stays; the cycle costs a search of its own.
    memory : int
        For how many frames a loop that is not found is remembered: when it comes back within its gates, widened by the
        motion since, it keeps its identity. By evidence it is told again once it is believed in again, some frames later.
    match : callable, optional
        Takes `Candidates` and gives the pairs (i, j) of a found loop i that is the known loop j, each once at most. Called for
        the known loops that are believed in, then for what is left. By default the least total distance of places within
        the gates.

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
        loops: str | None = None,
        gates: str = "near",
        identity: str = "killer-triangles",
        memory: int = 20,
        match: MatchRule | None = None,
    ) -> None:
        self.alpha = None if alpha is None else positive(alpha, "alpha")
        self.beta = None if beta is None else positive(beta, "beta")
        self.epsilon = None if epsilon is None else positive(epsilon, "epsilon")
        self.loops = ("evidence" if alpha is None else "alpha") if loops is None else loops
        self.gates, self.identity, self.memory = gates, identity, whole(memory, "memory")
        for name, known in (("loops", _LOOPS), ("gates", _GATES), ("identity", _IDENTITIES)):
            if getattr(self, name) not in known:
                raise ValueError(f"{name} must be one of {known}, not {getattr(self, name)!r}")
        if match is not None and not callable(match):
            raise TypeError(f"match must be a function of `Candidates`, not {match!r}")
        self._match = partial(within_gates, gates) if match is None else match
        self._number, self._next_id = 0, 0
        self._time: float | None = None
        self._before: Frame | None = None
        self._known: list[Known] = []
        self._film = Film()

    @classmethod
    def paper(cls, **options: Any) -> SeqPH:
        """Return the paper's tracker, rule for rule.

        Bars that live alpha are loops, alpha being half the largest distance of a point from its nearest other one, beta the
        longest killer edge, epsilon the Hausdorff distance of the clouds; the paper's gates on killer edges; no memory.

        Parameters
        ----------
        **options
            Those of the class, in place of the paper's.
        """
        return cls(**{**PAPER, **options})

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
            The persistence of these points, when it is known already: then all of them count, those that are alone too.
            Computed when not given. All its loops must die.
        """
        tree = as_tree(points, f"frame {self._number}", copy=True)
        frame = self._frame(tree)
        check_follows(self._number, (self._before, self._time), (frame, time))
        if diagram is None:
            diagram = self._film.next_diagram(tree.data[frame.ids])
        else:
            check_diagram(self._number, diagram, tree.n)
            frame = replace(frame, ids=np.arange(tree.n))
        return self._advance(tree.data, frame, diagram, time)

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

    def _frame(self, tree: cKDTree) -> Frame:
        """What this tracker takes from a cloud."""
        if self.loops == "alpha":
            return Frame.of_all_points(tree, self.alpha)
        frame = Frame.without_outliers(tree)
        return frame if self.alpha is None else replace(frame, alpha=self.alpha)

    def _advance(self, cloud: Array, frame: Frame, diagram: Diagram, time: float | None) -> TopologicalState:
        """Take a checked frame whose persistence is known."""
        evidence = self._loop_evidence(frame, diagram)
        found = np.flatnonzero(evidence > WEAKEST).tolist()
        shift, epsilon = self._motion(frame)
        known = [replace(k, place=k.place + shift, motion=k.motion + epsilon, missed=k.missed + 1) for k in self._known]
        deaths = (diagram.death[found], np.array([k.death for k in known]))
        beta = self._beta(*deaths)
        parameters = {"alpha": frame.alpha, "beta": float(np.max(beta, initial=0.0)), "epsilon": epsilon}
        points = cloud[frame.ids]
        places = [place(diagram, i, points, self.identity) for i in found]
        matched = self._pairs(candidates_of(diagram, found, places, known, (frame.alpha, beta)), known)
        loops, kept, next_id = [], [], self._next_id
        for k, i in enumerate(found):
            before = known[matched[k]] if k in matched else None
            belief = believe(before.belief if before else 0.0, evidence[i])
            identity = before.id if before else None
            if belief > 0:
                if identity is None:
                    identity, next_id, before = next_id, next_id + 1, None
                was = None if before is None else before.killer_edge
                loops.append(loop_at(diagram, i, cloud, frame.ids, identity, was))
            edge = points[diagram.killer_edge[i]]
            kept.append(Known(diagram.birth[i], diagram.death[i], places[k], edge, belief, identity))
        taken = set(matched.values())
        left = [k for j, k in enumerate(known) if j not in taken and k.missed <= self.memory]
        self._known = kept + [replace(k, belief=believe(k.belief, MISSED)) for k in left]
        state = TopologicalState(self._number, float(self._number if time is None else time), tuple(loops), parameters)
        self._before, self._next_id, self._number, self._time = frame, next_id, self._number + 1, time
        return state

    def _loop_evidence(self, frame: Frame, diagram: Diagram) -> Array:
        """(m,) evidence that each bar is a loop; by alpha alone there is no doubt."""
        if self.loops == "alpha":
            return np.where(diagram.lifetime >= frame.alpha, np.inf, -np.inf)
        return frame.loop_evidence(diagram.birth, diagram.death)

    def _motion(self, frame: Frame) -> tuple[Array | float, float]:
        """How far the scene as a whole has moved, and epsilon, given or estimated."""
        if self._before is None or self.epsilon is not None:
            return 0.0, self.epsilon or 0.0
        if self.loops == "alpha":
            return 0.0, hausdorff(frame.tree, self._before.tree)
        return frame.motion_since(self._before)

    def _beta(self, found: Array, known: Array) -> Array | float:
        """Given, or from the deaths of what is found and known: for all, or (n, m) for each pair when gates are near."""
        if self.beta is not None:
            return self.beta
        if self.gates == "near":
            return 2 * np.maximum(found[:, None], known)
        return 2 * max([*found, *known], default=0.0)

    def _pairs(self, loops: Candidates, known: list[Known]) -> dict[int, int]:
        """Which of what is found is which of what is known: loops that are believed in come first."""
        pairs: dict[int, int] = {}
        for turn in (True, False):
            rows = [i for i in range(len(loops.birth)) if i not in pairs]
            columns = [j for j, one in enumerate(known) if (one.belief > 0) == turn]
            if rows and columns:
                matched = check_pairs(self._match(loops.part(rows, columns)), len(rows), len(columns))
                pairs.update((rows[i], columns[j]) for i, j in matched)
        return pairs


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
    trees = (as_tree(cloud, f"frame {t}") for t, cloud in enumerate(clouds))
    frames = [(tracker._frame(tree), stamp) for tree, stamp in zip(trees, stamps, strict=True)]
    for number, frame in enumerate(frames):
        check_follows(number, frames[number - 1] if number else (None, None), frame)
    seen = [cloud[frame.ids] for cloud, (frame, _) in zip(clouds, frames, strict=True)]
    diagrams = rips_persistence_many(seen, n_jobs, progress=progress)
    known = zip(clouds, frames, diagrams, strict=True)
    return [tracker._advance(cloud, frame, diagram, time) for cloud, (frame, time), diagram in known]


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


def _cycle(diagram: Diagram, i: int, ids: NDArray[np.int64]) -> NDArray[np.int64]:
    return ids[diagram.cycle(i)]


def loop_at(
    diagram: Diagram, i: int, cloud: Array, ids: NDArray[np.int64], identity: int, before: Array | None
) -> Loop:
    """Gather what the state keeps of loop `i` of a diagram of the points `ids` of a cloud, after a killer edge (2, d)."""
    edge, neighbours, killer_shift = ids[diagram.killer_edge[i]], ids[diagram.neighbours(i)], float("nan")
    if before is not None:
        killer_shift = float(hausdorff_table(cloud[edge][None], before[None])[0, 0])
    sides = np.linalg.norm(cloud[neighbours] - cloud[neighbours[:, [2, 0, 1]]], axis=2)
    return loop_of(
        cloud,
        partial(_cycle, diagram, i, ids),
        id=identity,
        birth=float(diagram.birth[i]),
        death=float(diagram.death[i]),
        killer_shift=killer_shift,
        birth_edge=ids[diagram.birth_edge[i]],
        killer_edge=edge,
        killer_triangle_ids=ids[diagram.killer_triangles[i]],
        neighbour_ids=neighbours,
        neighbour_values=sides.max(axis=1, initial=0.0) / 2,
    )
