"""The accuracy of forecasts, sample by sample; a sample is a window of an episode at one of the steps ahead.

Idea: where L true loops are present (`topokit.evaluate.true_loops`), the k = min(L, 2) forecast loops of longest lifetime are
judged, as in the paper. They are matched to true loops in the way that favours the forecast. A true loop is marked by one curve
of its class, but other curves are as true (straight across a skirt, or behind a tie). So the hull of a true loop also contains
the edge that ends its class.

Source: the hull measure is that of Antonova et al. 2021, section 6. Taught in chapter 15.
"""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from topokit.evaluate import distance_to_hull
from topokit.linking import curve_centroid
from topokit.models import StateTensors, loop_mixtures
from topokit.seqph import assign

Array = NDArray[np.float64]
MOST = 2  # loops of a sample that are judged, at most: the paper's objects have one or two
OFFSET = 0.25  # distance from the plane of a loop up to which a point is in the plane, as a share of the loop's radius
POINTS = 16  # points drawn from an opening, for likelihood and coverage
DRAWN = 100  # points drawn from a mixture, for coverage

COLUMNS = (
    "hull_distance",  # of the farthest of the k means from its hull, metres; inf when fewer than k are forecast
    "hull_distance_any_curve",  # the same for the nearer of two hulls: of the marked curve, of another curve of its class
    "hull_distance_marked_curve",  # the same for hulls of the marked curves alone, of loops that are not present, too
    "opening_distance",  # the same for hulls of the vertices that are marked by the paper's words, of all loops, too
    "killer_distance",  # of the farthest mean from the middle of the edge that ends its loop, in halves of this edge
    "hull_distance_presence_ignored",  # as `hull_distance`, with loops ranked by lifetime times presence and none left out
    "in_plane",  # 1 when all k are in the curve's outline, seen along its normal, and near its plane
    "in_opening",  # 1 when all are nearer to the centres than the curves' farthest vertices, as for tracks in chapter 8
    "distance",  # of the k means from these centres, metres
    "same_slot",  # of the true loops found at the first step and still present, the share found by the same slot
    "nll",  # negative log-likelihood of points of the openings, nats
    "cover50",  # share of these points in the region of 50 % of the mass
    "cover90",  # share of them in the region of 90 %
    "expected_variance",  # variance that the forecast expects of its error, m^2: its noise without the opening's width
    "present",  # slots whose loop the tracker finds at that step
    "absent",  # slots whose loop the tracker does not find
    "present_right",  # how many of the present slots the forecast has right
    "absent_right",  # how many of the absent slots
    "brier",  # mean square of the forecast probability of presence less the truth
    "opens",  # how many more loops the tracker finds than in the last observed frame; slots of networks keep no identity
    "closes",  # how many fewer
    "opens_forecast",  # how many more are forecast
    "closes_forecast",  # how many fewer
    "opens_right",  # how many of the forecast openings can be true: the smaller of both counts
    "closes_right",  # the same for closings
)


