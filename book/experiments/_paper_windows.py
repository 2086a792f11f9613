"""Remedies of paper.py for networks that read windows: the grippers' frame, and points that they are given besides the cloud.

Idea: a remedy is a change of the windows, and of the forecast back. So the networks stay as they are. In the grippers' frame the
origin is the middle of the grippers in the last frame of the history, and x points from the first to the second, seen from above.
What a fully connected network is given besides (grippers of every frame, target, floor) are points before those of the cloud,
each always in the same place. A Motion learns where vertices went; `LabelledScenes` tell it what the other networks are told.
"""

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from forecasts import Forecaster
from numpy.typing import NDArray
from torch import Tensor
from torch.utils.data import Dataset, default_collate

from topokit.data import Dataset as Films
from topokit.data import WindowDataset
from topokit.models import Scenes, StateTensors
from topokit.models._motion import CARRIERS, KNOTS
from topokit.seqph import Loop, TopologicalState

PLACES = ("clouds", "grippers", "actions", "triangles", "past_triangles")
ON_TARGET = 4  # points of the target's line that a network is given
ASKED = 16  # vertices that a scene asks for
GIVEN = {"grippers": 2, "target": ON_TARGET, "floor": 1}


class Remedied(Dataset[dict[str, Tensor]]):
    """Windows with remedies.

    Parameters
    ----------
    windows : WindowDataset
    frame : {"room", "grippers"}
    given : sequence of {"grippers", "target", "floor"}
    """

    def __init__(self, windows: WindowDataset, frame: str = "room", given: tuple[str, ...] = ()) -> None:
        self.windows = windows
        self.frame = frame
        self.given = given
        self._targets: dict[int, Tensor] = {}

    def __len__(self) -> int:
        return len(self.windows)

    def __getitem__(self, i: int) -> dict[str, Tensor]:
        return self.__getitems__([i])[0]

    def __getitems__(self, rows: Sequence[int]) -> list[dict[str, Tensor]]:
        windows = self.windows.__getitems__(rows)
        if self.frame == "room" and not self.given:
            return windows
        parts = {name: part.unbind() for name, part in self.remedied(default_collate(windows)).items()}
        return [{name: part[i] for name, part in parts.items()} for i in range(len(windows))]

    def remedied(self, window: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return a batch of windows with the remedies."""
        changed = dict(window)
        before = [self._given(name, window) for name in self.given]
        changed["clouds"] = torch.cat([*before, window["clouds"]], dim=2)
        if self.frame == "grippers":
            origin, turn = grippers_frame(window)
            for name in PLACES:
                changed[name] = to_frame(changed[name], origin, turn)
        return changed

    def forecaster(self, model: torch.nn.Module) -> Forecaster:
        """Return a forecaster that asks a model about windows with the remedies, and writes its forecast in the room again."""

        def forecast(window: Mapping[str, Tensor]) -> StateTensors:
            states: StateTensors = model(self.remedied(window))
            if self.frame == "grippers":
                origin, turn = grippers_frame(window)
                states = states.replace(corners=from_frame(states.corners, origin, turn))
            return states.map(Tensor.float)

        return forecast

    def _given(self, name: str, window: Mapping[str, Tensor]) -> Tensor:
        """Return points (B, h, n, 3) that a network is given in every frame of the history."""
        if name == "grippers":
            return window["grippers"]
        targets = torch.stack([self._target(number) for number in window["episode"].tolist()])
        chosen = targets[:, -1:] if name == "floor" else targets[:, :-1]
        return chosen[:, None].expand(-1, window["clouds"].shape[1], -1, -1)

    def _target(self, number: int) -> Tensor:
        """Return points (n + 1, 3) of an episode's target, spread along its centre line, and where it stands."""
        if number not in self._targets:
            line = self.windows.dataset[number].centre_line
            rows = np.linspace(0, len(line) - 1, ON_TARGET).round().astype(int)
            lowest = line[line[:, 2].argmin()]
            self._targets[number] = torch.from_numpy(np.vstack([line[rows], lowest])).float()
        return self._targets[number]


def blind(height: float, slots: int) -> Forecaster:
    """Return the forecaster that reads no cloud: every loop is `height` metres below the planned middle of the grippers.

    The middle stays where they let go of the cloth. All slots are present, and at the same place.
    """

    def forecast(window: Mapping[str, Tensor]) -> StateTensors:
        held = window["actions_held"]
        last_held = torch.where(held, torch.arange(held.shape[1]), 0).cummax(dim=1).values
        middle = window["actions"].mean(dim=2).take_along_dim(last_held[..., None], dim=1)  # (B, K, 3)
        place = middle - torch.tensor([0.0, 0.0, height])
        ones = place.new_ones(*place.shape[:2], slots)
        return StateTensors(
            corners=place[:, :, None, None].expand(-1, -1, slots, 8, -1),
            neighbour_values=0.025 * ones[..., None].expand(-1, -1, -1, 4),
            birth=0.025 * ones,
            death=0.05 * ones,
            killer_shift=0.025 * ones,
            presence=6 * ones,
            noise=1e-4 * ones,
        )

    return forecast


def grippers_frame(window: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
    """Return the origin (B, 3) and the axes (B, 3, 3), as columns, of the grippers' frame."""
    last = window["grippers"][:, -1]
    level = (last[:, 1] - last[:, 0])[:, :2]
    length = level.norm(dim=1, keepdim=True)
    # Grippers above each other have no direction: the room's is taken.
    cosine, sine = torch.where(length > 1e-6, level / length.clamp_min(1e-6), level.new_tensor([1.0, 0.0])).T
    zero = torch.zeros_like(cosine)
    one = torch.ones_like(cosine)
    axes = [torch.stack(row, dim=1) for row in ((cosine, -sine, zero), (sine, cosine, zero), (zero, zero, one))]
    return last.mean(dim=1), torch.stack(axes, dim=1)


def to_frame(places: Tensor, origin: Tensor, turn: Tensor) -> Tensor:
    """Return places (B, ..., 3) of the room in a frame."""
    flat = places.flatten(1, -2) - origin[:, None]
    return (flat @ turn).view_as(places)


def from_frame(places: Tensor, origin: Tensor, turn: Tensor) -> Tensor:
    """Return places (B, ..., 3) of a frame in the room."""
    flat = places.flatten(1, -2) @ turn.transpose(1, 2)
    return (flat + origin[:, None]).view_as(places)


class LabelledScenes(Scenes):
    """Scenes in which a Motion is told how tracked loops moved, and not how vertices did.

    It is asked for the corners of their killer triangles. Each corner is told to move as the middle of its loop does, where the
    loop is still tracked. The futures of all other points are unknown.
    """

    def __init__(self, films: Films, episodes: Sequence[int]) -> None:
        super().__init__(films, episodes)
        self._tracks: dict[int, list[TopologicalState]] = {}

    def __getitem__(self, i: int) -> dict[str, Tensor]:
        scene = super().__getitem__(i)
        number, frame = self.index[i].tolist()
        loops = self.loops(number, frame)
        future = scene["points"].expand(len(KNOTS), -1, -1).clone()
        known = torch.zeros(len(KNOTS), ASKED, dtype=torch.bool)
        of_corner = np.resize(np.repeat(range(len(loops)), 6), ASKED)
        for row, ahead in enumerate(KNOTS):
            then = {loop.id: loop.centre for loop in self.loops(number, frame + ahead)}
            for k, loop in enumerate(loops):
                if loop.id in then:
                    corners = torch.from_numpy(of_corner == k)
                    future[row, corners] += torch.from_numpy(then[loop.id] - loop.centre).to(future)
                    known[row] |= corners
        unknown = torch.zeros(len(KNOTS), CARRIERS, dtype=torch.bool)
        scene["future"] = torch.cat([scene["future"][:, :CARRIERS], future], dim=1)
        scene["known"] = torch.cat([unknown, known], dim=1)
        return scene

    def _asked(self, number: int, frame: int) -> NDArray[np.int64] | None:
        """Return the corners of the killer triangles, some twice; where there is no loop, vertices are drawn."""
        corners = [loop.killer_triangle_ids.ravel() for loop in self.loops(number, frame)]
        return np.resize(np.concatenate(corners), ASKED) if corners else None

    def loops(self, number: int, frame: int) -> tuple[Loop, ...]:
        """Return the tracked loops of a frame, none after the film's end."""
        if number not in self._tracks:
            self._tracks[number] = self.dataset.states(number, "full")
        states = self._tracks[number]
        return states[frame].loops if frame < len(states) else ()
