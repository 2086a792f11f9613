"""The numbers of a simulation, in one place, checked and recorded with every episode."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from topokit._config import Count, NotNegative, Positive, checked

Stretch = Annotated[float, Field(gt=1)]


@checked
class SimulationConfig:
    """Physics, grippers and clock of a simulation. SI units; a ValueError names the number that is out of its range.

    Parameters
    ----------
    dt : float
        Seconds of a physics step.
    mass : float
        Of the garment, kg.
    stiffness : float
        Elastic stiffness of the springs as a multiple of mass / (N dt^2), the stiffness at which a vertex of a garment of N
        vertices oscillates as fast as the clock can follow. 0.4 to 0.8 is cloth; above about 1.5 it buzzes, at 3 it explodes.
    bending : float
        Bending stiffness as a share of the elastic one.
    damping : float
        Of the springs, in all directions.
    friction : float
        Coefficient of friction of cloth on target and cloth.
    self_collision : bool
        Whether the garment collides with itself. With it an episode repeats bit by bit in a fresh process only.
    margin : float
        Collision margin as a share of the shortest edge.
    gripper_mass, kp, kd, max_force : float
        Each gripper is a body of this mass (kg) without a shape, drawn to its target by a force
        kp * error + kd * (velocity of the target - velocity) (N/m, Ns/m), plus the weight it carries, of at most
        `max_force` newtons.
    frames : int, optional
        How many are recorded; as many as the path lasts when not given, at least 76.
    steps_per_frame : int
        Physics steps between two frames.
    settle : float
        Seconds for the garment to hang still between the grippers before the first frame.
    max_stretch, max_edge_stretch : float
        An episode is refused in which the 99th percentile of edge length over rest length exceeds the first, or the longest
        edge the second. Cloth that explodes exceeds both at once; a vertex that is caught behind a rod stretches its own
        edges alone, which a percentile does not see. Episodes that went well stayed below 1.2 and 1.8.
    """

    dt: Positive = 1 / 750
    mass: Positive = 0.3
    stiffness: Positive = 0.8
    bending: NotNegative = 0.0003
    damping: NotNegative = 0.15
    friction: NotNegative = 1.0
    self_collision: bool = True
    margin: Positive = 0.3
    gripper_mass: Positive = 0.1
    kp: Positive = 200.0
    kd: NotNegative = 20.0
    max_force: Positive = 30.0
    frames: Count | None = None
    steps_per_frame: Count = 27
    settle: NotNegative = 0.8
    max_stretch: Stretch = 1.8
    max_edge_stretch: Stretch = 2.5

    @property
    def frame_time(self) -> float:
        """Seconds between two frames."""
        return self.dt * self.steps_per_frame

    def elastic_stiffness(self, n_vertices: int) -> float:
        """Return the stiffness of the springs, N/m, of a garment of that many vertices."""
        return self.stiffness * self.mass / (n_vertices * self.dt**2)
