"""The core is small: its fourteen names need NumPy and SciPy, use numba where it is, and need no package of a companion."""

from __future__ import annotations

import importlib
import subprocess
import sys
from pathlib import Path

import pytest

import topokit

_PACKAGES = """
bokeh dask distributed fsspec gymnasium matplotlib pandas pybullet pydantic pypcd4 pyvista safetensors sklearn
torch tqdm trimesh vtk yaml gudhi networkx ripser
"""
_NAMES = """
Diagram Loop LoopMixture SeqPH TopologicalState covering_radius farthest_point_sample follow hausdorff linking_number
loop_mixture rips_persistence rips_persistence_many track
"""
COMPANIONS = _PACKAGES.split()
FACE = _NAMES.split()
FOLDER = Path(topokit.__file__).parent
PACKAGES = ["topokit", *(f"topokit.{face.parent.name}" for face in sorted(FOLDER.glob("*/__init__.py")))]
WITHOUT = f"import sys\nfor name in {COMPANIONS}: sys.modules[name] = None  # as where it is not installed\n"

USE_ALL = """
import numpy as np
import topokit as tk
from topokit.io import load_states, save_states

angle = np.linspace(0, 2 * np.pi, 40, endpoint=False)
ring = np.column_stack([np.cos(angle), np.sin(angle), 0.1 * np.cos(2 * angle)])
idx, radius = tk.farthest_point_sample(ring, 30)
assert tk.covering_radius(ring, ring[idx]) == radius == tk.hausdorff(ring, ring[idx])
assert isinstance(tk.rips_persistence(ring), tk.Diagram)
assert len(tk.rips_persistence_many([ring, ring])) == 2
clouds = [ring, ring + [0, 0, 0.01]]
states = tk.track(clouds)
assert isinstance(states[1], tk.TopologicalState)
assert [loop.id for loop in tk.SeqPH().update(ring).loops] == [0]
loop = states[1].loops[0]
assert isinstance(loop, tk.Loop)
assert [one.id for one in tk.follow([loop], ring)] == [loop.id]
assert isinstance(tk.loop_mixture(loop), tk.LoopMixture)
pole = np.array([[0, 0, -9], [0, 0, 9], [99, 0, 9], [99, 0, -9]])
assert abs(tk.linking_number(loop.cycle_points, pole)) == 1
assert load_states(save_states(sys.argv[1], states), clouds)[1].loops[0].birth == loop.birth
"""
SCORES = "from topokit.evaluate import compare, distance_to_hull\nassert distance_to_hull([0.5], [[0], [1]]) < 1e-9\n"


def run(code: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True)


@pytest.mark.parametrize("without", [WITHOUT, WITHOUT + "sys.modules['numba'] = None\n"], ids=["numba", "no numba"])
@pytest.mark.parametrize("code", [USE_ALL, SCORES], ids=["the core", "scores of tracks"])
def test_the_core_works_without_packages_of_companions(code, without, tmp_path):
    done = run(without + code, str(tmp_path / "states.npz"))
    assert done.returncode == 0, done.stderr


def test_the_face_of_the_library():
    done = run("import topokit; print(*topokit.__all__)")
    assert done.stdout.split() == FACE


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_shows_the_names_of_its_face_and_nothing_else(package):
    module = importlib.import_module(package)
    assert dir(module) == sorted(module.__all__)
    try:
        assert all(getattr(module, name) is not None for name in module.__all__)
    except ImportError as error:
        pytest.skip(str(error))  # the core's tests run without the companions' packages
    assert dir(module) == sorted(module.__all__)  # nothing comes with the modules that were imported
