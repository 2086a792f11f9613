"""Where each point of the cloth will be under a plan: a network that has seen how cloth moves, and no place, no garment by name.

Idea, four choices:

1. *Points, not loops.* What moves is cloth; loops are read off the moved cloud (`topokit.follow`), which needs no labels to learn
   from and no memory of where necks usually are.
2. *What a point knows is local*, but for two summaries of the cloud: where grippers, target, floor and neighbours are from it,
   and how it moved of late; in the grippers' frame, turned about the vertical: a turned or moved scene is the same scene.
3. *A correction of being carried.* Cloth that is held goes with the grippers, as a rigid body does; the network adds the rest.
4. *Few large steps.* The future is taken in 13 steps of one to six frames. A code of every point is carried along, and is told
   what grippers and target are like there, and what the mean and the maximum of the codes of 24 of the points, the carriers, say.
   So points do not wait for each other: a few are forecast under a thousand plans, or all under one.

Each point has a scale of its error, too, learned with the motion as that of a Laplace distribution.

Source: rollouts by messages as in Sanchez-Gonzalez et al. 2020, *Learning to simulate complex physics with graph networks*, with
codes pooled as in Qi et al. 2017, *PointNet*; edge convolutions of Wang et al. 2019, *Dynamic graph CNN*; gates of Cho et al.
2014, *Learning phrase representations using RNN encoder-decoder*. Taught in chapter 12.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import torch
from torch import Tensor, nn

from ._baselines import Normalisation, Shape

KNOTS = (1, 3, 6, 10, 15, 20, 25, 30, 36, 42, 48, 54, 60)  # frames ahead at which motion is forecast
PAST = (1, 4, 12)  # frames ago that are looked at
UNIT = 0.2  # metres
_REACH = 0.3  # metres over which the target's say fades
_NEAR = 12  # neighbours of a point
CARRIERS, _POOLED = 24, 16  # points that tell all others how the cloth fares, and the numbers that they do it with
Scene = Mapping[str, Tensor]
Line = Sequence[Tensor]  # what `_line` says


class Codes(NamedTuple):
    """What is known of B scenes before a plan, in the grippers' frame and units of 0.2 m; of carriers first, then of n points."""

    code: Tensor  # (B, carriers + n, width)
    place: Tensor  # (B, carriers + n, 3)
    hands: Tensor  # (B, 2, 3)
    target: Line
    floor: Tensor  # (B,) its height in that frame
    origin: Tensor  # (B, 3) of that frame, metres
    turn: Tensor  # (B, 3, 3) its axes
    carriers: int
    swapped: Tensor  # (B,) whether the grippers changed names


