"""Garments that are refused, and episodes in PyBullet: whole, repeatable, refused when they are not physical."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("pybullet")

from topokit import rips_persistence
from topokit.io import load_episode
from topokit.sim import Camera, Garment, Hook, SimulationConfig, SimulationError, simulate

from conftest import polygon

COARSE = {"spacing": 0.05, "strap_width": 0.05}


@pytest.mark.parametrize("sizes", [{}, COARSE, {"bib_width": 0.34, "strap_length": 0.8}, {"spacing": 0.025}])
def test_apron_is_a_disc_with_one_hole(sizes):
    apron = Garment.apron(**sizes)
    v, e, f = len(apron.vertices), len(apron.edges), len(apron.faces)
    assert v - e + f == 0  # Euler characteristic of an annulus
    lengths = apron.edge_lengths
    assert lengths.min() > 0.4 * apron.parameters["spacing"]
    assert lengths.max() < 1.8 * apron.parameters["spacing"]
    assert len(apron.loops) == 1
    edges = {tuple(edge) for edge in apron.edges.tolist()}
    loop = apron.loops[0].tolist()
    assert all((min(a, b), max(a, b)) in edges for a, b in zip(loop, loop[1:] + loop[:1], strict=True))
    diagram = rips_persistence(apron.vertices)
    assert diagram.lifetime[0] > 3 * diagram.lifetime[1]  # the opening is the one loop that lasts


def test_grips_are_on_the_strap_and_symmetric():
    apron = Garment.apron()
    left, right = apron.vertices[apron.grips]
    np.testing.assert_allclose(left * [-1, 1, 1], right, atol=0.01)
    assert min(left[2], right[2]) > 0.1


def square(**changes):
    """Two triangles and a loop around them."""
    parts = {
        "name": "square",
        "vertices": np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], float),
        "faces": np.array([[0, 1, 2], [0, 2, 3]]),
        "loops": (np.array([0, 1, 2, 3]),),
        "grips": np.array([0, 1]),
    }
    return Garment(**{**parts, **changes})


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"faces": np.array([[0, 1, 2], [0, 2, 4]])}, "vertex 4"),
        ({"faces": np.array([[0, 1, 2], [0, 2, 2]])}, "twice"),
        ({"faces": np.array([[0, 1, 2]])}, "vertex 3"),
        ({"vertices": np.full((4, 3), np.nan)}, "NaN"),
        ({"vertices": np.zeros((4, 2))}, r"\(N, 3\)"),
        ({"loops": (np.array([0, 1, 3]),)}, r"loops\[0\] is not a closed cycle.* 1 and 3"),
        ({"loops": (np.array([0, 1]),)}, "at least 3"),
        ({"grips": np.array([1, 1])}, "two different"),
        ({"loop_names": ("neck", "hem")}, "loop_names must be 1 different names, one a loop, not"),
        ({"loop_names": (1,)}, "loop_names must be 1 different names"),
        ({"loops": (np.arange(4), np.arange(4)), "loop_names": ("neck", "neck")}, "2 different names"),
        ({"vertices": np.array([[0, 0, 0], [0, 0, 0], [1, 1, 0], [0, 1, 0]], float)}, r"edge \[0, 1\] has length 0"),
    ],
)
def test_bad_garments(changes, says):
    with pytest.raises(ValueError, match=says):
        square(**changes)


def test_two_components_are_refused():
    vertices = np.vstack([polygon(3), polygon(3) + 5])
    with pytest.raises(ValueError, match="2 components"):
        square(vertices=np.column_stack([vertices, np.zeros(6)]), faces=np.array([[0, 1, 2], [3, 4, 5]]), loops=())


@pytest.mark.parametrize("sizes", [{"bib_width": 0.9}, {"strap_length": 0.1}, {"spacing": 0}, {"strap_width": 0.2}])
def test_bad_sizes(sizes):
    with pytest.raises(ValueError, match=next(iter(sizes))):
        Garment.apron(**sizes)


@pytest.mark.parametrize(
    "option", [{"dt": 0}, {"frames": 2.5}, {"max_stretch": 1}, {"max_edge_stretch": 0.5}, {"friction": -1}]
)
def test_bad_configuration(option):
    with pytest.raises(ValueError, match=next(iter(option))):
        SimulationConfig(**option)


def test_too_large_an_observation():
    with pytest.raises(ValueError, match="n_observed must be 1 to"):
        simulate(Garment.apron(**COARSE), n_observed=5000)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (
            {"cameras": Camera.around(n=2), "n_observed": 10**9},
            "n_observed must be 1 to 32768, the pixels of the cameras",
        ),
        ({"config": SimulationConfig(frames=10**9)}, "1,000,000,000 frames of .* fit into the memory"),
        ({"config": SimulationConfig(frames=200_000, steps_per_frame=1)}, "200,000 frames of .* fit into the memory"),
        ({"config": SimulationConfig(steps_per_frame=10**9)}, "frames of .* fit into the memory"),
        ({"config": SimulationConfig(dt=1e-300)}, "frames of .* fit into the memory"),
    ],
)
def test_what_does_not_fit_into_the_memory_is_refused_before_it_is_taken(options, says):
    with pytest.raises(ValueError, match=says):
        simulate(**options)


def test_pictures_and_rings_of_cameras_have_a_largest_size():
    with pytest.raises(ValueError, match=r"width: .* less than or equal to 4096"):
        Camera(width=10**9)
    with pytest.raises(ValueError, match="0 to 100 cameras, not 1000000000"):
        Camera.around(n=10**9)


def test_episode_is_whole_and_repeats_bit_by_bit_in_fresh_processes(tmp_path):
    code = (
        "from topokit.sim import *; from topokit.io import save_episode; import sys\n"
        "config = SimulationConfig(frames=8, steps_per_frame=20, settle=0.05)\n"
        "apron = Garment.apron(spacing=0.05, strap_width=0.05)\n"
        "save_episode(sys.argv[1], simulate(apron, seed=4, config=config, n_observed=100))\n"
    )
    paths = [tmp_path / "one.npz", tmp_path / "other.npz"]
    for path in paths:
        done = subprocess.run([sys.executable, "-c", code, str(path)], capture_output=True, text=True, check=True)
        assert done.stdout == done.stderr == ""  # PyBullet's own chatter is kept away
    assert paths[0].read_bytes() == paths[1].read_bytes()
    episode = load_episode(paths[0])
    assert episode.observed.shape == (8, 100, 3)
    assert episode.seed == 4
    assert episode.dt == pytest.approx(20 * SimulationConfig().dt)
    assert episode.held.all()
    assert not episode.success  # a fifth of a second is no time to hang anything
    physics = episode.physics
    assert physics["config"]["mass"] == 0.3
    assert physics["garment"]["spacing"] == 0.05
    assert physics["target"]["position"] == [0, 0.3, 0]
    assert (episode.task, episode.observation["kind"]) == ("apron-hook", "vertices")


def test_an_apron_is_hung_on_the_hook():
    episode = simulate(Garment.apron(**COARSE), seed=1, n_observed=150)
    assert episode.success
    hook = Hook()
    assert hook.holds(episode.points[-1][episode.loops[0]])
    assert not hook.holds(episode.points[0][episode.loops[0]])
    still = np.linalg.norm(episode.points[-1] - episode.points[-4], axis=1)
    assert still.max() < 0.1
    assert np.abs(episode.grippers - episode.actions)[episode.held].max() < 0.01  # the controller keeps up


def test_exploding_cloth_is_refused():
    """At once: before the first frame, while the cloth settles."""
    config = SimulationConfig(stiffness=8.0, frames=30, settle=0.1)
    with pytest.raises(SimulationError, match=r"settling: .*times its length"):
        simulate(Garment.apron(**COARSE), seed=0, config=config, n_observed=100)
