"""What rclpy's classes of messages hold to, without ROS: as rosidl generates them, each checks what it is given.

Made from the definitions that rosbags has. Taken from `rosidl_generator_py`: an empty message of numbers 0 and empty lists, names
as keywords, an AssertionError for a value of another kind (an int is no float), bytes as `array.array`.
"""

from __future__ import annotations

import array
import sys
import types
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
_MADE: dict[str, type] = {}


def ros_type(name: str) -> type:
    """The class of a type such as "std_msgs/msg/String"."""
    if name not in _MADE:
        fields = dict(STORE.fielddefs[name][1])
        body = {"__slots__": tuple(f"_{one}" for one in fields), "__init__": _start, "kind_": name, "told_": fields}
        body |= {one: _field(one, node.name, of) for one, (node, of) in fields.items()}
        _MADE[name] = type(name.rpartition("/")[2], (), body)
    return _MADE[name]


def _start(self: Any, **given: Any) -> None:
    assert set(given) <= set(self.told_), f"{self.kind_} has no {set(given) - set(self.told_)}"
    for one, (node, of) in self.told_.items():
        setattr(self, one, given.get(one, _default(node.name, of)))


def _default(node: str, of: Any) -> Any:
    if node == "NAME":
        return ros_type(of)()
    if node == "BASE":
        return {"string": "", "bool": False}.get(of[0], 0.0 if "float" in of[0] else 0)
    kind = of[0][1]
    return [] if of[0][0].name == "NAME" or kind[0] == "string" else array.array("B")


def _field(one: str, node: str, of: Any) -> property:
    def put(self: Any, value: Any) -> None:
        assert _fits(value, node, of), f"{self.kind_}.{one}: {value!r}"
        object.__setattr__(self, f"_{one}", value)

    return property(lambda self: getattr(self, f"_{one}"), put)


def _fits(value: Any, node: str, of: Any) -> bool:
    if node == "NAME":
        return isinstance(value, ros_type(of))
    if node == "BASE":
        whole = isinstance(value, int) and not isinstance(value, bool) and -(2**31) <= value < 2**32
        kinds = {"string": isinstance(value, str), "bool": isinstance(value, bool)}
        return kinds.get(of[0], isinstance(value, float) if "float" in of[0] else whole)
    if of[0][0].name == "NAME":
        return isinstance(value, list) and all(isinstance(part, ros_type(of[0][1])) for part in value)
    return isinstance(value, array.array)


def as_ros(message: Any) -> Any:
    """A message of rosbags as one of these."""
    parts = {}
    for one in ros_type(message.__msgtype__).told_:
        value = getattr(message, one)
        if isinstance(value, list):
            value = [as_ros(part) for part in value]
        elif isinstance(value, np.ndarray):
            value = array.array("B", value.tobytes())
        elif hasattr(value, "__msgtype__"):
            value = as_ros(value)
        parts[one] = value
    return ros_type(message.__msgtype__)(**parts)


def of_rosbags(message: Any) -> Any:
    """The way back."""
    parts = {}
    for one in message.told_:
        value = getattr(message, one)
        if isinstance(value, list):
            value = [of_rosbags(part) for part in value]
        elif isinstance(value, array.array):
            value = np.frombuffer(value, np.uint8)
        elif hasattr(value, "told_"):
            value = of_rosbags(value)
        parts[one] = value
    return STORE.types[message.kind_](**parts)


class Rclpy(types.ModuleType):
    """A node that is told some messages, each one as it comes over the wire, and keeps what it publishes."""

    def __init__(self, heard: list[Any]) -> None:
        super().__init__("rclpy")
        self.heard, self.published, self.warned, self.calls = heard, dict[str, list[Any]](), list[str](), list[Any]()
        self.qos = types.ModuleType("rclpy.qos")
        self.qos.QoSProfile = lambda **told: told
        self.qos.ReliabilityPolicy = types.SimpleNamespace(BEST_EFFORT="best effort", RELIABLE="reliable")

    def installed(self, monkeypatch: Any) -> Rclpy:
        monkeypatch.setitem(sys.modules, "rclpy", self)
        monkeypatch.setitem(sys.modules, "rclpy.qos", self.qos)
        for package in ("std_msgs", "sensor_msgs", "geometry_msgs", "visualization_msgs"):
            module = types.ModuleType(f"{package}.msg")
            module.__getattr__ = lambda name, package=package: ros_type(f"{package}/msg/{name}")
            monkeypatch.setitem(sys.modules, package, types.ModuleType(package))
            monkeypatch.setitem(sys.modules, f"{package}.msg", module)
        return self

    def init(self) -> None:
        self.calls.append("init")

    def create_node(self, name: str) -> Rclpy:
        assert self.calls == ["init"]
        return self

    def create_publisher(self, kind: type, topic: str, depth: int) -> Any:
        kept = self.published.setdefault(topic, [])

        def publish(message: Any) -> None:
            assert type(message) is kind, f"{topic} is of {kind}, not of {type(message)}"
            raw = STORE.serialize_cdr(of_rosbags(message), message.kind_)
            kept.append(STORE.deserialize_cdr(raw, message.kind_))

        return types.SimpleNamespace(publish=publish)

    def create_subscription(self, kind: type, topic: str, answer: Any, qos: dict[str, Any]) -> None:
        self.kind, self.topic, self.answer, self.asked = kind, topic, answer, qos

    def get_logger(self) -> Any:
        return types.SimpleNamespace(warning=lambda words, **how: self.warned.append(words))

    def spin(self, node: Any) -> None:
        for message in self.heard:
            assert type(message) is self.kind
            self.answer(message)
        raise KeyboardInterrupt

    def try_shutdown(self) -> None:
        self.calls.append("shutdown")
