"""Rips persistence: known shapes, scales of coordinates, ties, many edges, Ctrl-C, threads, bad input.

`test_rips_properties` holds the same functions to GUDHI and to the textbook on random clouds.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import numpy as np
import psutil
import pytest

from topokit import rips_persistence, rips_persistence_many

from clouds import FAMILIES, compiled, fewer, gudhi_pairs, random_cloud, same, sorted_pairs
from conftest import polygon

SQUARE = np.array([[0.0, 0], [2, 0], [2, 2], [0, 2]])


def distances(cloud: np.ndarray) -> np.ndarray:
    """Summed axis by axis, as the engine does."""
    return np.sqrt(sum((cloud[:, None, k] - cloud[None, :, k]) ** 2 for k in range(cloud.shape[1])))


def torus(n: int) -> np.ndarray:
    a, b = 2 * np.pi * np.random.default_rng(0).random((2, n))
    return np.column_stack([(1 + 0.35 * np.cos(b)) * np.cos(a), (1 + 0.35 * np.cos(b)) * np.sin(a), 0.35 * np.sin(b)])


# Known shapes


def test_square_by_hand():
    diagram = rips_persistence(SQUARE)
    assert diagram.birth.tolist() == [1.0]
    assert diagram.death[0] == pytest.approx(np.sqrt(2))
    assert diagram.birth_edge.tolist() == [[2, 3]]  # the last side in the order (length, index, index)
    assert diagram.killer_edge.tolist() == [[0, 2]]  # the first diagonal
    assert sorted(map(sorted, diagram.killer_triangles[0].tolist())) == [[0, 1, 2], [0, 2, 3]]
    # The second diagonal is as long as the first, so its two triangles are in the complex at death.
    assert {tuple(sorted(t)) for t in diagram.neighbours(0).tolist()} == {(0, 1, 3), (1, 2, 3)}
    assert len(diagram.neighbours(0)) == 4


@pytest.mark.parametrize("n", [5, 6, 7, 12, 24, 300])
def test_regular_polygon(n):
    """A regular n-gon dies with its first chord that spans at least a third of the circle."""
    diagram = rips_persistence(polygon(n))
    assert len(diagram) == 1
    assert diagram.birth[0] == pytest.approx(np.sin(np.pi / n))
    assert diagram.death[0] == pytest.approx(np.sin(np.pi * np.ceil(n / 3) / n))


@pytest.mark.parametrize(
    "points",
    [np.empty((0, 3)), [[0.0, 0.0]], [[0, 0], [1, 0], [0, 1]], np.zeros((50, 3)), np.arange(9.0)[:, None]],
    ids=["no points", "one", "three", "all equal", "on a line"],
)
def test_no_loops_is_an_answer(points):
    diagram = rips_persistence(points)
    assert len(diagram) == 0
    assert diagram.killer_triangles.shape == (0, 2, 3)
    assert "0 loops" in repr(diagram)


def test_clusters_far_apart_and_late_loops():
    """Loops born by edges far longer than all deaths before them: the stopping rule must not miss them."""
    far = np.vstack([polygon(6, 0.01) + 100 * corner for corner in polygon(5)])
    diagram = rips_persistence(far)
    assert diagram.death[0] == pytest.approx(100 * np.sin(2 * np.pi / 5), rel=1e-3)
    ours = sorted_pairs(np.column_stack([diagram.birth, diagram.death]))
    np.testing.assert_allclose(ours, gudhi_pairs(far), rtol=1e-9, atol=1e-9)


# Where the filtration is cut


@pytest.mark.parametrize(
    ("options", "deaths"),
    [
        ({"max_radius": np.sqrt(2)}, [np.sqrt(2)]),  # ties at the cut are inside
        ({"max_radius": np.nextafter(np.sqrt(2), 0)}, [np.inf]),
        ({"max_radius": 1.0}, [np.inf]),
        ({"max_radius": np.nextafter(1.0, 0)}, []),
        ({"max_radius": 1e200}, [np.sqrt(2)]),  # its square overflows
        ({"min_lifetime": np.sqrt(2) - 1}, [np.sqrt(2)]),
        ({"min_lifetime": np.nextafter(np.sqrt(2) - 1, 9)}, []),
    ],
)
def test_where_the_filtration_is_cut(options, deaths):
    diagram = rips_persistence(SQUARE, **options)
    assert diagram.death.tolist() == deaths
    if deaths == [np.inf]:
        assert diagram.killer_edge.tolist() == [[-1, -1]]
        assert diagram.killer_triangles.tolist() == [[[-1] * 3] * 2]
        assert diagram.neighbours(0).shape == (0, 3)


# Scales


@pytest.mark.parametrize("metric", ["euclidean", "precomputed"])
@pytest.mark.parametrize("exponent", [-400, -50, 50, 400])
def test_a_cloud_at_any_scale_is_the_same_cloud(metric, exponent):
    data = np.random.default_rng(3).integers(0, 16, (24, 3)).astype(float)
    if metric == "precomputed":
        data = np.rint(4 * distances(data))
    one, other = rips_persistence(data, metric=metric), rips_persistence(np.ldexp(data, exponent), metric=metric)
    assert len(one) > 2
    for name in ("birth", "death"):
        np.testing.assert_array_equal(getattr(other, name), np.ldexp(getattr(one, name), exponent))
    same(one, other, ("birth_edge", "killer_edge", "killer_triangles"))
    for i in range(len(one)):
        assert other.neighbours(i).tolist() == one.neighbours(i).tolist()
        assert other.cycle(i).tolist() == one.cycle(i).tolist()


@pytest.mark.parametrize("metric", ["euclidean", "precomputed"])
def test_a_diagram_does_not_change_with_the_array_it_was_made_of(metric):
    cloud = np.random.default_rng(2).normal(size=(30, 3))
    buffer, walk = distances(cloud) if metric == "precomputed" else cloud, np.arange(30)
    kept = rips_persistence(buffer.copy(), metric=metric)
    diagram = rips_persistence(buffer, metric=metric)
    buffer[:] = 0
    for i in range(len(kept)):
        assert diagram.neighbours(i).tolist() == kept.neighbours(i).tolist()
        assert diagram.cycle(i).tolist() == kept.cycle(i).tolist()
    assert diagram.killers_of([walk]).tolist() == kept.killers_of([walk]).tolist()
    with pytest.raises(ValueError, match="read-only"):
        diagram.birth[0] = 0


# Many edges


@compiled
def test_edges_of_one_length_are_sorted_in_less_than_quadratic_time():
    assert len(rips_persistence(1.0 - np.eye(1500), metric="precomputed")) == 0  # a million edges


@compiled
def test_points_are_paired_as_their_distances_are():
    """For more than 192 points the engine looks for a middle of each edge; for a matrix of distances it does not."""
    cloud = torus(1500)
    same(rips_persistence(cloud), rips_persistence(distances(cloud), metric="precomputed"))


# Ctrl-C


INTERRUPTED = """
import signal, sys, time
import numpy as np
from topokit import rips_persistence, rips_persistence_many

