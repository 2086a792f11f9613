"""The tracker of seqPH: loops through a sequence of point clouds.

Idea: every frame's loops come from Rips persistence. A loop is the same as one of the frame before when its birth, its death and
the place of its killer edge have moved no more than the sampling (alpha), the motion (epsilon) and the jitter of killers (beta)
allow. The assignment that moves killers least in total hands the identities on. The evidence of the diagram
and of earlier frames decides which bars are loops (`_evidence`), or, as in the paper, alpha alone.

Source: Antonova et al. 2021, Algorithm 1 and Corollary 1. The algorithm is given alpha, beta and epsilon; the estimates are ours.
In its listing the matching is called inside the loop over l. The last call has the whole distance matrix and replaces what the
calls before it have said, so here it is called once, after both loops. Taught in chapters 0 and 7.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from topokit._validate import Array, as_number, as_sequence, is_empty, positive, whole
from topokit.linking import curve_centroid
from topokit.rips import Diagram, rips_persistence, rips_persistence_many
from topokit.sampling import as_tree, hausdorff

from ._evidence import EvidenceRule
from ._frames import Frame
from ._matching import Candidates, MatchRule, match_leaps, within_gates
from ._state import TopologicalState, loop_at

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

PAPER: Mapping[str, Any] = MappingProxyType(
    {"loops": "alpha", "gates": "paper", "identity": "killer-edge", "memory": 0}
)
"""The options of `SeqPH` that make it the paper's tracker: ``SeqPH.paper(alpha=...)``, ``track(clouds, alpha=..., **PAPER)``."""

CHOICES = {
    "loops": ("evidence", "alpha"),
    "gates": ("paper", "proved", "near"),
    "identity": ("killer-edge", "killer-triangles", "cycle"),
}


@dataclass(frozen=True, eq=False)
class Known:
    """A bar of an earlier frame that may be found again. It is a loop once its belief is large enough."""

    birth: float
    death: float
    place: Array  #: (p, d) points of its place, by the tracker's `identity`
    killer_edge: Array  #: (2, d) ends of the killer edge
    belief: float  #: log-odds of being a loop
    id: int | None  #: identity; None as long as its belief is too small
    motion: float = 0.0  #: distance that the scene has moved since the bar was last found
    missed: int = 0  #: number of frames since the bar was last found

    def carried(self, shift: Array | float, epsilon: float, frames: int) -> Known:
        """Return it some frames later, moved with the scene."""
        return replace(self, place=self.place + shift, motion=self.motion + epsilon, missed=self.missed + frames)


