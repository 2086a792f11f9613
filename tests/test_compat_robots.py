"""Doors to Gymnasium, Stable-Baselines3, Rerun and ROS, and loops as objects of networkx, trimesh and PyVista in a line."""

from __future__ import annotations

import json
import subprocess
import sys

import numpy as np
import pytest
from scipy.spatial import cKDTree
from test_io import small_episode

from topokit import track
from topokit.cli import main
from topokit.io import load_episode, save_episode

from conftest import DATA, polygon

# -- Gymnasium, Stable-Baselines3 -------------------------------------------------------------------------------------------


@pytest.fixture
def starts():
    pytest.importorskip("pybullet")
    gymnasium = pytest.importorskip("gymnasium")
    from topokit.sim import Garment, HangingStarts, SimulationConfig

    garment, quick = Garment.apron(spacing=0.05, strap_width=0.05), SimulationConfig(self_collision=False, settle=0.02)

    def make(**options):
        env = gymnasium.make("topokit/HangApronHook-v1", garment=garment, config=quick, n_points=60, max_steps=4)
        return HangingStarts(env, **options)

    return make


def test_starts_come_in_a_row_and_again(starts):
    env = starts(seeds=[7, 8, 9])
    film = [env.reset() for _ in range(4)]
    assert [info["seed"] for _, info in film] == [7, 8, 9, 7]
    np.testing.assert_array_equal(film[0][0]["points"], film[3][0]["points"])
    assert not np.array_equal(film[0][0]["target"], film[1][0]["target"])
    assert [env.reset(seed=4)[1]["seed"], env.reset()[1]["seed"]] == [8, 9]
    env.close()


def test_they_are_those_of_the_hanging_benchmark(starts):
    from topokit.control import Controller, hang

    class GivesUp(Controller):
        def reset(self, observation):
            self.reason, self.seen = "", observation

        def act(self, observation):
            self.reason = "it looked"

    env, looks = starts(), GivesUp()
    mine = env.reset()[0]
    inner = env.unwrapped
    hang(
        "apron-hook",
        seed=1000,
        place="anywhere",
        controller=looks,
        garment=inner.garment,
        config=inner.config,
        n_points=60,
    )
    for name, value in looks.seen.items():
        np.testing.assert_array_equal(mine[name], value)
    env.close()


@pytest.mark.parametrize("seeds", [[], [0.5], [-1]], ids=str)
def test_seeds_are_whole_numbers(starts, seeds):
    with pytest.raises(ValueError, match="seed"):
        starts(seeds=seeds)


@pytest.mark.filterwarnings("ignore")
def test_stable_baselines3_checks_and_trains(starts):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import DummyVecEnv

    env = starts(seeds=range(3))
    checker.check_env(env)
    env.close()
    model = PPO(
        "MultiInputPolicy", DummyVecEnv([lambda: starts(seeds=range(3))]), n_steps=8, batch_size=8, n_epochs=1, seed=0
    )
    before = [one.detach().clone() for one in model.policy.parameters()]
    model.learn(16)
    assert any((one != other).any() for one, other in zip(before, model.policy.parameters(), strict=True))
    model.env.close()


# -- Rerun, and states as lines of JSON -------------------------------------------------------------------------------------


@pytest.fixture
def recorded(tmp_path):
    save_episode(tmp_path / "film.npz", small_episode())
    return tmp_path / "film.npz"


