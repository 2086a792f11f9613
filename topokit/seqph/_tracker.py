"""The tracker of seqPH: loops through a sequence of point clouds.

Idea: every frame's loops come from Rips persistence. A loop is the same as one of the frame before when its birth, its death and
the place of its killer edge have moved no more than the sampling (alpha), the motion (epsilon) and the jitter of killers (beta)
allow. The assignment that moves killers least in total hands the identities on. Which bars are loops is decided by the diagram
and the film before it (`_evidence`), or, as in the paper, by alpha alone.

Source: Antonova et al. 2021, Algorithm 1 and Corollary 1. In the paper's listing the matching is inside the loop over l; it needs
the whole distance matrix, so it follows both loops here. Taught in chapters 0 and 7.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from topokit._validate import Array, as_sequence, positive, whole
from topokit.linking import curve_centroid
from topokit.rips import Diagram, Film, rips_persistence_many
from topokit.sampling import as_tree, hausdorff

from ._evidence import MISSED, WEAKEST, believe
from ._frames import Frame, check_diagram, check_follows
from ._matching import Candidates, MatchRule, check_pairs, within_gates
from ._state import TopologicalState, loop_at

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

PAPER: Mapping[str, Any] = MappingProxyType(
    {"loops": "alpha", "gates": "paper", "identity": "killer-edge", "memory": 0}
)
"""The options of `SeqPH` that make it the paper's tracker, rule for rule: ``SeqPH.paper()``, ``track(clouds, **PAPER)``."""

_LOOPS = ("evidence", "alpha")
_GATES = ("paper", "proved", "near")
_IDENTITIES = ("killer-edge", "killer-triangles", "cycle")


