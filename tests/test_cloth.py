"""Cloth of kinds: they drape in their order, mass follows area, and a small mesh is no more rubber than a large one."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from drape import drape

pytest.importorskip("pybullet")

import itertools

from topokit.sim import Cloth, Garment, SimulationConfig, World


def test_kinds_of_cloth_drape_in_their_order():
    """On a coarse square and for a moment only; `python tests/drape.py` gives the figures of the finer one."""
    stiff_first = ["canvas", "cotton", "jersey", "silk"]
    assert list(Cloth.KINDS) == stiff_first
    measured = [drape(Cloth.KINDS[name], spacing=0.05, seconds=1.0) for name in stiff_first]
    assert all(a + 0.005 < b for a, b in itertools.pairwise(measured)), measured
    assert measured[0] > 0
    assert measured[-1] < 1


def test_mass_is_area_times_density_and_what_is_given_stays():
    sheet = Garment.sheet(holes=0, width=0.5, height=0.4, spacing=0.05)
    config = Cloth(density=0.3).config(sheet)
    assert config.mass == pytest.approx(0.3 * 0.5 * 0.4)
    assert config.frame_time == pytest.approx(SimulationConfig().frame_time)
    assert Cloth().config(sheet, mass=0.7).mass == 0.7
    doubled = dataclasses.replace(sheet, vertices=2 * sheet.vertices)
    assert Cloth(density=0.3).config(doubled).mass == pytest.approx(4 * config.mass)


def stretched(garment: Garment, config: SimulationConfig) -> float:
    """The 99th percentile of edge length over rest length after half a second between the grippers."""
    lift = np.array([0, 0, 1.0 - garment.vertices[:, 2].min()])
    with World(garment, lift, config) as world:
        for _ in range(round(0.4 / config.dt)):
            world.step(garment.vertices[garment.grips] + lift)
        points = world.vertices()
    ends = points[garment.edges]
    return float(np.percentile(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1) / garment.edge_lengths, 99))


@pytest.mark.parametrize("size", [0.2, 2.0])
def test_a_mesh_of_any_size_is_cloth(size):
    apron = Garment.apron(spacing=0.05, strap_width=0.05)
    scaled = dataclasses.replace(apron, vertices=apron.vertices * size / np.ptp(apron.vertices, axis=0).max())
    assert stretched(scaled, Cloth().config(scaled)) < 1.12
    if size < 1:
        assert stretched(scaled, SimulationConfig()) > 1.12  # too slow a clock makes it rubber


def test_bad_cloth():
    with pytest.raises(ValueError, match="density"):
        Cloth(density=0.0)
    with pytest.raises(ValueError, match="there is no 'thickness'"):
        Cloth().config(Garment.sheet(spacing=0.05), thickness=1.0)
