"""Test the figures of the chapters: their data, their pages, and that drawings of lenses agree with the definition."""

from __future__ import annotations

import re
import subprocess
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
from test_lemmas import critical_by_definition

from chapter_tools import figures
from topokit import farthest_point_sample, lemmas, rips_persistence, track, view
from topokit.io import Episode, load_episode

from conftest import polygon
from pages import needs_node, page_data, unpack

ROOT = Path(__file__).parents[1]
SQUARE = [[0.0, 0.0], [2.0, 0.0], [2.0, 2.0], [0.0, 2.0]]
RING = np.insert(polygon(8), 2, 0.0, axis=1)
HOOK = np.array([[0.0, 3, -2], [0, 3, 1], [0, 0, 1], [0, 0, 2]])
NETWORK = re.compile(r"https?:|//[a-z]+\.[a-z]|@import|url\(|<link|src=|fetch\(|XMLHttpRequest|WebSocket")


@pytest.fixture(autouse=True)
def close_figures():
    yield
    plt.close("all")


def film() -> np.ndarray:
    """Return a ring in space that tilts and shrinks, with points beside it."""
    rng = np.random.default_rng(6)
    ring = np.insert(polygon(24, 30.0), 2, 0.0, axis=1)
    beside = rng.normal(0, 20, (16, 3)) + [40, 0, 9]
    shaken = np.vstack([ring, beside]) + rng.normal(0, 0.5, (40, 3))
    return np.stack([shaken * [1, 1 - 0.2 * t, 1] + [0, 3 * t, 0] for t in range(3)])


def apron() -> Episode:
    return load_episode(ROOT / "data_small" / "apron_hook_0.npz")


# Figures with a text that would end their script.
PAGES = {
    "cloud": lambda: figures.cloud({"an </script> apron": RING, "a film": film()}),
    "growth": lambda: figures.growth(SQUARE, start=1, max_radius=3, title="four </script> corners"),
    "lunes": lambda: figures.lunes({"square </script>": SQUARE, "two": [[0, 0], [1, 1]]}),
    "belief": lambda: figures.belief({"a </script> film": [0.5, 1.5, 2.0], "another": [1, 1]}),
    "repaint": lambda: figures.repaint({"two </script>": ["aab-", "bba-"]}),
    "turning": lambda: figures.turning({"</script>": np.eye(3)[None]}, np.eye(3), np.eye(3), [0], [1, 2, 3]),
    "leak": lambda: figures.leak(np.eye(3), np.eye(3), [1, 1, 1], [0, 0, 1], [1, 2, 1], ["</script>", "b", "c"], 0.1),
    "player": lambda: view.player(replace(apron(), garment="an </script> apron"), track(apron().observed[:, ::9])),
}


@needs_node
@pytest.mark.parametrize("name", PAGES)
def test_a_page_asks_no_network_and_no_text_ends_its_script(name):
    figure = PAGES[name]()
    assert page_data(figure)
    assert not NETWORK.search(figure.page)
    assert figure._repr_html_().count('"') == 8  # nothing inside ends an attribute
    scripts = re.findall(r"<script[^>]*>(.*?)</script>", figure.page, re.DOTALL)
    assert len(scripts) == 2  # the data and the program
    subprocess.run(["node", "--check", "-"], input=scripts[1], text=True, capture_output=True, check=True)


def test_verdicts_are_those_of_the_library_for_every_step_of_both_sliders():
    before, after = film()[:2] / 100
    data = page_data(figures.verdicts(before, after, levels=(4, 3)))
    outcomes = unpack(data["outcomes"])
    numbers = unpack(data["numbers"])
    seen = unpack(data["seen"])
    assert [row[0] for row in data["alphas"]] == sorted(row[0] for row in data["alphas"])
    assert data["epsilons"][0] == 0.0
    assert data["epsilons"][2] == pytest.approx(np.linalg.norm(after - before, axis=1).max())
    found = set()
    for a, e in np.ndindex(4, 3):
        moved = before + e / 2 * (after - before)
        observed = np.flatnonzero(seen[a])
        assert len(observed) == data["counts"][a]
        then, _ = farthest_point_sample(moved, len(observed), start=1)
        checks = lemmas.verify_step(before, observed, moved, then)
        assert data["alphas"][a][e] == pytest.approx(checks["corollary"].alpha)
        for s, name in enumerate(data["statements"]):
            for v, version in enumerate(data["versions"]):
                outcome = ("", "no loop", "not met", "true", "false")[outcomes[a, e, s, v]]
                verdict = checks[name].versions.get(version)
                assert (verdict is None) == (outcome == "")
                if verdict is None:
                    continue
                assert verdict.applies == (outcome in ("true", "false"))
                assert (verdict.violated and verdict.loops > 0) == (outcome == "false")
                assert numbers[a, e, s, v].tolist() == pytest.approx([verdict.statistic, verdict.bound], rel=1e-6)
                found.add(outcome)
    assert found >= {"no loop", "true", "false"}


# ---- drawings of lenses


def holed_clouds(count: int, seed: int) -> list[np.ndarray]:
    """Return shaken grids with a hole."""
    rng = np.random.default_rng(seed)
    grid = np.mgrid[-2:2.1:0.5, -2:2.1:0.5].reshape(2, -1).T
    ring = grid[np.linalg.norm(grid, axis=1) > 0.9]
    return [ring + rng.normal(0, 0.08, ring.shape) for _ in range(count)]


def some_edges(cloud: np.ndarray, rng: np.random.Generator, count: int) -> list:
    """Return the edges of the three longest loops and random ones."""
    pairs = np.column_stack(np.triu_indices(len(cloud), 1))
    killers = rips_persistence(cloud).killer_edge
    return np.vstack([killers[:3], pairs[rng.integers(len(pairs), size=count)]]).tolist()


def test_a_lens_shows_what_is_critical_by_definition():
    rng = np.random.default_rng(3)
    axes = plt.figure().add_subplot()
    verdicts = []
    for cloud in holed_clouds(2, 3):
        for alpha, epsilon in ((0.0, 0.0), (0.15, 0.0), (0.1, 0.02)):
            for x, y in some_edges(cloud, rng, 9):
                axes.clear()
                figures.plot_lens(cloud, (x, y), alpha, epsilon, ax=axes)
                critical = critical_by_definition(cloud, x, y, alpha, epsilon)
                assert axes.get_title() == ("critical" if critical else "not critical")
                verdicts.append(critical)
    assert 10 < sum(verdicts) < len(verdicts) - 10
