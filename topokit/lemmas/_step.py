"""Two successive states with their observations, the displacement between them, and the records that a check returns.

Source: Antonova et al. 2021, Assumption 2. Taught in chapter 4.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from .._validate import Array, Ids, as_ids, as_points, as_reals
from ..rips import Diagram
from ..sampling import hausdorff_table
from ._matching import DiagramMatching, match_diagrams
from ._measures import State

STORED = 1e-4  # how far an observed point may be from its vertex: episodes store coordinates with 16 bits


@dataclass(frozen=True)
class Witness:
    """The loop at which an inequality is closest to failing, or fails."""

    place: str  #: the diagram of the loop: "S_t", "O_t", "S_t+1" or "O_t+1"
    loop: int  #: the index of the loop in that diagram
    birth: float  #: birth of the loop
    death: float  #: death of the loop
    edge: tuple[int, int]  #: vertex ids, in the state, of the loop's killer edge, which decides
    description: str  #: the way in which the inequality is tight or fails


@dataclass(frozen=True)
class Verdict:
    """One version of a statement on one instance: the inequality ``statistic <= bound`` where it is tightest."""

    statistic: float  #: the left side, in the unit of the points, unless the statement counts loops
    bound: float  #: the right side, in the same unit
    holds: bool  #: whether the inequality holds, up to rounding (1e-9 of the size of the cloud); true when there is no loop
    #: Whether the assumptions of the statement hold. The constants are measured, so only assumptions that relate them can fail.
    hypotheses: bool = True
    loops: int = 0  #: how many loops the statement is about; with zero it is empty
    witness: Witness | None = None  #: the loop where the inequality is tightest, if any

    @property
    def applies(self) -> bool:
        """Return whether the hypotheses hold and the statement is about at least one loop."""
        return self.hypotheses and self.loops > 0

    @property
    def violated(self) -> bool:
        """Return whether the statement is refuted: its hypotheses hold, but the inequality does not."""
        return self.hypotheses and not self.holds

    @property
    def outcome(self) -> str:
        """Return the verdict as a word for a printed check."""
        if not self.loops:
            return "empty"
        if self.holds:
            return "holds"
        if self.hypotheses:
            return "FAILS"
        return "fails (so do its hypotheses)"


def compare(
    statistic: float, bound: float, tolerance: float, loops: int, witness: Witness | None, hypotheses: bool = True
) -> Verdict:
    """Return the verdict on ``statistic <= bound``, up to a tolerance for rounding."""
    return Verdict(statistic, bound, statistic <= bound + tolerance, hypotheses, loops, witness)


@dataclass(frozen=True)
class LoopCheck:
    """One loop of S_t in a statement about killers."""

    loop: int  #: index of the loop in the diagram of S_t
    lifetime: float  #: lifetime of the loop, in the unit of the points
    statistic: (
        float  #: distance between the killers of the loop and of its counterpart; inf when there is no counterpart
    )
    legs: tuple[
        float, ...
    ]  #: distances from killer to killer along the chain of diagrams: one, or the corollary's three
    bounds: Mapping[
        str, float
    ]  #: the bound of each version ("paper", "corrected", "intrinsic") that is about this loop


@dataclass(frozen=True)
class Check:
    """A statement checked on one instance, in the paper's version and in the corrected one."""

    statement: str  #: one of `STATEMENTS`
    #: All verdicts by name: "paper", "corrected", "intrinsic" where points move, and other bounds for the same statistic.
    versions: Mapping[str, Verdict]
    alpha: float = 0.0  #: the measured covering radius; 0.0 where the statement has none
    epsilon: float = 0.0  #: the measured largest displacement; 0.0 where the statement has none
    distortion: float = 0.0  #: half the largest change of a distance, as measured
    loops: tuple[LoopCheck, ...] = ()  #: every loop that a statement about killers is about; empty for other statements

    @property
    def paper(self) -> Verdict:
        """Return the verdict on the paper's version of the statement."""
        return self.versions["paper"]

    @property
    def corrected(self) -> Verdict:
        """Return the verdict on the corrected version, which is proved."""
        return self.versions["corrected"]

    @property
    def intrinsic(self) -> Verdict | None:
        """Return the verdict with the distortion in place of epsilon: sharper and still true; None where nothing moves."""
        return self.versions.get("intrinsic")

    def __str__(self) -> str:
        constants = f"alpha {self.alpha:.4g}, epsilon {self.epsilon:.4g}, distortion {self.distortion:.4g}"
        lines = [f"{self.statement}: {constants}"]
        for name, verdict in self.versions.items():
            numbers = f"{verdict.statistic:.4g} <= {verdict.bound:.4g}"
            lines.append(f"  {name}: {numbers} {verdict.outcome}, {verdict.loops} loops")
            witness = verdict.witness
            if witness and not verdict.holds:
                lines.append(f"    {witness.description}: loop {witness.loop} of {witness.place}, edge {witness.edge}")
        return "\n".join(lines)


