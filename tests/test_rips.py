"""Rips persistence: known shapes, every scale of coordinates, ties, bounds of memory, Ctrl-C, threads.

`test_rips_properties` holds the same functions to GUDHI and to the textbook on random clouds.
"""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest

from topokit import rips_persistence, rips_persistence_many
from topokit.rips import _cloud, _pairs, tighten

from clouds import FAMILIES, compiled, config, fewer, gudhi_pairs, of_the_kernel, random_cloud, same, sorted_pairs
from conftest import polygon

if config is not None:
    from numba import njit

    from topokit.rips import kernel

SQUARE = np.array([[0.0, 0], [2, 0], [2, 2], [0, 2]])


def distances(cloud: np.ndarray) -> np.ndarray:
    """Summed axis by axis, as the kernel does."""
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


@compiled
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
    ours = sorted_pairs(np.column_stack([diagram.birth, diagram.death]))
    np.testing.assert_allclose(ours, gudhi_pairs(far), rtol=1e-9, atol=1e-9)


@compiled
def test_a_camera_that_sends_zeros_for_what_it_did_not_see():
    """A point that is there 20,000 times: with all its copies' edges it would take 15 GB."""
    ring = polygon(40)
    once = rips_persistence(np.insert(ring, 20, 0.0, axis=0))
    number = np.r_[:21, 20_020:20_040]
    diagram = rips_persistence(np.insert(ring, 20, np.zeros((20_000, 2)), axis=0))
    np.testing.assert_array_equal(diagram.death, once.death)
    np.testing.assert_array_equal(diagram.birth_edge, number[once.birth_edge])
    np.testing.assert_array_equal(diagram.killer_triangles, number[once.killer_triangles])


# Where the filtration is cut


def test_max_radius_leaves_loops_open_and_min_lifetime_leaves_them_out():
    circle = polygon(30)
    cut = rips_persistence(circle, max_radius=0.5)
    assert cut.death.tolist() == [np.inf]
    assert cut.killer_edge.tolist() == [[-1, -1]]
    assert cut.killer_triangles.tolist() == [[[-1] * 3] * 2]
    assert cut.neighbours(0).shape == (0, 3)
    assert len(rips_persistence(circle, max_radius=0.05)) == 0
    whole = rips_persistence(circle)
    assert len(rips_persistence(circle, min_lifetime=whole.lifetime[0])) == 1
    assert len(rips_persistence(circle, min_lifetime=np.nextafter(whole.lifetime[0], 9))) == 0


def test_ties_at_the_cut_are_inside():
    assert rips_persistence(SQUARE, max_radius=np.sqrt(2)).death[0] == np.sqrt(2)
    assert rips_persistence(SQUARE, max_radius=np.nextafter(np.sqrt(2), 0)).death[0] == np.inf
    assert len(rips_persistence(SQUARE, max_radius=1.0)) == 1
    assert len(rips_persistence(SQUARE, max_radius=np.nextafter(1.0, 0))) == 0
    assert rips_persistence(SQUARE, max_radius=1e200).death[0] == np.sqrt(2)  # its square overflows


# Scales


@compiled  # NumPy would warn of the quotients that overflow on purpose
@pytest.mark.parametrize("size", [5e-324, 1e-310, 1.7e308])
def test_distances_at_the_ends_of_floating_point(size):
    equal = np.full((8, 8), size)
    np.fill_diagonal(equal, 0)
    assert len(rips_persistence(equal, metric="precomputed")) == 0
    square = np.array([[0, 1, 2, 1], [1, 0, 1, 2], [2, 1, 0, 1], [1, 2, 1, 0]]) * (size if size < 1 else size / 2)
    assert rips_persistence(square, metric="precomputed").killer_edge.tolist() == [[0, 2]]


@pytest.mark.parametrize("size", [1e-320, 1e-310, 1e-200, 1e150, 5e307])
def test_coordinates_at_the_ends_of_floating_point(size):
    assert rips_persistence(SQUARE * size).killer_edge.tolist() == [[0, 2]]
    assert rips_persistence(SQUARE * size - size).killer_edge.tolist() == [[0, 2]]