class Motion(nn.Module):
    """Motion of points under plans.

    A scene is a dict of tensors of B windows, in metres:

    ============  ================  ============================================================================
    ``cloud``     (B, M, 3)         the cloth at the present frame, in an order that says nothing
    ``points``    (B, n, 3)         points of the cloth whose motion is asked for
    ``flow``      (B, M + n, 3, 3)  how cloud and points moved beside the grippers since 1, 4 and 12 frames ago
    ``grippers``  (B, 4, 2, 3)      at the present frame, and then
    ``held``      (B,) bool         whether they hold the cloth
    ``target``    (B, L, 3)         the upper part of the target's centre line, up to its tip
    ``floor``     (B,)              the height of the floor; far below where nobody knows
    ============  ================  ============================================================================

    Parameters
    ----------
    shape : Shape
        Its `horizon` is 60; `points` are those of a cloud that are looked at, at most.
    normalisation : Normalisation
        Not asked: nothing depends on where the scene is.
    width : int
        Units of a point's code.
    """

    learns = True

    def __init__(self, shape: Shape, normalisation: Normalisation, width: int = 64) -> None:
        super().__init__()
        if type(width) is not int or not 1 <= width <= 4096:
            raise ValueError(f"width must be a whole number from 1 to 4096, not {width!r}")
        if shape.horizon != KNOTS[-1]:
            raise ValueError(f"motion is forecast {KNOTS[-1]} frames ahead, not {shape.horizon}")
        self.shape, self.normalisation = shape, normalisation
        self.point = nn.Sequential(
            nn.Linear(3 + 9 + 5 + 2 + 2 + 12 + 2 + 16, width), nn.GELU(), nn.Linear(width, width)
        )
        self.edge = nn.Sequential(nn.Linear(2 * width + 4, width), nn.GELU(), nn.Linear(width, width))
        self.flow = nn.Linear(9, width)
        self.mix = nn.Linear(5 * width, width)
        self.pool = nn.Linear(width, _POOLED)
        self.own = nn.Linear(6 + 5 + 2 + 3 + 3, 3 * width)
        self.scene = nn.Linear(6 + 2 + 16 + 2 * _POOLED, 3 * width)
        self.before = nn.Linear(width, 3 * width)
        self.out = nn.Sequential(nn.Linear(width, width), nn.GELU(), nn.Linear(width, 4))
        last: Any = self.out[2]
        nn.init.normal_(last.weight, std=0.01)  # untrained it carries
        nn.init.zeros_(last.bias)

    def forward(self, scene: Scene) -> tuple[Tensor, Tensor]:
        """Places (B, 13, carriers + n, 3) of carriers and points, metres, and the scales of their errors, without the 3.

        The carriers are the first 24 of the cloud. The plans are in the scene, too: `actions` (B, 60, 2, 3) and
        `actions_held` (B, 60).
        """
        return self.under(self.encode(scene), scene["actions"], scene["actions_held"])

    def encode(self, scene: Scene) -> Codes:
        """What the points know, whatever the plan."""
        swapped = _behind(scene["grippers"][:, 0], scene["target"][:, -1])
        grippers = _renamed(scene["grippers"], swapped)
        origin, turn = _frame(grippers[:, 0])
        parts = (scene["cloud"], scene["points"], grippers, scene["target"])
        cloud, points, hands, way = (_local(part, origin, turn) for part in parts)
        floor, target = (scene["floor"] - origin[:, 2]) / UNIT, _line(way)
        size, carriers = cloud.shape[1], min(CARRIERS, cloud.shape[1])
        seen = torch.cat([cloud, points], dim=1)
        flow = (2 / UNIT * scene["flow"].flatten(1, 2) @ turn.mT).view(len(cloud), -1, 9)
        velocity = (10 * (hands[:, :1] - hands[:, 1:3])).flatten(1)
        opening = (hands[:, 0, 0] - hands[:, 0, 1]).norm(dim=1, keepdim=True)
        held = scene["held"].to(cloud)[:, None]
        whole = torch.cat([velocity, held, opening, _reach(hands[:, 0], target).flatten(1)], dim=1)[:, None]
        told = [seen, flow, _beside(seen, target), _above(seen, floor), torch.cdist(seen, hands[:, 0])]
        code = self.point(torch.cat([*told, whole.expand(-1, seen.shape[1], -1)], dim=-1))
        asked = torch.cat([torch.arange(carriers), torch.arange(size, seen.shape[1])])
        own, place = code[:, asked], seen[:, asked]
        near = torch.cdist(place, cloud).topk(min(_NEAR, size), largest=False).indices
        batch = torch.arange(len(cloud), device=cloud.device)[:, None, None]
        away = 2 * (cloud[batch, near] - place[:, :, None])
        there = torch.cat([away, away.norm(dim=-1, keepdim=True)], dim=-1)
        first: Any = self.edge[0]  # of [own, that of the neighbour, there]: of points, not edges, as far as may be
        mine, theirs, apart = first.weight.split([code.shape[2], code.shape[2], 4], dim=1)
        edges = (own @ mine.T + first.bias)[:, :, None] + (code[:, :size] @ theirs.T)[batch, near] + there @ apart.T
        edges = self.edge[1:](edges).amax(dim=2)
        moved = self.flow(flow[batch, near].mean(dim=2))
        cloth = code[:, :size]
        pooled = (part[:, None].expand_as(own) for part in (cloth.mean(dim=1), cloth.amax(dim=1)))
        code = torch.tanh(self.mix(torch.cat([own, edges, moved, *pooled], dim=-1)))
        return Codes(code, place, hands[:, 0], target, floor, origin, turn, carriers, swapped)

    def under(self, codes: Codes, actions: Tensor, held: Tensor) -> tuple[Tensor, Tensor]:
        """Places and scales, as `forward`, under C plans: one a scene, or any number for a single one.

        Parameters
        ----------
        codes : Codes
        actions : (C, 60, 2, 3)
            Planned places of the grippers, metres.
        held : (C, 60) bool
        """
        plans, carriers, width = len(actions), codes.carriers, codes.code.shape[2]
        parts = (part.expand(plans, *part.shape[1:]) for part in (codes.code, codes.place, *codes.target))
        code, place, *target = parts
        hands, shares = _hands(_local(_renamed(actions, codes.swapped), codes.origin, codes.turn), held, codes.hands)
        before = torch.cat([codes.hands.expand(plans, -1, -1)[:, None], hands[:, :-1]], dim=1)
        turns = _turns(before.flatten(0, 1), hands.flatten(0, 1)).unflatten(0, hands.shape[:2])
        shifts = hands.mean(dim=2, keepdim=True) - before.mean(dim=2, keepdim=True) @ turns
        lasts = torch.tensor((0, *KNOTS)).to(hands).diff() / 6
        reach = _reach(hands.flatten(1, 2), target).unflatten(1, hands.shape[1:3]).flatten(2)
        told = [(hands - before).flatten(2), shares[..., None], lasts.expand(plans, -1)[..., None], reach]
        # What is linear in the plan is done for all steps at once; what is linear in places, without their differences.
        planned, pooled = self.scene.weight.split([24, 2 * _POOLED], dim=1)
        one, other, around, goes, went = self.own.weight.split([3, 3, 7, 3, 3], dim=1)
        own = torch.cat([goes - one - other, -goes, 3 * went, around], dim=1)
        given = torch.cat([*told, hands.flatten(2)], dim=-1) @ torch.cat([planned, one, other], dim=1).T
        given = given + (self.scene.bias + self.own.bias)
        step, places, scales = torch.zeros_like(place), [], []
        for k, frames in enumerate(lasts.tolist()):
            ahead = torch.baddbmm(shifts[:, k], place, turns[:, k])
            said = self.pool(code[:, :carriers])
            scene = torch.addmm(given[:, k], torch.cat([said.mean(dim=1), said.amax(dim=1)], dim=1), pooled.T)
            new = torch.cat([ahead, place, step, _beside(ahead, target), _above(ahead, codes.floor)], dim=-1) @ own.T
            new, old = new + scene[:, None], self.before(code)
            keep, use = torch.sigmoid(new[..., width:] + old[..., width:]).chunk(2, dim=-1)
            code = torch.lerp(torch.tanh(torch.addcmul(new[..., :width], use, old[..., :width])), code, keep)
            change = self.out(code)
            there = torch.add(ahead, change[..., :3], alpha=frames)
            step, place = (there - place) / frames, there
            places.append(place)
            scales.append(change[..., 3])
        scale = 0.01 * (torch.stack(scales, dim=1) + 1).exp()
        return _world(torch.stack(places, dim=1), codes.origin, codes.turn), scale

    def loss(self, scene: Scene, generator: torch.Generator) -> tuple[Tensor, dict[str, Tensor]]:
        """Error and distortion in the mean, and likelihood, of `future` (B, 13, carriers + n, 3) where it is `known` (B, 13).

        The distortion is here by how much distances between points are wrong. Topology depends on it: deaths differ by half of
        the largest one at most. An error that all points share moves no killer to another place of the cloth.

        Clouds are thinned at random, so that nothing depends on how many points are seen.

        Parameters
        ----------
        scene : dict of Tensor
            With its plans, `future` and `known`, as `Scenes` gives it.
        generator : torch.Generator
            Of what is random.
        """
        whole = scene["cloud"].shape[1]
        few = int(torch.randint(64, whole + 1, (), generator=generator))
        flow = torch.cat([scene["flow"][:, :few], scene["flow"][:, whole:]], dim=1)
        places, scales = self({**scene, "cloud": scene["cloud"][:, :few], "flow": flow})
        future = scene["future"]
        error = ((places - future).square().sum(dim=-1) + 1e-6).sqrt()
        unlikely = error / scales + 3 * (scales / UNIT).log()  # of a Laplace distribution in three dimensions
        weight = scene["known"].to(error)[..., None] / (future.shape[2] * scene["known"].sum().clamp_min(1))
        apart = (_apart(places) - _apart(future)).abs().mean(dim=-1)
        each = {"error": error, "unlikely": unlikely, "distortion": apart}
        parts = {name: (weight * part).sum() for name, part in each.items()}
        loss = 30 * (parts["error"] + parts["distortion"]) + 0.3 * parts["unlikely"]
        return loss, {name: part.detach() for name, part in {"loss": loss, **parts}.items()}


