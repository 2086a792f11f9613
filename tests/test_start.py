"""How a mesh stands: any axis may be up, what lies or is upside down is told, an open front has its name."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pybullet")

from topokit.cli import main
from topokit.sim import Garment

VEST = Garment.vest(spacing=0.05)


def written(path: Path, vertices: np.ndarray, faces: np.ndarray) -> Path:
    rows = [f"v {x} {y} {z}" for x, y, z in vertices] + [f"f {a} {b} {c}" for a, b, c in faces + 1]
    path.write_text("\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize("up", ["x", "y", "z", "-x", "-y", "-z"])
def test_any_axis_may_be_up(tmp_path, up):
    """z of the garment becomes that axis of the file, and comes back; no turn mirrors."""
    axis, sign = "xyz".index(up[-1]), -1 if up[0] == "-" else 1
    turn = np.eye(3)
    turn[[axis, 2]] = turn[[2, axis]]
    turn[axis] *= sign
    turn[2 if axis != 2 else 0] *= np.linalg.det(turn)
    assert np.linalg.det(turn) == pytest.approx(1)
    loaded = Garment.from_mesh(written(tmp_path / "m.obj", VEST.vertices @ turn.T, VEST.faces), up=up)
    np.testing.assert_allclose(loaded.vertices[:, 2], VEST.vertices[:, 2], atol=1e-9)
    a, b, c = np.moveaxis(loaded.vertices[loaded.faces], 1, 0)
    before = np.moveaxis(VEST.vertices[VEST.faces], 1, 0)
    volume = np.linalg.det(np.stack([a, b, c], axis=1)).sum()
    assert volume * np.linalg.det(np.stack(before, axis=1)).sum() > 0


def test_grips_at_the_floor_are_refused_and_a_lying_mesh_is_told_of(tmp_path):
    path = written(tmp_path / "m.obj", VEST.vertices * [1, 1, -1], VEST.faces)
    with pytest.raises(ValueError, match=r"grips would be in the lowest third.*which axis is up"):
        Garment.from_mesh(path, grips=VEST.grips, up="z")
    assert Garment.from_mesh(path, grips=VEST.grips, up="-z").loops == ()
    low = written(tmp_path / "low.obj", VEST.vertices * [1, 3, 0.7], VEST.faces)
    assert any("seems to lie" in said for said in Garment.from_mesh(low).repairs)
    assert not any("seems to lie" in said for said in Garment.from_mesh(low, up="z").repairs)


def opened() -> np.ndarray:
    """The faces of the vest without a strip down its front."""
    middle = VEST.vertices[VEST.faces].mean(axis=1)
    return VEST.faces[~((np.abs(middle[:, 0]) < 0.05) & (middle[:, 1] < 0))]


def test_an_open_front_has_its_name(tmp_path, capsys):
    faces = opened()
    used, flat = np.unique(faces, return_inverse=True)
    path = written(tmp_path / "waistcoat.obj", VEST.vertices[used], flat.reshape(-1, 3))
    said = [words for words in Garment.from_mesh(path, loops="auto").repairs if "open front" in words]
    assert len(said) == 1
    assert said[0].startswith("neck, slit and hem are one border of ")
    whole = written(tmp_path / "vest.obj", VEST.vertices, VEST.faces)
    assert not any("open front" in words for words in Garment.from_mesh(whole, loops="auto").repairs)
    assert main(["mesh", str(path), "--json"]) == 0
    assert said[0] in json.loads(capsys.readouterr().out)["repairs"]