@pytest.mark.parametrize("metric", ["euclidean", "precomputed"])
@pytest.mark.parametrize("exponent", [-1070, -1022, -1000, -540, 510, 1000, 1019])
def test_a_cloud_at_any_scale_is_the_same_cloud(metric, exponent):
    """Also where births and deaths lose their digits, as tiny numbers do."""
    data = np.random.default_rng(3).integers(0, 16, (24, 3)).astype(float)
    if metric == "precomputed":
        data = np.rint(4 * distances(data)) / (1 if exponent < 0 else 16)
    one, other = rips_persistence(data, metric=metric), rips_persistence(np.ldexp(data, exponent), metric=metric)
    assert len(one) > 2
    for name in ("birth", "death"):
        np.testing.assert_array_equal(getattr(other, name), np.ldexp(getattr(one, name), exponent))
    same(one, other, ("birth_edge", "killer_edge", "killer_triangles"))
    for i in range(len(one)):
        assert other.neighbours(i).tolist() == one.neighbours(i).tolist()
        assert other.cycle(i).tolist() == one.cycle(i).tolist()
        assert tighten(other, other.cycle(i)).tolist() == tighten(one, one.cycle(i)).tolist()


def test_half_a_length_that_is_a_number_is_an_answer():
    wide = rips_persistence([[-1e308, 0], [1e308, 0], [0, 1e308], [0, -1e308]])
    assert wide.death.tolist() == [1e308]
    assert wide.killer_edge.tolist() == [[0, 1]]
    assert len(wide.neighbours(0)) == 4
    with pytest.raises(ValueError, match=r"1\.7e\+308"):
        rips_persistence([[-1.7e308] * 3, [1.7e308] * 3, [0] * 3, [1] * 3])


def test_what_differs_too_much_for_one_unit_is_refused():
    with pytest.raises(ValueError, match=r"points\[1\] and points\[3\]"):
        rips_persistence([[0, 1], [1e-200, 0], [1, 1], [0, 0]])
    assert len(rips_persistence([[0, 1], [1, 1e-200], [1, 1], [0, 1e-170]])) == 1
    matrix = (1.0 - np.eye(5)) * 1e300
    matrix[1, 2] = matrix[2, 1] = 1e-100
    with pytest.raises(ValueError, match=r"1e-100 and 1e\+300"):
        rips_persistence(matrix, metric="precomputed")


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
    with pytest.raises(IndexError):
        diagram.neighbours(len(diagram))


# Parts of the kernel


def called(function):
    """A function of the kernel, most of which are compiled for each other alone, for calls from Python."""
    return njit(lambda *arguments: function(*arguments))


class Counting(np.ndarray):
    """An array that counts what is written into it."""

    writes = 0

    def __setitem__(self, place, value):
        Counting.writes += np.size(value)
        super().__setitem__(place, value)


@of_the_kernel
@pytest.mark.parametrize("spread", [0.0, 1e-14], ids=["equal", "nearly equal"])
def test_sorting_edges_of_nearly_equal_length_takes_few_moves(spread, monkeypatch):
    """All pairs of 32 points, of lengths around 1; the last labels come first."""

    def plain(function):
        return getattr(function, "py_func", function)

    for name in ("heap_sort", "_key_precedes", "precedes", "edge_key", "ends_of"):
        monkeypatch.setattr(kernel, name, plain(getattr(kernel, name)))
    x, y = np.triu_indices(32, 1)
    lengths = 1 + spread * np.linspace(1, -1, len(x))
    m, label = len(x), np.arange(32)[::-1].copy()
    buffer = plain(kernel.new_buffer)(m)._replace(keys=np.empty(m, np.int64).view(Counting))
    buffer.found_keys[:] = [kernel.edge_key(a, b) for a, b in zip(x, y, strict=True)]
    buffer.found_lengths[:] = lengths
    monkeypatch.setattr(Counting, "writes", 0)
    plain(kernel.sort_edges)(buffer, m, label)
    assert Counting.writes <= m * (4 + np.log2(m))
    expected = sorted((length, *sorted((label[i], label[j]))) for length, i, j in zip(lengths, x, y, strict=True))
    assert [sorted(label[list(kernel.ends_of(key)[:2])]) for key in buffer.keys.tolist()] == [
        e[1:] for e in map(list, expected)
    ]