def test_a_recording_of_rerun_holds_what_was_tracked(recorded):
    pytest.importorskip("rerun")
    from topokit.view import rerun

    film = load_episode(DATA / "apron_hook_0.npz")
    states = track(film.points[:3])
    out = recorded.with_name("tracks.rrd")
    cut = [rerun(film.points[:3], states, out).stat().st_size]
    told = subprocess.run([sys.executable, "-m", "rerun", "rrd", "verify", str(out)], capture_output=True, text=True)
    assert told.returncode == 0
    assert "verified without error" in told.stderr + told.stdout
    shown = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "print", "-vv", str(out)], capture_output=True, text=True
    )
    for word in ("/cloud", "/loops/0/cycle", "/loops/0/killer", "/lifetimes/0"):
        assert word in shown.stdout, word
    assert "/plan" not in shown.stdout
    assert main(["track", str(recorded), "--rerun", str(out)]) == 0
    assert out.stat().st_size != cut[0]
    shown = subprocess.run(
        [sys.executable, "-m", "rerun", "rrd", "print", "-vv", str(out)], capture_output=True, text=True
    )
    assert "/plan" in shown.stdout
    with pytest.raises(ValueError, match="states has 2 frames"):
        rerun(film.points[:3], states[:2], out)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--rerun", "tracks.mp4"], "the name of a recording ends in .rrd"),
        (["--live", "--rerun", "tracks.rrd"], "leave out"),
        (["--out", "tracks.csv"], "ends in .npz or .jsonl"),
    ],
)
def test_bad_names_write_nothing(options, says, recorded, capsys):
    episode = [] if "--live" in options else [str(recorded)]
    assert main(["track", *episode, *options]) == 2
    assert says in capsys.readouterr().err
    assert [path.name for path in recorded.parent.iterdir()] == [recorded.name]


def test_without_rerun_it_is_named_before_the_work(recorded, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    assert main(["track", str(recorded), "--rerun", "tracks.rrd"]) == 2
    assert "topokit.view.rerun needs rerun: pip install 'topokit[rerun]'" in capsys.readouterr().err
    assert [path.name for path in recorded.parent.iterdir()] == [recorded.name]


def test_states_are_written_as_lines(recorded, capsys):
    out = recorded.with_name("states.jsonl")
    assert main(["track", str(recorded), "--out", str(out)]) == 0
    assert str(out) in capsys.readouterr().out
    lines = [json.loads(line) for line in out.read_text().splitlines()]
    film = load_episode(recorded)
    assert lines == [state.as_dict() for state in track(film.points, times=film.times)]


def test_a_bag_is_tracked_into_lines(tmp_path):
    pytest.importorskip("rosbags")
    from test_sensors import cloud_message, ring, save_bag

    bag = save_bag(
        tmp_path / "recording", {"/camera/points": [cloud_message(ring(t).reshape(6, 10, 3), 1 + t) for t in range(3)]}
    )
    assert main(["track", str(bag), "--out", str(tmp_path / "states.jsonl")]) == 0
    lines = [json.loads(line) for line in (tmp_path / "states.jsonl").read_text().splitlines()]
    assert [[loop["id"] for loop in line["loops"]] for line in lines] == [[0]] * 3


# -- networkx, trimesh, PyVista ---------------------------------------------------------------------------------------------


def test_a_loop_is_an_object_of_the_neighbours_in_a_line():
    networkx, trimesh = pytest.importorskip("networkx"), pytest.importorskip("trimesh")
    pyvista = pytest.importorskip("pyvista")
    ring = np.column_stack([polygon(12), np.zeros(12)])
    loop = track([ring])[0].loops[0]

    graph = networkx.cycle_graph(loop.cycle.tolist())
    assert networkx.is_connected(graph)
    assert sorted(graph.nodes) == list(range(12))
    complex_ = networkx.Graph(list(cKDTree(ring).query_pairs(2 * loop.birth * (1 + 1e-9))))
    assert networkx.is_isomorphic(graph, complex_)

    path = trimesh.load_path(loop.cycle_points[np.r_[: len(loop.cycle), 0]])
    assert path.is_closed
    assert path.length == pytest.approx(12 * 2 * loop.birth)
    mesh = trimesh.Trimesh(loop.killer_triangles.reshape(6, 3), np.arange(6).reshape(2, 3), process=False)
    assert len(mesh.faces) == 2

    line = pyvista.lines_from_points(loop.cycle_points, close=True)
    assert line.n_cells == 12
    assert line.length > 2
