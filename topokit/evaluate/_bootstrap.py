"""Means and medians with 95 % intervals, when samples come in bunches: the windows of an episode, the seeds of a training.

Idea: windows of one episode are near copies of each other, so a hundred of them are not a hundred facts. The bootstrap draws
whole episodes with replacement, within each garment, and seeds likewise; what a statistic does over a thousand such draws is
its interval. All models get the same draws of episodes, so that differences between them are on the same episodes.

Source: Efron and Tibshirani 1993; for samples in clusters, Davison and Hinkley 1997, section 3.8. Taught in chapter 11.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


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
    return Estimate(
        float(np.mean([one.value for one in estimates])),
        np.mean([one.draws for one in estimates], axis=0),
        max(one.n for one in estimates),
    )


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
        """(D, count) how often each of the seeds of a model is drawn."""
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
        above, below = (self._by_bunch(np.asarray(part, dtype=np.float64)) for part in (top, bottom))  # (S, E)
        often = self._seeds(len(above), model)
        with np.errstate(invalid="ignore", divide="ignore"):
            draws = (often * (self.weights @ above.T)).sum(axis=1) / (often * (self.weights @ below.T)).sum(axis=1)
            value = float(above.sum() / below.sum())
        return Estimate(value, draws, round(float(np.asarray(bottom).sum()) / len(above)))

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

    def _by_bunch(self, table: Array) -> Array:
        """(S, E) sums over the samples of each episode."""
        return np.array([np.bincount(self.bunch, row, len(self.names)) for row in table])
