"""What a stranger may hand in, and what it gets, through every door at once; `book/doors.md` says what is promised."""

from __future__ import annotations

import dataclasses
import json
import os
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import topokit as tk
from topokit import lemmas
from topokit.compat import LoopFeatures
from topokit.io import load_episode, save_episode, save_states
from topokit.linking import close_far, linking_numbers
from topokit.mixture import InverseWishart
from topokit.sampling import spacing
from topokit.view import plot_cloth

from conftest import DATA, polygon

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
    (lambda: tk.farthest_point_sample(RING, "3"), "n must be"),
    (lambda: tk.farthest_point_sample(RING, 3, 1.5), "start"),
    (lambda: MIXTURE.sample(float("nan")), "n must be"),
    (lambda: MIXTURE.density(0), "n must be"),
    (lambda: MIXTURE.density(4, extent=float("nan")), "extent"),
    (lambda: MIXTURE.credibility(RING, n=0), "n must be"),
    (lambda: MIXTURE.log_prob([[1, 2, 3], [1]]), "x must"),
    (lambda: tk.loop_mixture(LOOP, prior=InverseWishart(1.0, float("inf"))), "dof"),
    (lambda: tk.loop_mixture(LOOP, prior=InverseWishart("a")), "scale"),
    (lambda: close_far(RING * 1e308), "1e150"),
    (lambda: close_far(RING, start="up"), "start"),
    (lambda: linking_numbers(["a"], ["b"]), "curves_a"),
    (lambda: tk.rips_persistence([[0, np.inf], [np.inf, 0]], metric="precomputed"), r"inf at \[0, 1\].* max_radius"),
    (lambda: LoopFeatures().fit(RING), r"X is one array \(12, 3\)"),
]


@pytest.mark.parametrize(("call", "name"), BAD_CALLS, ids=[f"{i}: {name}" for i, (_, name) in enumerate(BAD_CALLS)])
def test_a_bad_argument_is_named(call, name):
    with pytest.raises(ValueError, match=name):
        call()


# -- files ------------------------------------------------------------------------------------------------------------------


def test_a_full_disk_names_the_file(tmp_path, monkeypatch):
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match=r"No space left on device: .*s.npz"):
        save_states(tmp_path / "s.npz", [])
    assert not list(tmp_path.iterdir())
