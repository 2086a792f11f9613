"""How good forecasts are, sample by sample: a window of an episode, at some of the steps ahead.

Idea: where L true loops are there (`topokit.evaluate.true_loops`), the first k = min(L, 2) forecast loops count, longest lifetime
first, as in the paper; which is compared with which is chosen in their favour. A true loop is marked by one curve of its class,
and others are as true (straight across a skirt, or behind a tie), so its hull takes in the edge that ends its class, too.

Source: the hull measure is that of Antonova et al. 2021, section 6. Taught in chapter 13.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from topokit.models import StateTensors, loop_mixtures
from topokit.seqph import assign

from ._tracking import distance_to_hull, extent

Array = NDArray[np.float64]
MOST = 2  # true loops that a sample asks for, at most: the paper's objects have one or two
OFFSET = 0.25  # how far beside the plane of a loop still counts as in it, as a share of its radius
POINTS, DRAWN = 16, 100  # of an opening, and of a mixture, for likelihood and coverage
_SLOTS = ("there", "absent")  # for the tracker, at that step
_EVENTS = ("opens", "closes")  # loops of the tracker that there are more, or fewer, than at the last frame seen
COLUMNS = (
    "outside",  # of the farthest of the k means from its hull, metres; inf when fewer than k are forecast
    "outside_any",  # the same for the nearer of two hulls: of the marked curve, of another curve of its class
    "outside_marked",  # the same for hulls of the marked curves alone, of loops that are not there, too
    "outside_anyway",  # the same as the first by lifetime times presence, none said to be absent
    "in_plane",  # whether all k are in the curve's outline, seen along its normal, and near its plane
    "in_opening",  # whether all are nearer to the centres than the curves' farthest vertices, as chapter 7 asks of tracks
    "distance",  # of the k means from these centres, metres
    "kept",  # of the true loops found at the first step and still there, the share that is found by the same slot
    *("nll", "cover50", "cover90"),  # of points of the openings: nats, shares in the regions of 50 and 90 % of the mass
    "doubt",  # the variance that a forecast expects of its error, square metres: noise that is not the opening's width
    *_SLOTS,  # how many slots there are of the kind
    *(f"{name}_right" for name in _SLOTS),  # how many of these the forecast has right
    "brier",  # mean square of presence, as a probability, less what is true
    *_EVENTS,  # how many there are, whichever loops they are: slots of networks do not say which of the present ones they mean
    *(f"{name}_said" for name in _EVENTS),  # how many the forecast says
    *(f"{name}_right" for name in _EVENTS),  # how many of these come true, at most
)


@dataclass(frozen=True, eq=False)
class TrueCurves:
    """The true loops of a window at K steps."""

    curves: tuple[Array, ...]  #: of each loop the vertices (K, L, 3), metres
    closing: tuple[Array, ...] = ()  #: of each the ends (K, 2, 3) of the edges of the full cloud that end its class
    present: tuple[NDArray[np.bool_], ...] = ()  #: (K,) whether it is there; all are when not given
    tight: tuple[Sequence[Array], ...] = ()  #: K other curves of its class, (n, 3) each

    def hulls(self, loop: int, k: int) -> list[Array]:
        """Points (n, 3) whose convex hulls count as the loop's: of the marked curve, and of another one of its class."""
        closing = self.closing[loop][k] if self.closing else np.zeros((0, 3))
        return [np.concatenate([one[loop][k], closing]) for one in (self.curves, self.tight) if one]

    @cached_property
    def extents(self) -> tuple[Array, Array]:
        """(K, loops, 3) centroids of the curves, by length, and (K, loops) largest distances from them."""
        found = [[extent(curve) for curve in loops] for loops in zip(*self.curves, strict=True)]
        centres, radii = ([[one[part] for one in frame] for frame in found] for part in (0, 1))
        return np.array(centres), np.array(radii)

    def beside(self, loop: int, k: int, point: Array) -> float:
        """At most 1 when the point lies in a curve's outline, seen along the normal, and near enough to its plane."""
        offsets = self.curves[loop][k] - point
        mean = offsets.mean(axis=0)
        axes = np.linalg.svd(offsets - mean, full_matrices=False)[2]  # of the scatter of its vertices, the normal last
        off = abs(float(mean @ axes[2])) / (OFFSET * self.extents[1][k, loop])
        inside = off <= 1 and distance_to_hull((0, 0), offsets @ axes[:2].T) < 1e-9
        return off if inside else float("inf")