@dataclass(frozen=True, eq=False)
class Step:
    """A state and the same points a moment later.

    The four diagrams have names, the places: "S_t" and "S_t+1" of all points, "O_t" and "O_t+1" of the observed points.
    """

    before: State
    after: State

    @cached_property
    def epsilon(self) -> float:
        return max_displacement(self.before.points, self.after.points)

    @cached_property
    def distortion(self) -> float:
        return distortion(self.before.points, self.after.points)

    @cached_property
    def matching(self) -> DiagramMatching:
        return match_diagrams(self.before.diagram, self.after.diagram)

    @property
    def alpha(self) -> float:
        return max(self.before.alpha, self.after.alpha)

    @property
    def tolerance(self) -> float:
        return max(self.before.tolerance, self.after.tolerance)

    def state(self, place: str) -> State:
        """Return the state of a place: the one before or the one after."""
        return self.after if place.endswith("+1") else self.before

    def diagram(self, place: str) -> Diagram:
        """Return the diagram of a place: of all points, or of the observed ones."""
        return self.state(place).diagram if place.startswith("S") else self.state(place).observed_diagram

    def killer_edges(self, place: str) -> Ids:
        """Return (k, 2) vertex ids, in the state, of the killer edges of a place."""
        edges = self.diagram(place).killer_edge
        return edges if place.startswith("S") else self.state(place).ids[edges]

    def killers(self, place: str, n_loops: int) -> Ids:
        """Return (n, 2) vertex ids of the killer edges of n loops in a place.

        The loops are the longest-lived ones of S_t, followed to the place by the matchings; -1 where one has no counterpart.
        """
        # The appended -1 makes the index -1, no counterpart, stay -1.
        loops = np.arange(n_loops)
        if place.endswith("+1"):
            loops = np.append(self.matching.partner, -1)[loops]
        if place.startswith("O"):
            loops = np.append(self.state(place).matching.partner, -1)[loops]
        return np.vstack([self.killer_edges(place), [[-1, -1]]])[loops]

    def killer_distances(self, place: str, other: str, n_loops: int) -> Array:
        """Return (n, n) Hausdorff distances between the killer edges of n loops in one place and in another.

        The loops are those of `killers`. A distance is inf where a loop has no counterpart.
        """
        edges = []
        for name in (place, other):
            # Vertex -1, of a loop without counterpart, is a point of nan.
            points = np.pad(self.state(name).points, ((0, 1), (0, 0)), constant_values=np.nan)
            edges.append(points[self.killers(name, n_loops)])
        return np.nan_to_num(hausdorff_table(*edges), nan=np.inf)

    def witness(self, place: str, loop: int, description: str) -> Witness | None:
        """Return a loop of a place as a witness; None for the loop -1."""
        if loop < 0:
            return None
        diagram = self.diagram(place)
        a, b = self.killer_edges(place)[loop].tolist()
        return Witness(place, loop, float(diagram.birth[loop]), float(diagram.death[loop]), (a, b), description)


