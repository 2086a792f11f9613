"""From samples to tables: means and medians with 95 % intervals, of every measure of every model at every horizon.

Idea: windows of one episode are near copies of each other, so a hundred of them are not a hundred facts. The bootstrap draws
whole episodes with replacement, within each garment, and seeds likewise; what a statistic does over a thousand such draws is
its interval. All models get the same draws of episodes, so that differences between them are on the same episodes.

Source: Efron and Tibshirani 1993; for samples in clusters, Davison and Hinkley 1997, section 3.8. Taught in chapter 13.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._conditions import EvaluationConfig
from ._forecasters import horizons_of, steps_of
from ._results import MEASURES

Array = NDArray[np.float64]
_ORDER = ("seqph", "hold", "carry", "ridge", "mlp", "pointnet", "ours")
FAR = 0.05  # metres outside the hull: a forecast that is lost
TOLERANCES = (0.0, 0.01, 0.02, 0.03, 0.05, 0.1)
OF_PARTS = ("hull_accuracy", "in_opening")  # those that are shown of every garment and target, too


@dataclass(frozen=True, eq=False)
class Estimate:
    """A statistic and what the bootstrap made of it."""

    value: float  #: on all samples; nan when there is none
    draws: Array  #: (D,) on each draw
    n: int  #: samples that it is of

    def __sub__(self, other: Estimate) -> Estimate:
        """The gain over another one on the same draws."""
        return Estimate(self.value - other.value, self.draws - other.draws, min(self.n, other.n))

    def interval(self) -> tuple[float, float]:
        """The middle 95 % of the draws."""
        known = self.draws[np.isfinite(self.draws)]
        low, high = np.quantile(known, [0.025, 0.975]) if len(known) else (np.nan, np.nan)
        return float(low), float(high)

    def as_dict(self) -> dict[str, float | int | None]:
        """`mean`, `low`, `high`, `n`; None where there is nothing to say."""
        numbers = dict(zip(("mean", "low", "high"), (self.value, *self.interval()), strict=True))
        return {name: round(x, 4) if np.isfinite(x) else None for name, x in numbers.items()} | {"n": self.n}


def mean_of(estimates: Sequence[Estimate]) -> Estimate:
    """The mean of several statistics of the same samples, draw by draw."""
    value, draws = (np.mean([getattr(one, name) for one in estimates], axis=0) for name in ("value", "draws"))
    return Estimate(float(value), draws, max(one.n for one in estimates))


class Bootstrap:
    """Draws of episodes, the same for all statistics, and of seeds, their own for each model.

    Parameters
    ----------
    bunches : (n,) array_like of int
        Which episode each sample is of.
    draws : int
    seed : int
    strata : (n,) array_like, optional
        Which garment, say. How many there are of each was decided and not drawn, so it is the same in all draws: episodes are
        drawn among those of the same stratum.
    """

    def __init__(
        self, bunches: ArrayLike, draws: int = 1000, seed: int = 0, *, strata: ArrayLike | None = None
    ) -> None:
        self.names, first, self.bunch = np.unique(np.asarray(bunches), return_index=True, return_inverse=True)
        kind = np.zeros(len(first)) if strata is None else np.asarray(strata)[first]
        self.weights, rng = np.zeros((draws, len(first))), np.random.default_rng(seed)  # (D, E)
        for one in np.unique(kind):
            mine = np.flatnonzero(kind == one)
            drawn = rng.multinomial(len(mine), np.full(len(mine), 1 / len(mine)), size=draws)
            size = np.bincount(self.bunch)[mine]  # episodes differ in length: hold the weight of the stratum, too
            self.weights[:, mine] = drawn * (size.sum() / (drawn @ size))[:, None]
        self.seed = seed

    def _seeds(self, count: int, model: int) -> Array:
        rng = np.random.default_rng((self.seed, 1 + model))
        return rng.multinomial(count, np.full(count, 1 / count), size=len(self.weights)).astype(np.float64)

    def ratio(self, top: ArrayLike, bottom: ArrayLike, model: int = 0) -> Estimate:
        """Return the sum of `top` over that of `bottom`: a mean, where `bottom` says which samples count.

        Parameters
        ----------
        top, bottom : (seeds, n) array_like
        model : int
            Any number that tells models apart, so that their seeds are drawn independently.
        """
        parts = np.asarray(top, dtype=np.float64), np.asarray(bottom, dtype=np.float64)
        above, below = (np.array([np.bincount(self.bunch, row) for row in part]) for part in parts)  # (S, E)
        often = self._seeds(len(above), model)
        with np.errstate(invalid="ignore", divide="ignore"):
            draws = (often * (self.weights @ above.T)).sum(axis=1) / (often * (self.weights @ below.T)).sum(axis=1)
            value = float(above.sum() / below.sum())
        return Estimate(value, draws, round(float(below.sum()) / len(above)))

    def median(self, values: ArrayLike, model: int = 0) -> Estimate:
        """Return the median of what is not nan.

        Parameters
        ----------
        values : (seeds, n) array_like
        model : int
            As in `ratio`.
        """
        table = np.asarray(values, dtype=np.float64)
        seed, sample = np.nonzero(np.isfinite(table))
        if not len(seed):
            return Estimate(float("nan"), np.full(len(self.weights), np.nan), 0)
        order = np.argsort(table[seed, sample], kind="stable")
        seed, sample = seed[order], sample[order]
        found = table[seed, sample]
        often = self._seeds(len(table), model)[:, seed]
        reached = np.cumsum(self.weights[:, self.bunch[sample]] * often, axis=1)  # (D, found)
        middle = (reached < reached[:, -1:] / 2).sum(axis=1)
        draws = np.where(reached[:, -1] > 0, found[middle], np.nan)
        return Estimate(float(np.median(found)), draws, round(len(found) / len(table)))


@dataclass(frozen=True, eq=False)
class Samples:
    """All measurements of a condition."""

    columns: Mapping[str, Mapping[str, Array]]  #: model, then a name of `COLUMNS`: (seeds, n, K)
    episode: NDArray[np.int64]  #: (n,)
    garment: NDArray[np.str_]  #: (n,)
    target: NDArray[np.str_]  #: (n,)

    def of(self, rows: NDArray[np.bool_]) -> Samples:
        some = {model: {name: part[:, rows] for name, part in table.items()} for model, table in self.columns.items()}
        return Samples(some, self.episode[rows], self.garment[rows], self.target[rows])


def summarise(samples: Samples, config: EvaluationConfig, thorough: bool) -> dict[str, Any]:
    """All tables of a condition; `thorough` adds to each garment how nearly flat hulls may be treated."""
    table = _Table(samples, config)
    answer: dict[str, Any] = {name: table.at_horizons(name) for name in MEASURES}
    answer |= {"gain_of_ours": table.gains("ours"), "outcomes": table.outcomes(), "by_seed": table.by_seed()}
    answer["curves"] = {name: table.curve(name) for name in ("hull_accuracy", "distance_cm", "identity", "presence")}
    answer["hull_treatments"] = table.treatments()
    for name, kinds, fully in (("by_garment", samples.garment, thorough), ("by_target", samples.target, False)):
        parts = {kind: samples.of(kinds == kind) for kind in sorted(set(kinds.tolist()))}
        if len(parts) > 1:
            answer[name] = {kind: _of_part(part, config, fully) for kind, part in parts.items()}
    return answer


def _of_part(samples: Samples, config: EvaluationConfig, thorough: bool) -> dict[str, Any]:
    table = _Table(samples, config)
    answer: dict[str, Any] = {"windows": len(samples.episode), "episodes": len(table.bootstrap.names)}
    answer |= {name: table.at_horizons(name) for name in OF_PARTS}
    return answer | {"hull_treatments": table.treatments((0.0, config.tolerance))} if thorough else answer


class _Table:
    def __init__(self, samples: Samples, config: EvaluationConfig) -> None:
        self.samples, self.tolerance = samples, config.tolerance
        self.bootstrap = Bootstrap(samples.episode, config.samples, config.seed, strata=samples.garment)
        self.models = sorted(samples.columns, key=lambda name: ([*_ORDER, name].index(name), name))
        self.steps = {str(step): k for k, step in enumerate(steps_of(config.shape.horizon))}
        self.horizons = {str(step): self.steps[str(step)] for step in horizons_of(config.shape.horizon)}

    def hits(self, model: str, tolerance: float | None = None, column: str = "outside") -> Array:
        """(seeds, n, K) whether the means are in their hulls; nan where no true loop is there."""
        near, outside = self.tolerance if tolerance is None else tolerance, self.samples.columns[model][column]
        return np.where(np.isnan(outside), np.nan, outside <= max(near, 1e-9))

    def estimate(self, name: str, model: str, k: int) -> Estimate:
        columns, number = self.samples.columns[model], self.models.index(model)
        if name.endswith(("_recall", "_precision")):
            kind, _, of = name.partition("_")
            whole = columns[kind if of == "recall" else f"{kind}_said"]
            return self.bootstrap.ratio(columns[f"{kind}_right"][..., k], whole[..., k], number)
        if name == "presence":
            pairs = [(columns[f"{kind}_right"][..., k], columns[kind][..., k]) for kind in ("there", "absent")]
            return mean_of([self.bootstrap.ratio(*pair, number) for pair in pairs])
        if name == "hull_accuracy":
            return self.mean(self.hits, model, k)
        if name == "lost":
            return self.lost(columns["doubt"][..., k], columns["outside"][..., k] > FAR, number)
        column = name.removesuffix("_cm").removesuffix("_median")
        values = columns[{"identity": "kept"}.get(column, column)] * (100 if name.endswith("_cm") else 1)
        if "median" in name:
            return self.bootstrap.median(values[..., k], number)
        return self.mean(lambda _: values, model, k)

    def lost(self, values: Array, bad: NDArray[np.bool_], model: int) -> Estimate:
        """The chance that one of the bad has a greater value than one of the others; equal ones count half."""
        seed, sample = np.nonzero(np.isfinite(values))
        found, lost, bunch = values[seed, sample], bad[seed, sample], self.bootstrap.bunch[sample]
        often = self.bootstrap._seeds(len(values), model)[:, seed] * self.bootstrap.weights[:, bunch]
        above = (1 + np.sign(found[lost][:, None] - found[~lost])) / 2
        with np.errstate(invalid="ignore"):
            pairs = often[:, lost].sum(axis=1) * often[:, ~lost].sum(axis=1)
            draws = ((often[:, lost] @ above) * often[:, ~lost]).sum(axis=1) / pairs
        return Estimate(float(above.mean()) if above.size else np.nan, draws, round(len(found) / len(values)))

    def mean(self, values: Callable[[str], Array], model: str, k: int) -> Estimate:
        """At the k-th step, of (seeds, n, K) values of a model, without those that are nan."""
        column = values(model)[..., k]
        there = np.isfinite(column)
        return self.bootstrap.ratio(np.where(there, column, 0), there, self.models.index(model))

    def rows(self, estimate: Callable[[str, int], Estimate]) -> dict[str, dict[str, Estimate]]:
        """Model, then horizon, and the mean over these."""
        rows = {model: {step: estimate(model, k) for step, k in self.horizons.items()} for model in self.models}
        return {model: row | {"mean": mean_of(list(row.values()))} for model, row in rows.items()}

    def at_horizons(self, name: str) -> dict[str, Any]:
        return _plain(self.rows(partial(self.estimate, name)))

    def curve(self, name: str) -> dict[str, Any]:
        return _plain({m: {step: self.estimate(name, m, k) for step, k in self.steps.items()} for m in self.models})

    def gains(self, of: str) -> dict[str, Any]:
        """What the hull accuracy of a model is above that of the others, on the same draws of episodes."""
        if of not in self.models:
            return {}
        rows = self.rows(partial(self.mean, self.hits))
        mine = rows.pop(of)
        return _plain({model: {key: mine[key] - row[key] for key in row} for model, row in rows.items()})

    def outcomes(self) -> dict[str, Any]:
        """Shares of windows: in the hull, beside it by 10 cm at most, farther, or too few loops forecast."""
        return {model: {step: self.shares(model, k) for step, k in self.horizons.items()} for model in self.models}

    def shares(self, model: str, k: int) -> dict[str, float | None]:
        outside = self.samples.columns[model]["outside"][..., k]
        outside = outside[~np.isnan(outside)]
        hit, near, silent = outside <= max(self.tolerance, 1e-9), outside <= 0.1, np.isinf(outside)
        parts = {"hit": hit, "near": near & ~hit, "far": ~near & ~hit & ~silent, "silent": silent}
        return {name: round(float(part.mean()), 4) if part.size else None for name, part in parts.items()}

    def by_seed(self) -> dict[str, Any]:
        """Hull accuracy of every training seed on its own, for models that have several."""
        answer = {}
        for model, hits in {model: self.hits(model) for model in self.models}.items():
            if len(hits) > 1:
                hits = hits[..., list(self.horizons.values())]
                with np.errstate(invalid="ignore"):
                    each = np.nansum(hits, axis=1) / np.isfinite(hits).sum(axis=1)  # (seeds, horizons)
                rows = np.column_stack([each, each.mean(axis=1)]).round(4).T.astype(object)
                rows[rows != rows] = None  # nan is not equal to itself
                answer[model] = dict(zip([*self.horizons, "mean"], rows.tolist(), strict=True))
        return answer

    def treatments(self, tolerances: Sequence[float] = TOLERANCES) -> dict[str, Any]:
        """Hull accuracy when a nearly flat hull is treated otherwise, or presence is not asked for."""
        ways: dict[str, Callable[[str], Array]] = {}
        columns = {"": "outside", "any curve of the class, ": "outside_any", "marked curve alone, ": "outside_marked"}
        for marked, column in columns.items():
            for near in tolerances:
                ways[f"{marked}within {100 * near:g} cm"] = partial(self.hits, tolerance=near, column=column)
        ways["in the plane"] = lambda model: self.samples.columns[model]["in_plane"]
        ways["in the opening"] = lambda model: self.samples.columns[model]["in_opening"]
        ways["presence not asked for"] = partial(self.hits, column="outside_anyway")
        return {name: _plain(self.rows(partial(self.mean, way))) for name, way in ways.items()}


def _plain(rows: Mapping[str, Mapping[str, Estimate]]) -> dict[str, Any]:
    return {model: {key: one.as_dict() for key, one in row.items()} for model, row in rows.items()}
