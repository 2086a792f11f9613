"""How good forecasts are, sample by sample: a window of an episode, at some of the steps ahead.

A forecast names some loops; the simulator knows where the true ones are, and persistence on the full cloud which of them are
there (`topokit.evaluate.tracking.true_loops`). With L of them the first k = min(L, 2) forecast loops count, longest lifetime
first, as in the paper; which is compared with which true loop is chosen in their favour.

A true loop is marked by one curve of its class, and others are as true: around a tie that hangs before a skirt the curve may go
straight across the skirt, or along behind the tie. So its hull is that of the marked curve and of the edge of the full cloud
that ends its class. For most loops that edge spans the curve, and the hull is that of the curve alone.

Source: the hull measure is that of Antonova et al. 2021, section 6. Taught in chapter 11.
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

from topokit._matching import assign
from topokit.models.losses import match_slots
from topokit.models.mixture import loop_mixtures
from topokit.models.states import States

from .localisation import nearest_in_hull

__all__ = ["COLUMNS", "TrueCurves", "measure", "opening_points"]

Array = NDArray[np.float64]
MOST = 2
"""True loops that a sample asks for, at most: the paper's objects have one or two."""
OFFSET = 0.25
"""In the plane: how far beside the hull's plane still counts, as a share of the loop's radius."""
POINTS, DRAWN = 16, 100  # of an opening, and of a mixture, for likelihood and coverage
COLUMNS = (
    "outside",
    "outside_marked",
    "outside_anyway",
    "in_plane",
    "in_opening",
    "distance",
    "nll",
    "cover50",
    "cover90",
    "kept",
    "there",
    "there_right",
    "absent",
    "absent_right",
    "changed",
    "changed_right",
    "same",
    "same_right",
)
"""What `measure` says of every sample and step."""


@dataclass(frozen=True, eq=False)
class TrueCurves:
    """The true loops of a window at K steps.

    Attributes
    ----------
    curves : tuple of (K, L, 3) float64
        Their vertices, metres.
    closing : tuple of (K, 2, 3) float64, optional
        The ends of the edges of the full cloud that end their classes, metres.
    present : tuple of (K,) bool, optional
        Whether they are there; all of them when not given.
    """

    curves: tuple[Array, ...]
    closing: tuple[Array, ...] = ()
    present: tuple[NDArray[np.bool_], ...] = ()

    def there(self, k: int) -> list[int]:
        """The loops that are there."""
        return [loop for loop in range(len(self.curves)) if not self.present or self.present[loop][k]]

    def hull(self, loop: int, k: int) -> Array:
        """(n, 3) points whose convex hull counts as the loop's."""
        curve = self.curves[loop][k]
        return np.concatenate([curve, self.closing[loop][k]]) if self.closing else curve

    @cached_property
    def centres(self) -> Array:
        """(loops, K, 3) centroids of the curves, by length: vertices may crowd on one side."""
        found = []
        for curve in self.curves:
            after = np.roll(curve, -1, axis=1)
            sides = np.linalg.norm(after - curve, axis=2, keepdims=True) + 1e-12
            found.append((sides * (curve + after) / 2).sum(axis=1) / sides.sum(axis=1))
        return np.array(found)

    @cached_property
    def radii(self) -> Array:
        """(loops, K) largest distances of the curves from their centres."""
        pairs = zip(self.curves, self.centres, strict=True)
        return np.array([np.linalg.norm(curve - middle[:, None], axis=2).max(axis=1) for curve, middle in pairs])

    @cached_property
    def planes(self) -> tuple[tuple[Array, Array], ...]:
        """Of each loop the means of its vertices (K, 3) and the axes of their scatter (K, 3, 3), the normal last."""
        means = [curve.mean(axis=1) for curve in self.curves]
        pairs = zip(self.curves, means, strict=True)
        axes = [np.linalg.svd(curve - mean[:, None], full_matrices=False)[2] for curve, mean in pairs]
        return tuple(zip(means, axes, strict=True))

    def beside(self, loop: int, k: int, point: Array) -> float:
        """At most 1 when the point lies in a curve's outline, seen along the normal, and near enough to its plane."""
        mean, axes = (part[k] for part in self.planes[loop])
        off = abs(float((point - mean) @ axes[2])) / (OFFSET * self.radii[loop, k])
        if off > 1 or nearest_in_hull((self.curves[loop][k] - point) @ axes[:2].T) >= 1e-9:
            return float("inf")
        return float(off)