def _apart(points: Tensor) -> Tensor:
    """(..., n, n) distances between points (..., n, 3), to 1 mm: as products, which take a third of the time of differences."""
    central = points - points.mean(dim=-2, keepdim=True)
    size = central.square().sum(dim=-1)
    square = size[..., :, None] + size[..., None, :] - 2 * central @ central.mT
    return (square.clamp_min(0) + 1e-6).sqrt()


def carried(points: Tensor, before: Tensor, now: Tensor) -> Tensor:
    """Points (B, N, 3) moved as grippers (B, 2, 3) were: with their middle, and about the vertical through it."""
    return (points - before.mean(dim=1)[:, None]) @ _turns(before, now) + now.mean(dim=1)[:, None]


def _turns(before: Tensor, now: Tensor) -> Tensor:
    """(B, 3, 3) by which rows turn about the vertical as the line between grippers (B, 2, 3) does."""
    one, other = ((hands[:, 1] - hands[:, 0])[:, :2] for hands in (before, now))
    size = (one.norm(dim=1) * other.norm(dim=1)).clamp_min(1e-6)
    cosine = (one * other).sum(dim=1) / size
    sine = (one[:, 0] * other[:, 1] - one[:, 1] * other[:, 0]) / size
    none, unit = torch.zeros_like(sine), torch.ones_like(sine)
    return torch.stack([cosine, sine, none, -sine, cosine, none, none, none, unit], dim=1).unflatten(1, (3, 3))


