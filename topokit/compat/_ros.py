"""Tracked loops as messages of ROS 2.

Idea: all that a node answers is made by `LoopMessages`, which needs no ROS; `listen` is the shell around it. A marker keeps its
number as long as its loop lives and is deleted with it: RViz flickers when all are deleted and drawn anew.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from importlib import import_module
from typing import Any

import numpy as np

from topokit._archive import FormatError
from topokit.sensors import Cleaner, Pipeline
from topokit.sensors._files import Asked, as_cloud, rows_of
from topokit.seqph import SeqPH, TopologicalState, loop_colour

_TYPES = {"": "visualization_msgs/msg/MarkerArray", "/json": "std_msgs/msg/String"}  # by the end of the topic
_ADD, _DELETE, _DELETE_ALL = 0, 2, 3
_KINDS = {"cycles": (4, 0.006), "killers": (11, 1.0), "names": (9, 0.03)}  # line strip, triangles, text; metres thick


def of_ros(kind: str) -> Any:
    """An empty message of a type, where ROS is installed."""
    package, _, name = kind.split("/")
    try:
        return getattr(import_module(f"{package}.msg"), name)()
    except ModuleNotFoundError as error:
        raise ImportError(f"{package} comes with ROS 2: source its setup.bash first") from error


class LoopMessages:
    """A PointCloud2 of ROS 2 in, its tracked loops out, as a MarkerArray for RViz and a String of JSON: what a node answers.

    When time goes back, as when a bag is played again, tracking begins anew. A message without a cloud that can follow gets a
    ValueError; the next is as welcome.

    Parameters
    ----------
    pipeline : Pipeline, optional
        What is left out of a cloud.
    new : callable, optional
        Makes an empty message of a type such as ``"std_msgs/msg/String"``; by default of the ROS that is installed.
    **tracker
        Options of `topokit.SeqPH`.
    """

    def __init__(self, pipeline: Pipeline | None = None, *, new: Callable[[str], Any] = of_ros, **tracker: Any) -> None:
        self._clean, self._new, self._options, self._tracker = Cleaner(pipeline), new, tracker, SeqPH(**tracker)
        self._time: float | None = None
        self._drawn: set[int] | None = None  # identities; none before the first answer

    def __call__(self, message: Any) -> tuple[Any, Any]:
        try:
            cloud = as_cloud(rows_of(message), Asked(), {})
        except (KeyError, TypeError, AttributeError) as error:
            raise FormatError(f"no PointCloud2, or a damaged one: {type(error).__name__} {error}") from error
        time = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec or None  # not stamped
        if (time is None) != (self._time is None) or (time or 0) < (self._time or 0):
            self._tracker = SeqPH(**self._options)
        state, self._time = self._tracker.update(self._clean(cloud), time=time), time
        return self.of(state, message.header)

    def of(self, state: TopologicalState, header: Any) -> tuple[Any, Any]:
        """Return the two messages of a state that is tracked already.

        Parameters
        ----------
        state, header
            Of loops in space; a std_msgs Header.
        """
        here, markers = {loop.id for loop in state.loops}, []
        markers += [self._marker(header, "", 0, _DELETE_ALL)] if self._drawn is None else []  # of an earlier node
        for gone in sorted((self._drawn or set()) - here):
            markers += [self._marker(header, name, gone, _DELETE) for name in _KINDS]
        for loop in state.loops:
            cycle, killer, name = (self._marker(header, name, loop.id, _ADD) for name in _KINDS)
            cycle.points = self._points([*loop.cycle_points, loop.cycle_points[0]])
            killer.points, killer.color.a = self._points(loop.killer_triangles.reshape(6, 3)), 0.5
            name.text, name.pose.position = f"loop {loop.id}", self._points([loop.centre])[0]
            markers += [cycle, killer, name]
        array, text = map(self._new, _TYPES.values())
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

    def _points(self, places: Any) -> list[Any]:
        kind, rows = type(self._new("geometry_msgs/msg/Point")), np.asarray(places)
        if rows.shape[1] != 3:
            raise ValueError(f"loops are in {rows.shape[1]} dimensions: markers are in space")
        return [kind(x=x, y=y, z=z) for x, y, z in rows.tolist()]


def listen(topic: str, answer: LoopMessages) -> None:
    """Run a node until Ctrl-C: the newest PointCloud2 of `topic` goes to `answer`, and what it answers to `topic`/loops.

    Parameters
    ----------
    topic, answer
        JSON is published as `topic`/loops/json. A publisher of any reliability is heard. What is refused is logged.
    """
    cloud, *kinds = (type(of_ros(kind)) for kind in ("sensor_msgs/msg/PointCloud2", *_TYPES.values()))
    import rclpy
    from rclpy.qos import QoSProfile, ReliabilityPolicy

    rclpy.init()
    node = rclpy.create_node("topokit")
    topics = (f"{topic}/loops{end}" for end in _TYPES)
    outs = [node.create_publisher(*one, 10) for one in zip(kinds, topics, strict=True)]

    def heard(message: Any) -> None:
        try:
            for out, told in zip(outs, answer(message), strict=True):
                out.publish(told)
        except ValueError as error:
            node.get_logger().warning(str(error), throttle_duration_sec=5.0)

    node.create_subscription(cloud, topic, heard, QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT))
    try:
        rclpy.spin(node)
    finally:
        rclpy.try_shutdown()