@dataclass(frozen=True, eq=False)
class TrueCurves:
    """The true loops of a window at K steps."""

    curves: tuple[Array, ...]  #: for each loop the vertices (K, L, 3) of its marked curve, metres
    #: for each loop the ends (K, 2, 3) of the edges of the full cloud that end its class
    closing: tuple[Array, ...] = ()
    present: tuple[NDArray[np.bool_], ...] = ()  #: for each loop (K,) whether it is present; all are when not given
    tight: tuple[Sequence[Array], ...] = ()  #: for each loop K other curves of its class, (n, 3) each
    marked: tuple[Array, ...] = ()  #: for each loop the vertices (K, n, 3) that are marked; its curve when not given

    def hulls(self, loop: int, k: int) -> list[Array]:
        """Return the points (n, 3) whose hulls stand for a loop at step k: those of the marked curve, and of another one."""
        closing = np.zeros((0, 3))
        if self.closing:
            closing = self.closing[loop][k]
        curves = [self.curves[loop][k]]
        if self.tight:
            curves.append(self.tight[loop][k])
        return [np.concatenate([curve, closing]) for curve in curves]

    @cached_property
    def extents(self) -> tuple[Array, Array]:
        """Return the centroids of the curves (K, loops, 3), by length, and the largest distances from them (K, loops)."""
        centres = np.zeros((len(self.curves[0]), len(self.curves), 3))
        radii = np.zeros(centres.shape[:2])
        for loop, curves in enumerate(self.curves):
            for k, curve in enumerate(curves):
                centres[k, loop] = curve_centroid(curve)
                radii[k, loop] = np.linalg.norm(curve - centres[k, loop], axis=1).max()
        return centres, radii

    def from_killer(self, loop: int, k: int, point: Array) -> float:
        """Return the distance of a point from the middle of the edge that ends a loop, as a share of half the edge's length."""
        one, other = self.closing[loop][k]
        return float(2 * np.linalg.norm(point - (one + other) / 2) / np.linalg.norm(one - other))

    def beside(self, loop: int, k: int, point: Array) -> float:
        """Return the distance of a point from a curve's plane, as a share of the allowed one; inf outside the outline."""
        offsets = self.curves[loop][k] - point
        mean = offsets.mean(axis=0)
        axes = np.linalg.svd(offsets - mean, full_matrices=False)[2]  # principal axes of the vertices, the normal last
        distance = abs(float(mean @ axes[2])) / (OFFSET * self.extents[1][k, loop])
        if distance > 1 or distance_to_hull((0, 0), offsets @ axes[:2].T) >= 1e-9:
            return float("inf")
        return distance


def measure_forecasts(
    states: StateTensors,
    target: StateTensors,
    past: StateTensors,
    truth: Sequence[TrueCurves],
    steps: Sequence[int],
    fine: Sequence[int],
    rng: np.random.Generator,
) -> dict[str, Array]:
    """Return the `COLUMNS` (B, K) of forecasts of B windows at K steps ahead, from 1; nan where there is nothing to measure.

    `states` are the forecasts, (B, horizon, slots), and `target` the tracked states at all steps; `past` are those at the last
    frame before them, (B, 1, slots). `fine` are the steps at which likelihood and coverage are measured, which takes long.
    """
    at = torch.tensor([step - 1 for step in steps])
    chosen = states[:, at]
    means = chosen.mean.double().numpy()
    lifetimes = (chosen.death - chosen.birth).double().numpy()
    presence = chosen.presence.double().sigmoid().numpy()

    # Measure places and identities sample by sample. Collect the pairs, whose mixtures are measured together afterwards.
    columns = {name: np.full((len(truth), len(steps)), np.nan) for name in COLUMNS}
    pairs = []  # window, step, slot, true loop
    for i, curves in enumerate(truth):
        samples = [_Sample(curves, k, means[i, k], lifetimes[i, k], presence[i, k]) for k in range(len(steps))]
        for k, sample in enumerate(samples):
            for name, value in sample.places().items():
                columns[name][i, k] = value
            columns["same_slot"][i, k] = sample.same_slot(samples[0])
            if steps[k] in fine:
                pairs += [(i, k, slot, loop) for slot, loop in sample.pairs]
    _measure_mixtures(chosen, truth, pairs, columns, rng)
    _count_slots(states, target, past, at, columns)
    return columns


