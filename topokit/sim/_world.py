"""One PyBullet world: a cloth, two grippers that hold it, rods to hang it on, a floor; and a check of the cloth's stretch."""

from __future__ import annotations

import contextlib
import ctypes
import math
import os
import sys
import tempfile
import weakref
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from topokit._config import Count, NotNegative, Positive, checked
from topokit.sampling import farthest_point_sample

from ._camera import Camera
from ._garments import Garment
from ._surface import Array, edge_lengths

Stretch = Annotated[float, Field(gt=1)]


class SimulationError(RuntimeError):
    """A run that failed: the cloth exploded or was stretched too far, or the simulator crashed or did not progress."""


@checked
class SimulationConfig:
    """Physics, grippers and clock of a simulation, in SI units. A ValueError names a number that is out of its range.

    Each gripper is a body without a shape, drawn to its target by a force kp * error + kd * (velocity of the target -
    velocity), plus the weight it carries. An episode is refused when the 99th percentile of edge length over rest
    length exceeds `max_stretch`, or the longest edge exceeds `max_edge_stretch`. Cloth that explodes exceeds both at once; a
    vertex that is caught behind a rod stretches its own edges alone. Episodes that succeeded stayed below 1.2 and 1.8.
    """

    GRAVITY = 9.8  # m/s^2, the same in every world

    dt: Positive = 1 / 750  #: duration of a physics step, seconds
    mass: Positive = 0.3  #: mass of the garment, kg
    #: Elastic stiffness of the springs as a multiple of mass / (N dt^2), the stiffness at which a vertex of a garment of N
    #: vertices oscillates as fast as the clock can follow. 0.4 to 0.8 is cloth; above about 1.5 it buzzes, at 3 it explodes.
    stiffness: Positive = 0.8
    bending: NotNegative = 0.0003  #: bending stiffness as a share of the elastic one
    damping: NotNegative = 0.15  #: damping of the springs, in all directions
    friction: NotNegative = 1.0  #: coefficient of friction of cloth on target and cloth
    #: Collision of the garment with itself; with it an episode repeats bit by bit in a fresh process only.
    self_collision: bool = True
    margin: Positive = 0.3  #: collision margin as a share of the shortest edge
    gripper_mass: Positive = 0.1  #: mass of each gripper, kg
    kp: Positive = 200.0  #: stiffness of the grippers' springs, N/m
    kd: NotNegative = 20.0  #: damping of the grippers' springs, Ns/m
    max_force: Positive = 30.0  #: largest force of a gripper, N
    #: Number of recorded frames; when not given, the frames of the path, at least 76.
    frames: Count | None = None
    steps_per_frame: Count = 27  #: number of physics steps between two frames
    #: Time for the garment to come to rest between the grippers before the first frame, seconds.
    settle: NotNegative = 0.8
    max_stretch: Stretch = 1.8  #: largest 99th percentile of the edges' stretch
    max_edge_stretch: Stretch = 2.5  #: largest stretch of any edge

    @property
    def frame_time(self) -> float:
        """Return the time between two frames, seconds."""
        return self.dt * self.steps_per_frame

    @classmethod
    def of(cls, garment: Garment) -> SimulationConfig:
        """Return the physics of a garment of any size and resolution: it weighs 250 g a square metre.

        Idea: with springs of stiffness k = s m / (N dt^2) the mass m cancels in the strain: a strap that carries the garment
        stretches by about g dt^2 S / (s L^2), where S is the garment's size and L the length of its edges. Small or fine meshes
        are like rubber where the clock is too slow for them. So dt goes with L / sqrt(S).
        """
        area = garment.area
        mass = 0.25 * area
        shortest = float(garment.edge_lengths.min())
        usual = float(np.median(garment.edge_lengths))
        # Steps of a frame go with sqrt(S) / L, about as for the garments of the wardrobe; sqrt(S) is area**0.25. With fewer than
        # 27 of them straps tunnel, and more than 81 take long.
        steps = min(max(math.ceil(area**0.25 / usual), 27), 81)
        return cls(
            dt=0.036 / steps,  # a frame takes 36 ms
            steps_per_frame=steps,
            mass=mass,
            bending=0.0003 * (27 / steps) ** 2,  # the same acceleration at any clock
            damping=350 * mass / len(garment.vertices),
            margin=min(0.3, 0.18 * usual / shortest),  # at most 0.3 of the shortest edge, and 0.18 of the median one
        )

    def elastic_stiffness(self, n_vertices: int) -> float:
        """Return the stiffness of the springs, N/m, of a garment with this number of vertices."""
        return self.stiffness * self.mass / (n_vertices * self.dt**2)


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Discard what is written to file descriptors 1 and 2: PyBullet prints its build and its arguments there."""
    sys.stdout.flush()
    sys.stderr.flush()
    saved = [os.dup(1), os.dup(2)]
    try:
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), 1)
            os.dup2(nowhere.fileno(), 2)
            yield
    finally:
        if os.name == "posix":
            ctypes.CDLL(None).fflush(None)  # C keeps a buffer of its own
        for descriptor, copy in zip((1, 2), saved, strict=True):
            os.dup2(copy, descriptor)
            os.close(copy)


class World(contextlib.AbstractContextManager["World"]):
    """A PyBullet client with a garment in it; use it in a `with` block, which always disconnects.

    Parameters
    ----------
    garment : Garment
    offset : (3,) float
        Shift of the garment's rest positions, metres.
    config : SimulationConfig
    """

    def __init__(self, garment: Garment, offset: Array, config: SimulationConfig) -> None:
        self._garment = garment
        self._config = config
        self._goals: list[list[float]] | None = None
        with _silent():
            import pybullet

            self._p: Any = pybullet
            self._client = self._p.connect(self._p.DIRECT)
        # PyBullet ends the process when about a thousand clients are left open: a world that is dropped is closed, too.
        self.close = weakref.finalize(self, self._p.disconnect, self._client)
        self._bullet("resetSimulation", self._p.RESET_USE_DEFORMABLE_WORLD)
        self._bullet("setGravity", 0, 0, -config.GRAVITY)
        self._bullet("setPhysicsEngineParameter", fixedTimeStep=config.dt)
        self._cloth = self._load(offset)
        # Grippers without a shape: a kinematic or a fixed anchor body can make the cloth explode, these do not.
        places = (garment.vertices[garment.grips] + offset).tolist()
        self._grippers = [
            self._bullet("createMultiBody", config.gripper_mass, -1, -1, basePosition=place) for place in places
        ]
        self._anchors = [
            self._bullet("createSoftBodyAnchor", self._cloth, vertex, gripper, -1)
            for vertex, gripper in zip(garment.grips.tolist(), self._grippers, strict=True)
        ]
        # The floor is a thick slab with its top at z = 0: cloth would rest 10 cm above PyBullet's endless plane.
        slab = self._bullet("createCollisionShape", self._p.GEOM_BOX, halfExtents=[4, 4, 0.5])
        self._add_fixed(slab, basePosition=[0, 0, -0.5])

    def __exit__(self, *_: object) -> None:
        self.close()

    def add_rods(self, rods: Sequence[tuple[Array, Array, float]]) -> None:
        """Add fixed capsules, each (start, end, radius)."""
        for start, end, radius in rods:
            axis = end - start
            length = float(np.linalg.norm(axis))
            shape = self._bullet("createCollisionShape", self._p.GEOM_CAPSULE, radius=radius, height=length)
            place = ((start + end) / 2).tolist()
            self._add_fixed(shape, basePosition=place, baseOrientation=_turn_z_to(axis / length))

    def settle(self, goals: Array) -> None:
        """Let the garment come to rest between the grippers at their goals (2, 3); raise SimulationError when it explodes."""
        for step in range(round(self._config.settle / self._config.dt)):
            # A step of self-collision in exploded cloth can take minutes.
            if step % 5 == 0 and step:
                check_stretch(self._garment, self._config, self.vertices(), "settling")
            self.step(goals)

    def step(self, goals: Array | None) -> None:
        """Advance one step of `dt`, with the grippers drawn to their goals (2, 3); None when they have let go."""
        if goals is not None:
            now: list[list[float]] = goals.tolist()
            for body, goal, before in zip(self._grippers, now, self._goals or now, strict=True):
                self._draw(body, goal, before)
            self._goals = now
        self._p.stepSimulation(self._client)

    def release(self, keep: int = 0) -> None:
        """Let go of the garment with all but the first `keep` grippers; grippers have no shape that could touch it afterwards."""
        for anchor in self._anchors[keep:]:
            self._bullet("removeConstraint", anchor)
        del self._anchors[keep:]

    def vertices(self) -> Array:
        """Return (N, 3) positions in the order of the garment's vertices."""
        _, points = self._bullet("getMeshData", self._cloth, -1, flags=self._p.MESH_DATA_SIMULATION_MESH)
        return np.array(points)

    def grippers(self) -> Array:
        """Return (2, 3) positions of the grippers."""
        return np.array([self._bullet("getBasePositionAndOrientation", body)[0] for body in self._grippers])

    def image(self, camera: Camera) -> tuple[Array, NDArray[np.bool_]]:
        """Return a camera's depth (h, w) in metres, inf where nothing is, and mask (h, w) of the cloth, after the first step."""
        size = (camera.width, camera.height)
        near = camera.near
        far = camera.far
        view = self._p.computeViewMatrix(camera.eye, camera.target, camera.up)
        projection = self._p.computeProjectionMatrixFOV(camera.fov, camera.width / camera.height, near, far)
        image = self._bullet("getCameraImage", *size, view, projection, renderer=self._p.ER_TINY_RENDERER, shadow=0)
        _, _, _, buffer, bodies = image
        # The buffer is 0 at `near` and 1 at `far`.
        values = np.array(buffer, np.float64).reshape(size[::-1])
        depth = np.where(values < 1 - 1e-6, near * far / (far - (far - near) * values), np.inf)
        return depth, (np.reshape(bodies, depth.shape) == self._cloth) & np.isfinite(depth)

    def observe(self, cameras: Sequence[Camera], n: int, rng: np.random.Generator) -> Array:
        """Return `n` points (n, 3) of the cloth in the cameras' images: a farthest-point sample of all their pixels.

        When fewer are visible, they are repeated in order. When no cloth is in view, there are none: (0, 3).

        Parameters
        ----------
        cameras : sequence of Camera
            At least one camera.
        n : int
        rng : numpy.random.Generator
            Generator of the noise, for cameras with noise only.
        """
        views = []
        for camera in cameras:
            depth, mask = self.image(camera)
            if camera.noise:
                depth, mask = camera.add_noise(depth, mask, rng)
            views.append(camera.unproject(depth, mask))
        points = np.concatenate(views)
        if not len(points):
            return points
        chosen = farthest_point_sample(points, min(n, len(points)))[0]
        return np.asarray(points[np.resize(chosen, n)])

    def _bullet(self, function: str, *arguments: Any, **options: Any) -> Any:
        """Call a function of PyBullet for this client."""
        return getattr(self._p, function)(*arguments, **options, physicsClientId=self._client)

    def _add_fixed(self, shape: int, **place: list[float]) -> None:
        """Add a body that does not move."""
        body: int = self._bullet("createMultiBody", 0, shape, -1, **place)
        self._bullet("changeDynamics", body, -1, lateralFriction=self._config.friction)

    def _load(self, offset: Array) -> int:
        """Load the garment through a temporary OBJ file, because PyBullet reads meshes from files only."""
        garment = self._garment
        config = self._config
        stiffness = config.elastic_stiffness(len(garment.vertices))
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "cloth.obj"
            rows = [f"v {x!r} {y!r} {z!r}" for x, y, z in garment.vertices.tolist()]
            rows += [f"f {a} {b} {c}" for a, b, c in (garment.faces + 1).tolist()]
            path.write_text("\n".join(rows) + "\n")
            return self._bullet(
                "loadSoftBody",
                str(path),
                basePosition=offset.tolist(),
                mass=config.mass,
                useMassSpring=1,
                useBendingSprings=1,
                useNeoHookean=0,
                springElasticStiffness=stiffness,
                springBendingStiffness=config.bending * stiffness,
                springDampingStiffness=config.damping,
                springDampingAllDirections=1,
                frictionCoeff=config.friction,
                useFaceContact=1,
                useSelfCollision=int(config.self_collision),
                collisionMargin=config.margin * float(garment.edge_lengths.min()),
            )

    def _draw(self, body: int, goal: list[float], before: list[float]) -> None:
        """Push a gripper towards its goal, which was at `before` a step ago; plain floats are far quicker than arrays."""
        config = self._config
        kp = config.kp
        kd = config.kd
        dt = config.dt
        place, _ = self._p.getBasePositionAndOrientation(body, self._client)
        velocity, _ = self._p.getBaseVelocity(body, self._client)
        # A spring and a damper towards the goal. The weight of the cloth is fed forward, or the gripper sags.
        numbers = zip(goal, before, place, velocity, strict=True)
        force = [kp * (to - at) + kd * ((to - last) / dt - speed) for to, last, at, speed in numbers]
        holding = self._grippers[: len(self._anchors)]
        carried = config.mass / len(holding) if body in holding else 0.0
        force[2] += config.GRAVITY * (config.gripper_mass + carried)
        x, y, z = force
        size = math.sqrt(x * x + y * y + z * z)
        if size > config.max_force:
            force = [config.max_force / size * part for part in force]
        self._p.applyExternalForce(body, -1, force, place, self._p.WORLD_FRAME, self._client)


def check_stretch(garment: Garment, config: SimulationConfig, points: Array, where: str) -> tuple[float, float]:
    """Return the 99th percentile and the maximum of edge length over rest length, or raise SimulationError."""
    if not np.isfinite(points).all():
        raise SimulationError(f"{where}: the cloth exploded")
    stretch = edge_lengths(points, garment.edges) / garment.edge_lengths
    measured = float(np.percentile(stretch, 99)), float(stretch.max())
    for limit, most in zip(("max_stretch", "max_edge_stretch"), measured, strict=True):
        allowed = getattr(config, limit)
        if most > allowed:
            raise SimulationError(f"{where}: the cloth is stretched {most:.2f} times, beyond {limit} {allowed:g}")
    return measured


def _turn_z_to(axis: Array) -> list[float]:
    """Return the quaternion (x, y, z, w) that turns the z axis to a unit vector."""
    if axis[2] < -0.999999:
        return [1.0, 0.0, 0.0, 0.0]
    x, y, z = np.cross([0, 0, 1], axis)
    quaternion = np.array([x, y, z, 1 + axis[2]])
    return (quaternion / np.linalg.norm(quaternion)).tolist()
