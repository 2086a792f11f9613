"""From samples to tables: every measure of every model at every horizon, with its interval."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._bootstrap import Bootstrap, Estimate, mean_of
from ._config import EvaluationConfig
from ._results import MEASURES

Array = NDArray[np.float64]
_ORDER = ("seqph", "hold", "carry", "ridge", "mlp", "pointnet", "ours")
_PLACES = {name: place for place, name in enumerate(_ORDER)}
TOLERANCES = (0.0, 0.01, 0.02, 0.03, 0.05, 0.1)
OF_GARMENTS = ("hull_accuracy", "in_plane", "in_opening", "distance_cm")
"""Those that are shown of every garment, too."""


@dataclass(frozen=True, eq=False)
class Samples:
    """All measurements of a condition."""

    columns: Mapping[str, Mapping[str, Array]]  #: model, then a name of `COLUMNS`: (seeds, n, K)
    episode: NDArray[np.int64]  #: (n,)
    garment: NDArray[np.str_]  #: (n,)
    steps: tuple[int, ...]  #: the K steps
    horizons: tuple[int, ...]  #: those of the tables

    def of(self, garment: str) -> Samples:
        rows = self.garment == garment
        some = {model: {name: part[:, rows] for name, part in table.items()} for model, table in self.columns.items()}
        return Samples(some, self.episode[rows], self.garment[rows], self.steps, self.horizons)


def horizons_of(horizon: int) -> tuple[int, ...]:
    """The steps of the tables: the paper's 1, 15, 30, 60, as far as the forecast goes."""
    return tuple(step for step in (1, 15, 30, 60) if step <= horizon)


def steps_of(horizon: int) -> tuple[int, ...]:
    """The steps of the curves: every fifth, and the first."""
    return tuple(sorted({1, *range(5, horizon + 1, 5), *horizons_of(horizon)}))


def summarise(samples: Samples, config: EvaluationConfig, thorough: bool) -> dict[str, Any]:
    """All tables of a condition; `thorough` adds the treatments of nearly flat hulls."""
    table = _Table(samples, config)
    answer: dict[str, Any] = {name: table.at_horizons(name) for name in MEASURES}
    answer |= {f"gain_of_{model}": table.gains(model) for model in ("ours", "pointnet", "mlp")}
    answer |= {"outcomes": table.outcomes(), "by_seed": table.by_seed()}
    answer["curves"] = {name: table.curve(name) for name in ("hull_accuracy", "distance_cm", "identity", "presence")}
    if thorough:
        answer["hull_treatments"] = table.treatments()
    garments = sorted(set(samples.garment.tolist()))
    if len(garments) > 1:
        answer["by_garment"] = {name: _of_garment(samples.of(name), config, thorough) for name in garments}
    return answer


def _of_garment(samples: Samples, config: EvaluationConfig, thorough: bool) -> dict[str, Any]:
    table = _Table(samples, config)
    answer: dict[str, Any] = {"windows": len(samples.episode), "episodes": len(table.bootstrap.names)}
    answer |= {name: table.at_horizons(name) for name in OF_GARMENTS} | {"outcomes": table.outcomes()}
    return answer | {"hull_treatments": table.treatments()} if thorough else answer


class _Table:
    def __init__(self, samples: Samples, config: EvaluationConfig) -> None:
        self.samples, self.tolerance = samples, config.tolerance
        self.bootstrap = Bootstrap(samples.episode, config.samples, config.seed, strata=samples.garment)
        self.models = sorted(samples.columns, key=lambda name: (_PLACES.get(name, len(_PLACES)), name))
        self.steps = {str(step): k for k, step in enumerate(samples.steps)}
        self.horizons = {str(step): self.steps[str(step)] for step in samples.horizons}

    def hits(self, model: str, tolerance: float | None = None, column: str = "outside") -> Array:
        """(seeds, n, K) whether the means are in their hulls; nan where no true loop is there."""
        near, outside = self.tolerance if tolerance is None else tolerance, self.samples.columns[model][column]
        return np.where(np.isnan(outside), np.nan, outside <= max(near, 1e-9))

    def estimate(self, name: str, model: str, k: int) -> Estimate:
        columns, number = self.samples.columns[model], self.models.index(model)
        if name.startswith("presence"):
            kinds = ("there", "absent") if name == "presence" else (name.removeprefix("presence_"),)
            pairs = [(columns[f"{kind}_right"][..., k], columns[kind][..., k]) for kind in kinds]
            return mean_of([self.bootstrap.ratio(*pair, number) for pair in pairs])
        if name == "hull_accuracy":
            return self.mean(self.hits, model, k)
        column = name.removesuffix("_cm").removesuffix("_median")
        values = columns[{"identity": "kept"}.get(column, column)] * (100 if name.endswith("_cm") else 1)
        return (
            self.bootstrap.median(values[..., k], number) if "median" in name else self.mean(lambda _: values, model, k)
        )

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

    def shares(self, model: str, k: int) -> dict[str, float]:
        outside = self.samples.columns[model]["outside"][..., k]
        outside = outside[~np.isnan(outside)]
        hit, near, silent = outside <= max(self.tolerance, 1e-9), outside <= 0.1, np.isinf(outside)
        parts = {"hit": hit, "near": near & ~hit, "far": ~near & ~hit & ~silent, "silent": silent}
        return {name: round(float(part.mean()), 4) for name, part in parts.items()}

    def by_seed(self) -> dict[str, Any]:
        """Hull accuracy of every training seed on its own, for models that have several."""
        answer = {}
        for model, hits in {model: self.hits(model) for model in self.models}.items():
            if len(hits) > 1:
                each = np.nanmean(hits, axis=1)[:, list(self.horizons.values())]
                columns = dict(zip(self.horizons, each.T.round(4).tolist(), strict=True))
                answer[model] = columns | {"mean": each.mean(axis=1).round(4).tolist()}
        return answer

    def treatments(self) -> dict[str, Any]:
        """Hull accuracy when a nearly flat hull is treated otherwise, or presence is not asked for."""
        ways: dict[str, Callable[[str], Array]] = {}
        for marked, column in {"": "outside", "marked curve alone, ": "outside_marked"}.items():
            for near in TOLERANCES:
                ways[f"{marked}within {100 * near:g} cm"] = partial(self.hits, tolerance=near, column=column)
        ways["in the plane"] = lambda model: self.samples.columns[model]["in_plane"]
        ways["in the opening"] = lambda model: self.samples.columns[model]["in_opening"]
        ways["presence not asked for"] = partial(self.hits, column="outside_anyway")
        return {name: _plain(self.rows(partial(self.mean, way))) for name, way in ways.items()}


def _plain(rows: Mapping[str, Mapping[str, Estimate]]) -> dict[str, Any]:
    return {model: {key: one.as_dict() for key, one in row.items()} for model, row in rows.items()}
