"""Two states in succession with what is observed of them, how far points move between them, and what a check answers.

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

STORED = 1e-4  # how far a coordinate may be from its vertex: episodes are stored with 16 bits


@dataclass(frozen=True)
class Witness:
    """The loop at which an inequality is closest to failing, or fails."""

    of: str  #: where the loop lives: "S_t", "O_t", "S_t+1" or "O_t+1"
    loop: int  #: its index in that diagram
    birth: float  #: its birth
    death: float  #: its death
    edge: tuple[int, int]  #: vertex ids, in the state, of the edge that decides: the killer
    what: str  #: a description in words


@dataclass(frozen=True)
class Verdict:
    """One version of a statement on one instance: the inequality ``statistic <= bound`` where it is tightest."""

    statistic: float  #: in the unit of the points, unless the statement counts loops
    bound: float  #: in the same unit
    holds: bool  #: up to rounding (1e-9 of the size of the cloud); true when there is no loop to speak about
    #: Whether what the statement assumes is so. The constants are measured: only assumptions that relate them can fail.
    hypotheses: bool = True
    loops: int = 0  #: to how many loops the statement speaks: zero makes it empty
    witness: Witness | None = None  #: the loop where it is tightest, if any

    @property
    def applies(self) -> bool:
        """Return whether the hypotheses hold and there is a loop to speak about."""
        return self.hypotheses and self.loops > 0

    @property
    def violated(self) -> bool:
        """Return whether the statement is refuted: its hypotheses hold, and it does not."""
        return self.hypotheses and not self.holds

    @property
    def word(self) -> str:
        """Return the verdict in words."""
        if not self.loops:
            return "empty"
        if self.holds:
            return "holds"
        return "FAILS" if self.hypotheses else "fails (so do its hypotheses)"


def compare(
    statistic: float, bound: float, tolerance: float, loops: int, witness: Witness | None, hypotheses: bool = True
) -> Verdict:
    """Return whether ``statistic <= bound``, up to rounding."""
    return Verdict(statistic, bound, statistic <= bound + tolerance, hypotheses, loops, witness)


@dataclass(frozen=True)
class LoopCheck:
    """One loop of S_t in a statement about killers."""

    loop: int  #: index in the diagram of S_t
    lifetime: float  #: in the unit of the points
    statistic: float  #: how far the killers lie apart; inf when the loop has no counterpart
    legs: tuple[float, ...]  #: the same from killer to killer along the chain: one leg, or the corollary's three
    bounds: Mapping[str, float]  #: of each version ("paper", "corrected", "intrinsic") that speaks about this loop


@dataclass(frozen=True)
class Check:
    """A statement on one instance, as the paper has it and as it is true."""

    statement: str  #: one of `STATEMENTS`
    #: All verdicts by name: "paper", "corrected", "intrinsic" where something moves, and other bounds for the same statistic.
    versions: Mapping[str, Verdict]
    alpha: float = 0.0  #: as measured, as are the next two; 0.0 where the statement has none
    epsilon: float = 0.0  #: largest displacement
    distortion: float = 0.0  #: half the largest change of a distance
    loops: tuple[LoopCheck, ...] = ()  #: for statements about killers, every loop they speak about

    @property
    def paper(self) -> Verdict:
        """Return the verdict on the statement as the paper has it."""
        return self.versions["paper"]

    @property
    def corrected(self) -> Verdict:
        """Return the verdict on the statement as it is true."""
        return self.versions["corrected"]

    @property
    def intrinsic(self) -> Verdict | None:
        """Return the verdict with the distortion in place of epsilon, where something moves: sharper, and still true."""
        return self.versions.get("intrinsic")

    def __str__(self) -> str:
        constants = f"alpha {self.alpha:.4g}, epsilon {self.epsilon:.4g}, distortion {self.distortion:.4g}"
        lines = [f"{self.statement}: {constants}"]
        for name, verdict in self.versions.items():
            numbers = f"{verdict.statistic:.4g} <= {verdict.bound:.4g}"
            lines.append(f"  {name}: {numbers} {verdict.word}, {verdict.loops} loops")
            witness = verdict.witness
            if witness and not verdict.holds:
                lines.append(f"    {witness.what}: loop {witness.loop} of {witness.of}, edge {witness.edge}")
        return "\n".join(lines)


@dataclass(frozen=True, eq=False)
class Step:
    """A state and the same points a moment later; the places of its loops are "S_t", "O_t", "S_t+1" and "O_t+1"."""

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
        return self.after if place.endswith("+1") else self.before

    def diagram(self, place: str) -> Diagram:
        return self.state(place).diagram if place.startswith("S") else self.state(place).observed_diagram

    def killer_edges(self, place: str) -> Ids:
        """Return (k, 2) vertex ids, in the state, of the killer edges of this place."""
        edges = self.diagram(place).killer_edge
        return edges if place.startswith("S") else self.state(place).ids[edges]

    def killers(self, place: str, n_loops: int) -> Ids:
        """Return (n, 2) vertex ids of the killer edges that the longest-lived loops of S_t have in a place, -1 for none."""
        loops = np.arange(n_loops)
        if place.endswith("+1"):
            loops = np.append(self.matching.partner, -1)[loops]
        if place.startswith("O"):
            loops = np.append(self.state(place).matching.partner, -1)[loops]
        return np.vstack([self.killer_edges(place), [[-1, -1]]])[loops]

    def apart(self, place: str, other: str, n_loops: int) -> Array:
        """Return (n, n) Hausdorff distances of the killers that the longest-lived loops of S_t have in two places.

        A distance is inf where a loop has no killer.
        """
        ends = []
        for name in (place, other):
            points = np.pad(self.state(name).points, ((0, 1), (0, 0)), constant_values=np.nan)
            ends.append(points[self.killers(name, n_loops)])
        return np.nan_to_num(hausdorff_table(*ends), nan=np.inf)

    def witness(self, place: str, loop: int, what: str) -> Witness | None:
        """Return a loop of a place as a witness, None for the loop -1."""
        if loop < 0:
            return None
        diagram = self.diagram(place)
        a, b = self.killer_edges(place)[loop].tolist()
        return Witness(place, loop, float(diagram.birth[loop]), float(diagram.death[loop]), (a, b), what)


def as_step(
    before: ArrayLike | Step,
    observed_before: ArrayLike | None = None,
    after: ArrayLike | None = None,
    observed_after: ArrayLike | None = None,
) -> Step:
    """Return two states with what is observed of them, checked.

    Without `after` nothing moves; all vertices are observed where that is not given; a step is returned as it is.
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
    """Return half the largest change of a distance between two points: what a motion does to the filtration.

    Never above `max_displacement`, and zero for a rigid motion, however fast. Wherever a statement needs epsilon for a change
    of filtration values this number does instead; only where it says how far an edge moves must epsilon stay. That it bounds
    the bottleneck distance of Rips diagrams is the theorem of Chazal, de Silva and Oudot 2014.

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
        raise ValueError(f"before has shape {a.shape}, after {b.shape}; row i of both must be the same point")
    return a, b


def vertex_ids(points: ArrayLike, observed: ArrayLike, name: str = "observed") -> Ids:
    """Return which vertices of a state are observed, each once, ascending.

    Parameters
    ----------
    points : (n, d) array_like
        The dense state.
    observed : (m,) array_like of int, or (m, d) array_like
        Vertex ids, or coordinates of vertices.
    name : str
        The name for it in error messages.

    Raises
    ------
    TypeError, ValueError
        When nothing is observed, an id is out of range, or an observed point is no vertex of the state.
    """
    state = as_points(points)
    ids = as_reals(observed, name)
    if ids.size == 0:
        raise ValueError(f"{name} is empty; a state without a single observed point has no covering radius")
    if ids.ndim != 1:
        return np.unique(_nearest_vertices(state, as_points(observed, name), name)).astype(np.int64)
    return np.unique(as_ids(ids, name, len(state)))


def _nearest_vertices(state: Array, cloud: Array, name: str) -> Ids:
    """Return the vertices at which the points of a cloud are."""
    if cloud.shape[1] != state.shape[1]:
        raise ValueError(f"{name} has {cloud.shape[1]} dimensions, the state {state.shape[1]}")
    distance, nearest = cKDTree(state).query(cloud)
    if distance.max() > STORED:
        far = int(np.argmax(distance))
        raise ValueError(f"{name} must be vertices of the state: point {far} is {distance[far]:.3g} from the nearest")
    return np.asarray(nearest)