def measure(
    states: States,
    target: States,
    past: States,
    truth: Sequence[TrueCurves],
    steps: Sequence[int],
    fine: Sequence[int],
    rng: np.random.Generator,
) -> dict[str, Array]:
    """Measure the forecasts of B windows.

    Parameters
    ----------
    states : States
        The forecasts, all H steps of them.
    target, past : States
        What the tracker saw at these steps, and at the last frame before them.
    truth : sequence of B TrueCurves
        At the K `steps`.
    steps : sequence of K int
        Which of the steps ahead, from 1 to H.
    fine : sequence of int
        Those of the steps at which likelihood and coverage are taken, too; they are dear.
    rng : numpy Generator
        For these.

    Returns
    -------
    dict of (B, K) float64
        ``outside``, ``outside_anyway``: the farthest of the k means from its hull, metres; inf when fewer than k are forecast.
        The second ranks by lifetime times presence and lets none be absent. ``outside_marked``: the same as the first for hulls
        of the marked curves alone, and loops that are not there asked for, too. ``in_plane``: whether all k means lie in the
        marked curve's outline, seen along its normal, and beside its plane by `OFFSET` radii at most. ``in_opening``: whether
        all are nearer to the centres of the curves than the curves' farthest vertices, as chapter 6 asks of tracks.
        ``distance``: of the k means from these centres, metres. ``nll``, ``cover50``, ``cover90``: of `POINTS` points of the
        openings under the k mixtures, nats, and the share of them in the smallest region that has 50 or 90 % of the mass.
        ``kept``: of the true loops found at the first step and still there, how many are found by the same slot. Then counts of
        slots: those that the tracker sees there and those that are absent, those that changed since the last frame seen and
        those that did not; each with how many the forecast has right. nan where there is nothing to measure.
    """
    at = torch.tensor([step - 1 for step in steps])
    some = states[:, at]
    told = _Told(
        some.centre.double().numpy(),
        (some.death - some.birth).double().numpy(),
        some.presence.double().sigmoid().numpy(),
    )
    columns = {name: np.full((len(truth), len(steps)), np.nan) for name in COLUMNS}
    pairs = [
        pair for i, curves in enumerate(truth) for pair in _places(told, i, curves, columns, [s in fine for s in steps])
    ]
    _likelihood(some, truth, pairs, columns, rng)
    _presence(states, target, past, at, columns)
    return columns


@dataclass(frozen=True, eq=False)
class _Told:
    """Forecasts as NumPy arrays: (B, K, S, 3), and (B, K, S) twice."""

    centre: Array
    lifetime: Array
    presence: Array

    def there(self, i: int, k: int) -> NDArray[np.bool_]:
        """(S,) which slots are more likely there than not."""
        return np.asarray(self.presence[i, k] > 0.5)

    def first(self, i: int, k: int, count: int) -> list[int]:
        """The slots of window i at step k that count."""
        ranked, there = np.argsort(-self.lifetime[i, k], kind="stable"), self.there(i, k)
        return [int(slot) for slot in ranked if there[slot]][:count]

    def first_anyway(self, i: int, k: int, count: int) -> list[int]:
        """The same, whether they are said to be there or not."""
        weight = self.lifetime[i, k] * self.presence[i, k]
        return [int(slot) for slot in np.argsort(-weight, kind="stable") if self.lifetime[i, k, slot] > 0][:count]


def _places(
    told: _Told, i: int, truth: TrueCurves, columns: Mapping[str, Array], fine: Sequence[bool]
) -> list[tuple[int, int, int, int]]:
    """Fill in what concerns the places of window i; the (window, step, slot, loop) that belong together at fine steps."""
    centres, radii = truth.centres, truth.radii
    pairs, found_first = [], None
    for k in range(columns["outside"].shape[1]):
        means, loops = told.centre[i, k], truth.there(k)
        everything = min(len(truth.curves), MOST)
        marked = [curve[k] for curve in truth.curves]
        columns["outside_marked"][i, k] = _outside(means[told.first(i, k, everything)], marked, everything)
        away = np.linalg.norm(means[:, None] - centres[None, :, k], axis=2)  # (S, loops)
        near = (away <= radii[:, k]) & told.there(i, k)[:, None] & np.isin(np.arange(len(radii)), loops)
        found = {loop: slot for slot, loop in assign(away, near)}
        found_first = found if found_first is None else found_first
        still = [loop for loop in found_first if loop in loops]
        if still:
            columns["kept"][i, k] = np.mean([found.get(loop) == found_first[loop] for loop in still])
        asked = min(len(loops), MOST)
        if not asked:
            continue
        hulls = [truth.hull(loop, k) for loop in loops]
        chosen, anyway = told.first(i, k, asked), told.first_anyway(i, k, asked)
        columns["outside"][i, k] = _outside(means[chosen], hulls, asked)
        columns["outside_anyway"][i, k] = (
            columns["outside"][i, k] if chosen == anyway else _outside(means[anyway], hulls, asked)
        )
        flat = [[truth.beside(loop, k, means[slot]) for loop in loops] for slot in chosen]
        columns["in_plane"][i, k] = _least_worst(flat, asked) <= 1
        columns["in_opening"][i, k] = _least_worst((away / radii[:, k])[chosen][:, loops].tolist(), asked) <= 1
        if len(chosen) == asked:
            mates = [loops[place] for place in _nearest(away[chosen][:, loops])]
            columns["distance"][i, k] = away[chosen, mates].mean()
            pairs += [(i, k, slot, loop) for slot, loop in zip(chosen, mates, strict=True) if fine[k]]
    return pairs


