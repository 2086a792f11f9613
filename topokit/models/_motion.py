"""A network that predicts the place of each point of the cloth under a plan, without regard to the garment or the place.

Idea, four choices:

1. *Points, not loops.* The network predicts how the cloth moves. Loops are read off the moved cloud (`topokit.follow`). So
   learning needs no labels, and nothing depends on the usual place of a neck.
2. *Local inputs.* A point's inputs are the offsets to grippers, target, floor and neighbours, its recent motion, and two
   summaries of the cloud. All are in the grippers' frame: a scene that is moved, or turned about the vertical,
   is the same scene.
3. *A correction of being carried.* Cloth that is held moves with the grippers, as a rigid body does. The network adds the rest.
4. *Few large steps.* The future is taken in 13 steps of one to six frames. A code of every point is updated at each step, from
   grippers and target at that step, and from the mean and the maximum of the codes of 24 of the points, the carriers. No
   point depends on the others: a few points can be forecast under a thousand plans, or all points under one.

The network also predicts a scale of each point's error, learned with the motion as the scale of a Laplace distribution.

Source: rollouts by messages as in Sanchez-Gonzalez et al. 2020, *Learning to simulate complex physics with graph networks*, with
codes pooled as in Qi et al. 2017, *PointNet*; edge convolutions of Wang et al. 2019, *Dynamic graph CNN*; gates of Cho et al.
2014, *Learning phrase representations using RNN encoder-decoder*. Taught in chapter 14.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import torch
from torch import Tensor, nn

from ._baselines import Model, Normalisation, Shape

KNOTS = (1, 3, 6, 10, 15, 20, 25, 30, 36, 42, 48, 54, 60)  # frames ahead at which motion is forecast
PAST = (1, 4, 12)  # frames ago whose clouds and grippers are inputs
UNIT = 0.2  # metres; lengths in the network are in this unit
CARRIERS = 24  # points whose codes are pooled for all others
Scene = Mapping[str, Tensor]


class Codes(NamedTuple):
    """The codes of B scenes before a plan, in the grippers' frame and units of 0.2 m; carriers first, then the n points."""

    code: Tensor  # (B, carriers + n, width)
    place: Tensor  # (B, carriers + n, 3)
    hands: Tensor  # (B, 2, 3)
    target: Tensor  # (B, L, 3) places along a line
    floor: Tensor  # (B,) height of the floor in that frame
    origin: Tensor  # (B, 3) origin of that frame, metres
    axes: Tensor  # (B, 3, 3) axes of that frame
    carriers: int
    swapped: Tensor  # (B,) bool, true where the grippers are in the other order