class SeqPH:
    """Tracker of loops, one frame at a time: sequential persistent homology.

    Parameters
    ----------
    alpha : float, optional
        Largest distance from a point of the scene to the nearest observed point (Assumption 1). By default it is estimated as
        half the distance within which 95 % of the points have their nearest other point; all points with ``loops="alpha"``.
    beta : float, optional
        Largest distance between two killers of one loop (Assumption 3). By default it is estimated as the length of the longer
        of the two killer edges: on cloth the candidates for a loop's killer lie around that loop.
    epsilon : float, optional
        Largest motion of a point from one frame to the next (Assumption 2). By default earlier places are moved with the
        scene as a whole, and epsilon is estimated as the 90 % quantile of the motion that remains. With ``loops="alpha"``
        the estimate is the Hausdorff distance of the clouds. When epsilon is given, no place is moved.
    loops : {"evidence", "alpha"}, optional
        Rule by which bars are loops. "evidence": bars that the diagram and earlier frames support; isolated points are
        left out (`topokit.sampling.inliers`). "alpha", as in the paper: bars that live alpha or longer, with all points.
        The default is "alpha" when alpha is given, else "evidence".
    gates : {"near", "proved", "paper"}
        Largest changes of birth, death and place for the same loop. "near": ``alpha + epsilon`` and a quarter of the larger
        death for birth and for death, and ``beta + epsilon`` with the beta of this pair for the place. With evidence, a loop
        that would get a new identity takes that of a missed loop within ``2 beta``, if there is one. "proved": the bounds of the
        proofs, ``alpha + epsilon`` and ``2 beta + epsilon``. "paper": ``2 alpha + epsilon`` and ``2 alpha + beta + epsilon``.
    identity : {"killer-edge", "killer-triangles", "cycle"}
        Place of a loop. In the paper it is the two ends of the killer edge, compared by Hausdorff distance. On a nearly
        round loop that edge can jump across the loop between two frames. The barycentre of the thick killer triangle and
        the centroid of the representative cycle do not jump; the cycle needs a search of its own.
    memory : int
        Number of frames for which a missed loop is remembered, 40 by default. When it returns within its gates, widened by
        the motion since, it keeps its identity. With evidence it is returned once its belief is large enough: after 25 missed
        frames, some three frames later. When times are given, a gap counts as the frames that it would hold, at the median
        step of the 100 frames before it.
    match : callable, optional
        Function of `Candidates` that returns the pairs (i, j) of a found loop i and the same known loop j, each at most once.
        It is called for the known loops with positive belief, then for the rest. By default it minimises the total
        distance of places within the gates.

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
        memory: int = 40,
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
        for name, choices in CHOICES.items():
            if getattr(self, name) not in choices:
                raise ValueError(f"{name} must be one of {choices}, not {getattr(self, name)!r}")
        self._rule = EvidenceRule()
        self._match = match or partial(within_gates, gates)
        self._matches_leaps = match is None and gates == "near" and loops == "evidence"

        # The memory from frame to frame.
        self._last_frame: Frame | None = None
        self._number = 0  # number of the next frame
        self._seconds = -np.inf  # time of the last frame
        self._steps: deque[float] = deque(maxlen=100)  # seconds between frames
        self._next_id = 0
        self._known: list[Known] = []

    @classmethod
    def paper(cls, **options: Any) -> SeqPH:
        """Return the paper's tracker: bars that live alpha are loops, the paper's gates on killer edges, no memory.

        The paper's Algorithm 1 is given alpha, beta and epsilon; pass them where they are known. Each that is not passed is
        guessed, and the guess is ours, not the paper's: alpha by half the largest distance of a point from its nearest other
        one, beta by the longest killer edge, epsilon by the Hausdorff distance of the clouds. One stray point makes this
        alpha too large, and repeated points make it too small.

        Parameters
        ----------
        **options
            Options of the class that replace the paper's.
        """
        return cls(**{**PAPER, **options})

    def update(
        self, points: ArrayLike, *, time: float | None = None, diagram: Diagram | None = None
    ) -> TopologicalState:
        """Take the next frame and return its state. One that cannot follow is refused, and the tracker stays as it was.

        Parameters
        ----------
        points : (n, d) array_like
            Cloud, which is copied. Clouds may differ in n, not in d. In one that is None or empty nothing was seen: the state
            has no loops, and known loops are remembered.
        time : float, optional
            Time in seconds, for all frames or for none; the frame's number when not given.
        diagram : Diagram, optional
            Persistence of these points, computed when not given. With a given diagram isolated points are not left out.
            All its loops must die. That it belongs to other points with the same number of them is not noticed.

        Raises
        ------
        ValueError
            When the cloud has a NaN, or another dimension than the one before; when its time is not later than the last; when
            the diagram has another number of points, or a loop that does not die.
        """
        seconds = check_time(self._number, time, self._seconds)
        if is_empty(points):
            return self._skip(seconds)
        tree = as_tree(points, f"frame {self._number}", copy=True)
        dimension = None if self._last_frame is None else self._last_frame.tree.m
        if dimension not in (None, tree.m):
            raise ValueError(f"frame {self._number} has {tree.m} dimensions, the frames before it have {dimension}")
        frame = self._frame(tree)
        if diagram is None:
            diagram = rips_persistence(tree.data[frame.ids])
        elif diagram.n_points != tree.n or np.isinf(diagram.death).any():
            needed = f"{tree.n} points, computed without max_radius"
            raise ValueError(f"frame {self._number} needs a diagram of its {needed}, not {diagram!r}")
        else:
            frame = replace(frame, ids=np.arange(tree.n))
        return self._advance(tree.data, frame, diagram, seconds)

    def stream(self, frames: Iterable[ArrayLike]) -> Iterator[TopologicalState]:
        """Yield the state of every frame as it comes; only the input of the next frame is kept.

        Examples
        --------
        >>> square = np.array([[0, 0], [1, 0], [1, 1], [0, 1.01]])
        >>> [len(state) for state in SeqPH(alpha=0.1).stream(square for _ in range(2))]
        [1, 1]
        """
        for points in frames:
            yield self.update(points)

    @property
    def frame(self) -> Frame:
        """Return the points of the last cloud that count, and how far apart they are; LookupError before the first."""
        if self._last_frame is None:
            raise LookupError("the tracker has no frame yet: call update(points)")
        return self._last_frame

    def evidence(self, diagram: Diagram) -> Array:
        """Return the log-odds (m,) that each bar is a loop, by the last frame alone; by alpha alone they are infinite.

        The diagram is of the points that count in the last frame, wherever they are now.
        """
        return self._evidence(diagram, self.frame)

    def presence(self, birth: ArrayLike, death: ArrayLike, ahead: ArrayLike) -> Array:
        """Return the probability that loops are in the state so many frames ahead, by their evidence there and by memory.

        Parameters
        ----------
        birth, death : array_like
            Of the loops then. They are judged by the sampling of the last frame.
        ahead : array_like
            Frames since the loops were last seen, and seen well; infinite for loops that are new.
        """
        evidence = self._rule.evidence(np.asarray(birth), np.asarray(death), self.frame, compared=False)
        log_odds = evidence + self._rule.belief_after(np.asarray(ahead, dtype=np.float64))
        return np.asarray(1 / (1 + np.exp(-log_odds)))

    def _frame(self, tree: cKDTree) -> Frame:
        """Return the points that this tracker takes from a cloud."""
        points_of = Frame.of_all_points if self.loops == "alpha" else Frame.without_outliers
        return points_of(tree, self.alpha)

    def _skip(self, seconds: float) -> TopologicalState:
        """Return the state of a frame in which nothing was seen."""
        epsilon = self.epsilon or 0.0
        parameters = {"alpha": self.alpha or 0.0, "beta": self.beta or 0.0, "epsilon": epsilon}
        state = TopologicalState(self._number, seconds, (), parameters)
        frames = self._frames_until(seconds)
        carried = [loop.carried(0.0, epsilon, frames) for loop in self._known]
        self._known = [loop for loop in carried if loop.missed <= self.memory]
        self._pass(seconds)
        return state

    def _advance(self, cloud: Array, frame: Frame, diagram: Diagram, seconds: float) -> TopologicalState:
        """Return the state of a checked frame whose persistence is known: one turn of Algorithm 1.

        The tracker changes only at the end, so that an error of a match rule leaves it as it was.
        """
        # The bars of this frame that may be loops, and their places. In the paper: bars that live alpha or longer.
        evidence = self._evidence(diagram, frame)
        bars = np.flatnonzero(evidence > self._rule.weakest).tolist()
        points = cloud[frame.ids]
        places = [place(diagram, bar, points, self.identity) for bar in bars]

        # The loops known from before, carried along with the scene. A loop of the last frame has missed no frame yet.
        shift, epsilon = self._motion(frame)
        frames = self._frames_until(seconds)
        carried = [loop.carried(shift, epsilon, frames) for loop in self._known]
        known = [loop for loop in carried if loop.missed <= self.memory + 1]

        # Match bars with known loops: distances and gates of all pairs, then the cheapest matching.
        beta = self._beta(diagram.death[bars], np.array([loop.death for loop in known]))
        candidates = Candidates(
            birth=diagram.birth[bars],
            death=diagram.death[bars],
            places=np.array(places),
            known_birth=np.array([loop.birth for loop in known]),
            known_death=np.array([loop.death for loop in known]),
            known_places=np.array([loop.place for loop in known]),
            motion=np.array([loop.motion for loop in known]),
            alpha=frame.alpha,
            beta=np.broadcast_to(beta, (len(bars), len(known))),
        )
        known_of_bar = self._matching(candidates, known)

        # A matched bar takes over the belief. A bar whose belief becomes positive takes over the identity, too: of its known
        # loop, or of a missed loop near it; otherwise it gets a new one.
        beliefs = []
        for i, bar in enumerate(bars):
            belief = known[known_of_bar[i]].belief if i in known_of_bar else 0.0
            beliefs.append(self._rule.believe(belief, evidence[bar]))
        named = {i: j for i, j in known_of_bar.items() if known[j].id is not None}
        if self._matches_leaps:
            nameless = [i for i, belief in enumerate(beliefs) if belief > 0 and i not in named]
            matched = set(known_of_bar.values())
            missed = [j for j, loop in enumerate(known) if loop.id is not None and j not in matched]
            named |= _matched(match_leaps, candidates, nameless, missed)

        loops = []
        known_now = []
        next_id = self._next_id
        for i, bar in enumerate(bars):
            identity = known[named[i]].id if i in named else None
            edge_before = known[named[i]].killer_edge if i in named else None
            if beliefs[i] > 0:
                if identity is None:
                    identity = next_id
                    next_id += 1
                loops.append(loop_at(diagram, bar, cloud, frame.ids, identity, edge_before))
            killer_edge = points[diagram.killer_edge[bar]]
            known_now.append(
                Known(diagram.birth[bar], diagram.death[bar], places[i], killer_edge, beliefs[i], identity)
            )

        # Known loops that were not found are remembered for some frames, with less belief. The paper forgets them.
        matched = {*known_of_bar.values(), *named.values()}
        for j, loop in enumerate(known):
            if j not in matched and loop.missed <= self.memory:
                known_now.append(replace(loop, belief=self._rule.believe(loop.belief, self._rule.missed)))

        # The state X_t, and the memory for the next frame.
        parameters = {"alpha": frame.alpha, "beta": float(np.max(beta, initial=0.0)), "epsilon": epsilon}
        state = TopologicalState(self._number, seconds, tuple(loops), parameters)
        self._known = known_now
        self._next_id = next_id
        self._last_frame = frame
        self._pass(seconds)
        return state

    def _frames_until(self, seconds: float) -> int:
        """Return how many frames there are from the last one to one at this time, when all steps are the usual one."""
        if not self._steps:
            return 1
        return max(1, round((seconds - self._seconds) / np.median(self._steps)))

    def _pass(self, seconds: float) -> None:
        """Go on to the next frame."""
        if self._number > 0:
            self._steps.append(seconds - self._seconds)
        self._seconds = seconds
        self._number += 1

    def _evidence(self, diagram: Diagram, frame: Frame) -> Array:
        """Return the evidence (m,) that each bar of a frame is a loop; by alpha alone it is infinite, for or against."""
        if self.loops == "alpha":
            return np.where(diagram.lifetime >= frame.alpha, np.inf, -np.inf)
        return self._rule.evidence(diagram.birth, diagram.death, frame)

    def _motion(self, frame: Frame) -> tuple[Array | float, float]:
        """Return the motion of the scene as a whole, and epsilon, given or estimated."""
        if self._last_frame is None or self.epsilon is not None:
            return 0.0, self.epsilon or 0.0
        if self.loops == "alpha":
            return 0.0, hausdorff(frame.tree, self._last_frame.tree)
        return frame.motion_since(self._last_frame)

    def _beta(self, death: Array, known_death: Array) -> Array | float:
        """Return beta, given or estimated as the length of the longer killer edge: of all, or (n, m) of each near pair."""
        if self.beta is not None:
            return self.beta
        if self.gates == "near":
            return 2 * np.maximum(death[:, None], known_death)
        return 2 * max([*death, *known_death], default=0.0)

    def _matching(self, candidates: Candidates, known: list[Known]) -> dict[int, int]:
        """Return the known loop of each matched bar. Known loops with positive belief are matched first."""
        pairs: dict[int, int] = {}
        for believed in (True, False):
            rows = [i for i in range(len(candidates.birth)) if i not in pairs]
            columns = [j for j, loop in enumerate(known) if (loop.belief > 0) == believed]
            pairs |= _matched(self._match, candidates, rows, columns)
        return pairs


def _matched(rule: MatchRule, candidates: Candidates, rows: list[int], columns: list[int]) -> dict[int, int]:
    """Return the known loop of each bar that a rule matches, of these bars and these known loops."""
    if not rows or not columns:
        return {}
    pairs = list(rule(candidates.subset(rows, columns)))
    matching = {rows[i]: columns[j] for i, j in pairs}
    if len(set(matching.values())) < len(pairs):
        raise ValueError(f"match must return each found and each known loop once at most, not {pairs}")
    return matching


def check_time(number: int, time: float | None, before: float) -> float:
    """Return the time of a frame, its number when it has none, or raise ValueError unless it is later than the one before."""
    seconds = float(number if time is None else as_number(time, "time", "number of seconds"))
    if not seconds > before:
        reason = f"its time {seconds:g} s is not later than the time {before:g} s of the frame before"
        raise ValueError(f"frame {number} cannot follow: {reason}; sort the frames by time and drop repeated ones")
    return seconds


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
        In a frame that is None or empty nothing was seen.
    times : T floats, optional
        Seconds of the frames.
    n_jobs : int, optional
        Threads for the persistence of the frames; as many as there are cores when not given.
    progress : bool
        Count the frames done on stderr.
    **options
        Options of `SeqPH`.

    Raises
    ------
    ValueError
        In the cases of `SeqPH`; the message names the frame. All frames are checked before anything is computed.
    """
    clouds = as_sequence(sequence)
    stamps: list[float | None] = [None] * len(clouds) if times is None else list(times)
    if len(stamps) != len(clouds):
        raise ValueError(f"times has {len(stamps)} values for {len(clouds)} frames")
    tracker = SeqPH(**options)
    seconds = [-np.inf]
    for number, time in enumerate(stamps):
        seconds.append(check_time(number, time, seconds[-1]))

    # Persistence of all frames at once, then the matching frame by frame.
    frames = [tracker._frame(as_tree(cloud)) if len(cloud) else None for cloud in clouds]
    counted = [cloud if frame is None else cloud[frame.ids] for cloud, frame in zip(clouds, frames, strict=True)]
    diagrams = rips_persistence_many(counted, n_jobs, progress=progress)
    return [
        tracker._skip(time) if frame is None else tracker._advance(cloud, frame, diagram, time)
        for cloud, frame, diagram, time in zip(clouds, frames, diagrams, seconds[1:], strict=True)
    ]


def place(diagram: Diagram, bar: int, cloud: Array, identity: str) -> Array:
    """Return the place (p, d) of the loop of a bar, for one of the identities of `SeqPH`; the cloud is the diagram's."""
    if identity == "killer-edge":
        return cloud[diagram.killer_edge[bar]]
    if identity == "killer-triangles":
        return cloud[diagram.killer_triangles[bar, 0]].mean(axis=0, keepdims=True)
    return curve_centroid(cloud[diagram.cycle(bar)])[None]
