"""Garments and targets of other sizes: each size is drawn by itself, the number of vertices stays."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, replace

import numpy as np

from ._garments import Garment
from ._targets import Target
from ._tasks import hangs_down

MOST = 1.25  # times as many vertices, faces and vertices of a loop as the garment has at its own sizes
_TRIES, _THIN = 50, 0.02


def varied_garment(
    make: Callable[..., Garment], garment: Garment, vary: float, rng: np.random.Generator, longest: float = np.inf
) -> Garment:
    """Return the garment with each size but its spacing multiplied by a factor from 1 / (1 + vary) to 1 + vary.

    Drawn again, at most 50 times, is what the pattern refuses, what has too many vertices, and what hangs down more than
    `longest` metres. Then the garment stays as it is. The spacing changes with the area of the cloth.
    """
    names, own = [name for name in garment.parameters if name != "spacing"], garment.parameters
    for _ in range(_TRIES):
        factors = _factors(len(names), vary, rng)
        sizes = {name: float(own[name] * factor) for name, factor in zip(names, factors, strict=True)}
        try:
            wide = make(**sizes, spacing=own["spacing"])
            spacing = float(own["spacing"] * np.sqrt(len(wide.vertices) / len(garment.vertices)))
            other = make(**sizes, spacing=spacing)
        except ValueError:
            continue
        fits = hangs_down(other) <= longest and all(np.array(_extent(other)) <= MOST * np.array(_extent(garment)))
        if fits:
            return other
    return garment


def varied_target(target: Target, vary: float, rng: np.random.Generator) -> Target:
    """Return the target with its sizes multiplied likewise; no rod gets thinner than cloth tunnels through."""
    own = {name: size for name, size in asdict(target).items() if name != "distance"}
    for _ in range(_TRIES):
        factors = dict(zip(own, _factors(len(own), vary, rng), strict=True))
        sizes = {name: float(size * factors[name]) for name, size in own.items()}
        thick = {name: max(size, min(own[name], _THIN)) for name, size in sizes.items() if "radius" in name}
        try:
            return replace(target, **sizes | thick)
        except ValueError:
            continue
    return target


def _factors(count: int, vary: float, rng: np.random.Generator) -> list[float]:
    factors: list[float] = np.exp(np.log1p(vary) * rng.uniform(-1, 1, count)).tolist()
    return factors


def _extent(garment: Garment) -> list[int]:
    return [len(garment.vertices), len(garment.faces), *map(len, garment.loops)]
