"""One PyBullet world: a cloth, two grippers that hold it, and rods to hang it on."""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .config import SimulationConfig
from .garments import Garment

__all__ = ["World"]

Array = NDArray[np.float64]
_GRAVITY = 9.8  # m/s^2


def _pybullet() -> ModuleType:
    try:
        with _silent():
            import pybullet
    except ImportError as error:
        raise ImportError("topokit.sim needs PyBullet: pip install 'topokit[sim]'") from error
    module: ModuleType = pybullet
    return module


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Send file descriptors 1 and 2 to nowhere: PyBullet's C++ side prints its build and its arguments there."""
    flush_c = ctypes.CDLL(None).fflush if os.name == "posix" else (lambda _: None)  # C keeps a buffer of its own
    sys.stdout.flush()
    sys.stderr.flush()
    saved = [os.dup(1), os.dup(2)]
    try:
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), 1)
            os.dup2(nowhere.fileno(), 2)
            yield
    finally:
        flush_c(None)
        for descriptor, copy in zip((1, 2), saved, strict=True):
            os.dup2(copy, descriptor)
            os.close(copy)


class World:
    """A PyBullet client with a garment in it; use it in a `with` block, which always disconnects.

    Parameters
    ----------
    garment : Garment
    offset : (3,) float
        Added to the garment's rest positions, metres.
    config : SimulationConfig

    Raises
    ------
    ImportError
        When PyBullet is not installed.
    """

    def __init__(self, garment: Garment, offset: Array, config: SimulationConfig) -> None:
        self._p = _pybullet()
        self._config = config
        self._targets: Array | None = None
        with _silent():
            self._client = self._p.connect(self._p.DIRECT)
        try:
            self._bullet("resetSimulation", self._p.RESET_USE_DEFORMABLE_WORLD)
            self._bullet("setGravity", 0, 0, -_GRAVITY)
            self._bullet("setPhysicsEngineParameter", fixedTimeStep=config.dt)
            self._cloth = self._load(garment, offset)
            self._grippers = [self._gripper(vertex, garment.vertices[vertex] + offset) for vertex in garment.grips]
            self._anchors = [
                self._bullet("createSoftBodyAnchor", self._cloth, int(vertex), body, -1)
                for vertex, body in zip(garment.grips, self._grippers, strict=True)
            ]
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> World:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Disconnect. PyBullet ends the process when about a thousand clients are left open."""
        if self._client >= 0:
            self._p.disconnect(physicsClientId=self._client)
            self._client = -1

    def add_rods(self, rods: list[tuple[Array, Array, float]]) -> None:
        """Add fixed capsules, each (start, end, radius)."""
        for start, end, radius in rods:
            axis = end - start
            length = float(np.linalg.norm(axis))
            shape = self._bullet("createCollisionShape", self._p.GEOM_CAPSULE, radius=radius, height=length)
            body = self._bullet(
                "createMultiBody",
                0,
                shape,
                -1,
                basePosition=((start + end) / 2).tolist(),
                baseOrientation=_turn_z_to(axis / length),
            )
            self._bullet("changeDynamics", body, -1, lateralFriction=self._config.friction)

    def step(self, targets: Array | None) -> None:
        """Advance one step of `dt`, drawing the grippers to `targets` (2, 3); None when they have let go."""
        if targets is not None:
            before = targets if self._targets is None else self._targets
            speeds = (targets - before) / self._config.dt
            for body, target, speed in zip(self._grippers, targets, speeds, strict=True):
                self._draw(body, target, speed)
            self._targets = targets.copy()
        self._bullet("stepSimulation")

    def release(self) -> None:
        """Let go of the garment; the grippers stay, without a shape that could touch it."""
        for anchor in self._anchors:
            self._bullet("removeConstraint", anchor)
        self._anchors = []

    def vertices(self) -> Array:
        """(N, 3) positions in the order of the garment's vertices."""
        _, points = self._bullet("getMeshData", self._cloth, -1, flags=self._p.MESH_DATA_SIMULATION_MESH)
        return np.array(points)

    def grippers(self) -> Array:
        """(2, 3) positions of the grippers."""
        return np.array([self._bullet("getBasePositionAndOrientation", body)[0] for body in self._grippers])

    def _bullet(self, function: str, *arguments: Any, **options: Any) -> Any:
        return getattr(self._p, function)(*arguments, **options, physicsClientId=self._client)

    def _load(self, garment: Garment, offset: Array) -> int:
        """Load the garment through a temporary OBJ file, the only way PyBullet takes a mesh."""
        lengths, stiffness = garment.edge_lengths, self._config.elastic_stiffness(len(garment.vertices))
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "cloth.obj"
            rows = [f"v {x!r} {y!r} {z!r}" for x, y, z in garment.vertices.tolist()]
            rows += [f"f {a} {b} {c}" for a, b, c in (garment.faces + 1).tolist()]
            path.write_text("\n".join(rows) + "\n")
            cloth: int = self._bullet(
                "loadSoftBody",
                str(path),
                basePosition=offset.tolist(),
                mass=self._config.mass,
                useMassSpring=1,
                useBendingSprings=1,
                useNeoHookean=0,
                springElasticStiffness=stiffness,
                springBendingStiffness=self._config.bending * stiffness,
                springDampingStiffness=self._config.damping,
                springDampingAllDirections=1,
                frictionCoeff=self._config.friction,
                useFaceContact=1,
                useSelfCollision=int(self._config.self_collision),
                collisionMargin=self._config.margin * float(lengths.min()),
            )
        return cloth

    def _gripper(self, vertex: int, place: Array) -> int:
        """A body without a shape: a kinematic or a fixed anchor body can make the cloth explode, this one does not."""
        body: int = self._bullet("createMultiBody", self._config.gripper_mass, -1, -1, basePosition=place.tolist())
        return body

    def _draw(self, body: int, target: Array, speed: Array) -> None:
        place, _ = self._bullet("getBasePositionAndOrientation", body)
        velocity, _ = self._bullet("getBaseVelocity", body)
        force = self._config.kp * (target - np.array(place)) + self._config.kd * (speed - np.array(velocity))
        carried = self._config.mass / 2 if self._anchors else 0.0  # fed forward: the error alone would let it sag
        force[2] += _GRAVITY * (self._config.gripper_mass + carried)
        size = float(np.linalg.norm(force))
        if size > self._config.max_force:
            force *= self._config.max_force / size
        self._bullet("applyExternalForce", body, -1, force.tolist(), place, self._p.WORLD_FRAME)


def _turn_z_to(axis: Array) -> list[float]:
    """Quaternion (x, y, z, w) that turns the z axis into the unit vector `axis`."""
    if axis[2] < -0.999999:
        return [1.0, 0.0, 0.0, 0.0]
    x, y, z = np.cross([0, 0, 1], axis)
    quaternion = np.array([x, y, z, 1 + axis[2]])
    turned: list[float] = (quaternion / np.linalg.norm(quaternion)).tolist()
    return turned
