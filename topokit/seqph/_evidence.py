"""Which bars are loops: what one diagram says, and what a film adds.

Idea: a bar of the scene is long beside the distances between neighbouring points, and dies at many times the radius of its
birth; the more points there are, the more chances has noise. One number holds all three, and says loop where it is above 1.
Its logarithm is the evidence of a frame. Along a track evidence adds up and is slowly forgotten, so that a loop that has been
seen well is kept through frames in which it is hardly seen, and a chance bar does not become one.

Source: death / birth as what tells loops from noise, and the count of bars in its threshold, are from Bobrowski and Skraba 2023
(*A universal null-distribution for topological data analysis*); the sum of evidence is Wald's sequential test. The constants
were chosen on simulated films that no table of the book scores. Taught in chapter 7.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
WEAKEST = -2.5  # evidence of a bar that is looked at at all
MISSED = -1.0  # evidence of a frame in which nothing is found
_FEW, _MANY = 128, 1000  # below the first number of points the rule was not tried; at the second it is in plain units
_EVEN, _STREWN = 2.1, 2.4  # unevenness of points that keep their distance, and of points strewn at random
_AGAINST, _FOR = -3.0, 2.0  # the least and the most that a frame says
_FORGET, _LEAST = 0.8, -8.0  # what is left of it a frame later, the least belief


class Gaps(NamedTuple):
    """How wide the gaps between the points of a cloud are, holes aside."""

    spacing: float  #: median distance of a point from its fifth nearest neighbour, in the unit of the points
    unevenness: float  #: 1.4 for a grid, 2.6 for points strewn at random on a surface

    @classmethod
    def of(cls, nearest: Array) -> Gaps:
        """Of the distances (n, 5) of points from their nearest other ones."""
        middle, fifth = np.median(nearest[:, [0, -1]], axis=0).tolist()
        if middle == 0:
            return cls(fifth, 1.4)
        # A fifth neighbour is far on a curve as well, and some nearest ones are where a mesh is irregular: not both.
        return cls(fifth, min(fifth / middle, 1.4 * float(np.quantile(nearest[:, 0], 0.9)) / middle))


def significance(birth: Array, death: Array, gaps: Gaps, n_points: int) -> Array:
    """How much each bar stands out from the sampling: a loop above 1.

    It is 1.1 lifetime / spacing * log(death / birth)^0.3 * (1000 / n)^p, whatever the unit of length. Points strewn at random
    leave wide gaps, in a small sample as in a large one: for them the spacing counts 1.3 times and p, else 3/4, is 0.3.
    """
    if gaps.spacing == 0:
        return np.zeros(np.shape(death))
    power = np.interp(gaps.unevenness, (_EVEN, _STREWN), (0.75, 0.3))
    spacing = gaps.spacing * max(gaps.unevenness / 2, 1.0)
    with np.errstate(divide="ignore"):
        times = np.log(death / birth) ** 0.3
    return np.asarray(1.1 * (death - birth) / spacing * times * (_MANY / max(n_points, _FEW)) ** power)


def evidence(birth: Array, death: Array, gaps: Gaps, n_points: int) -> Array:
    """What this frame says for each bar's being a loop, in natural logarithms of odds."""
    with np.errstate(divide="ignore"):
        return np.clip(5 * np.log(significance(birth, death, gaps, n_points)), _AGAINST, _FOR)


def believe(belief: float, evidence: float) -> float:
    """What is believed of a bar, in natural logarithms of odds, once a frame has said something about it."""
    return max(_FORGET * belief + evidence, _LEAST)


def belief_after(frames: Array) -> Array:
    """What is left, so many frames later, of the belief in a loop that has long been seen well."""
    return np.asarray(_FOR / (1 - _FORGET) * _FORGET**frames)
