"""Linking numbers: known links, exact crossing counts, another library, properties, errors that say where."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, reject, settings
from hypothesis import strategies as st
from scipy.optimize import lsq_linear
from scipy.spatial.transform import Rotation

from topokit import linking_number, track
from topokit.linking import close_far, curve_centroid, linking_numbers, side_lengths, to_segment

from conftest import polygon


def torus_curve(turns, n=40, phase=0.0):
    """A curve that goes once around the z axis and `turns` times around the core of a torus."""
    t = 2 * np.pi * np.arange(n) / n
    radius = 2 + 0.5 * np.cos(turns * t + phase)
    return np.column_stack([radius * np.cos(t), radius * np.sin(t), 0.5 * np.sin(turns * t + phase)])


def circle(n=24, radius=1.0, axis=2):
    return np.insert(polygon(n, radius), axis, 0.0, axis=1)


T = 2 * np.pi * np.arange(60) / 60
ELLIPSE = np.column_stack([2.8 * np.cos(T), 2.34 * np.sin(T), 0 * T])
CLASP = np.column_stack([3 * np.sin(T), np.sin(2 * T), np.cos(3 * T)])  # alternates: the Whitehead link
BORROMEAN = [np.roll(np.column_stack([2 * np.cos(T), np.sin(T), 0 * T]), k, axis=1) for k in range(3)]


class Degenerate(Exception):
    """A corner of one curve lies on the line through a segment of the other: the projection cannot tell."""


class Touch(Exception):
    """A segment of one curve meets one of the other."""


def crossings(a, b, direction=(1, 4099, 4099**2)):
    """Signs of the crossings at which a passes over b, seen along an integer direction: exact for integer corners.

    The direction is so steep in every coordinate that small integer vectors are orthogonal to it only when they are zero.
    """
    a, b = (np.vectorize(Fraction, otypes=[object])(curve) for curve in (a, b))
    signs = []
    for p, q in zip(a, np.roll(a, -1, axis=0), strict=True):
        for s, e in zip(b, np.roll(b, -1, axis=0), strict=True):
            u, v = q - p, e - s
            ahead, behind = (triple(v, end - s, direction) for end in (p, q))
            left, right = (triple(u, end - p, direction) for end in (s, e))
            if ahead * behind >= 0 or left * right >= 0:
                if ahead * behind * left * right == 0:
                    raise Degenerate
                continue
            gap = triple(u, v, s - p)  # 0 when the segments meet
            if gap == 0:
                raise Touch
            turn = triple(u, v, direction)
            if (gap > 0) != (turn > 0):  # at the crossing the point of a is farther along the direction
                signs.append(1 if turn > 0 else -1)
    return signs


def generic(curve):
    """The curve turned askew and rounded, so that no two of its coordinates are equal by symmetry."""
    return np.rint(1e6 * curve @ Rotation.from_rotvec([0.3, 0.5, 0.7]).as_matrix().T)


def triple(u, v, w):
    """Determinant of three vectors, exactly."""
    return u[0] * (v[1] * w[2] - v[2] * w[1]) + u[1] * (v[2] * w[0] - v[0] * w[2]) + u[2] * (v[0] * w[1] - v[1] * w[0])


LINKS = {
    "unlink": (circle(), circle() + [5, 0, 0], 0),
    "unlink, stacked": (circle(), circle() + [0, 0, 0.1], 0),
    "Hopf": (circle(), circle(axis=1) + [1, 0, 0], 1),
    "Whitehead": (ELLIPSE, CLASP, 0),
    "Borromean": (BORROMEAN[0], BORROMEAN[1], 0),
    "Solomon": (torus_curve(2), torus_curve(2, 47, np.pi), 2),
    **{f"T(2, {2 * n})": (torus_curve(n), torus_curve(n, 53, np.pi), n) for n in range(1, 8)},
}


@pytest.mark.parametrize("name", LINKS)
def test_known_links(name):
    a, b, expected = LINKS[name]
    number = linking_number(a, b)
    assert abs(number) == expected
    assert sum(crossings(generic(a), generic(b), (7, 11, 10**6))) == number
    assert linking_number(b, a) == number
    assert linking_number(a[::-1], b) == -number
    assert linking_number(a * [1, 1, -1], b * [1, 1, -1]) == -number
    assert linking_number(np.repeat(a, 2, axis=0), np.vstack([b, b[:1]])) == number  # corners that are there twice


corner = st.tuples(*[st.integers(-6, 6)] * 3)
curves = st.lists(corner, min_size=3, max_size=9, unique=True).map(lambda c: np.array(c, dtype=float))


@settings(max_examples=300, deadline=None)
@given(curves, curves)
def test_exact_crossing_count(a, b):
    """Integer corners: parallel, coplanar and touching segments are common, and the count of crossings is exact."""
    try:
        expected = sum(crossings(a, b))
    except Degenerate:
        reject()
    except Touch:
        with pytest.raises(ValueError, match="touch"):
            linking_number(a, b)
    else:
        assert linking_number(a, b) == expected


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(-9, 9), st.floats(0, 6))
def test_properties(seed, log_scale, log_offset):
    """Motion, scale, starting corner, direction, mirror and subdivision do to the number what they should."""
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(rng.integers(3, 20), 3)), rng.normal(size=(rng.integers(3, 20), 3))
    number = linking_number(a, b)
    turn = Rotation.random(rng=rng).as_matrix()
    moved = [curve @ turn.T + 10**log_offset * np.array([1, -2, 0.5]) for curve in (a, b)]
    assert linking_number(*moved) == number
    assert linking_number(a * 10**log_scale, b * 10**log_scale) == number
    assert linking_number(np.roll(a, 2, axis=0), b) == linking_number(b, a) == number
    assert linking_number(a, b[::-1]) == linking_number(a * [-1, 1, 1], b * [-1, 1, 1]) == -number
    share = rng.uniform(0.1, 0.9, len(a))[:, None]
    finer = np.stack([a, a + share * (np.roll(a, -1, axis=0) - a)], axis=1).reshape(-1, 3)
    assert linking_number(finer, b) == number


def test_batches_equal_single_links():
    rng = np.random.default_rng(0)
    a, b = rng.normal(size=(40, 12, 3)), rng.normal(size=(40, 9, 3))
    numbers, errors = linking_numbers(a, b)
    assert numbers.dtype == np.int64
    assert numbers.tolist() == [linking_number(x, y) for x, y in zip(a, b, strict=True)]
    assert numbers.any()
    assert np.abs(errors).max() < 1e-12
    assert linking_numbers(a, b[3])[0].tolist() == [linking_number(x, b[3]) for x in a]
    assert linking_numbers(a[0], b[0])[0].shape == (1,)


@pytest.mark.parametrize("gap", [1e-3, 1e-6, 1e-9])
def test_nearly_touching(gap):
    """A side passes by the other curve on either side at a hair's breadth: one is linked, the other is not."""
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    upright = np.array([[0, 0.5, -1], [0, 0.5, 1], [-3, 0.5, 1], [-3, 0.5, -1]])
    inside, outside = linking_numbers([upright + [gap, 0, 0], upright - [gap, 0, 0]], square)[0]
    assert (abs(inside), outside) == (1, 0)


SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)


@pytest.mark.parametrize(
    ("other", "where"),
    [
        ([[0.5, 0, -1], [0.5, 0, 1], [0.5, -3, 0]], "segment 0 of curve_a meets segment 0 of curve_b"),  # inside both
        ([[5, 5, 0], [1, 1, 0], [5, 6, 1]], r"segment \d of curve_a meets segment \d of curve_b"),  # at a corner
        ([[3, 3, 1], [0.25, 1, 0], [0.75, 1, 0], [3, 4, 1]], r"segment 2 of curve_a meets segment \d of curve_b"),
        (SQUARE + [0.5, 1, 0], r"segment [12] of curve_a meets segment [03] of curve_b"),  # overlap along a side
        (SQUARE, "the curves touch"),
    ],
)
@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_touching_curves(other, where, offset):
    with pytest.raises(ValueError, match=where):
        linking_number(SQUARE + offset, np.asarray(other, dtype=float) + offset)


def test_a_pole_is_closed_far_away():
    """Rings around it, beyond its end on its lead, and beside it; a line up through a counter-clockwise circle counts +1."""
    rings = circle(radius=0.2) + np.array([[0, 0, 0.5], [0, 0, 3], [0.5, 0, 0.5]])[:, None]
    assert linking_numbers(rings, close_far([[0, 0, 0], [0, 0, 1]]))[0].tolist() == [1, 1, 0]