@dataclass(frozen=True, eq=False)
class _Sample:
    """A window at one of its steps, with its true loops and S forecast loops."""

    truth: TrueCurves
    k: int
    means: Array  # (S, 3)
    lifetimes: Array  # (S,)
    presence: Array  # (S,)

    @cached_property
    def loops(self) -> list[int]:
        """Return the true loops that are present."""
        every = range(len(self.truth.curves))
        if not self.truth.present:
            return list(every)
        return [loop for loop in every if self.truth.present[loop][self.k]]

    @cached_property
    def distances(self) -> Array:
        """Return the distances (S, loops) of the forecast means from the centres of the true loops."""
        return np.linalg.norm(self.means[:, None] - self.truth.extents[0][self.k], axis=2)

    @cached_property
    def slot_of_loop(self) -> dict[int, int]:
        """Return the slot that finds each true loop: its mean is in the loop's opening."""
        radii = self.truth.extents[1][self.k]
        likely = (self.presence > 0.5)[:, None]
        near = (self.distances <= radii) & likely & np.isin(np.arange(len(radii)), self.loops)
        return {loop: slot for slot, loop in assign(self.distances, near)}

    @cached_property
    def ranked(self) -> list[int]:
        """Return the slots that are judged: the longest-lived of those that are likely present."""
        return _first(self.lifetimes, self.presence > 0.5)

    @cached_property
    def pairs(self) -> list[tuple[int, int]]:
        """Return pairs of a judged slot and its true loop; none when too few loops are forecast."""
        chosen = self.ranked[: len(self.loops)]
        if len(chosen) < min(len(self.loops), MOST):
            return []
        # Of all ways to pair them, take the one whose distances of centres have the least sum.
        orders = itertools.permutations(self.loops, len(chosen))
        best = min(orders, key=lambda order: float(self.distances[chosen, list(order)].sum()))
        return list(zip(chosen, best, strict=True))

    def same_slot(self, first: Self) -> float:
        """Return the share of the true loops found at the first step and still present that the same slot finds."""
        still = [loop for loop in first.slot_of_loop if loop in self.loops]
        if not still:
            return np.nan
        return float(np.mean([self.slot_of_loop.get(loop) == first.slot_of_loop[loop] for loop in still]))

    def places(self) -> dict[str, float]:
        """Return the columns about places; where no true loop is present, only those of the marked curves and vertices."""
        truth = self.truth
        k = self.k
        curves = [[curve[k]] for curve in truth.curves]
        values = {"hull_distance_marked_curve": self.hull_distance(self.ranked, curves)}
        marked = [[vertices[k]] for vertices in truth.marked or truth.curves]
        values["opening_distance"] = self.hull_distance(self.ranked, marked)
        if not self.loops:
            return values

        # Measure distances from hulls, with the forecast presence and without it.
        either = [truth.hulls(loop, k) for loop in self.loops]
        first = [hulls[:1] for hulls in either]
        likeliest = _first(self.lifetimes * self.presence, self.lifetimes > 0)
        values["hull_distance"] = self.hull_distance(self.ranked, first)
        values["hull_distance_any_curve"] = self.hull_distance(self.ranked, either)
        values["hull_distance_presence_ignored"] = self.hull_distance(likeliest, first)

        # Compare with the edges that end the loops, with planes, openings and centres.
        if truth.closing:
            ends = [[truth.from_killer(loop, k, self.means[slot]) for loop in self.loops] for slot in self.ranked]
            values["killer_distance"] = _least_worst(ends, len(self.loops))
        beside = [[truth.beside(loop, k, self.means[slot]) for loop in self.loops] for slot in self.ranked]
        values["in_plane"] = _least_worst(beside, len(self.loops)) <= 1
        shares = (self.distances / truth.extents[1][k])[self.ranked][:, self.loops]
        values["in_opening"] = _least_worst(shares.tolist(), len(self.loops)) <= 1
        if self.pairs:
            values["distance"] = float(np.mean([self.distances[pair] for pair in self.pairs]))
        return values

    def hull_distance(self, slots: Sequence[int], hulls: Sequence[Sequence[Array]]) -> float:
        """Return the distance of the farthest mean from the nearest hull of its loop."""

        def nearest(slot: int, choices: Sequence[Array]) -> float:
            return min(distance_to_hull(self.means[slot], hull) for hull in choices)

        return _least_worst([[nearest(slot, choices) for choices in hulls] for slot in slots], len(hulls))


def _first(rank: Array, chosen: NDArray[np.bool_]) -> list[int]:
    """Return the slots of highest rank among the chosen ones."""
    ranked = np.argsort(-rank, kind="stable")
    return ranked[chosen[ranked]][:MOST].tolist()


def _least_worst(table: Sequence[Sequence[float]], loops: int) -> float:
    """Return the value of the worst pair, in the assignment whose worst pair is best.

    It is below a threshold if and only if some assignment has all its pairs below the threshold.
    """
    n_pairs = min(loops, MOST)
    if len(table) < n_pairs:
        return float("inf")
    orders = itertools.permutations(range(loops), n_pairs)
    return min(max(row[loop] for row, loop in zip(table[:n_pairs], order, strict=True)) for order in orders)


