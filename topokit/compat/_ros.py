"""Tracked loops as messages of ROS 2, in a bag or live.

Idea: all that a node answers is made by `LoopMessages`, which needs no ROS; `listen` is the shell around it. A message is made
empty and then filled, which classes of rclpy and of rosbags both allow. A marker keeps its number as long as its loop lives
and is deleted with it: RViz flickers when all are deleted and drawn anew.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from topokit._archive import FormatError
from topokit.sensors import Cleaner, Pipeline
from topokit.sensors._files import Asked, as_cloud, rows_of
from topokit.seqph import SeqPH
from topokit.state import TopologicalState, loop_colour

New = Callable[[str], Any]
TYPES = {"loops": "visualization_msgs/msg/MarkerArray", "loops/json": "std_msgs/msg/String"}
_ADD, _DELETE, _DELETE_ALL = 0, 2, 3
# Namespaces of markers, their types (line strip, triangles, text that faces the viewer) and sizes: metres, but of triangles.
_KINDS = {"cycles": (4, 0.006), "killers": (11, 1.0), "names": (9, 0.03)}


def of_ros(kind: str) -> Any:
    """An empty message of a type, where ROS is installed."""
    package, _, name = kind.split("/")
    return getattr(import_module(f"{package}.msg"), name)()


class LoopMessages:
    """Clouds as messages of ROS 2 in, their tracked loops as messages out: what a node answers.

    Parameters
    ----------
    pipeline : Pipeline, optional
        What is left out of a cloud, as of `topokit.sensors.Cleaner`.
    new : callable, optional
        Makes an empty message of a type such as ``"std_msgs/msg/String"``; by default of the ROS that is installed.
    **tracker
        Options of `topokit.SeqPH`.
    """

    def __init__(self, pipeline: Pipeline | None = None, *, new: New = of_ros, **tracker: Any) -> None:
        self._clean, self._new, self._options, self._tracker = Cleaner(pipeline), new, tracker, SeqPH(**tracker)
        self._time: float | None = None
        self._drawn: set[int] | None = None  # identities; none before the first answer

    def __call__(self, message: Any) -> tuple[Any, Any]:
        """Return a MarkerArray, and a String of JSON, that tell the loops in the cloud of a message, tracked so far.

        Parameters
        ----------
        message : sensor_msgs.msg.PointCloud2
            In metres. Where its time is before the last, as when a bag is played again, tracking begins anew.

        Raises
        ------
        ValueError
            It holds no cloud, or none that can follow the last; the next message may.
        """
        try:
            cloud = as_cloud(rows_of(message), Asked(), {})
        except (KeyError, TypeError, AttributeError) as error:
            raise FormatError(f"no PointCloud2, or a damaged one: {type(error).__name__} {error}") from error
        stamp = message.header.stamp
        time = stamp.sec + 1e-9 * stamp.nanosec or None  # not stamped
        if (time is None) != (self._time is None) or (time or 0) < (self._time or 0):
            self._tracker = SeqPH(**self._options)
        state, self._time = self._tracker.update(self._clean(cloud), time=time), time
        return self.of(state, message.header)

    def of(self, state: TopologicalState, header: Any) -> tuple[Any, Any]:
        """Return the same two messages for a state that is tracked already.

        Parameters
        ----------
        state : TopologicalState
            Of loops in space.
        header : std_msgs.msg.Header
        """
        here, markers = {loop.id for loop in state.loops}, []
        if self._drawn is None:
            markers.append(self._marker(header, "", 0, _DELETE_ALL))  # what an earlier node drew
        for gone in sorted((self._drawn or set()) - here):
            markers += [self._marker(header, name, gone, _DELETE) for name in _KINDS]
        for loop in state.loops:
            if len(loop.centre) != 3:
                raise ValueError(f"loop {loop.id} is in {len(loop.centre)} dimensions: markers are in space")
            cycle, killer, name = (self._marker(header, name, loop.id, _ADD) for name in _KINDS)
            cycle.points = self._points([*loop.cycle_points, loop.cycle_points[0]])
            killer.points, killer.color.a = self._points(loop.killer_triangles.reshape(6, 3)), 0.5
            name.text, name.pose.position = f"loop {loop.id}", self._points([loop.centre])[0]
            markers += [cycle, killer, name]
        array, text = map(self._new, TYPES.values())
        array.markers, text.data = markers, json.dumps({"frame_id": header.frame_id, **state.as_dict()})
        self._drawn = here
        return array, text

    def _marker(self, header: Any, name: str, number: int, action: int) -> Any:
        marker = self._new("visualization_msgs/msg/Marker")
        marker.header, marker.ns, marker.id, marker.action = header, name, int(number), action
        marker.type, size = _KINDS.get(name, (0, 1.0))
        marker.scale.x = marker.scale.y = marker.scale.z = size
        marker.pose.orientation.w = marker.color.a = 1.0
        marker.color.r, marker.color.g, marker.color.b = (byte / 255 for byte in bytes.fromhex(loop_colour(number)[1:]))
        return marker

    def _points(self, places: ArrayLike) -> list[Any]:
        kind = type(self._new("geometry_msgs/msg/Point"))
        return [kind(x=x, y=y, z=z) for x, y, z in np.asarray(places).tolist()]


def listen(topic: str, answer: LoopMessages) -> None:
    """Run a node that tracks the clouds of a topic, and publishes `topic`/loops (markers) and `topic`/loops/json.

    It takes the newest cloud, of a publisher of any reliability, and logs why it refuses one. Ctrl-C stops it.

    Parameters
    ----------
    topic : str
        Of PointCloud2.
    answer : LoopMessages
    """
    try:
        import rclpy
        from rclpy.qos import QoSProfile, ReliabilityPolicy
    except ModuleNotFoundError as error:
        raise ImportError("a topic of ROS 2 needs rclpy, which comes with ROS: source its setup.bash first") from error
    rclpy.init()
    node = rclpy.create_node("topokit")
    outs = [node.create_publisher(type(of_ros(kind)), f"{topic}/{name}", 10) for name, kind in TYPES.items()]

    def heard(message: Any) -> None:
        try:
            answers = answer(message)
        except ValueError as error:
            node.get_logger().warning(str(error), throttle_duration_sec=5.0)
            return
        for out, told in zip(outs, answers, strict=True):
            out.publish(told)

    newest = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    node.create_subscription(type(of_ros("sensor_msgs/msg/PointCloud2")), topic, heard, newest)
    try:
        rclpy.spin(node)
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