def _outside(means: Array, corners: Sequence[Array], asked: int) -> float:
    """How far the means are from hulls, one each."""
    return _least_worst([[nearest_in_hull(hull - mean) for hull in corners] for mean in means], asked)


def _least_worst(table: Sequence[Sequence[float]], asked: int) -> float:
    """The worst pair of the assignment whose worst pair is best: below a threshold iff all can be below it, one each."""
    if len(table) < asked:
        return float("inf")
    orders = itertools.permutations(range(len(table[0])), asked)
    return min(max(row[loop] for row, loop in zip(table, order, strict=True)) for order in orders)


def _nearest(away: Array) -> list[int]:
    """The loop of each slot (k, loops) when the sum of distances is smallest."""
    rows = np.arange(len(away))
    orders = itertools.permutations(range(away.shape[1]), len(away))
    return list(min(orders, key=lambda order: float(away[rows, np.array(order)].sum())))


def opening_points(curve: Array, n: int, rng: np.random.Generator) -> Array:
    """(n, 3) points of the opening that a closed curve (L, 3) bounds, uniformly: of the fan of triangles about its middle."""
    middle = np.broadcast_to(curve.mean(axis=0), curve.shape)
    fan = np.stack([middle, curve, np.roll(curve, -1, axis=0)], axis=1)  # (L, 3, 3)
    area = np.linalg.norm(np.cross(fan[:, 1] - fan[:, 0], fan[:, 2] - fan[:, 0]), axis=1) + 1e-15
    share = rng.dirichlet(np.ones(3), n)
    return np.asarray((share[:, :, None] * fan[rng.choice(len(fan), n, p=area / area.sum())]).sum(axis=1))


def _likelihood(
    states: States,
    truth: Sequence[TrueCurves],
    pairs: Sequence[tuple[int, int, int, int]],
    columns: Mapping[str, Array],
    rng: np.random.Generator,
) -> None:
    """Fill in likelihood and coverage at the pairs of forecast and true loops."""
    if not pairs:
        return
    i, k, slot, _ = np.array(pairs).T
    mixtures: Any = loop_mixtures(states.triangles[i, k, slot].double(), states.values[i, k, slot].double())
    points = np.array([opening_points(truth[i].curves[loop][k], POINTS, rng) for i, k, _, loop in pairs])
    density = mixtures.log_prob(torch.from_numpy(points).transpose(0, 1))  # (POINTS, pairs)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(int(rng.integers(2**62)))
        own = mixtures.log_prob(mixtures.sample((DRAWN,)))  # (DRAWN, pairs)
    above = (own[:, None] > density[None]).double().mean(dim=0)  # the credible region that just reaches each point
    parts = {"nll": -density, "cover50": (above <= 0.5).double(), "cover90": (above <= 0.9).double()}
    for name, part in parts.items():
        total, count = np.zeros_like(columns[name]), np.zeros_like(columns[name])
        np.add.at(total, (i, k), part.mean(dim=0).numpy())
        np.add.at(count, (i, k), 1)
        columns[name][count > 0] = total[count > 0] / count[count > 0]


def _presence(states: States, target: States, past: States, at: Tensor, columns: Mapping[str, Array]) -> None:
    """Fill in the counts of slots. Slots have no order: the one that suits the forecast best over all steps is taken."""
    order = match_slots(states, target)
    now, before = target.slots(order)[:, at].presence > 0, past.slots(order).presence > 0  # (B, K, S), (B, 1, S)
    right, changed = (states[:, at].presence > 0) == now, now != before
    for name, which in {"there": now, "absent": ~now, "changed": changed, "same": ~changed}.items():
        columns[name][:] = which.sum(dim=-1).numpy()
        columns[f"{name}_right"][:] = (which & right).sum(dim=-1).numpy()
