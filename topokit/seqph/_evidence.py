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
_WIDE = 3.0  # birth, in spacings, from which the cycle of a bar crosses gaps of another kind than those between points
_OPEN = 2.0  # death / birth of a loop across gaps twice as wide as that
_BARS = 100  # bars; the noise of fewer is not known
_GRID = 1.3  # unevenness of points of a grid, whose bars are so short that they are no measure of noise
_ABOVE = 2.6  # significance of a loop where the fourth bar is noise, as a multiple of that bar's
_QUIET = 0.72  # least significance of a loop in a cloud without noise: bays between folds of cloth have up to 0.70
_AGAINST = -3.0  # least evidence of one frame
_FOR = 2.0  # most evidence of one frame
_FORGET = 0.9  # share of a belief that is left a frame later
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

    A birth far above the spacing shows that the cycle crosses gaps, between objects or where points are sparse. The spacing of
    the cloud says nothing about such a bar: it is a loop when it dies at twice its birth, as a hexagon nearly does.
    """
    if gaps.spacing == 0:
        return np.zeros(np.shape(death))
    power = np.interp(gaps.unevenness, (_EVEN, _STREWN), (0.75, 0.3))
    spacing = gaps.spacing * max(gaps.unevenness / 2, 1.0)
    with np.errstate(divide="ignore"):  # points that coincide are born at 0
        ratio = np.log(death / birth)
    strength = 1.1 * (death - birth) / spacing * ratio**0.3 * (_MANY / max(n_points, _FEW)) ** power

    # From 3 to 6 spacings the first measure gives way to the second.
    wide = np.clip(birth / (_WIDE * gaps.spacing) - 1, 0, 1)
    return np.asarray(strength ** (1 - wide) * np.minimum(strength, ratio / np.log(_OPEN)) ** wide)


def needed(significance: Array, birth: Array, gaps: Gaps) -> Array:
    """Return the significance that each bar of a cloud needs to be a loop: 1, or less where the other bars have little.

    Few clouds have four loops, so that the fourth bar is taken for noise. Where it is a loop, nothing changes. A bar born above
    the spacing is not of a cycle that is seen well, and needs 1.
    """
    if len(significance) < _BARS or gaps.unevenness < _GRID:
        return np.ones(len(significance))
    fourth = np.partition(significance, -4)[-4]
    return np.where(birth > gaps.spacing, 1.0, np.clip(_ABOVE * fourth, _QUIET, 1.0))


def evidence(significance: Array, needed: Array | float = 1.0) -> Array:
    """Return the log-odds that bars are loops, by one frame alone, given the significance that a loop needs there."""
    with np.errstate(divide="ignore"):
        return np.clip(5 * np.log(significance / needed), _AGAINST, _FOR)


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