def opening_points(curve: Array, n: int, rng: np.random.Generator) -> Array:
    """Draw (n, 3) points uniformly from the fan of triangles between a closed curve (L, 3) and the mean of its vertices."""
    middle = np.broadcast_to(curve.mean(axis=0), curve.shape)
    fan = np.stack([middle, curve, np.roll(curve, -1, axis=0)], axis=1)  # (L, 3, 3)
    area = np.linalg.norm(np.cross(fan[:, 1] - fan[:, 0], fan[:, 2] - fan[:, 0]), axis=1) + 1e-15
    share = rng.dirichlet(np.ones(3), n)
    triangles = fan[rng.choice(len(fan), n, p=area / area.sum())]
    return np.asarray((share[:, :, None] * triangles).sum(axis=1))


def _measure_mixtures(
    states: StateTensors,
    truth: Sequence[TrueCurves],
    pairs: Sequence[tuple[int, int, int, int]],
    columns: Mapping[str, Array],
    rng: np.random.Generator,
) -> None:
    """Fill in likelihood, coverage and expected variance: means over the pairs of each window and step."""
    if not pairs:
        return
    i, k, slot, _ = np.array(pairs).T
    triangles = states.triangles[i, k, slot].double()
    values = states.values[i, k, slot].double()
    noise = states.noise[i, k, slot].double()
    mixtures: Any = loop_mixtures(triangles, values, noise)

    # A point is in the region of 90 % of the mass when at most 90 % of draws from the mixture are at places of higher density.
    points = np.array([opening_points(truth[i].curves[loop][k], POINTS, rng) for i, k, _, loop in pairs])
    density = mixtures.log_prob(torch.from_numpy(points).transpose(0, 1))  # (POINTS, pairs)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(int(rng.integers(2**62)))
        density_of_draws = mixtures.log_prob(mixtures.sample((DRAWN,)))  # (DRAWN, pairs)
    # The mass of the credible region that just reaches each point.
    above = (density_of_draws[:, None] > density[None]).double().mean(dim=0)

    measured = {
        "nll": -density.mean(dim=0),
        "cover50": (above <= 0.5).double().mean(dim=0),
        "cover90": (above <= 0.9).double().mean(dim=0),
        "expected_variance": (noise - states.death[i, k, slot].double() ** 2).clamp(min=0),
    }
    # Take the mean over the pairs of a window and a step.
    for name, values_of_pairs in measured.items():
        total = np.zeros_like(columns[name])
        count = np.zeros_like(columns[name])
        np.add.at(total, (i, k), values_of_pairs.numpy())
        np.add.at(count, (i, k), 1)
        columns[name][count > 0] = total[count > 0] / count[count > 0]


def _count_slots(
    states: StateTensors, target: StateTensors, past: StateTensors, at: Tensor, columns: Mapping[str, Array]
) -> None:
    """Fill in the counts of slots.

    Slots have no order, so the order that suits the forecast best over all steps is taken.
    """
    present = target.matched_to(states)[:, at].presence > 0  # (B, K, S)
    logits = states[:, at].presence
    forecast = logits > 0
    columns["brier"][:] = (logits.double().sigmoid() - present.double()).square().mean(dim=-1).numpy()
    for name, which in (("present", present), ("absent", ~present)):
        columns[name][:] = which.sum(dim=-1).numpy()
        columns[f"{name}_right"][:] = (which & (forecast == present)).sum(dim=-1).numpy()

    # Count how many loops open or close since the last observed frame, without regard to which loops they are.
    before = (past.presence > 0).sum(dim=-1)
    true_change = present.sum(dim=-1) - before  # (B, K)
    forecast_change = forecast.sum(dim=-1) - before
    for name, sign in (("opens", 1), ("closes", -1)):
        true = (sign * true_change).clamp(min=0).numpy()
        predicted = (sign * forecast_change).clamp(min=0).numpy()
        columns[name][:] = true
        columns[f"{name}_forecast"][:] = predicted
        columns[f"{name}_right"][:] = np.minimum(true, predicted)
