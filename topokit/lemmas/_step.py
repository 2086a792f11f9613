"""Two successive states with their observations, the displacement between them, and the records that a check returns.

Source: Antonova et al. 2021, Assumption 2. Taught in chapter 4.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from .._validate import Array, Ids, as_points
from ..rips import Diagram
from ..sampling import hausdorff_table
from ._matching import DiagramMatching, match_diagrams
from ._measures import State

Given = ArrayLike | None  # what may be left out of a statement


@dataclass(frozen=True)
class Verdict:
    """One version of a statement on one instance: the inequality ``statistic <= bound`` where it is tightest."""

    statistic: float  #: the left side, in the unit of the points, unless the statement counts loops
    bound: float  #: the right side, in the same unit
    holds: bool  #: whether the inequality holds, up to rounding (1e-9 of the size of the cloud); true when there is no loop
    #: Whether the assumptions of the statement hold. The constants are measured, so only assumptions that relate them can fail.
    hypotheses: bool = True
    loops: int = 0  #: how many loops the statement is about; with zero it is empty

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


def compare(statistic: float, bound: float, tolerance: float, loops: int, hypotheses: bool = True) -> Verdict:
    """Return the verdict on ``statistic <= bound``, up to a tolerance for rounding."""
    return Verdict(statistic, bound, statistic <= bound + tolerance, hypotheses, loops)


@dataclass(frozen=True)
class LoopCheck:
    """One loop of S_t in a statement about killers."""

    loop: int  #: index of the loop in the diagram of S_t
    lifetime: float  #: lifetime of the loop, in the unit of the points
    death: float  #: death of the loop
    statistic: float  #: distance between the killers of the loop and of its counterpart; inf when it has none
    #: distances from killer to killer along the chain of diagrams: one, or the corollary's three
    legs: tuple[float, ...]
    bounds: Mapping[str, float]  #: the bound of each version ("paper", "corrected", "intrinsic") about this loop


@dataclass(frozen=True)
class Check:
    """A statement checked on one instance, in the paper's version and in the corrected one."""

    statement: str  #: its name in `verify_step`
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
        return "\n".join(lines)


@dataclass(frozen=True, eq=False)
class Step:
    """A state and the same points a moment later, with diagrams at four places: "S_t", "S_t+1" of all points, "O_t", "O_t+1"."""

    before: State
    after: State

    @cached_property
    def epsilon(self) -> float:
        """Return the largest distance that a point moves: the paper's epsilon."""
        return float(np.linalg.norm(self.after.points - self.before.points, axis=1).max(initial=0.0))

    @cached_property
    def distortion(self) -> float:
        """Return half the largest change of a distance between two points, which bounds the change of filtration values.

        It is never above epsilon, and it is zero for a rigid motion, however fast. It does not bound how far an edge moves. It
        bounds the bottleneck distance of Rips diagrams: Chazal, de Silva and Oudot 2014.
        """
        return float(np.abs(self.after.distances - self.before.distances).max(initial=0.0)) / 2

    @cached_property
    def matching(self) -> DiagramMatching:
        return match_diagrams(self.before.diagram, self.after.diagram)

    @property
    def alpha(self) -> float:
        return max(self.before.alpha, self.after.alpha)

    @property
    def larger_alpha(self) -> float:
        """Return an alpha above 2 epsilon, as Assumption 2 asks: observations cover with a larger radius, too."""
        return max(self.alpha, 2.001 * self.epsilon)

    @property
    def tolerance(self) -> float:
        return max(self.before.tolerance, self.after.tolerance)

    def state(self, place: str) -> State:
        """Return the state of a place: the one before or the one after."""
        return self.after if place.endswith("+1") else self.before

    def diagram(self, place: str) -> Diagram:
        """Return the diagram of a place: of all points, or of the observed ones."""
        return self.state(place).diagram if place.startswith("S") else self.state(place).observed_diagram

    def killers(self, place: str, n_loops: int) -> Ids:
        """Return (n, 2) vertex ids of the killer edges of n loops in a place.

        The loops are the longest-lived ones of S_t, followed to the place by the matchings; -1 where one has no counterpart.
        """
        # The appended -1 makes the index -1, no counterpart, stay -1.
        edges = self.diagram(place).killer_edge
        loops = np.arange(n_loops)
        if place.endswith("+1"):
            loops = np.append(self.matching.partner, -1)[loops]
        if place.startswith("O"):
            edges = self.state(place).ids[edges]
            loops = np.append(self.state(place).matching.partner, -1)[loops]
        return np.vstack([edges, [[-1, -1]]])[loops]

    def killer_distances(self, place: str, other: str, n_loops: int) -> Array:
        """Return (n, n) Hausdorff distances between the `killers` of two places; inf where a loop has no counterpart."""
        edges = []
        for name in (place, other):
            # Vertex -1, of a loop without counterpart, is a point of nan.
            points = np.pad(self.state(name).points, ((0, 1), (0, 0)), constant_values=np.nan)
            edges.append(points[self.killers(name, n_loops)])
        return np.nan_to_num(hausdorff_table(*edges), nan=np.inf)


def as_step(
    before: ArrayLike | Step, observed_before: Given = None, after: Given = None, observed_after: Given = None
) -> Step:
    """Check two states and their observations, and return them as a step; what is not given does not move, or is observed."""
    if isinstance(before, Step):
        return before
    if after is None:
        state = State.of(as_points(before, "state"), observed_before, "observed")
        return Step(state, state)
    step = Step(
        State.of(as_points(before, "before"), observed_before, "observed_before"),
        State.of(as_points(after, "after"), observed_after, "observed_after"),
    )
    shapes = (step.before.points.shape, step.after.points.shape)
    if shapes[0] != shapes[1]:
        raise ValueError(f"before and after must have one shape: row i of both is the same point; they are {shapes}")
    return step