def _hands(actions: Tensor, held: Tensor, start: Tensor) -> tuple[Tensor, Tensor]:
    """Where the grippers are at the knots while they hold, (C, 13, 2, 3), or were at last; shares (C, 13) of held frames."""
    holds = held.to(actions)
    moves = torch.cat([start.expand(len(actions), 2, 3)[:, None], actions], dim=1).diff(dim=1)
    place = start[:, None] + (moves * holds[..., None, None]).cumsum(dim=1)
    at = torch.tensor(KNOTS, device=actions.device)
    count = torch.cat([torch.zeros_like(holds[:, :1]), holds.cumsum(dim=1)], dim=1)[:, torch.cat([at.new_zeros(1), at])]
    return place[:, at - 1], count.diff(dim=1) / torch.cat([at[:1], at.diff()])


def _line(places: Tensor) -> Line:
    """Of the L pieces of a line (B, L + 1, 3): ways (B, 3, L), minus their products with starts, their squares (B, 1, L); minus
    twice the starts (B, 3, L), their squares (B, 1, L); starts, ways and shares of the line before them (B, L, 7).
    """
    start, along = places[:, :-1], places.diff(dim=1)
    before = (torch.arange(along.shape[1]).to(places) / along.shape[1])[:, None].expand(len(places), -1, 1)
    base, square, first = (part.sum(dim=-1)[:, None] for part in (-start * along, along.square(), start.square()))
    table = torch.cat([start, along, before], dim=-1)
    return along.mT, base, square.clamp_min(1e-9 / UNIT**2), -2 * start.mT, first, table