def measure_forecasts(
    states: StateTensors,
    target: StateTensors,  # what the tracker saw at all steps
    past: StateTensors,  # and at the last frame before them
    truth: Sequence[TrueCurves],
    steps: Sequence[int],
    fine: Sequence[int],  # of these, where likelihood and coverage are taken, which are dear
    rng: np.random.Generator,
) -> dict[str, Array]:
    """Measure forecasts of B windows at K steps ahead, as (B, K) columns; nan where there is nothing to measure."""
    at = torch.tensor([step - 1 for step in steps])
    some = states[:, at]
    numbers = some.mean, some.death - some.birth, some.presence.double().sigmoid()
    parts = [part.double().numpy() for part in numbers]
    columns = {name: np.full((len(truth), len(steps)), np.nan) for name in COLUMNS}
    pairs = []
    for i, curves in enumerate(truth):
        samples = [_Sample(curves, k, *(part[i, k] for part in parts)) for k in range(len(steps))]
        for k, sample in enumerate(samples):
            for name, value in {**sample.places(), "kept": sample.kept(samples[0])}.items():
                columns[name][i, k] = value
            if steps[k] in fine:
                pairs += [(i, k, slot, loop) for slot, loop in sample.pairs]
    _measure_mixtures(some, truth, pairs, columns, rng)
    _count_slots(states, target, past, at, columns)
    return columns


@dataclass(frozen=True, eq=False)
class _Sample:
    """A window at one of its steps: true loops, and S forecast ones."""

    truth: TrueCurves
    k: int
    means: Array  # (S, 3)
    lifetimes: Array  # (S,)
    presence: Array  # (S,)

    @cached_property
    def loops(self) -> list[int]:
        curves, present = self.truth.curves, self.truth.present
        return [loop for loop in range(len(curves)) if not present or present[loop][self.k]]

    @cached_property
    def away(self) -> Array:
        """(S, loops) how far the means are from the centres of the true loops."""
        return np.linalg.norm(self.means[:, None] - self.truth.extents[0][self.k], axis=2)

    @cached_property
    def found(self) -> dict[int, int]:
        """The slot of each true loop in whose opening one is."""
        radii, slots = self.truth.extents[1][self.k], (self.presence > 0.5)[:, None]
        near = (self.away <= radii) & slots & np.isin(np.arange(len(radii)), self.loops)
        return {loop: slot for slot, loop in assign(self.away, near)}

    @cached_property
    def ranked(self) -> list[int]:
        """The slots that can count: of those that are more likely there than not the longest-lived."""
        return _first(self.lifetimes, self.presence > 0.5)

    @cached_property
    def pairs(self) -> list[tuple[int, int]]:
        """The slots that count, and the true loops that they are compared with; none when there are too few."""
        chosen = self.ranked[: len(self.loops)]
        if len(chosen) < min(len(self.loops), MOST):
            return []
        orders = itertools.permutations(self.loops, len(chosen))
        best = min(orders, key=lambda order: float(self.away[chosen, list(order)].sum()))
        return list(zip(chosen, best, strict=True))

    def kept(self, first: _Sample) -> float:
        """The share of the true loops found at the first step and still there that are found by the same slot."""
        still = [loop for loop in first.found if loop in self.loops]
        return float(np.mean([self.found.get(loop) == first.found[loop] for loop in still])) if still else np.nan

    def places(self) -> dict[str, float]:
        """The columns of places; only the marked curves are asked for where no true loop is there."""
        truth, k, loops = self.truth, self.k, self.loops
        values = {"outside_marked": self.outside(self.ranked, [[curve[k]] for curve in truth.curves])}
        if not loops:
            return values
        both = [truth.hulls(loop, k) for loop in loops]
        marked = [hulls[:1] for hulls in both]
        values["outside"], values["outside_any"] = self.outside(self.ranked, marked), self.outside(self.ranked, both)
        values["outside_anyway"] = self.outside(_first(self.lifetimes * self.presence, self.lifetimes > 0), marked)
        flat = [[truth.beside(loop, k, self.means[slot]) for loop in loops] for slot in self.ranked]
        values["in_plane"] = _least_worst(flat, len(loops)) <= 1
        share = (self.away / truth.extents[1][k])[self.ranked][:, loops]
        values["in_opening"] = _least_worst(share.tolist(), len(loops)) <= 1
        if self.pairs:
            values["distance"] = float(np.mean([self.away[pair] for pair in self.pairs]))
        return values

    def outside(self, slots: Sequence[int], hulls: Sequence[Sequence[Array]]) -> float:
        """Of the farthest, from the nearest of the hulls of its loop."""
        away = [[min(distance_to_hull(self.means[slot], hull) for hull in some) for some in hulls] for slot in slots]
        return _least_worst(away, len(hulls))


