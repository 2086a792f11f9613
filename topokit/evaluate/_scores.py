"""The measures of multi-object tracking: MOTA, IDF1, HOTA, switches and fragments, for objects of any kind.

Idea: the measures follow from counts, and counts of several sequences can be added.

Source: Bernardin and Stiefelhagen 2008 (MOTA, switches), Ristani et al. 2016 (IDF1), Luiten et al. 2021 (HOTA); as in
TrackEval, to which the tests hold every number. Taught in chapter 8.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from topokit._validate import Array, Ids
from topokit.seqph import assign

Kind = Literal["match", "switch", "fragment", "miss", "false positive"]
LEVELS = np.arange(0.05, 0.99, 0.05)  # (19,) the similarities over which HOTA is averaged
THRESHOLD = 0.5  # least similarity of a match for the other measures


@dataclass(frozen=True, eq=False)
class Overlap:
    """The objects and identities of one frame, and how similar they are."""

    objects: Ids  #: (m,) the objects that are present
    ids: Ids  #: (k,) the identities that the tracker gave
    similarity: Array  #: (m, k) from 0 to 1


@dataclass(frozen=True)
class Event:
    """The outcome of an object or of a detection at a frame; a "switch" is a match with another identity than the last one."""

    frame: int  #: position in the sequence
    kind: Kind  #: one of the five
    loop: int  #: the object; -1 for a false positive
    id: int  #: the identity; -1 for a miss


@dataclass(frozen=True, eq=False)
class TrackingScore:
    """Counts of a sequence, or of several added up, and the measures that follow from them."""

    objects: int  #: true loops, summed over the frames
    detections: int  #: tracked loops, summed over the frames
    matches: int  #: objects that were found
    switches: int  #: objects found under another identity than the last time
    fragments: int  #: objects found again after a loss
    id_matches: int  #: matches left when every object is given one identity for good, and every identity one object
    level_matches: Array  #: (19,) matches at each of HOTA's levels
    #: (19,) the sum over these of the share ``|both|`` / ``|either|`` that the frames of object and identity have in common.
    level_association: Array

    def __add__(self, other: TrackingScore) -> TrackingScore:
        return TrackingScore(*(getattr(self, f.name) + getattr(other, f.name) for f in fields(self)))

    @property
    def misses(self) -> int:
        """Objects that were not found."""
        return self.objects - self.matches

    @property
    def false_positives(self) -> int:
        """Detections that are no object."""
        return self.detections - self.matches

    @property
    def mota(self) -> float:
        """Accuracy: 1 - (misses + false positives + switches) / objects; can be negative."""
        return 1 - _share(self.misses + self.false_positives + self.switches, self.objects)

    @property
    def idf1(self) -> float:
        """Share of detections and objects under the right identity, for good."""
        return _share(2 * self.id_matches, self.objects + self.detections)

    @property
    def deta(self) -> float:
        """Detection accuracy, the mean over the levels of matches / (matches + misses + false positives)."""
        return float(self._detection.mean())

    @property
    def assa(self) -> float:
        """Association accuracy, the mean over the levels of how well the identities of the matches fit."""
        return float(self._association.mean())

    @property
    def hota(self) -> float:
        """Higher-order accuracy: the mean over the levels of the geometric mean of detection and association."""
        return float(np.sqrt(self._detection * self._association).mean())

    @property
    def _detection(self) -> Array:
        return self.level_matches / np.maximum(self.objects + self.detections - self.level_matches, 1)

    @property
    def _association(self) -> Array:
        return self.level_association / np.maximum(self.level_matches, 1)


def score(overlaps: Iterable[Overlap]) -> TrackingScore:
    """Score a sequence; scores of several sequences can be added. Without any object MOTA and IDF1 are nan, and HOTA is 0.

    A match has a similarity of `THRESHOLD` or more. HOTA alone is averaged over nineteen thresholds.
    """
    overlaps, shape = _numbered(list(overlaps))
    kinds = [event.kind for event in events(overlaps)]

    # IDF1 gives every object one identity for good: the pairs that have most frames in common.
    frames_together = np.zeros(shape)
    for overlap in overlaps:
        frames_together[np.ix_(overlap.objects, overlap.ids)] += _reaches(overlap.similarity, THRESHOLD)
    id_matches = int(sum(frames_together[pair] for pair in greatest(frames_together)))

    level_matches, level_association = _higher_order(overlaps, shape)
    return TrackingScore(
        objects=sum(len(overlap.objects) for overlap in overlaps),
        detections=sum(len(overlap.ids) for overlap in overlaps),
        matches=kinds.count("match") + kinds.count("switch"),
        switches=kinds.count("switch"),
        fragments=kinds.count("fragment"),
        id_matches=id_matches,
        level_matches=level_matches,
        level_association=level_association,
    )


def events(overlaps: Sequence[Overlap]) -> Iterator[Event]:
    """Yield what became of every object and detection.

    A match of the frame before is kept while it holds; the rest is matched for the greatest similarity.
    """
    last: dict[int, int] = {}  # of each object: the identity of its last match
    current: dict[int, int] = {}  # the matches of the last frame that had objects and identities
    for frame, overlap in enumerate(overlaps):
        objects = overlap.objects.tolist()
        ids = overlap.ids.tolist()
        # A kept match gains more than all similarities together.
        matched_before = [[current.get(loop) == identity for identity in ids] for loop in objects]
        gain = overlap.similarity + 1000 * np.reshape(matched_before, (len(objects), len(ids)))
        pairs = greatest(np.where(_reaches(overlap.similarity, THRESHOLD), gain, 0))
        matched = {objects[row]: ids[column] for row, column in pairs}

        for loop in objects:
            if loop not in matched:
                yield Event(frame, "miss", loop, -1)
                continue
            is_switch = last.get(loop, matched[loop]) != matched[loop]
            yield Event(frame, "switch" if is_switch else "match", loop, matched[loop])
            if loop in last and loop not in current:
                yield Event(frame, "fragment", loop, matched[loop])
        for identity in ids:
            if identity not in matched.values():
                yield Event(frame, "false positive", -1, identity)
        last |= matched
        if objects and ids:
            current = matched


def _higher_order(overlaps: Sequence[Overlap], shape: tuple[int, int]) -> tuple[Array, Array]:
    """Return the matches, and their summed association, at each of HOTA's levels."""
    # How well each object and identity fit over the whole sequence, whatever the level.
    potential = np.zeros(shape)
    frames_of_object = np.zeros((shape[0], 1))
    frames_of_id = np.zeros((1, shape[1]))
    for overlap in overlaps:
        table = overlap.similarity
        union = table.sum(axis=0) + table.sum(axis=1, keepdims=True) - table
        potential[np.ix_(overlap.objects, overlap.ids)] += table / np.where(union > 0, union, 1)
        frames_of_object[overlap.objects] += 1
        frames_of_id[0, overlap.ids] += 1
    alignment = potential / (frames_of_object + frames_of_id - potential)

    # Match each frame by that, and count the matches that reach each level.
    together = np.zeros((len(LEVELS), *shape))
    for overlap in overlaps:
        for row, column in greatest(alignment[np.ix_(overlap.objects, overlap.ids)] * overlap.similarity):
            reached = _reaches(overlap.similarity[row, column], LEVELS)
            together[reached, overlap.objects[row], overlap.ids[column]] += 1
    association = together / np.maximum(frames_of_object + frames_of_id - together, 1)
    return together.sum(axis=(1, 2)), (together * association).sum(axis=(1, 2))


def greatest(gain: Array) -> list[tuple[int, int]]:
    """Return the assignment of greatest total gain, without pairs that gain nothing."""
    return [pair for pair in assign(-gain) if gain[pair] > 0]


def _numbered(overlaps: Sequence[Overlap]) -> tuple[list[Overlap], tuple[int, int]]:
    """Return the same with objects and identities numbered from 0, and how many there are of each."""
    objects = sorted({int(one) for overlap in overlaps for one in overlap.objects})
    ids = sorted({int(one) for overlap in overlaps for one in overlap.ids})
    numbered = []
    for overlap in overlaps:
        rows = np.searchsorted(objects, overlap.objects)
        columns = np.searchsorted(ids, overlap.ids)
        numbered.append(Overlap(rows, columns, np.asarray(overlap.similarity, np.float64)))
    return numbered, (len(objects), len(ids))


def _reaches(similarity: Array, level: float | Array) -> NDArray[np.bool_]:
    """Return whether similarities reach a level, to rounding."""
    return np.asarray(similarity >= level - np.finfo(float).eps)


def _share(part: int, whole: int) -> float:
    return part / whole if whole else float("nan")
