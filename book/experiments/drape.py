"""How far each kind of cloth drapes: `python book/experiments/drape.py` prints a table.

A square of 30 cm lies across a rod under its middle, held there at both ends; its halves overhang. The drape is how far their
free edges hang below the rod as a share of the overhang: near 0 for a board, near 1 for what hangs straight down.
"""

import dataclasses

import numpy as np

from topokit.sim import WARDROBE, Garment, SimulationConfig, World

SIDE, RADIUS, LIFT = 0.30, 0.02, 1.0
# Options of `SimulationConfig.of`. Area densities (as ISO 3801 measures them) are typical of such fabrics.
KINDS: dict[str, dict[str, float]] = {
    "canvas": {"density": 0.34, "stiffness": 0.6, "bending": 0.4, "damping": 60.0},
    "cotton": {"density": 0.15, "stiffness": 0.6, "bending": 0.1, "damping": 60.0, "friction": 0.8},
    "jersey": {"density": 0.18, "stiffness": 0.6, "bending": 0.03, "damping": 60.0},
    "silk": {"density": 0.06, "bending": 0.0003, "damping": 60.0, "friction": 0.5},
}


def square(spacing: float = 0.03) -> Garment:
    """A square of cloth that lies level, held at both ends of its middle line."""
    sheet = WARDROBE["sheet"](holes=0, width=SIDE, height=SIDE, spacing=spacing)
    flat = sheet.vertices[:, [0, 2, 1]] + [0, SIDE / 2, 0]
    ends = [[-SIDE / 2, 0, 0], [SIDE / 2, 0, 0]]
    grips = np.linalg.norm(flat[:, None] - ends, axis=2).argmin(axis=0)
    return dataclasses.replace(sheet, vertices=flat, faces=sheet.faces[:, ::-1], grips=grips)


def drape(cloth: dict[str, float], spacing: float = 0.03, seconds: float = 1.8) -> float:
    garment = square(spacing)
    config, lift = SimulationConfig.of(garment, **cloth), np.array([0, 0, LIFT])
    with World(garment, lift, config) as world:
        start, end = np.array([[-0.3, 0, LIFT - RADIUS], [0.3, 0, LIFT - RADIUS]])
        world.add_rods([(start, end, RADIUS)])
        for _ in range(round(seconds / config.dt)):
            world.step(garment.vertices[garment.grips] + lift)
        points = world.vertices()
    free = np.abs(garment.vertices[:, 1]) > SIDE / 2 - 1e-6
    return float((LIFT - points[free, 2].mean()) / (SIDE / 2))


if __name__ == "__main__":
    print("kind     kg/m^2  drape")
    for name, cloth in KINDS.items():
        print(f"{name:8} {cloth['density']:6.2f} {drape(cloth):6.2f}")