def _first(rank: Array, which: NDArray[np.bool_]) -> list[int]:
    ranked = np.argsort(-rank, kind="stable")
    return ranked[which[ranked]][:MOST].tolist()


def _least_worst(table: Sequence[Sequence[float]], loops: int) -> float:
    """The worst pair of the assignment whose worst pair is best: below a threshold iff all can be below it, one each."""
    asked = min(loops, MOST)
    if len(table) < asked:
        return float("inf")
    orders = itertools.permutations(range(loops), asked)
    return min(max(row[loop] for row, loop in zip(table[:asked], order, strict=True)) for order in orders)


def opening_points(curve: Array, n: int, rng: np.random.Generator) -> Array:
    """(n, 3) points of the opening that a closed curve (L, 3) bounds, uniformly: of the fan of triangles about its middle."""
    middle = np.broadcast_to(curve.mean(axis=0), curve.shape)
    fan = np.stack([middle, curve, np.roll(curve, -1, axis=0)], axis=1)  # (L, 3, 3)
    area = np.linalg.norm(np.cross(fan[:, 1] - fan[:, 0], fan[:, 2] - fan[:, 0]), axis=1) + 1e-15
    share = rng.dirichlet(np.ones(3), n)
    return np.asarray((share[:, :, None] * fan[rng.choice(len(fan), n, p=area / area.sum())]).sum(axis=1))


def _measure_mixtures(
    states: StateTensors,
    truth: Sequence[TrueCurves],
    pairs: Sequence[tuple[int, int, int, int]],
    columns: Mapping[str, Array],
    rng: np.random.Generator,
) -> None:
    if not pairs:
        return
    i, k, slot, _ = np.array(pairs).T
    shown = [getattr(states, name)[i, k, slot].double() for name in ("triangles", "values", "noise")]
    mixtures: Any = loop_mixtures(*shown)
    points = np.array([opening_points(truth[i].curves[loop][k], POINTS, rng) for i, k, _, loop in pairs])
    density = mixtures.log_prob(torch.from_numpy(points).transpose(0, 1))  # (POINTS, pairs)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(int(rng.integers(2**62)))
        own = mixtures.log_prob(mixtures.sample((DRAWN,)))  # (DRAWN, pairs)
    above = (own[:, None] > density[None]).double().mean(dim=0)  # the credible region that just reaches each point
    doubt = (shown[2] - states.death[i, k, slot].double() ** 2).clamp(min=0)[None]
    parts = {"nll": -density, "cover50": (above <= 0.5).double(), "cover90": (above <= 0.9).double(), "doubt": doubt}
    for name, part in parts.items():
        total, count = np.zeros_like(columns[name]), np.zeros_like(columns[name])
        np.add.at(total, (i, k), part.mean(dim=0).numpy())
        np.add.at(count, (i, k), 1)
        columns[name][count > 0] = total[count > 0] / count[count > 0]


def _count_slots(
    states: StateTensors, target: StateTensors, past: StateTensors, at: Tensor, columns: Mapping[str, Array]
) -> None:
    """Fill in the counts of slots. Slots have no order: the one that suits the forecast best over all steps is taken."""
    now, logits = target.matched_to(states)[:, at].presence > 0, states[:, at].presence  # (B, K, S)
    said = logits > 0
    columns["brier"][:] = (logits.double().sigmoid() - now.double()).square().mean(dim=-1).numpy()
    for name, which in zip(_SLOTS, (now, ~now), strict=True):
        columns[name][:] = which.sum(dim=-1).numpy()
        columns[f"{name}_right"][:] = (which & (said == now)).sum(dim=-1).numpy()
    more, told = (part.sum(dim=-1) - (past.presence > 0).sum(dim=-1) for part in (now, said))  # (B, K)
    for name, sign in zip(_EVENTS, (1, -1), strict=True):
        true, claimed = ((sign * part).clamp(min=0).numpy() for part in (more, told))
        columns[name][:], columns[f"{name}_said"][:] = true, claimed
        columns[f"{name}_right"][:] = np.minimum(true, claimed)