class Motion(Model):
    """Motion of points under plans, for 60 frames, by codes of `width` units.

    A scene is a dict of tensors of B windows, in metres:

    ============  ================  ============================================================================
    ``cloud``     (B, M, 3)         the cloth at the present frame, in an order that carries no information
    ``points``    (B, n, 3)         points of the cloth whose motion is predicted
    ``flow``      (B, M + n, 3, 3)  motion of cloud and points relative to the grippers since 1, 4, 12 frames ago
    ``grippers``  (B, 4, 2, 3)      the grippers at the present frame, and 1, 4 and 12 frames ago
    ``held``      (B,) bool         whether they hold the cloth
    ``target``    (B, L, 3)         the upper part of the target's centre line, up to its tip
    ``floor``     (B,)              the height of the floor; far below where it is unknown
    ============  ================  ============================================================================

    To measure what each part is worth, it can be named in `without`: ``target`` (target and floor are unknown), ``frame`` (inputs
    are in the frame of the room), ``carry`` (the network predicts the whole motion, and no correction of being carried).
    """

    def __init__(
        self, shape: Shape, normalisation: Normalisation, width: int = 64, without: Sequence[str] = ()
    ) -> None:
        super().__init__(shape, normalisation)
        if shape.horizon != KNOTS[-1]:
            raise ValueError(f"motion is forecast {KNOTS[-1]} frames ahead, not {shape.horizon}")
        self.without = frozenset(without)
        # The inputs of a point, of an edge between neighbours, and of the code before any plan.
        self.point = _two_layers(3 + 9 + 5 + 2 + 2 + 12 + 2 + 16, width, width)
        self.edge = _two_layers(2 * width + 4, width, width)
        self.flow = nn.Linear(9, width)
        self.mix = nn.Linear(5 * width, width)
        # The inputs of a step: of the point itself, of the plan and the carriers, of the code before.
        self.pool = nn.Linear(width, 16)
        self.own = nn.Linear(6 + 5 + 2 + 3 + 3, 3 * width)
        self.scene = nn.Linear(6 + 2 + 16 + 2 * 16, 3 * width)
        self.before = nn.Linear(width, 3 * width)
        self.out = _two_layers(width, width, 4)
        # An untrained network predicts that the cloth is carried.
        weight, bias = self.out[2].parameters()
        nn.init.normal_(weight, std=0.01)
        nn.init.zeros_(bias)

    def forward(self, scene: Scene) -> tuple[Tensor, Tensor]:
        """Return places (B, 13, carriers + n, 3) of carriers and points in metres, and scales (B, 13, carriers + n) of errors.

        The carriers are the first 24 points of the cloud. The scene also holds the plans: `actions` (B, 60, 2, 3) and
        `actions_held` (B, 60).
        """
        return self.under(self.encode(scene), scene["actions"], scene["actions_held"])

    def encode(self, scene: Scene) -> Codes:
        """Return the codes of the points, which do not depend on the plan."""
        # Convert everything to the grippers' frame.
        target = scene["target"]
        floor = scene["floor"]
        if "target" in self.without:
            target = torch.tensor([0.0, 0.0, -1000.0]).expand_as(target)
            floor = torch.full_like(floor, -1000.0)
        swapped = _behind(scene["grippers"][:, 0], target[:, -1])
        grippers = _renamed(scene["grippers"], swapped)
        origin, axes = _frame(grippers[:, 0])
        if "frame" in self.without:
            origin = torch.zeros_like(origin)
            axes = torch.eye(3).expand_as(axes)
        cloud = _local(scene["cloud"], origin, axes)  # (B, M, 3)
        points = _local(scene["points"], origin, axes)  # (B, n, 3)
        hands = _local(grippers, origin, axes)  # (B, 4, 2, 3)
        target = _local(target, origin, axes)
        floor = (floor - origin[:, 2]) / UNIT  # (B,)
        seen = torch.cat([cloud, points], dim=1)  # (B, M + n, 3)
        flow = (2 / UNIT * scene["flow"].flatten(1, 2) @ axes.mT).view(len(cloud), -1, 9)  # (B, M + n, 9)

        # Compute the code of each point alone.
        velocity = (10 * (hands[:, :1] - hands[:, 1:3])).flatten(1)  # (B, 12)
        opening = (hands[:, 0, 0] - hands[:, 0, 1]).norm(dim=1, keepdim=True)  # (B, 1)
        held = scene["held"].to(cloud)[:, None]  # (B, 1)
        shared = torch.cat([velocity, held, opening, _reach(hands[:, 0], target).flatten(1)], dim=1)  # (B, 30)
        shared = shared[:, None].expand(-1, seen.shape[1], -1)
        features = [seen, flow, _beside(seen, target), _above(seen, floor), torch.cdist(seen, hands[:, 0]), shared]
        code = self.point(torch.cat(features, dim=-1))  # (B, M + n, width)

        # For carriers and points, mix in the codes of their neighbours in the cloud and of the whole cloud.
        size = cloud.shape[1]
        carriers = min(CARRIERS, size)
        asked = torch.cat([torch.arange(carriers), torch.arange(size, seen.shape[1])])
        own = code[:, asked]  # (B, carriers + n, width)
        place = seen[:, asked]  # (B, carriers + n, 3)
        near = torch.cdist(place, cloud).topk(min(12, size), largest=False).indices
        batch = torch.arange(len(cloud), device=cloud.device)[:, None, None]
        offset = 2 * (cloud[batch, near] - place[:, :, None])  # (B, carriers + n, neighbours, 3)
        offset = torch.cat([offset, offset.norm(dim=-1, keepdim=True)], dim=-1)
        cloth = code[:, :size]
        mine = own[:, :, None].expand(-1, -1, near.shape[2], -1)
        edges = self.edge(torch.cat([mine, cloth[batch, near], offset], dim=-1)).amax(dim=2)  # (B, carriers + n, width)
        moved = self.flow(flow[batch, near].mean(dim=2))  # (B, carriers + n, width)
        mean = cloth.mean(dim=1)[:, None].expand_as(own)
        highest = cloth.amax(dim=1)[:, None].expand_as(own)
        code = torch.tanh(self.mix(torch.cat([own, edges, moved, mean, highest], dim=-1)))
        return Codes(code, place, hands[:, 0], target, floor, origin, axes, carriers, swapped)

    def under(self, codes: Codes, actions: Tensor, held: Tensor) -> tuple[Tensor, Tensor]:
        """Return what `forward` does, under a plan (C, 60, 2, 3), held or not (C, 60), for each scene or C for a single one."""
        plans = len(actions)
        carriers = codes.carriers
        code = codes.code.expand(plans, -1, -1)  # (C, N, width)
        place = codes.place.expand(plans, -1, -1)  # (C, N, 3)
        target = codes.target.expand(plans, -1, -1)

        # Compute the plan at the knots: places of the grippers, and how held cloth is carried from knot to knot.
        actions = _local(_renamed(actions, codes.swapped), codes.origin, codes.axes)
        hands, shares = _hands(actions, held, codes.hands)  # (C, 13, 2, 3), (C, 13)
        before = torch.cat([codes.hands.expand(plans, -1, -1)[:, None], hands[:, :-1]], dim=1)
        turns = _turns(before.flatten(0, 1), hands.flatten(0, 1)).unflatten(0, hands.shape[:2])  # (C, 13, 3, 3)
        shifts = hands.mean(dim=2, keepdim=True) - before.mean(dim=2, keepdim=True) @ turns  # (C, 13, 1, 3)
        if "carry" in self.without:
            turns = torch.eye(3).expand_as(turns)
            shifts = torch.zeros_like(shifts)
        lengths = torch.tensor((0.0, *KNOTS)).diff() / 6  # (13,) of the steps
        both = torch.stack([shares, lengths.expand_as(shares)], dim=2)  # (C, 13, 2)
        reach = _reach(hands.flatten(1, 2), target).unflatten(1, hands.shape[1:3]).flatten(2)  # (C, 13, 16)
        of_plan = torch.cat([(hands - before).flatten(2), both, reach], dim=2)  # (C, 13, 24)

        step = torch.zeros_like(place)
        places = []
        scales = []
        for k, length in enumerate(lengths.tolist()):
            ahead = place @ turns[:, k] + shifts[:, k]  # (C, N, 3): carried
            # Update the code by a gated recurrent unit, from inputs of the point and of the whole scene.
            pooled = self.pool(code[:, :carriers])  # (C, carriers, 16)
            pooled = torch.cat([pooled.mean(dim=1), pooled.amax(dim=1)], dim=1)
            scene = self.scene(torch.cat([of_plan[:, k], pooled], dim=1))  # (C, 3 width)
            to_hands = [hand[:, None] - ahead for hand in hands[:, k].unbind(dim=1)]
            features = [*to_hands, _beside(ahead, target), _above(ahead, codes.floor), ahead - place, 3 * step]
            own = self.own(torch.cat(features, dim=-1))  # (C, N, 3 width)
            code = _gated(own + scene[:, None], self.before(code), code)
            # Add the motion of the point besides being carried.
            change = self.out(code)  # (C, N, 4)
            moved = ahead + length * change[..., :3]
            step = (moved - place) / length
            place = moved
            places.append(place)
            scales.append(change[..., 3])
        scale = 0.01 * (torch.stack(scales, dim=1) + 1).exp()
        return world(torch.stack(places, dim=1), codes.origin, codes.axes), scale

    def loss(self, scene: Scene, generator: torch.Generator) -> tuple[Tensor, dict[str, Tensor]]:
        """Return the loss of a batch, and its parts for the log: mean error, mean distortion, and likelihood.

        The distortion is the error of the distances between points: deaths differ by at most half of the largest one. Clouds are
        thinned at random, so that nothing depends on the number of visible points. The scene also has `future`
        (B, 13, carriers + n, 3) and `known` (B, 13), as `Scenes` returns it; or `known` for each point.
        """
        whole = scene["cloud"].shape[1]
        kept = int(torch.randint(64, whole + 1, (), generator=generator))
        thinned_flow = torch.cat([scene["flow"][:, :kept], scene["flow"][:, whole:]], dim=1)
        thinned = {**scene, "cloud": scene["cloud"][:, :kept], "flow": thinned_flow}
        places, scales = self(thinned)  # (B, 13, N, 3), (B, 13, N)
        future = scene["future"]
        error = ((places - future).square().sum(dim=-1) + 1e-6).sqrt()
        # The negative log-density of a Laplace distribution in three dimensions, up to a constant.
        unlikely = error / scales + 3 * (scales / UNIT).log()
        # By differences, not by matrix products, which are less exact far from the origin.
        exact = "donot_use_mm_for_euclid_dist"
        now = torch.cdist(places, places, compute_mode=exact)
        distorted = (now - torch.cdist(future, future, compute_mode=exact)).abs()

        # Points whose future is not known count neither alone nor in a pair.
        known = scene["known"].to(error)
        if known.dim() == 2:
            known = known[..., None].expand_as(error)
        weight = known / known.sum().clamp_min(1)
        distortion = (distorted * known[:, :, None]).sum(dim=-1) / known.sum(dim=-1, keepdim=True).clamp_min(1)
        sums = {"error": error, "unlikely": unlikely, "distortion": distortion}
        parts = {name: (weight * part).sum() for name, part in sums.items()}
        loss = 30 * (parts["error"] + parts["distortion"]) + 0.3 * parts["unlikely"]
        logged = {"loss": loss, **parts}
        return loss, {name: part.detach() for name, part in logged.items()}