@of_the_kernel
def test_lengths_are_the_same_in_numpy_and_compiled():
    points = np.random.default_rng(3).normal(size=(20, 3)) * np.logspace(-3, 3, 3)
    edge_length = called(kernel.edge_length)
    for i in range(20):
        squares = _cloud.squares(points[i], points)
        assert squares.tolist() == [edge_length(points, i, j) for j in range(20)]
        assert squares.tolist() == [edge_length(points, j, i) for j in range(20)]


@of_the_kernel
@pytest.mark.parametrize("d", [2, 3])
def test_a_point_is_near_the_middle_only_if_it_is_near_all_of_the_lune(d):
    """Against points on the rim of the lune, where it is farthest from what is between its two balls."""
    rng, near = np.random.default_rng(d), 0
    edge_length, is_near_middle = called(kernel.edge_length), called(kernel.is_near_middle)
    for _ in range(300):
        data = np.zeros((3, 3))
        data[:, :d] = rng.normal(size=(3, d))
        data[2] = data[:2].mean(axis=0)
        data[2, :d] += rng.normal(size=d) * 0.3
        length = edge_length(data, 0, 1)
        across = np.zeros((400, 3))
        across[:, :d] = rng.normal(size=(400, d))
        step = (data[1] - data[0]) / np.sqrt(length)
        across -= np.outer(across @ step, step)
        rim = data[:2].mean(axis=0) + np.sqrt(0.75 * length) * across / np.linalg.norm(across, axis=1, keepdims=True)
        farthest = max(((np.vstack([rim, data[:2]]) - data[2]) ** 2).sum(axis=1))
        is_near = is_near_middle(data, 0, 1, 2, length)
        assert is_near <= (farthest < length)
        near += is_near
    assert 20 < near < 200


@compiled
@pytest.mark.parametrize("shape", ["sheet", "torus"])
def test_places_decide_as_the_distances_do(shape):
    """Above 2,048 points cones are known from places; for a matrix of distances they cannot be."""
    cloud = torus(2300)
    if shape == "sheet":
        a, b = np.random.default_rng(11).random((2, 2300))
        cloud = np.column_stack([a, b, 0.05 * np.sin(5 * a)])[(a - 0.5) ** 2 + (b - 0.4) ** 2 > 0.04]
    assert len(cloud) > 64 * kernel.FEW_WORDS or shape == "sheet"
    same(rips_persistence(cloud), rips_persistence(distances(cloud), metric="precomputed"))


@compiled
def test_windows_of_edges_are_bounded_and_leave_none_out():
    cloud = _cloud.Cloud.of(np.random.default_rng(12).random((3100, 2)))
    tree = called(kernel.build_tree)(cloud.data)
    edges_between = called(kernel.edges_between)
    buffer, shortest, count, before, stop = kernel.new_buffer(1 << 16), 0.0, 0, -1.0, np.zeros(1, np.int64)
    while shortest < 4:
        buffer, m, bound = edges_between(tree.points, tree, shortest, 5.0, buffer, 1 << 40, stop)
        lengths = buffer.lengths[:m]
        assert m <= len(buffer.found_keys) == kernel.WINDOW
        assert before <= lengths[0]
        assert (np.diff(lengths) >= 0).all()
        assert shortest <= lengths[0] <= lengths[-1] < bound
        shortest, count, before = bound, count + m, lengths[-1]
    assert count == 3100 * 3099 // 2


# Memory, Ctrl-C, compilation


