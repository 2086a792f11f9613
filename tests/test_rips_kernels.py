"""The two kernels give the same simplices, at every scale of coordinates, on threads, and where a filtration is cut."""

from __future__ import annotations

import time

import numpy as np
import pytest

from topokit import rips_persistence, rips_persistence_many
from topokit.rips import _cloud

from clouds import gudhi_pairs, sorted_pairs
from conftest import polygon


def same(one, other) -> None:
    for name in ("birth", "death", "birth_edge", "killer_edge", "killer_triangles"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_ring_of_thousands_of_points():
    rng = np.random.default_rng(0)
    angle = 2 * np.pi * rng.random(5000)
    ring = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(5000)]) * (1 + 0.05 * rng.random((5000, 1)))
    diagram = rips_persistence(ring)
    assert diagram.death[0] == pytest.approx(np.sqrt(3) / 2, rel=0.01)  # the inner rim has radius 1
    assert (diagram.lifetime[1:] < 0.05).all()


def test_clusters_far_apart_and_late_loops():
    """Loops born by edges far longer than all deaths before them: the stopping rule must not miss them."""
    far = np.vstack([polygon(6, 0.01) + 100 * corner for corner in polygon(5)])
    diagram = rips_persistence(far)
    assert diagram.death[0] == pytest.approx(100 * np.sin(2 * np.pi / 5), rel=1e-3)
    np.testing.assert_allclose(
        sorted_pairs(np.column_stack([diagram.birth, diagram.death])), gudhi_pairs(far), rtol=1e-9, atol=1e-9
    )


@pytest.mark.parametrize("scale", [1e-200, 1e-30, 1e30, 1e150])
def test_units_do_not_matter(scale):
    cloud = np.random.default_rng(1).random((60, 3))
    one, other = rips_persistence(cloud), rips_persistence(cloud * scale)
    np.testing.assert_allclose(other.death, one.death * scale, rtol=1e-9)
    np.testing.assert_array_equal(other.killer_edge, one.killer_edge)


def test_a_cut_filtration_is_the_same_up_to_the_cut():
    cloud = np.random.default_rng(4).random((80, 2))
    whole = rips_persistence(cloud)
    for radius in (0.05, 0.1, whole.death[0], float(np.median(whole.death))):
        cut = rips_persistence(cloud, max_radius=radius)
        inside = whole.birth <= radius
        expected = np.where(whole.death <= radius, whole.death, np.inf)[inside]
        order = np.lexsort((cut.death, cut.birth))
        reference = np.lexsort((expected, whole.birth[inside]))
        np.testing.assert_array_equal(cut.birth[order], whole.birth[inside][reference])
        np.testing.assert_array_equal(cut.death[order], expected[reference])


def test_ties_at_the_cut_are_inside():
    square = np.array([[0, 0], [2, 0], [2, 2], [0, 2]])
    assert rips_persistence(square, max_radius=np.sqrt(2)).death[0] == np.sqrt(2)
    assert rips_persistence(square, max_radius=np.nextafter(np.sqrt(2), 0)).death[0] == np.inf
    assert len(rips_persistence(square, max_radius=1.0)) == 1
    assert len(rips_persistence(square, max_radius=np.nextafter(1.0, 0))) == 0


def test_many_clouds_on_threads():
    rng = np.random.default_rng(0)
    clouds = [rng.random((int(n), 3)) for n in rng.integers(1, 120, size=40)]
    for one, other in zip(rips_persistence_many(clouds, n_jobs=4), map(rips_persistence, clouds), strict=True):
        same(one, other)
    assert rips_persistence_many([]) == []


def test_many_says_which_cloud_is_bad(capsys):
    good = np.zeros((5, 2))
    with pytest.raises(ValueError, match=r"clouds\[1\] has 1 of 5 points with a NaN"):
        rips_persistence_many([good, np.where(np.eye(5, 2) > 0, [np.nan, 0], 0)])
    with pytest.raises(ValueError, match="n_jobs"):
        rips_persistence_many([good], n_jobs=0)
    rips_persistence_many([good, good], progress=True)
    assert "2 of 2 clouds" in capsys.readouterr().err


def test_long_compilation_is_announced(monkeypatch, capsys):
    monkeypatch.setattr(_cloud, "_PATIENCE", 0.01)
    with _cloud._announced("compiling"):
        time.sleep(0.2)
    assert capsys.readouterr().err == "compiling\n"
    with _cloud._announced("compiling"):
        pass
    time.sleep(0.05)
    assert capsys.readouterr().err == ""