def _two_layers(n_in: int, width: int, n_out: int) -> nn.Sequential:
    return nn.Sequential(nn.Linear(n_in, width), nn.GELU(), nn.Linear(width, n_out))


def carried(points: Tensor, before: Tensor, now: Tensor) -> Tensor:
    """Return points (B, N, 3) moved as the grippers (B, 2, 3): with their middle, and about the vertical through it."""
    return (points - before.mean(dim=1)[:, None]) @ _turns(before, now) + now.mean(dim=1)[:, None]


def _turns(before: Tensor, now: Tensor) -> Tensor:
    """Return matrices (B, 3, 3) that turn rows about the vertical as the line between grippers (B, 2, 3) turns."""
    return _frame(before)[1].mT @ _frame(now)[1]


def _hands(actions: Tensor, held: Tensor, start: Tensor) -> tuple[Tensor, Tensor]:
    """Return the grippers (C, 13, 2, 3) at the knots, which stay where they let go; and shares (C, 13) of held frames."""
    holds = held.to(actions)  # (C, 60)
    start = start.expand(len(actions), 2, 3)[:, None]
    moves = torch.cat([start, actions], dim=1).diff(dim=1)
    place = start + (moves * holds[..., None, None]).cumsum(dim=1)  # (C, 60, 2, 3)
    # Count the frames held up to each knot, from 0 before the first.
    knots = torch.tensor((0, *KNOTS), device=actions.device)
    count = torch.cat([torch.zeros_like(holds[:, :1]), holds.cumsum(dim=1)], dim=1)[:, knots]  # (C, 14)
    return place[:, knots[1:] - 1], count.diff(dim=1) / knots.diff()


