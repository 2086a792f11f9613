"""What a check of a statement answers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class Witness:
    """The loop at which an inequality is closest to failing, or fails."""

    of: str  #: where the loop lives: "S_t", "O_t", "S_t+1" or "O_t+1"
    loop: int  #: its index in that diagram
    birth: float  #: its birth
    death: float  #: its death
    edge: tuple[int, int]  #: vertex ids, in the state, of the edge that decides: the killer
    what: str  #: what is the matter with it, in words


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