@compiled
def test_more_memory_than_is_allowed(monkeypatch):
    with pytest.raises(MemoryError, match=r"2200000 points need 4\.7 GB"):
        rips_persistence(np.random.default_rng(0).random((2_200_000, 3)))
    all_alike = 1.0 - np.eye(2000)
    many_loops = np.random.default_rng(0).random((4500, 3))
    for cloud, metric, spare, what in (
        (all_alike, "precomputed", 1 << 26, "edges"),
        (many_loops, "euclidean", 500_000, "loops"),
    ):
        monkeypatch.setattr(_cloud, "MEMORY", len(cloud) * ((len(cloud) + 63) // 64) * 8 + spare)
        with pytest.raises(MemoryError, match=f"these {len(cloud)} points need .*{what}"):
            rips_persistence(cloud, metric=metric)


@compiled
@pytest.mark.parametrize(
    "shape", ["plane", "torus", "grid", "far apart", "repeated", "in eight places", "in one place"]
)
def test_large_clouds_are_paired_without_a_table_of_pairs(shape, monkeypatch):
    rng = np.random.default_rng(0)
    angles = 2 * np.pi * rng.random((2, 1200))
    ring = 1 + 0.35 * np.cos(angles[1])
    torus = np.column_stack([ring * np.cos(angles[0]), ring * np.sin(angles[0]), 0.35 * np.sin(angles[1])])
    points = {
        "plane": rng.random((1500, 2)),
        "torus": torus,  # its lunes grow so large that rows of bits are used
        "grid": np.argwhere(np.ones((8, 8, 8))),
        "far apart": np.r_[torus[:500], torus[500:] + [1e6, 0, 0]],
        "repeated": torus[rng.integers(0, 400, 1200)],
        "in eight places": rng.integers(0, 2, (600, 3)),
        "in one place": np.ones((600, 3)),
    }[shape]
    for max_radius in (np.inf, 0.2):
        dense = rips_persistence(points, max_radius=max_radius)
        with monkeypatch.context() as patch:
            patch.setattr(_pairs, "LARGE", 4)
            large = rips_persistence(points, max_radius=max_radius)
        same(dense, large)


@compiled
def test_a_refusal_gives_memory_back(monkeypatch):
    statm = Path("/proc/self/statm")
    if not statm.exists():
        pytest.skip("only Linux tells what a process holds")
    cloud, held = np.random.default_rng(0).random((8192, 3)), []
    monkeypatch.setattr(_cloud, "MEMORY", 8192 * 1024 + 1_000_000)
    for _ in range(12):
        with pytest.raises(MemoryError, match="loops"):
            rips_persistence(cloud)
        held.append(int(statm.read_text().split()[1]) * resource.getpagesize())
    assert held[-1] - held[2] < 4 * 8192 * 1024  # nine refusals


INTERRUPTED = """
import signal, sys, time
if "numba" in sys.argv[1]:
    sys.modules["numba"] = None
import numpy as np
from topokit import rips_persistence, rips_persistence_many

signal.signal(signal.SIGINT, signal.default_int_handler)
small, middle, large = map(np.load, sys.argv[2:])
if "diagram" in sys.argv[1]:
    diagram = rips_persistence(middle)
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
        "rips_persistence(small)",
        "rips_persistence(large)",
        "rips_persistence_many([small] * 100)",
        "rips_persistence_many([large] * 2, 1)",
        "[diagram.cycle(i) for i in range(len(diagram))]",
        "diagram.to_gudhi()",
        "rips_persistence(middle)  # without numba",
        "rips_persistence(large)  # not compiled",
    ],
)
def test_ctrl_c_is_heard_at_any_moment(computation, tmp_path):
    """A fresh process goes on with KeyboardInterrupt within a second of the processor, and in the end does not crash."""
    clouds = [str(tmp_path / f"{n}.npy") for n in (700, 3000, 12_000)]
    for path, n in zip(clouds, (700, 3000, 12_000), strict=True):
        np.save(path, torus(n))
    command = [sys.executable, "-c", INTERRUPTED, computation, *clouds]
    process = subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    for moment in np.random.default_rng().random(4):
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
    # Python exits with 1 instead where at that moment another thread runs `exec`, as numba does while it is loaded.
    assert process.returncode in (-signal.SIGINT, 1)


@of_the_kernel
@pytest.mark.parametrize(
    ("seconds", "kept", "says"), [(0.3, False, "compiling"), (0.3, True, "loading"), (0.0, False, "")]
)
def test_long_compilation_is_announced(monkeypatch, capsys, seconds, kept, says):
    monkeypatch.setattr(_pairs, "_PATIENCE", 0.1)
    monkeypatch.setattr(_pairs, "_ready", set())
    monkeypatch.setattr(_pairs, "_pairs_of_kernel", lambda *_: time.sleep(seconds))
    monkeypatch.setattr(_pairs._numba, "is_compiled", lambda _: kept)
    _pairs._load(_pairs.CLOUDS)
    time.sleep(0.2)
    announced = capsys.readouterr().err
    assert says in announced
    assert bool(announced) == bool(seconds)
    monkeypatch.setattr(_pairs, "_pairs_of_kernel", None)
    _pairs._load(_pairs.CLOUDS)  # once is enough


# Many clouds


def test_many_clouds_on_threads(capsys):
    rng = np.random.default_rng(0)
    clouds = [rng.random((int(n), 3)) for n in rng.integers(1, 120, size=40)]
    together = rips_persistence_many(clouds, n_jobs=4, progress=True)
    for one, other in zip(together, map(rips_persistence, clouds), strict=True):
        same(one, other)
    assert "40 of 40 clouds" in capsys.readouterr().err
    assert rips_persistence_many([]) == []


@pytest.mark.parametrize("family", FAMILIES)
def test_clouds_in_one_call_are_what_they_are_alone(family):
    """Bit for bit, with short loops, ties, repeated points, and clouds of all sizes."""
    rng = np.random.default_rng(FAMILIES.index(family))
    for radius in (np.inf, 0.5):
        clouds = [random_cloud(rng, family, max_points=60) for _ in range(fewer(40))]
        clouds = [cloud for cloud in clouds if cloud.shape[1] == clouds[0].shape[1]]
        together = rips_persistence_many(clouds, n_jobs=1, max_radius=radius, min_lifetime=0.01)
        for cloud, one in zip(clouds, together, strict=True):
            same(one, rips_persistence(cloud, max_radius=radius, min_lifetime=0.01))
            assert (one.n_points, one.max_radius) == (len(cloud), radius)
            if len(one):
                assert one.cycle(0).tolist() == rips_persistence(cloud, max_radius=radius).cycle(0).tolist()


# Bad input


@pytest.mark.parametrize(
    ("points", "error", "names"),
    [
        ([[0, 0], [1, np.nan], [1, 1], [0, 1]], ValueError, "row 1"),
        ([[0, 0], [np.inf, 1]], ValueError, "row 1"),
        ([1.0, 2.0, 3.0], ValueError, r"\(3,\)"),
        (np.zeros((3, 4, 2)), ValueError, "topokit.track"),
        ([[0, 0], [1]], ValueError, "points"),
        ([["a", "b"]], TypeError, "points"),
        ([[1 + 1j, 0]], TypeError, "complex"),
        (np.empty((4, 0)), ValueError, "points"),
    ],
)
def test_bad_points(points, error, names):
    with pytest.raises(error, match=names):
        rips_persistence(points)


@pytest.mark.parametrize(
    ("matrix", "names"),
    [
        (np.zeros((3, 4)), r"\(3, 4\)"),
        ([[0, 1], [2, 0]], r"symmetric at \[0, 1\]"),
        ([[0, -1], [-1, 0]], r"\[0, 1\]"),
        ([[0, 1], [1, 3]], r"\[1, 1\]"),
    ],
)
def test_bad_distance_matrix(matrix, names):
    with pytest.raises(ValueError, match=names):
        rips_persistence(matrix, metric="precomputed")


@pytest.mark.parametrize(
    ("option", "error"),
    [
        ({"max_radius": -1}, ValueError),
        ({"min_lifetime": np.nan}, ValueError),
        ({"max_radius": "x"}, TypeError),
        ({"metric": "l1"}, ValueError),
    ],
)
def test_bad_options(option, error):
    with pytest.raises(error, match=next(iter(option))):
        rips_persistence(SQUARE, **option)


def test_many_names_the_cloud_that_is_bad():
    good = np.zeros((5, 2))
    with pytest.raises(ValueError, match=r"clouds\[1\]"):
        rips_persistence_many([good, np.where(np.eye(5, 2) > 0, [np.nan, 0], 0)])
    for n_jobs in (0, -1, 1.5, True, "2", float("nan"), float("inf")):
        with pytest.raises((TypeError, ValueError), match="n_jobs"):
            rips_persistence_many([good], n_jobs=n_jobs)