def _gated(new: Tensor, old: Tensor, code: Tensor) -> Tensor:
    """Return the next code (C, N, width) of a gated recurrent unit, from new inputs and those of the old code."""
    width = code.shape[-1]
    keep, use = torch.sigmoid(new[..., width:] + old[..., width:]).chunk(2, dim=-1)
    candidate = torch.tanh(torch.addcmul(new[..., :width], use, old[..., :width]))
    return candidate.lerp(code, keep)


def _beside(points: Tensor, line: Tensor) -> Tensor:
    """Return features (B, N, 5) of points (B, N, 3) near a line (B, L + 1, 3): fading offset and place along it, and nearness."""
    start = line[:, :-1]  # (B, L, 3)
    along = line.diff(dim=1)
    square = along.square().sum(dim=-1)[:, None].clamp_min(1e-9 / UNIT**2)  # (B, 1, L)
    # Find the nearest piece of the line. Squared distances are sums of products, up to the square of the point.
    product = points @ along.mT - (start * along).sum(dim=-1)[:, None]  # (B, N, L)
    share = (product / square).clamp(0, 1)
    to_start = start.square().sum(dim=-1)[:, None] - 2 * points @ start.mT
    nearest = (to_start + share * (share * square - 2 * product)).argmin(dim=-1, keepdim=True)  # (B, N, 1)

    # The offset to its nearest place fades with the distance.
    share = share.gather(2, nearest)
    toward = start.take_along_dim(nearest, dim=1) + share * along.take_along_dim(nearest, dim=1) - points  # (B, N, 3)
    near = _nearness(toward.norm(dim=-1, keepdim=True))
    place = (nearest + share) / start.shape[1]
    return torch.cat([toward * near, place * near, near], dim=-1)


