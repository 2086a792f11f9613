"""Sizes that vary between the episodes of a dataset: those of garments and of targets."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping

import numpy as np

from topokit.sim import Garment, Hanger, Hook, Mannequin

Target = Hook | Hanger | Mannequin


def varied_garment(
    make: Callable[..., Garment], garment: Garment, vary: float, rng: np.random.Generator, longest: float = np.inf
) -> Garment:
    """Return the garment with each size but its spacing multiplied by a factor from 1 / (1 + vary) to 1 + vary.

    Sizes are drawn again, at most 50 times, when the pattern refuses them, when the garment has over 1.25 times as many
    vertices, and when it hangs down more than `longest` metres. After that the garment stays as it is. The spacing follows the
    area of the cloth.
    """
    spacing = garment.parameters["spacing"]
    extent = np.array(_extent(garment))
    own = {name: size for name, size in garment.parameters.items() if name != "spacing"}
    for sizes in _varied(own, vary, rng):
        # The first garment tells how much cloth there is; the second has about as many vertices as the original.
        try:
            first = make(**sizes, spacing=spacing)
            other = make(**sizes, spacing=float(spacing * np.sqrt(len(first.vertices) / len(garment.vertices))))
        except ValueError:
            continue
        if other.length <= longest and (_extent(other) <= 1.25 * extent).all():
            return other
    return garment


def varied_target(target: Target, vary: float, rng: np.random.Generator) -> Target:
    """Return the target with its sizes multiplied likewise; no rod gets thinner than 2 cm: cloth tunnels through it."""
    own = {name: size for name, size in dataclasses.asdict(target).items() if name not in ("distance", "place", "yaw")}
    for sizes in _varied(own, vary, rng):
        thick = {name: max(size, min(own[name], 0.02)) for name, size in sizes.items() if "radius" in name}
        try:
            return dataclasses.replace(target, **sizes | thick)
        except ValueError:
            continue
    return target


def _varied(sizes: Mapping[str, float], vary: float, rng: np.random.Generator) -> Iterator[dict[str, float]]:
    for _ in range(50):
        factors = np.exp(np.log1p(vary) * rng.uniform(-1, 1, len(sizes))).tolist()
        yield {name: float(size * factor) for (name, size), factor in zip(sizes.items(), factors, strict=True)}


def _extent(garment: Garment) -> list[int]:
    return [len(garment.vertices), len(garment.faces), *map(len, garment.loops)]