def _beside(points: Tensor, line: Line) -> Tensor:
    """(B, N, 5) the way from points (B, N, 3) to a line and where along it that ends, which fade; how near it is."""
    ways, base, square, starts, first, table = line
    way = torch.baddbmm(base, points, ways)
    share = (way / square).clamp(0, 1)
    # Squares of distances, but for what a point adds to all of them.
    off = torch.baddbmm(first, points, starts)
    nearest = torch.addcmul(off, share, torch.sub(share * square, way, alpha=2)).argmin(dim=-1, keepdim=True)
    share, piece = share.gather(2, nearest), table.gather(1, nearest.expand(-1, -1, 7))
    away = torch.addcmul(piece[..., :3] - points, share, piece[..., 3:6])
    near = (-UNIT / _REACH * torch.linalg.vector_norm(away, dim=-1, keepdim=True)).exp()
    along = torch.add(piece[..., 6:], share, alpha=1 / table.shape[1])
    return torch.cat([torch.cat([away, along], dim=-1) * near, near], dim=-1)


def _above(points: Tensor, floor: Tensor) -> Tensor:
    """(B, N, 2) how high points (B, N, 3) are above the floor (B,), which fades; how near it is."""
    height = (points[..., 2:] - floor[:, None, None]).relu()
    near = (-UNIT / _REACH * height).exp()
    return torch.cat([height * near, near], dim=-1)


def _reach(hands: Tensor, target: Line) -> Tensor:
    """(B, N, 8) where the target is from grippers (B, N, 3): its line, and its tip, which fades with the square."""
    last = target[-1][:, -1:]
    tip = last[..., :3] + last[..., 3:6] - hands
    faded = tip / (0.1 / UNIT**2 + tip.square().sum(dim=-1, keepdim=True)).sqrt()
    return torch.cat([_beside(hands, target), faded], dim=-1)


def _behind(grippers: Tensor, tip: Tensor) -> Tensor:
    """(B,) whether a tip (B, 3), seen from grippers (B, 2, 3), lies to the right of the way from the first to the second."""
    across, away = ((end - grippers[:, 0])[:, :2] for end in (grippers[:, 1], tip))
    return across[:, 0] * away[:, 1] < across[:, 1] * away[:, 0]


def _renamed(grippers: Tensor, swapped: Tensor) -> Tensor:
    """Grippers (B, K, 2, 3), in the other order where they are swapped: which is which makes no difference to the cloth."""
    return torch.where(swapped[:, None, None, None], grippers.flip(2), grippers)


def _frame(grippers: Tensor) -> tuple[Tensor, Tensor]:
    """Middle (B, 3) of the grippers (B, 2, 3), and axes (B, 3, 3): from one gripper to the other, level; the third is up."""
    across = (grippers[:, 1] - grippers[:, 0])[:, :2]
    size = across.norm(dim=1, keepdim=True)
    x, y = torch.where(size > 1e-3, across / size.clamp_min(1e-6), across.new_tensor([1.0, 0.0])).unbind(dim=1)
    none, one = torch.zeros_like(x), torch.ones_like(x)
    return grippers.mean(dim=1), torch.stack([x, y, none, -y, x, none, none, none, one], dim=1).unflatten(1, (3, 3))


def _local(points: Tensor, origin: Tensor, turn: Tensor) -> Tensor:
    """Points (B, ..., 3) in metres, seen from a frame, in units; of one frame and many scenes, too."""
    flat = points.flatten(1, -2) - origin[:, None]
    return (flat @ (turn / UNIT).mT).view_as(points)


def _world(points: Tensor, origin: Tensor, turn: Tensor) -> Tensor:
    return (points.flatten(1, -2) @ (UNIT * turn) + origin[:, None]).view_as(points)