@dataclass(frozen=True, eq=False)
class Known:
    """A bar of an earlier frame that may be found again. It is a loop once there is enough belief in it."""

    birth: float
    death: float
    place: Array  #: (p, d) for the tracker's identity
    killer_edge: Array  #: (2, d)
    belief: float  #: log-odds of being a loop
    id: int | None  #: None as long as there is too little belief in it
    motion: float = 0.0  #: how far the scene has moved since it was seen
    missed: int = 0  #: for how many frames it has not been found

    def carried(self, shift: Array | float, epsilon: float) -> Known:
        """Return it one frame later, moved with the scene."""
        return replace(self, place=self.place + shift, motion=self.motion + epsilon, missed=self.missed + 1)


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
        if loops is None:
            loops = "evidence" if alpha is None else "alpha"
        self.loops = loops
        self.gates = gates
        self.identity = identity
        self.memory = whole(memory, "memory")
        for name, choices in (("loops", _LOOPS), ("gates", _GATES), ("identity", _IDENTITIES)):
            if getattr(self, name) not in choices:
                raise ValueError(f"{name} must be one of {choices}, not {getattr(self, name)!r}")
        if match is None:
            match = partial(within_gates, gates)
        if not callable(match):
            raise TypeError(f"match must be a function of `Candidates`, not {match!r}")
        self._match = match

        # What is kept from frame to frame.
        self._number = 0  # of the next frame
        self._next_id = 0
        self._before: Frame | None = None
        self._time_before: float | None = None
        self._known: list[Known] = []
        self._film = Film()  # what persistence keeps of the frames before

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
        check_follows(self._number, frame, time, self._before, self._time_before)
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
        """Return what this tracker takes from a cloud."""
        if self.loops == "alpha":
            return Frame.of_all_points(tree, self.alpha)
        frame = Frame.without_outliers(tree)
        if self.alpha is not None:
            frame = replace(frame, alpha=self.alpha)
        return frame

    def _advance(self, cloud: Array, frame: Frame, diagram: Diagram, time: float | None) -> TopologicalState:
        """Return the state of a checked frame whose persistence is known: one turn of Algorithm 1.

        The tracker changes only at the end, so that an error of a match rule leaves it as it was.
        """
        # The bars of this frame that may be loops, and where they are. In the paper: those that live alpha or longer.
        evidence = self._loop_evidence(frame, diagram)
        bars = np.flatnonzero(evidence > WEAKEST).tolist()
        points = cloud[frame.ids]
        places = [place(diagram, bar, points, self.identity) for bar in bars]

        # The loops known from before, carried along with the scene.
        shift, epsilon = self._motion(frame)
        known = [one.carried(shift, epsilon) for one in self._known]

        # Which bar is which known loop: distances and gates of all pairs, then the cheapest matching of them.
        beta = self._beta(diagram.death[bars], np.array([one.death for one in known]))
        candidates = Candidates(
            birth=diagram.birth[bars],
            death=diagram.death[bars],
            places=np.array(places),
            known_birth=np.array([one.birth for one in known]),
            known_death=np.array([one.death for one in known]),
            known_places=np.array([one.place for one in known]),
            motion=np.array([one.motion for one in known]),
            alpha=frame.alpha,
            beta=beta,
        )
        matched = self._pairs(candidates, known)

        # A matched bar takes over belief and identity. A bar that is believed in for the first time gets a new identity.
        loops = []
        found = []
        next_id = self._next_id
        for i, bar in enumerate(bars):
            belief = 0.0
            identity = None
            edge_before = None
            if i in matched:
                before = known[matched[i]]
                belief = before.belief
                identity = before.id
                if identity is not None:
                    edge_before = before.killer_edge
            belief = believe(belief, evidence[bar])
            if belief > 0:
                if identity is None:
                    identity = next_id
                    next_id += 1
                loops.append(loop_at(diagram, bar, cloud, frame.ids, identity, edge_before))
            killer_edge = points[diagram.killer_edge[bar]]
            found.append(Known(diagram.birth[bar], diagram.death[bar], places[i], killer_edge, belief, identity))

        # Known loops that were not found are remembered for some frames, with less belief. The paper forgets them.
        taken = set(matched.values())
        missed = [one for j, one in enumerate(known) if j not in taken and one.missed <= self.memory]
        remembered = [replace(one, belief=believe(one.belief, MISSED)) for one in missed]

        # The state X_t, and what the next frame needs.
        parameters = {"alpha": frame.alpha, "beta": float(np.max(beta, initial=0.0)), "epsilon": epsilon}
        seconds = float(self._number if time is None else time)
        state = TopologicalState(self._number, seconds, tuple(loops), parameters)
        self._known = found + remembered
        self._next_id = next_id
        self._before = frame
        self._time_before = time
        self._number += 1
        return state

    def _loop_evidence(self, frame: Frame, diagram: Diagram) -> Array:
        """Return the evidence (m,) that each bar is a loop; by alpha alone it is infinite, for or against."""
        if self.loops == "alpha":
            return np.where(diagram.lifetime >= frame.alpha, np.inf, -np.inf)
        return frame.loop_evidence(diagram.birth, diagram.death)

    def _motion(self, frame: Frame) -> tuple[Array | float, float]:
        """Return how far the scene as a whole has moved, and epsilon, given or estimated."""
        if self._before is None or self.epsilon is not None:
            return 0.0, self.epsilon or 0.0
        if self.loops == "alpha":
            return 0.0, hausdorff(frame.tree, self._before.tree)
        return frame.motion_since(self._before)

    def _beta(self, death: Array, known_death: Array) -> Array | float:
        """Return beta, given or estimated as the length of the longer killer edge: of all, or (n, m) of each near pair."""
        if self.beta is not None:
            return self.beta
        if self.gates == "near":
            return 2 * np.maximum(death[:, None], known_death)
        return 2 * max([*death, *known_death], default=0.0)

    def _pairs(self, candidates: Candidates, known: list[Known]) -> dict[int, int]:
        """Return the known loop of each found one that has one. Loops that are believed in are matched first."""
        pairs: dict[int, int] = {}
        for believed in (True, False):
            rows = [i for i in range(len(candidates.birth)) if i not in pairs]
            columns = [j for j, one in enumerate(known) if (one.belief > 0) == believed]
            if rows and columns:
                rule_pairs = self._match(candidates.subset(rows, columns))
                for i, j in check_pairs(rule_pairs, len(rows), len(columns)):
                    pairs[rows[i]] = columns[j]
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

    # Check all frames before anything is computed.
    tracker = SeqPH(**options)
    frames: list[Frame] = []
    before = None
    time_before = None
    for number, (cloud, time) in enumerate(zip(clouds, stamps, strict=True)):
        frame = tracker._frame(as_tree(cloud, f"frame {number}"))
        check_follows(number, frame, time, before, time_before)
        frames.append(frame)
        before = frame
        time_before = time

    # Persistence of all frames at once, then the matching frame by frame.
    counting = [cloud[frame.ids] for cloud, frame in zip(clouds, frames, strict=True)]
    diagrams = rips_persistence_many(counting, n_jobs, progress=progress)
    states = []
    for cloud, frame, diagram, time in zip(clouds, frames, diagrams, stamps, strict=True):
        states.append(tracker._advance(cloud, frame, diagram, time))
    return states


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
