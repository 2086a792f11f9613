"""Which bars are loops: the evidence of one diagram, and its sum over a film.

Idea: a bar of the scene is long beside the distances between neighbouring points, and it dies at many times the radius of its
birth. The more points there are, the more chances has noise. One number, the significance, holds all three: a loop has more
than 1. Its logarithm is the evidence of a frame. Along a track evidence adds up and is slowly forgotten. So a loop that was
seen well is remembered through frames in which it is hardly seen, and a chance bar does not become one.

Source: death / birth as the mark of a loop against noise, and the number of bars in its threshold, are from Bobrowski and
Skraba 2023 (*A universal null-distribution for topological data analysis*); the sum of evidence is Wald's sequential test.
Taught in chapter 7.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from topokit._validate import Array

from ._frames import Frame


@dataclass(frozen=True)
class EvidenceRule:
    """The rule that decides which bars are loops, with its thresholds; not tried on fewer than 128 points.

    They were chosen on films of simulated garments, which no table of the book scores, and on points strewn at random on a sheet.
    """

    even: float = 2.1  #: unevenness of points that keep their distance from each other
    strewn: float = 2.4  #: unevenness of points strewn at random
    #: birth, in spacings, from which the cycle of a bar crosses gaps of another kind than those between points
    wide: float = 3.0
    open: float = 2.0  #: death / birth of a loop across gaps twice as wide as that
    #: radius, in deaths, of the part of a large scene whose points count for a bar
    reach: float = 8.0
    bars: int = 100  #: number of bars; the noise of fewer is not known
    #: unevenness of points of a grid, whose bars are so short that they are no measure of noise
    grid: float = 1.3
    above: float = 2.6  #: significance of a loop where the fourth bar is noise, as a multiple of that bar's
    #: least significance of a loop in a cloud without noise: bays between folds of cloth have up to 0.70
    quiet: float = 0.72
    weakest: float = -2.5  #: a bar of less evidence is not looked at
    least_evidence: float = -3.0  #: of one frame
    most_evidence: float = 2.0  #: of one frame
    missed: float = -1.0  #: evidence of a frame in which a known loop is not found
    remembered: float = 0.9  #: share of a belief that is left a frame later
    least_belief: float = -8.0

    def significance(self, birth: Array, death: Array, frame: Frame) -> Array:
        """Return how much each bar stands out from the sampling: a loop has more than 1.

        It is 1.1 lifetime / spacing * log(death / birth)^0.3 * (1000 / n)^p, whatever the unit of length. Points strewn at
        random leave wide gaps, in a small sample as in a large one: for them the spacing counts 1.3 times, and p is 0.3
        instead of 3/4. Of the n points, those beyond 1,000 count only as far as a sheet has them within 8 deaths of the bar:
        a denser cloud resolves more bays of cloth, but a larger scene does not make its loops less certain.

        A birth far above the spacing shows that the cycle crosses gaps, between objects or where points are sparse. The
        spacing of the cloud says nothing about such a bar: it is a loop when it dies at twice its birth, as a hexagon nearly
        does.
        """
        if frame.spacing == 0:
            return np.zeros(np.shape(death))
        power = np.interp(frame.unevenness, (self.even, self.strewn), (0.75, 0.3))
        spacing = frame.spacing * max(frame.unevenness / 2, 1.0)
        with np.errstate(divide="ignore"):  # points that coincide are born at 0
            ratio = np.log(death / birth)
        nearby = 5 * (self.reach * death / frame.spacing) ** 2  # the spacing is the radius of five points of a sheet
        n = np.clip(frame.tree.n, 128, np.maximum(nearby, 1000))
        strength = 1.1 * (death - birth) / spacing * ratio**0.3 * (1000 / n) ** power

        # From 3 to 6 spacings the first measure gives way to the second.
        share = np.clip(birth / (self.wide * frame.spacing) - 1, 0, 1)
        by_ratio = np.minimum(strength, ratio / np.log(self.open))
        return np.asarray(strength ** (1 - share) * by_ratio**share)

    def evidence(self, birth: Array, death: Array, frame: Frame, *, compared: bool = True) -> Array:
        """Return the log-odds that bars of a frame are loops, by this frame alone.

        They are `compared` with each other when they are all bars of the frame's diagram: a loop needs a significance of 1, or
        less where the other bars have little; the fourth bar is taken for noise. A bar born above the spacing needs 1.
        """
        significance = self.significance(birth, death, frame)
        needed: Array | float = 1.0
        if compared and len(significance) >= self.bars and frame.unevenness >= self.grid:
            fourth = np.partition(significance, -4)[-4]
            needed = np.where(birth > frame.spacing, 1.0, np.clip(self.above * fourth, self.quiet, 1.0))
        with np.errstate(divide="ignore"):
            return np.clip(5 * np.log(significance / needed), self.least_evidence, self.most_evidence)

    def believe(self, belief: float, evidence: float) -> float:
        """Return the belief in a loop, as log-odds, after one more frame."""
        return max(self.remembered * belief + evidence, self.least_belief)

    def belief_after(self, frames: Array) -> Array:
        """Return the belief, as log-odds, that is left so many frames after a loop was last seen, when it was seen well."""
        highest = self.most_evidence / (1 - self.remembered)  # where forgetting and evidence balance
        return np.asarray(highest * self.remembered**frames)
