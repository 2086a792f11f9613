"""Which bars are loops: the evidence of one diagram, and its sum over a film.

Idea: a bar of the scene is long beside the distances between neighbouring points, and it dies at many times the radius of its
birth. The more points there are, the more chances has noise. One number, the significance, holds all three: a loop has more
than 1. Its logarithm is the evidence of a frame. Along a track evidence adds up and is slowly forgotten. So a loop that has been
seen well is kept through frames in which it is hardly seen, and a chance bar does not become one.

Source: death / birth as the mark of a loop against noise, and the number of bars in its threshold, are from Bobrowski and
Skraba 2023 (*A universal null-distribution for topological data analysis*); the sum of evidence is Wald's sequential test. The
constants were chosen on simulated films that no table of the book scores. Taught in chapter 7.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from topokit._validate import Array

WEAKEST = -2.5  # a bar of less evidence is never looked at
MISSED = -1.0  # evidence of a frame in which a known loop is not found

_FEW = 128  # points; the rule was not tried on fewer
_MANY = 1000  # points for which significance needs no factor
_EVEN = 2.1  # unevenness of points that keep their distance from each other
_STREWN = 2.4  # unevenness of points strewn at random
_AGAINST = -3.0  # least evidence of one frame
_FOR = 2.0  # most evidence of one frame
_FORGET = 0.8  # share of a belief that is left a frame later
_LEAST = -8.0  # least belief


class Gaps(NamedTuple):
    """The widths of the gaps between the points of a cloud, holes aside."""

    spacing: float  #: median distance of a point from its fifth nearest neighbour, in the unit of the points
    unevenness: float  #: 1.4 for a grid, 2.6 for points strewn at random on a surface

    @classmethod
    def of(cls, nearest: Array) -> Gaps:
        """Measure the gaps, given the distances (n, 5) of points from their nearest other ones."""
        first, fifth = np.median(nearest[:, [0, -1]], axis=0).tolist()
        if first == 0:
            return cls(fifth, 1.4)

        # Points strewn at random have far fifth neighbours, and some far nearest ones. On a curve only the fifth are far,
        # where a mesh is irregular only the nearest. So the smaller of the two measures counts.
        by_fifth = fifth / first
        by_nearest = 1.4 * float(np.quantile(nearest[:, 0], 0.9)) / first
        return cls(fifth, min(by_fifth, by_nearest))


def significance(birth: Array, death: Array, gaps: Gaps, n_points: int) -> Array:
    """Return how much each bar stands out from the sampling: a loop has more than 1.

    It is 1.1 lifetime / spacing * log(death / birth)^0.3 * (1000 / n)^p, whatever the unit of length. Points strewn at random
    leave wide gaps, in a small sample as in a large one: for them the spacing counts 1.3 times, and p is 0.3 instead of 3/4.
    """
    if gaps.spacing == 0:
        return np.zeros(np.shape(death))
    power = np.interp(gaps.unevenness, (_EVEN, _STREWN), (0.75, 0.3))
    spacing = gaps.spacing * max(gaps.unevenness / 2, 1.0)
    with np.errstate(divide="ignore"):  # points that coincide are born at 0
        ratio = np.log(death / birth) ** 0.3
    return np.asarray(1.1 * (death - birth) / spacing * ratio * (_MANY / max(n_points, _FEW)) ** power)


def evidence(significance: Array) -> Array:
    """Return the log-odds that bars are loops, by one frame alone."""
    with np.errstate(divide="ignore"):
        return np.clip(5 * np.log(significance), _AGAINST, _FOR)


def believe(belief: float, evidence: float) -> float:
    """Return the belief in a loop, as log-odds, after one more frame."""
    return max(_FORGET * belief + evidence, _LEAST)


def belief_after(frames: Array) -> Array:
    """Return the belief, as log-odds, that is left so many frames after a loop was last seen.

    The loop is taken to have been seen well for long before.

    Parameters
    ----------
    frames : (n,) float64
    """
    highest = _FOR / (1 - _FORGET)  # where forgetting and evidence balance
    return np.asarray(highest * _FORGET**frames)
