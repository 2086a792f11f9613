"""Corners, batched mixtures and losses: against NumPy, against the tracker, and by what must not matter."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch.utils.data import default_collate

import topokit as tk
from topokit.io import load_episode
from topokit.models import StateTensors, forecast_loss, loop_mixtures
from topokit.models._states import past_of

from windows import ring_windows


@pytest.fixture(scope="module")
def tracked(episode_path):
    return tk.track(load_episode(episode_path).points[20:36], identity="killer-triangles")


@pytest.fixture(scope="module")
def window():
    data = ring_windows(6, seed=3)
    return default_collate([data[i] for i in range(6)])


def test_corners_give_the_triangles_of_the_tracker_back(tracked):
    states = StateTensors.from_past(past_of(tracked, 3))
    totals = states.lifetime[0].sum(dim=0)  # slots are ordered by lifetime
    assert (totals.diff() <= 0).all()
    seen = 0
    for frame, state in enumerate(tracked):
        for slot in range(3):
            rows = [loop for loop in state.loops if np.isclose(loop.death, float(states.death[0, frame, slot]))]
            if states.presence[0, frame, slot] < 0:
                continue
            loop = rows[0]
            triangles, values = states.triangles[0, frame, slot].numpy(), states.values[0, frame, slot].numpy()
            assert np.allclose(triangles[:2], loop.killer_triangles, atol=1e-6)
            assert np.allclose(triangles[2:][values[2:] > 0], loop.neighbours, atol=1e-6)
            assert np.allclose(values[2:][values[2:] > 0], loop.neighbour_values, atol=1e-6)
            assert np.allclose(states.mean[0, frame, slot], tk.loop_mixture(loop).mean, atol=1e-6)
            seen += 1
    assert seen >= 16


def test_neighbours_stand_on_their_edges_when_some_are_missing(window):
    states = StateTensors.from_labels(window)
    assert torch.allclose(states.values[:, :, 0, :].sum(-1), window["values"][:, :, 0].sum(-1))
    assert (states.neighbour_values[:, :, 0] > 0).sum() == 2 * 6 * 60
    there = states.values[:, :, 0] > 0
    rebuilt = states.triangles[:, :, 0][there].mean(dim=-2)
    stored = window["triangles"][:, :, 0][window["values"][:, :, 0] > 0].mean(dim=-2)
    assert torch.allclose(rebuilt.sum(dim=0), stored.sum(dim=0), rtol=1e-4)


def test_batched_mixtures_are_those_of_numpy(tracked):
    loops = [state.loops[0] for state in tracked if len(state.loops[0].neighbours) == 4]
    assert len(loops) > 3
    triangles = torch.tensor(np.array([np.concatenate([loop.killer_triangles, loop.neighbours]) for loop in loops]))
    values = torch.tensor(np.array([np.concatenate([loop.killer_values, loop.neighbour_values]) for loop in loops]))
    triangles.requires_grad_()
    mixtures = loop_mixtures(triangles, values, noise=3e-4)
    x = np.random.default_rng(0).normal(loops[0].centre, 0.1, size=(50, 3))
    got = mixtures.log_prob(torch.tensor(x)[:, None]).detach().numpy()
    for i, loop in enumerate(loops):
        assert np.allclose(got[:, i], tk.loop_mixture(loop, noise=3e-4).log_prob(x))
        assert np.allclose(mixtures.mean[i].detach(), tk.loop_mixture(loop).mean)
    mixtures.log_prob(torch.tensor(x[:1])).sum().backward()
    assert torch.isfinite(triangles.grad).all()
    assert triangles.grad.abs().sum() > 0


def losses(states, window, **options):
    total, parts = forecast_loss(states, window, centre=1, **options)
    return float(total), {name: float(part) for name, part in parts.items()}


def test_the_truth_has_no_error_and_anything_else_more(window):
    truth = StateTensors.from_labels(window)
    best, parts = losses(truth, window)
    assert parts["features"] < 1e-9
    assert parts["presence"] < 1e-6
    assert parts["distance"] < 1e-7
    for change in (
        {"corners": truth.corners + 0.01},
        {"death": truth.death + 0.01},
        {"neighbour_values": truth.neighbour_values + 0.01},
        {"presence": -truth.presence},
    ):
        assert losses(truth.replace(**change), window)[0] > best + 1e-3


def test_an_edge_has_no_direction(window):
    truth = StateTensors.from_labels(window)
    assert losses(truth.reversed(), window)[1]["features"] < 1e-9
    wrong = truth.replace(corners=truth.corners[..., [2, 1, 0, 3, 4, 5, 6, 7], :])
    assert losses(wrong, window)[1]["features"] > 0.1


def test_slots_are_matched(window):
    truth = StateTensors.from_labels(window)
    moved = truth.map(lambda part: part[:, :, [2, 0, 3, 1]])
    assert losses(moved, window)[1]["presence"] > 1
    _, parts = losses(moved, window, match=True)
    assert parts["features"] < 1e-9
    assert parts["presence"] < 1e-6


def test_absent_loops_have_no_say_in_places(window):
    truth = StateTensors.from_labels(window)
    there = (truth.presence > 0)[..., None, None]
    noise = truth.replace(corners=torch.where(there, truth.corners, torch.randn_like(truth.corners)))
    assert losses(noise, window)[1]["features"] < 1e-9


def test_a_batch_without_a_loop_has_a_finite_loss(window):
    empty = window | {"present": torch.zeros_like(window["present"])}
    states = StateTensors.from_labels(window)
    leaf = states.corners.clone().requires_grad_()
    total, _ = forecast_loss(states.replace(corners=leaf), empty, centre=1, match=True)
    total.backward()
    assert torch.isfinite(total)
    assert torch.equal(leaf.grad, torch.zeros_like(leaf))