def _nearness(distance: Tensor) -> Tensor:
    """Return a number that falls from 1 towards 0 over 30 cm."""
    return (-distance * UNIT / 0.3).exp()


def _above(points: Tensor, floor: Tensor) -> Tensor:
    """Return features (B, N, 2) of points (B, N, 3) above the floor (B,): fading height and nearness."""
    height = (points[..., 2:] - floor[:, None, None]).relu()
    near = _nearness(height)
    return torch.cat([height * near, near], dim=-1)


def _reach(hands: Tensor, target: Tensor) -> Tensor:
    """Return features (B, N, 8) of a target for grippers (B, N, 3): those of its line, and its tip, fading with the square."""
    tip = target[:, -1:] - hands  # (B, N, 3)
    faded = tip / (0.1 / UNIT**2 + tip.square().sum(dim=-1, keepdim=True)).sqrt()
    return torch.cat([_beside(hands, target), faded], dim=-1)


def _behind(grippers: Tensor, tip: Tensor) -> Tensor:
    """Return whether a tip (B, 3) lies to the right of the direction from the first gripper to the second; (B,) bool."""
    across = (grippers[:, 1] - grippers[:, 0])[:, :2]
    away = (tip - grippers[:, 0])[:, :2]
    return across[:, 0] * away[:, 1] < across[:, 1] * away[:, 0]


def _renamed(grippers: Tensor, swapped: Tensor) -> Tensor:
    """Return grippers (B, K, 2, 3) in the other order where they are swapped; the cloth does not depend on their order."""
    return torch.where(swapped[:, None, None, None], grippers.flip(2), grippers)


def _frame(grippers: Tensor) -> tuple[Tensor, Tensor]:
    """Return the middle (B, 3) of grippers (B, 2, 3), and axes (B, 3, 3): level from one to the other, across, and up."""
    across = (grippers[:, 1] - grippers[:, 0])[:, :2]
    size = across.norm(dim=1, keepdim=True)
    x, y = torch.where(size > 1e-3, across / size.clamp_min(1e-6), across.new_tensor([1.0, 0.0])).unbind(dim=1)
    none = torch.zeros_like(x)
    rows = [x, y, none, -y, x, none, none, none, torch.ones_like(x)]
    return grippers.mean(dim=1), torch.stack(rows, dim=1).unflatten(1, (3, 3))


def _local(points: Tensor, origin: Tensor, axes: Tensor) -> Tensor:
    """Return points (B, ..., 3) in metres as points of a frame, in units; one frame may serve many scenes."""
    flat = points.flatten(1, -2) - origin[:, None]
    return (flat @ (axes / UNIT).mT).view_as(points)


def world(points: Tensor, origin: Tensor, axes: Tensor) -> Tensor:
    """Return points (B, ..., 3) of a frame in room coordinates, metres: the inverse of `_local`."""
    return (points.flatten(1, -2) @ (UNIT * axes) + origin[:, None]).view_as(points)