@pytest.mark.parametrize("start", [(0, 0, -1), (0, 0, 1), (3, 1, -1), (0, 1, 0)])
def test_the_side_on_which_a_curve_is_closed_does_not_matter(start):
    """Rings near an open curve link it alike however its first corner is led off (not through the ring)."""
    rng = np.random.default_rng(3)
    line = np.cumsum(rng.normal(size=(8, 3)), axis=0)
    rings = (
        circle(radius=0.5) @ Rotation.random(30, rng=rng).as_matrix() + (line[rng.integers(3, 7, 30)] + 0.1)[:, None]
    )
    usual, _ = linking_numbers(rings, close_far(line))
    other, _ = linking_numbers(rings, close_far(line, start=start))
    assert usual.any()
    np.testing.assert_array_equal(usual, other)


def test_quadrilateral_goes_around_its_loop():
    ring = circle(30) + np.random.default_rng(0).normal(0, 0.01, (30, 3))
    loop = track([ring])[0].loops[0]
    x, z1, y, z2 = loop.quadrilateral
    np.testing.assert_array_equal([x, y], ring[loop.killer_edge])
    for apex, ids in zip((z1, z2), loop.killer_triangle_ids, strict=True):
        np.testing.assert_array_equal(apex, ring[np.setdiff1d(ids, loop.killer_edge)[0]])
    axis = close_far([[0, 0, -1], [0, 0, 1]])
    assert abs(linking_number(loop.quadrilateral, axis)) == 1
    assert linking_number(loop.quadrilateral, axis + [3, 0, 0]) == 0
    flat = track([ring[:, :2]])[0].loops[0]
    assert flat.quadrilateral.shape == (4, 2)


def test_far_away_is_where_it_is_said_to_be():
    """Extents of 1, 4 and 2: the leads are 100 times 4 long, whatever the length of the directions."""
    curve = np.array([[0.0, 0, 0], [1, 4, 0], [1, 4, 1], [1, 4, 2]])
    closed = close_far(curve, start=(0, -2, 0), end=(0, 0, 5))
    np.testing.assert_array_equal(closed[:4], curve)
    assert closed[4:].tolist() == [[1, 4, 402], [-399, 4, 402], [-400, -400, 0], [0, -400, 0]]
    assert close_far(curve, far=10.0)[4].tolist() == [1, 4, 42]


def test_distances_from_segments_are_those_of_bounded_least_squares():
    rng = np.random.default_rng(4)
    points, starts, ends = rng.normal(size=(3, 60, 3)) * rng.choice([1e-3, 1.0, 1e3], size=(1, 60, 1))
    ends[:5] = starts[:5]  # segments that are points
    expected = []
    for point, start, end in zip(points, starts, ends, strict=True):
        best = lsq_linear((end - start)[:, None], point - start, bounds=(0, 1), tol=1e-14)
        expected.append(np.linalg.norm((end - start) * best.x - (point - start)))
    np.testing.assert_allclose(to_segment(points, starts, ends), expected, rtol=1e-5)


def test_sides_and_the_centroid_of_a_curve_whose_corners_crowd_on_one_side():
    square = np.array([[0.0, 0], [2, 0], [2, 2], [0, 2], [0, 0.5], [0, 0.25]])
    assert side_lengths(square).tolist() == [2, 2, 2, 1.5, 0.25, 0.25]
    np.testing.assert_allclose(curve_centroid(square), [1, 1])


MANY = np.stack([SQUARE + [0, 0, k] for k in range(3)])


@pytest.mark.parametrize(
    ("call", "names"),
    [
        (lambda: linking_number(SQUARE + 9, SQUARE[:2]), r"curve_b .*\(2, 3\).*close_far"),
        (lambda: linking_numbers(MANY, SQUARE + [0.5, 0, 2]), r"curves_a\[2\] .* curves_b\[0\]"),
        (lambda: linking_numbers(MANY, MANY[:2] + 9), "3 and 2"),
        (lambda: linking_numbers(MANY[:0], SQUARE), r"curves_a .*\(0, 4, 3\)"),
        (lambda: close_far([[0, 0, 0], [0, 0, 0]]), "extent"),
        (lambda: close_far([[0, 0, 0], [0, 0, 1]], end=(0, 0)), "end"),
        (lambda: close_far([[0, 0, 0]]), "corners"),
    ],
)
def test_what_is_no_curve_is_named(call, names):
    with pytest.raises(ValueError, match=names):
        call()
