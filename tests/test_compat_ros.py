"""Loops as messages of ROS 2: in a bag that is read back, and by a node whose ROS is a stand-in (`tests/ros.py`)."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest

pytest.importorskip("rosbags")

from ros import Rclpy, as_ros, of_rosbags, ros_type
from rosbags.highlevel import AnyReader
from test_sensors import cloud_message, image_message, ring, save_bag

from topokit import track
from topokit.cli import main
from topokit.compat import LoopMessages, listen
from topokit.io import read_clouds
from topokit.sensors import Cleaner

from conftest import polygon

RINGS = [ring(t).reshape(6, 10, 3) for t in range(3)]


def films(*numbers: int) -> list[object]:
    """Rings at 1, 2, ... seconds, as rclpy hands them to a node."""
    return [as_ros(cloud_message(RINGS[t % 3], 1 + t)) for t in numbers]


def answers(messages: list[object], **how: object) -> list[tuple[list[object], dict[str, object]]]:
    answer = LoopMessages(new=lambda kind: ros_type(kind)(), **how)
    return [(markers.markers, json.loads(text.data)) for markers, text in map(answer, messages)]


def corners(points: list[object]) -> np.ndarray:
    return np.array([[point.x, point.y, point.z] for point in points])


def test_markers_are_the_loops_that_topokit_tracks():
    states = track([Cleaner()(ring(t)) for t in range(3)], times=[1.0, 2.0, 3.0])
    found = answers(films(0, 1, 2))
    assert [told["time"] for _, told in found] == [1, 2, 3]
    for number, ((markers, told), state) in enumerate(zip(found, states, strict=True)):
        assert {**told, "frame_id": "camera"} == told
        loop = state.loops[0]
        assert [one["id"] for one in told["loops"]] == [0]
        np.testing.assert_allclose(told["loops"][0]["centre"], loop.centre, atol=1e-6)
        assert [marker.action for marker in markers] == [3] * (number == 0) + [0, 0, 0]
        cycle, killer, name = markers[-3:]
        assert [(one.ns, one.type, one.id) for one in markers[-3:]] == [
            ("cycles", 4, 0),
            ("killers", 11, 0),
            ("names", 9, 0),
        ]
        assert {one.header.frame_id for one in markers} == {"camera"}
        assert all(one.pose.orientation.w == 1 and one.color.a > 0 and one.scale.z > 0 for one in markers)
        line = corners(cycle.points)
        assert len(line) == 61
        np.testing.assert_array_equal(line[0], line[-1])
        assert {tuple(place) for place in line.round(5)} == {
            tuple(place) for place in ring(number).astype(float).round(5)
        }
        np.testing.assert_allclose(corners(killer.points).reshape(2, 3, 3), loop.killer_triangles, atol=1e-6)
        assert name.text == "loop 0"
        np.testing.assert_allclose(corners([name.pose.position])[0], loop.centre, atol=1e-6)


def test_a_loop_that_is_gone_is_deleted_and_another_has_another_number():
    blob = np.random.default_rng(0).normal(size=(60, 3)).astype(np.float32) * 0.02 + [0, 0, 1]
    messages = films(0) + [as_ros(cloud_message(blob.astype(np.float32).reshape(6, 10, 3), 2 + t)) for t in range(2)]
    found = answers(messages, alpha=0.05)
    assert [len(told["loops"]) for _, told in found] == [1, 0, 0]
    gone = [(one.ns, one.id, one.action) for one in found[1][0]]
    assert gone == [("cycles", 0, 2), ("killers", 0, 2), ("names", 0, 2)]
    assert found[2][0] == []


def test_time_that_goes_back_begins_anew_and_no_time_is_no_mistake():
    assert [told["frame"] for _, told in answers(films(1, 2, 0, 1))] == [0, 1, 0, 1]
    unstamped = [as_ros(cloud_message(points, 0)) for points in RINGS]
    assert [told["frame"] for _, told in answers([*unstamped[:2], *films(2)])] == [0, 1, 0]


def damaged(**parts: object) -> object:
    message = films(0)[0]
    for name, value in parts.items():
        setattr(message, name, value)
    return message


def with_datatype(number: int) -> object:
    message = films(0)[0]
    message.fields[0].datatype = number
    return message


BAD = {
    "its points have no x": lambda: damaged(fields=films(0)[0].fields[2:]),
    "size of buffer": lambda: damaged(data=films(0)[0].data[:50]),
    "no PointCloud2, or a damaged one: KeyError": lambda: with_datatype(99),
    "rows of 8 bytes are none of 10 points": lambda: damaged(row_step=8, height=2**31),
    "nothing is left of frame": lambda: as_ros(cloud_message(np.full((6, 10, 3), np.nan, np.float32), 1)),
    "no PointCloud2, or a damaged one: AttributeError": lambda: ros_type("std_msgs/msg/String")(data="hello"),
    "images of encoding mono8": lambda: as_ros(image_message(np.zeros((6, 10), np.uint8), 1, "mono8")),
}


@pytest.mark.parametrize("says", BAD)
def test_a_message_that_holds_no_cloud_is_refused_and_the_next_is_not(says):
    answer = LoopMessages(new=lambda kind: ros_type(kind)())
    with pytest.raises(ValueError, match=says):
        answer(BAD[says]())
    assert json.loads(answer(films(1)[0])[1].data)["loops"]


def test_options_are_those_of_the_tracker():
    with pytest.raises(ValueError, match="alpha must be"):
        LoopMessages(alpha=-1.0)
    flat = track([polygon(12)])[0]
    with pytest.raises(ValueError, match="loops are in 2 dimensions: markers are in space"):
        LoopMessages(new=lambda kind: ros_type(kind)()).of(flat, ros_type("std_msgs/msg/Header")())


# -- the shell of the node: a stand-in for rclpy, and what the node does with it --------------------------------------------


def test_a_node_answers_what_it_hears_and_outlives_what_it_refuses(monkeypatch, capsys):
    heard = films(0, 0, 1)  # the second is repeated
    rclpy = Rclpy(heard).installed(monkeypatch)
    assert main(["track", "--live", "--topic", "/camera/points", "--memory", "3"]) == 130
    assert (rclpy.topic, rclpy.asked) == ("/camera/points", {"depth": 1, "reliability": "best effort"})
    assert rclpy.calls == ["init", "shutdown"]
    assert len(rclpy.warned) == 1
    assert "is repeated: its time 1.0 s" in rclpy.warned[0]
    texts = rclpy.published["/camera/points/loops/json"]
    assert [json.loads(text.data)["time"] for text in texts] == [1, 2]
    assert [len(markers.markers) for markers in rclpy.published["/camera/points/loops"]] == [4, 3]
    assert sorted(rclpy.published) == ["/camera/points/loops", "/camera/points/loops/json"]


def test_without_ros_it_is_said_what_to_do(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "sensor_msgs", None)
    with pytest.raises(ImportError, match=r"comes with ROS 2: source its setup\.bash first"):
        listen("/camera/points", LoopMessages())
    assert main(["track", "--live", "--topic", "/camera/points"]) == 2
    assert main(["track", "--live", "--topic", "/camera/points", "--unit", "mm"]) == 2
    assert "--live reads a topic and publishes: leave out unit" in capsys.readouterr().err


# -- a bag -------------------------------------------------------------------------------------------------------------------


def test_messages_are_written_into_a_bag_that_is_read_back(tmp_path):
    """As `ros2 bag record` does with what the node publishes."""
    states = track([ring(t) for t in range(2)], times=[1.0, 2.0])
    answer = LoopMessages(new=lambda kind: ros_type(kind)())
    told = [answer.of(state, ros_type("std_msgs/msg/Header")(frame_id="camera")) for state in states]
    topics = {
        name: [of_rosbags(one) for one in part]
        for name, part in zip(("/loops", "/json"), zip(*told, strict=True), strict=True)
    }
    bag = save_bag(tmp_path / "bag", {"/points": [cloud_message(points, 1) for points in RINGS], **topics})
    with AnyReader([bag]) as reader:
        rows = [(one.topic, reader.deserialize(raw, one.msgtype)) for one, _, raw in reader.messages()]
    texts = [json.loads(message.data) for topic, message in rows if topic == "/json"]
    assert texts == [{"frame_id": "camera", **state.as_dict()} for state in states]
    cycles = [message.markers[-3] for topic, message in rows if topic == "/loops"]
    for cycle, state in zip(cycles, states, strict=True):
        np.testing.assert_array_equal(corners(cycle.points)[:-1], state.loops[0].cycle_points)
    assert len(list(read_clouds(bag))) == 3  # the topic of clouds is found among the others


def test_the_stand_in_is_as_strict_as_ros():
    point = ros_type("geometry_msgs/msg/Point")
    assert of_rosbags(point(x=1.0)).x == 1
    for wrong in ({"x": 1}, {"x": np.float32(1)}, {"w": 1.0}):
        with pytest.raises(AssertionError):
            point(**wrong)
    with pytest.raises(AssertionError):
        ros_type("visualization_msgs/msg/Marker")(points=[(0.0, 0.0, 0.0)])
