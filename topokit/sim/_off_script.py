"""Paths off their script: what hands do that miss, hesitate, take a detour, let go too early, push, or wander.

Idea: from films of plans that succeed, nobody learns what the cloth does under other plans. Each change has a probability of
its own, and changes are composed; what was drawn is noted in `GripperPath.drawn`. Taught in chapter 8.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ._garments import Garment
from ._path import GripperPath, Via
from ._surface import Array, EdgeGraph, turned
from ._targets import Target

LONGEST = 4.5  # seconds of an episode, unless its script lasts longer
_CLEAR, _ABOVE = 0.3, 0.05  # metres at a start from the rods, and from the floor
_TAUT = 1.02  # the grippers are at most so far apart, in multiples of the way between them along the cloth


def off_script(path: GripperPath, garment: Garment, target: Target, rng: np.random.Generator) -> GripperPath:
    """Return a path that does not do what the script does.

    One in seven wanders about the target, one in ten pushes the cloth against it. The others are the script at another
    pace with some of: a miss, other openings, a detour, a stop, another start and yaw; an early or a late release, or none.

    Parameters
    ----------
    path : GripperPath
        The script, planned for that garment and target.
    garment : Garment
    target : Target
        As it stands in the script's coordinates.
    rng : numpy.random.Generator
    """
    drawn: dict[str, float] = {}
    vias, kind = list(path.vias), rng.random()
    drop = float(garment.vertices[garment.grips, 2].mean() - garment.vertices[:, 2].min()) + _ABOVE
    if kind < 0.15:
        drawn["wander"], vias = 1.0, _wander(vias[0], target.seat, drop, rng)
    elif kind < 0.25:
        drawn["push"], vias = 1.0, _push(vias[0], target.seat, drop, rng)
    elif kind < 0.65:
        shift, turn = rng.normal(0, 0.08, 3), float(rng.normal(0, 15))
        drawn |= {"miss": float(np.linalg.norm(shift)), "turn": turn}
        approach = max(1, len(vias) - 3)
        vias[approach:] = [replace(via, place=_at(via) + shift, yaw=via.yaw + turn) for via in vias[approach:]]
    if rng.random() < 0.5:
        drawn["openings"] = 1.0
        vias[1:] = [replace(via, opening=via.opening * rng.uniform(0.6, 1.4)) for via in vias[1:]]
    if rng.random() < 0.3:
        i, aside = int(rng.integers(1, len(vias))), rng.normal(0, 0.1, 3)
        drawn["detour"] = float(np.linalg.norm(aside))
        vias = [*vias[:i], _between(vias[i - 1], vias[i], aside), *_later(vias[i:], 0.25)]
    if rng.random() < 0.25:
        i = int(rng.integers(1, len(vias)))
        still = replace(vias[i], rest=True)
        drawn["stop"] = still.time
        vias = [*vias[:i], still, *_later([still, *vias[i + 1 :]], 0.3)]
    if rng.random() < 0.6:
        vias, drawn["elsewhere"] = _elsewhere(vias, garment, target, rng)
    longest = max(LONGEST, path.end)
    pace = min(float(0.7 * 2 ** rng.random()), (longest - 0.4) / vias[-1].time)
    vias = [replace(via, time=pace * via.time) for via in vias]
    last = vias[-1].time
    release = (last + 0.05, rng.uniform(0.35, 1) * last, last + rng.uniform(0.2, 0.7), longest)
    let_go = float(release[int(rng.choice(4, p=(0.35, 0.3, 0.15, 0.2)))])  # as scripted, early, late, never
    end = min(longest, max(3.0, let_go + path.end - path.release))
    let_go = end if let_go == longest else min(let_go, longest - 0.25)
    drawn |= {"pace": pace, "release": let_go}
    return _slack(replace(path, vias=vias, release=let_go, end=end, drawn=drawn), path, garment)


def _wander(start: Via, seat: Array, drop: float, rng: np.random.Generator) -> list[Via]:
    """Random places around the seat, as high as the garment is long."""
    low = max(float(seat[2]) - 0.1, drop)
    vias = [start]
    for _ in range(int(rng.integers(3, 6))):
        place = np.array([*rng.uniform((-0.35, -0.5), (0.35, 0.15)), 0]) + [seat[0], seat[1], low + rng.uniform(0, 0.4)]
        time = vias[-1].time + 0.3 + float(np.linalg.norm(place - _at(vias[-1]))) / rng.uniform(0.6, 1.2)
        vias.append(Via(time, place, yaw=vias[-1].yaw + rng.normal(0, 40)))
    return vias


def _push(start: Via, seat: Array, drop: float, rng: np.random.Generator) -> list[Via]:
    """Straight on at a height at which the cloth meets the target; half of the time back again."""
    x, beyond, z = rng.uniform((-0.15, -0.05, 0.0), (0.15, 0.2, 0.25))
    level = np.array([x, 0, max(seat[2] + z, drop)])
    near, far = level + [0, seat[1] - 0.35, 0], level + [0, seat[1] + beyond, 0]
    times = np.cumsum([start.time + 1.0, (beyond + 0.35) / rng.uniform(0.35, 0.8) + 0.2, 0.9])
    return [
        start,
        *(Via(*via) for via in list(zip(times.tolist(), (near, far, near), strict=True))[: rng.integers(2, 4)]),
    ]


def _elsewhere(vias: list[Via], garment: Garment, target: Target, rng: np.random.Generator) -> tuple[list[Via], float]:
    """Start turned by any yaw, somewhere before or beside the target; how far from its seat, 0 when nothing is free."""
    start, cloth = vias[0], garment.vertices - garment.vertices[garment.grips].mean(axis=0)
    for _ in range(30):
        yaw, away = float(rng.uniform(-180, 180)), rng.uniform(0.5, 1.0)
        place = target.seat + turned([0, -away, 0], rng.uniform(-100, 100))
        place[2] = _at(start)[2] + rng.uniform(-0.15, 0.15)
        there = turned(cloth, yaw) + place
        if there[:, 2].min() > _ABOVE and _room(there, target) > _CLEAR:
            needs = max(float(np.linalg.norm(place - _at(vias[1]))), abs(yaw - vias[1].yaw) / 120)
            rest = _later(vias[1:], max(0.0, needs - vias[1].time + start.time))
            return [replace(start, place=place, yaw=yaw), *rest], float(away)
    return vias, 0.0


def _room(points: Array, target: Target) -> float:
    """Least distance of points (N, 3) from the surface of the target."""
    gaps = []
    for start, end, radius in target.rods:
        along = (end - start) / max(float((end - start) @ (end - start)), 1e-12)
        share = np.clip((points - start) @ along, 0, 1)
        gaps.append(float(np.linalg.norm(points - start - share[:, None] * (end - start), axis=1).min()) - radius)
    return min(gaps)


def _slack(path: GripperPath, script: GripperPath, garment: Garment) -> GripperPath:
    """The path with its grippers no farther apart than the cloth between them allows, or than in the script."""
    way = float(EdgeGraph(garment.vertices, garment.edges).distances(garment.grips)[0, 1])
    most = max(_TAUT * way, _widest(script))
    while (widest := _widest(path)) > most:
        vias = [replace(via, opening=via.opening * 0.99 * most / widest) for via in path.vias[1:]]
        path = replace(path, vias=[path.vias[0], *vias])
    return path


def _widest(path: GripperPath) -> float:
    one, other = np.moveaxis(path.at(np.arange(0, path.end, 0.02)), -2, 0)
    return float(np.linalg.norm(one - other, axis=-1).max())


def _between(one: Via, other: Via, aside: Array) -> Via:
    time, place = (one.time + other.time + 0.25) / 2, (_at(one) + _at(other)) / 2 + aside
    return Via(time, place, (one.opening + other.opening) / 2, yaw=(one.yaw + other.yaw) / 2)


def _later(vias: list[Via], seconds: float) -> list[Via]:
    return [replace(via, time=via.time + seconds) for via in vias]


def _at(via: Via) -> Array:
    return np.asarray(via.place, dtype=np.float64)
