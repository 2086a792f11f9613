"""What a check of a statement answers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Witness:
    """The loop at which an inequality is closest to failing, or fails.

    Attributes
    ----------
    of : str
        Where the loop lives: "S_t", "O_t", "S_t+1" or "O_t+1".
    loop : int
        Its index in that diagram.
    birth, death : float
    edge : (int, int)
        Vertex ids, in the state, of the edge that decides: the killer.
    what : str
        What is the matter with it, in words.
    """

    of: str
    loop: int
    birth: float
    death: float
    edge: tuple[int, int]
    what: str


@dataclass(frozen=True)
class Verdict:
    """One version of a statement on one instance: the inequality ``statistic <= bound`` where it is tightest.

    Attributes
    ----------
    statistic, bound : float
        Both sides, at the loop where it is tightest. In the unit of the points, unless the statement counts loops.
    holds : bool
        Up to rounding (1e-9 of the size of the cloud). True when there is no loop to speak about.
    hypotheses : bool
        Whether what the statement assumes is so here. The constants are measured, so only assumptions that relate them can
        fail.
    loops : int
        To how many loops the statement speaks: zero makes it empty.
    witness : Witness or None
        The loop where it is tightest, if any.
    """

    statistic: float
    bound: float
    holds: bool
    hypotheses: bool = True
    loops: int = 0
    witness: Witness | None = None

    @property
    def margin(self) -> float:
        """bound - statistic: negative when it fails."""
        return self.bound - self.statistic

    @property
    def applies(self) -> bool:
        """The hypotheses hold and there is a loop to speak about."""
        return self.hypotheses and self.loops > 0

    @property
    def violated(self) -> bool:
        """The statement is refuted: what it assumes is so, and it does not hold."""
        return self.hypotheses and not self.holds

    @property
    def word(self) -> str:
        """What became of it, for a reader."""
        if not self.loops:
            return "empty"
        return "holds" if self.holds else "FAILS" if self.hypotheses else "fails (so do its hypotheses)"


def compared(
    statistic: float, bound: float, tolerance: float, loops: int, witness: Witness | None, hypotheses: bool = True
) -> Verdict:
    """Whether ``statistic <= bound``, up to rounding."""
    return Verdict(statistic, bound, statistic <= bound + tolerance, hypotheses, loops, witness)


@dataclass(frozen=True)
class LoopCheck:
    """One loop of S_t in a statement about killers.

    Attributes
    ----------
    loop : int
        Index in the diagram of S_t.
    lifetime : float
    statistic : float
        How far the killers lie apart; inf when the loop has no counterpart.
    legs : tuple of float
        The same from killer to killer along the chain: one leg, or the corollary's three.
    bounds : mapping of str to float
        The bound of each version ("paper", "corrected", "intrinsic") that speaks about this loop.
    """

    loop: int
    lifetime: float
    statistic: float
    legs: tuple[float, ...]
    bounds: Mapping[str, float]


@dataclass(frozen=True)
class Check:
    """A statement on one instance, as the paper has it and as it is true.

    Attributes
    ----------
    statement : str
        One of `STATEMENTS`.
    versions : mapping of str to Verdict
        All verdicts by name: "paper", "corrected", "intrinsic" where something moves, and other bounds for the same statistic.
    alpha, epsilon, distortion : float
        As measured; 0.0 where the statement has none.
    loops : tuple of LoopCheck
        For statements about killers, every loop they speak about.
    """

    statement: str
    versions: Mapping[str, Verdict]
    alpha: float = 0.0
    epsilon: float = 0.0
    distortion: float = 0.0
    loops: tuple[LoopCheck, ...] = ()

    @property
    def paper(self) -> Verdict:
        """As the paper has it."""
        return self.versions["paper"]

    @property
    def corrected(self) -> Verdict:
        """As it is true."""
        return self.versions["corrected"]

    @property
    def intrinsic(self) -> Verdict | None:
        """The distortion of the motion in place of epsilon, where something moves: sharper, and still true."""
        return self.versions.get("intrinsic")

    def __str__(self) -> str:
        constants = f"alpha {self.alpha:.4g}, epsilon {self.epsilon:.4g}, distortion {self.distortion:.4g}"
        lines = [f"{self.statement}: {constants}"]
        for name, v in self.versions.items():
            lines.append(f"  {name}: {v.statistic:.4g} <= {v.bound:.4g} {v.word}, {v.loops} loops")
            if v.witness and not v.holds:
                lines.append(f"    {v.witness.what}: loop {v.witness.loop} of {v.witness.of}, edge {v.witness.edge}")
        return "\n".join(lines)