signal.signal(signal.SIGINT, signal.default_int_handler)
middle, large = map(np.load, sys.argv[2:])
diagram = rips_persistence(middle)  # the engine is loaded
while input() == "compute":
    try:
        print(flush=True)
        while True:
            exec(sys.argv[1])
    except KeyboardInterrupt:
        print(time.process_time(), flush=True)
raise KeyboardInterrupt
"""


@compiled
@pytest.mark.skipif(os.name != "posix", reason="signals")
@pytest.mark.parametrize(
    "computation",
    [
        "rips_persistence(large)",
        "rips_persistence_many([large] * 2, 1)",
        "[diagram.cycle(i) for i in range(len(diagram))]",
    ],
)
def test_ctrl_c_ends_long_work(computation, tmp_path):
    """A fresh process goes on with KeyboardInterrupt within a second of the processor, and in the end does not crash."""
    clouds = [str(tmp_path / f"{n}.npy") for n in (3000, 12_000)]
    for path, n in zip(clouds, (3000, 12_000), strict=True):
        np.save(path, torus(n))
    command = [sys.executable, "-c", INTERRUPTED, computation, *clouds]
    process = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    for moment in np.random.default_rng().random(2):
        process.stdin.write("compute\n")
        process.stdin.flush()
        assert process.stdout.readline(), process.communicate()
        time.sleep(moment)
        process.send_signal(signal.SIGINT)
        times = psutil.Process(process.pid).cpu_times()
        heard = process.stdout.readline()
        assert heard, process.communicate()
        assert float(heard) - times.user - times.system < 1
    assert "KeyboardInterrupt" in process.communicate("end\n")[1]
    assert process.returncode == -signal.SIGINT


# Many clouds


@pytest.mark.parametrize("family", FAMILIES)
def test_clouds_in_one_call_are_what_they_are_alone(family, capsys):
    """Bit for bit, with short loops, ties, repeated points, clouds of all sizes, and threads."""
    rng = np.random.default_rng(FAMILIES.index(family))
    for options in ({}, {"max_radius": 0.5, "min_lifetime": 0.01}):
        clouds = [random_cloud(rng, family, max_points=120) for _ in range(fewer(60))]
        clouds = [cloud for cloud in clouds if cloud.shape[1] == clouds[0].shape[1]]
        together = rips_persistence_many(clouds, n_jobs=3, progress=True, **options)
        for cloud, one in zip(clouds, together, strict=True):
            same(one, rips_persistence(cloud, **options))
            assert (one.n_points, one.max_radius) == (len(cloud), options.get("max_radius", np.inf))
        assert f"{len(clouds)} of {len(clouds)} clouds" in capsys.readouterr().err
    assert rips_persistence_many([]) == []


# Bad input


@pytest.mark.parametrize(
    ("points", "options", "error", "names"),
    [
        ([[0, 0], [np.inf, 1]], {}, ValueError, "row 1"),
        ([1.0, 2.0, 3.0], {}, ValueError, r"\(3,\)"),
        (np.zeros((3, 4, 2)), {}, ValueError, "topokit.track"),
        (np.zeros((3, 4)), {"metric": "precomputed"}, ValueError, r"\(3, 4\)"),
        ([[0, 1], [2, 0]], {"metric": "precomputed"}, ValueError, r"symmetric at \[0, 1\]"),
        (SQUARE, {"max_radius": -1}, ValueError, "max_radius"),
        (SQUARE, {"min_lifetime": np.nan}, ValueError, "min_lifetime"),
        (SQUARE, {"metric": "l1"}, ValueError, "metric"),
        (np.zeros((24_000, 4)), {}, MemoryError, r"24000 points.*farthest_point_sample"),
    ],
)
def test_bad_input(points, options, error, names):
    with pytest.raises(error, match=names):
        rips_persistence(points, **options)


def test_many_names_the_cloud_that_is_bad():
    good = np.zeros((5, 2))
    with pytest.raises(ValueError, match=r"clouds\[1\]"):
        rips_persistence_many([good, np.where(np.eye(5, 2) > 0, [np.nan, 0], 0)])
    for n_jobs in (0, -1, 1.5, True, "2", float("nan"), float("inf")):
        with pytest.raises((TypeError, ValueError), match="n_jobs"):
            rips_persistence_many([good], n_jobs=n_jobs)