def as_step(
    before: ArrayLike | Step,
    observed_before: ArrayLike | None = None,
    after: ArrayLike | None = None,
    observed_after: ArrayLike | None = None,
) -> Step:
    """Check two states and their observations, and return them as a step.

    Without `after`, nothing moves. Without an observation, all vertices are observed. A step is returned as it is.
    """
    if isinstance(before, Step):
        return before
    points = as_points(before, "state" if after is None else "before")
    if after is None:
        state = _observed(points, observed_before, "observed")
        return Step(state, state)
    points, points_after = _same_points(points, after)
    return Step(
        _observed(points, observed_before, "observed_before"),
        _observed(points_after, observed_after, "observed_after"),
    )


def _observed(points: Array, observed: ArrayLike | None, name: str) -> State:
    """Return the state of points and of an observation, which has a name in error messages."""
    ids = np.arange(len(points)) if observed is None else vertex_ids(points, observed, name)
    return State(points, ids)


def max_displacement(before: ArrayLike, after: ArrayLike) -> float:
    """Return the largest distance that a point moves: the paper's epsilon, in the unit of the points.

    Parameters
    ----------
    before, after : (n, d) array_like
        Row i of both is the same point.
    """
    a, b = _same_points(before, after)
    return float(np.linalg.norm(b - a, axis=1).max(initial=0.0))


def distortion(before: ArrayLike, after: ArrayLike) -> float:
    """Return half the largest change of a distance between two points, which bounds the change of filtration values.

    It is never above `max_displacement`, and it is zero for a rigid motion, however fast. Where a statement uses epsilon to
    bound a change of filtration values, the distortion is enough; where it bounds how far an edge moves, epsilon is needed.
    The distortion bounds the bottleneck distance of Rips diagrams: Chazal, de Silva and Oudot 2014.

    Parameters
    ----------
    before, after : (n, d) array_like
        Row i of both is the same point.
    """
    a, b = _same_points(before, after)
    return float(np.abs(cdist(b, b) - cdist(a, a)).max(initial=0.0)) / 2


def _same_points(before: ArrayLike, after: ArrayLike) -> tuple[Array, Array]:
    """Return both clouds, or raise ValueError when row i of both cannot be the same point."""
    a = as_points(before, "before")
    b = as_points(after, "after")
    if a.shape != b.shape:
        raise ValueError(
            f"before and after must have one shape, since row i of both is the same point, not {a.shape} and {b.shape}"
        )
    return a, b


def vertex_ids(points: ArrayLike, observed: ArrayLike, name: str = "observed") -> Ids:
    """Return the ids of the observed vertices of a state, each once, in ascending order.

    Parameters
    ----------
    points : (n, d) array_like
        All vertices of the state.
    observed : (m,) array_like of int, or (m, d) array_like
        The ids of the observed vertices, or their coordinates.
    name : str
        The name of `observed` in error messages.

    Raises
    ------
    TypeError, ValueError
        When nothing is observed, an id is out of range, or an observed point is no vertex of the state.
    """
    state = as_points(points)
    ids = as_reals(observed, name)
    if ids.size == 0:
        raise ValueError(f"{name} is empty: at least one vertex must be observed, for the covering radius to exist")
    if ids.ndim != 1:
        return np.unique(_nearest_vertices(state, as_points(observed, name), name)).astype(np.int64)
    return np.unique(as_ids(ids, name, len(state)))


def _nearest_vertices(state: Array, cloud: Array, name: str) -> Ids:
    """Return the ids of the vertices at which the points of a cloud are."""
    if cloud.shape[1] != state.shape[1]:
        raise ValueError(f"{name} must have the {state.shape[1]} dimensions of the state, not {cloud.shape[1]}")
    distance, nearest = cKDTree(state).query(cloud)
    if distance.max() > STORED:
        far = int(np.argmax(distance))
        problem = f"point {far} is {distance[far]:.3g} from the nearest vertex, more than {STORED:g}"
        raise ValueError(f"{name} must be vertices of the state, by ids or coordinates: {problem}")
    return np.asarray(nearest)
