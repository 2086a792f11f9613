"""What a stranger may hand in, and what it gets, through every door at once; `book/doors.md` says what is promised."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import topokit as tk
from topokit import lemmas
from topokit._config import load
from topokit.io import load_episode, load_states, save_episode, save_states
from topokit.linking import close_far, linking_numbers
from topokit.mixture import InverseWishart
from topokit.sampling import spacing
from topokit.sim import Garment, HangEnv, SimulationConfig
from topokit.view import plot_cloth

from conftest import DATA, memory, polygon

RING = np.column_stack([polygon(12), np.zeros(12)])
FAR = RING + [9.0, 0, 0]
LOOP = tk.SeqPH(alpha=0.1).update(RING).loops[0]
MIXTURE = tk.loop_mixture(LOOP)


def loop_with_triangles(corners: Any) -> SimpleNamespace:
    names = ("neighbours", "killer_values", "neighbour_values")
    parts = {name: getattr(LOOP, name) for name in names}
    return SimpleNamespace(killer_triangles=corners[:6].reshape(2, 3, 3), **parts)


# -- clouds, matrices and masks ---------------------------------------------------------------------------------------------

TAKES_CLOUD = {
    "rips_persistence": tk.rips_persistence,
    "rips_persistence_many": lambda cloud: tk.rips_persistence_many([cloud], n_jobs=1),
    "rips_persistence_many of an array": lambda cloud: tk.rips_persistence_many(np.ma.stack([cloud, cloud]), n_jobs=1),
    "track": lambda cloud: tk.track([cloud, cloud], n_jobs=1),
    "SeqPH.update": lambda cloud: tk.SeqPH().update(cloud),
    "follow": lambda cloud: tk.follow([LOOP], cloud),
    "farthest_point_sample": lambda cloud: tk.farthest_point_sample(cloud, 3),
    "covering_radius": lambda cloud: tk.covering_radius(RING, cloud),
    "hausdorff": lambda cloud: tk.hausdorff(cloud, RING),
    "spacing": spacing,
    "linking_number": lambda cloud: tk.linking_number(cloud, FAR),
    "linking_numbers": lambda cloud: linking_numbers(np.ma.stack([cloud, cloud]), FAR),
    "linking_numbers of a list": lambda cloud: linking_numbers([FAR], [cloud]),
    "close_far": close_far,
    "close_far(start=)": lambda cloud: close_far(RING, start=cloud[0]),
    "LoopMixture.log_prob": MIXTURE.log_prob,
    "loop_mixture": lambda cloud: tk.loop_mixture(loop_with_triangles(cloud)),
    "feature_separation": lemmas.feature_separation,
    "max_displacement": lambda cloud: lemmas.max_displacement(RING, cloud),
    "distortion": lambda cloud: lemmas.distortion(cloud, RING),
    "vertex_ids": lambda cloud: lemmas.vertex_ids(RING, cloud),
    "plot_cloth": plot_cloth,
}


@pytest.mark.parametrize("door", TAKES_CLOUD)
def test_masked_entries_are_refused_and_nothing_under_a_mask_is_read(door):
    with pytest.raises(ValueError, match="masked"):
        TAKES_CLOUD[door](np.ma.masked_greater(RING, 0.9))
    TAKES_CLOUD[door](np.ma.masked_greater(RING, 9.0))  # none is masked


def test_masks_of_matrices_ids_times_and_rows_are_refused():
    matrix = np.linalg.norm(RING[:, None] - RING, axis=2)
    with pytest.raises(ValueError, match="masked"):
        tk.rips_persistence(np.ma.masked_less(matrix, 0.6), metric="precomputed")
    with pytest.raises(ValueError, match="masked"):
        tk.rips_persistence([np.ma.masked_less([0.0, 1.0], 0.5), [1, 2], [3, 4]])
    with pytest.raises(ValueError, match="masked"):
        lemmas.vertex_ids(RING, np.ma.masked_less(np.arange(12), 3))
    with pytest.raises(ValueError, match="frame 1"):
        tk.track([RING, RING], times=np.ma.masked_greater([0.0, 1.0], 0.5))
    film = load_episode(DATA / "apron_hook_0.npz")
    with pytest.raises(ValueError, match="points"):
        save_episode("never.npz", dataclasses.replace(film, points=np.ma.masked_greater(film.points, 1)))


@pytest.mark.parametrize("rows", [1, 2, 3])
def test_few_rows_of_many_columns_are_asked_about(rows):
    cloud = np.random.default_rng(0).random((rows, 500))
    for call in (tk.rips_persistence, lambda c: tk.track([c]), lambda c: tk.SeqPH().update(c)):
        with pytest.raises(ValueError, match=f"500 points in {rows} dimensions"):
            call(cloud)
    assert tk.hausdorff(cloud, cloud) == 0  # two edges in a space of many dimensions are two edges
    repeated = np.concatenate([cloud, np.repeat(cloud[:1], 3, axis=0)])
    assert len(tk.rips_persistence(repeated)) == 0  # the answer to the question
    assert len(tk.rips_persistence(np.zeros((rows, 32)))) == 0


BAD_CLOUDS = {
    "nothing": None,
    "a word": "abc",
    "whole numbers beyond floating point": [[10**400, 0]],
    "longer floating point": np.full((4, 2), np.longdouble("1e4000")),
    "rows of different length": [[1, 2], [3]],
    "nested too deep": json.loads("[" * 80 + "]" * 80),
    "dates": np.zeros((4, 2), "M8[s]"),
    "named columns": np.zeros(4, [("x", "f8"), ("y", "f8")]),
    "complex numbers": np.zeros((4, 2), complex),
    "a NaN": np.full((4, 2), np.nan),
    "one axis": np.zeros(4),
}


@pytest.mark.parametrize("what", BAD_CLOUDS)
def test_what_is_no_cloud(what):
    for call in (tk.rips_persistence, spacing, lambda c: tk.track([c]), lambda c: tk.linking_number(c, RING)):
        with pytest.raises(ValueError, match=r"points|sequence\[0\]|curve"):
            call(BAD_CLOUDS[what])


# What is called, and the argument that the error must name.
BAD_CALLS = [
    (lambda: tk.SeqPH(alpha=10**400), "alpha"),
    (lambda: tk.SeqPH(memory=float("inf")), "memory"),
    (lambda: tk.SeqPH(memory=True), "memory"),
    (lambda: tk.track([RING], times=["now"]), "frame 0 has time now"),
    (lambda: tk.track([RING], times=np.zeros((1, 2))), "frame 0 has time"),
    (lambda: tk.SeqPH().update(RING, time=10**400), "frame 0 has time"),
    (lambda: tk.farthest_point_sample(RING, 2.5), "n must be"),
    (lambda: tk.farthest_point_sample(RING, "3"), "n must be"),
    (lambda: tk.farthest_point_sample(RING, 3, 1.5), "start"),
    (lambda: MIXTURE.sample(float("nan")), "n must be"),
    (lambda: MIXTURE.sample("3"), "n must be"),
    (lambda: MIXTURE.density(0), "n must be"),
    (lambda: MIXTURE.density(4, extent=float("nan")), "extent"),
    (lambda: MIXTURE.credibility(RING, n=0), "n must be"),
    (lambda: MIXTURE.log_prob("abc"), "x must"),
    (lambda: MIXTURE.log_prob([[1, 2, 3], [1]]), "x must"),
    (lambda: tk.loop_mixture(LOOP, prior=InverseWishart(1.0, float("inf"))), "dof"),
    (lambda: tk.loop_mixture(LOOP, prior=InverseWishart(np.inf)), "scale"),
    (lambda: tk.loop_mixture(LOOP, prior=InverseWishart("a")), "scale"),
    (lambda: close_far(RING * 1e308), "1e150"),
    (lambda: close_far(RING, start="up"), "start"),
    (lambda: linking_numbers(["a"], ["b"]), "curves_a"),
]


@pytest.mark.parametrize(("call", "name"), BAD_CALLS, ids=[f"{i}: {name}" for i, (_, name) in enumerate(BAD_CALLS)])
def test_a_bad_argument_is_named(call, name):
    with pytest.raises(ValueError, match=name):
        call()


# -- files ------------------------------------------------------------------------------------------------------------------

PLY = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
PLY += "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 0 1\n3 0 1 2\n"


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("element face", "element evil 2000000000\nproperty char x\nelement face"),
        ("element face", "element evil -1\nproperty char x\nelement face"),
        ("vertex 3", "vertex 9" + "9" * 30),
        ("3 0 1 2", "inf 0 1 2"),
        ("3 0 1 2", "3 0 nan 2"),
        ("3 0 1 2", "900000000 0 1 2"),
        ("property float x", "property list uchar float x"),
        ("property list uchar int", "property list"),
        ("element vertex", "property float w\nelement vertex"),
        ("element vertex", "element\nelement vertex"),
        ("1 0 0", "1e200 0 0"),
    ],
)
def test_a_ply_file_declares_no_more_than_it_holds(tmp_path, old, new):
    path = tmp_path / "cloth.ply"
    path.write_text(PLY.replace(old, new, 1))
    with pytest.raises(ValueError, match=r"cloth\.ply"):
        Garment.from_mesh(path)


def test_work_for_a_mesh_is_bounded(tmp_path):
    """Cutting faces into triangles takes the square of their corners: thirty seconds here."""
    around = "".join(f"v {x} 0 {z}\n" for x, z in polygon(1000))
    (tmp_path / "round.obj").write_text(around + ("f " + " ".join(map(str, range(1, 1001))) + "\n") * 31)
    with pytest.raises(ValueError, match=r"round.obj: 31 faces"):
        Garment.from_mesh(tmp_path / "round.obj")


@pytest.mark.parametrize("suffix", [".ply", ".obj", ".stl"])
def test_a_mesh_takes_a_hundred_times_its_file_at_most(tmp_path, suffix):
    """The densest files: a byte or two for each number."""
    n = 20_000
    dense = PLY.replace("ascii", "binary_little_endian").replace("float", "char").replace("uchar int", "uchar uchar")
    head = dense.replace("vertex 3", f"vertex {n}").replace("face 1", f"face {n}").split("0 0 0")[0]
    facet = b"facet normal vertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n"
    data = {
        ".ply": head.encode() + b"\0\1\2" * n + b"\3\0\1\2" * n,
        ".obj": b"v 0 0 0\n" * n + b"f 1 2 3\n" * n,
        ".stl": b"solid\n" + facet * n + b"endsolid",
    }[suffix]
    path = tmp_path / f"cloth{suffix}"
    path.write_bytes(data)
    with memory() as peak, contextlib.suppress(ValueError):
        Garment.from_mesh(path)
    assert peak() < 100 * len(data)


@settings(max_examples=60, deadline=None)
@given(st.binary(max_size=200), st.sampled_from([".ply", ".obj", ".stl"]), st.integers(0, 200))
def test_any_mesh_file_is_read_or_refused(tmp_path_factory, noise, suffix, at):
    """A slice of `tests/fuzz_readers.py`, without coverage to guide it."""
    whole = PLY.encode() if suffix == ".ply" else b"v 0 0 0\nv 1 0 0\nv 0 0 1\nf 1 2 3\n"
    path = tmp_path_factory.getbasetemp() / f"fuzz{suffix}"
    path.write_bytes(whole[:at] + noise + whole[at + len(noise) // 2 :])
    with contextlib.suppress(ValueError):
        Garment.from_mesh(path)


def test_deep_json_of_a_configuration_names_the_file(tmp_path):
    (tmp_path / "deep.json").write_text("[" * 100_000)
    with pytest.raises(ValueError, match=r"deep.json"):
        load(SimulationConfig, tmp_path / "deep.json")


@pytest.mark.parametrize("reader", [load_episode, load_states, Garment.from_mesh])
def test_a_device_is_no_file(reader):
    with pytest.raises(FileNotFoundError, match="/dev/null"):
        reader("/dev/null")


def test_a_full_disk_names_the_file(tmp_path, monkeypatch):
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match=r"No space left on device: .*s.npz"):
        save_states(tmp_path / "s.npz", [])
    assert not list(tmp_path.iterdir())


# -- the environment --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "options",
    [{"n_points": 2.5}, {"n_points": "a"}, {"n_points": True}, {"max_steps": 0.5}, {"max_steps": float("inf")}],
    ids=str,
)
def test_numbers_of_the_environment_are_whole(options):
    with pytest.raises(ValueError, match=next(iter(options))):
        HangEnv(**options)


BAD_ACTIONS = [None, "abc", [0] * 6, [np.inf] * 7, [[1], 2, 3, 4, 5, 6, 7], [10**400] * 7, np.zeros(7, complex)]


@pytest.mark.parametrize("action", [*BAD_ACTIONS, np.ma.masked_all(7)], ids=str)
def test_an_action_that_is_none_moves_nothing(action, monkeypatch):
    env = HangEnv(n_points=50)
    monkeypatch.setattr(env, "_running", lambda: None)
    with pytest.raises(ValueError, match="action"):
        env.step(action)
